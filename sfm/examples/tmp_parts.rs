//! tmp
use std::path::Path;
fn main() {
    let run = std::env::args().nth(1).unwrap();
    let run = Path::new(&run);
    let v: serde_json::Value = serde_json::from_slice(&std::fs::read(run.join(".stages/frames.json")).unwrap()).unwrap();
    let mut f: scene::FrameSet = serde_json::from_value(v["value"].clone()).unwrap();
    for x in &mut f.frames { x.path = run.join(&x.path); x.mask = x.mask.as_ref().map(|m| run.join(m)); }
    let model = scene::io::read_model(&run.join("sparse/0")).unwrap();
    let mut model = model;
    if let Some(t) = std::env::args().nth(2).filter(|t| t != "-") {
        model = scene::io::read_model(Path::new(&t)).unwrap();
        for k in 0..8u64 { let q = |b: u64| if k >> b & 1 == 1 { 0.3 } else { -0.3 };
            model.points.insert(k, scene::ScenePoint { position: glam::DVec3::new(q(0), q(1), q(2)), rgb: [0; 3], error_px: 0.0, track: vec![] }); }
        println!("camera {:?}", model.cameras);
    }
    let (a, corrected) = sfm::moving_parts(&f, &model, &sfm::KltConfig::default(), 0, &scene::Progress::silent()).unwrap();
    for p in &a.parts { println!("{} tracks {:?} place {:?} axis ± {:.2} turn {:.1} rms {:.2} still {:.2}", p.tracks, p.axis, p.place, p.axis_sigma_deg, p.angles_deg.last().unwrap(), p.error_px, p.still_error_px); }
    std::fs::create_dir_all(run.join("sparse_parts")).unwrap();
    scene::io::write_model_bin(&corrected, &run.join("sparse_parts")).unwrap();
    println!("points {} of {}", corrected.points.len(), model.points.len());
    println!("noise {} tracks {} unexplained {}", a.noise_px, a.tracks, a.unexplained);
    if let Some(out) = std::env::args().nth(3) {
        std::fs::create_dir_all(&out).unwrap();
        for (k, fr) in f.frames.iter().enumerate() {
            let mut m = image::open(fr.mask.as_ref().unwrap()).unwrap().to_luma8();
            let Some(im) = model.images.values().find(|i| i.name == fr.name) else { continue };
            let cam = &model.cameras[&im.camera];
            for p in &a.parts {
                let pose = p.pose(k).unwrap();
                for x in &p.points {
                    let Some(q) = cam.project(im.pose.transform(pose.transform(glam::DVec3::from(*x)))) else { continue };
                    for dy in -14i32..=14 { for dx in -14i32..=14 { let (x, y) = (q.x as i32 + dx, q.y as i32 + dy);
                        if x >= 0 && y >= 0 && (x as u32) < m.width() && (y as u32) < m.height() && dx * dx + dy * dy < 200 { m.put_pixel(x as u32, y as u32, image::Luma([0])); } } }
                }
            }
            m.save(Path::new(&out).join(&fr.name)).unwrap();
        }
    }
    std::fs::write(run.join("parts.json"), serde_json::to_vec(&a).unwrap()).unwrap();
}
