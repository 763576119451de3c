//! Trains a splat on a posed data set (`images/` and a model) and renders its held-out views:
//! `train_and_render DATASET OUT`.

use scene::Progress;
use splat::{Dataset, DatasetConfig, RenderOptions, Renderer, TrainConfig, train};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dataset, out] = &arguments[..] else { return Err("give a data set and a folder to write".into()) };
    for (name, psnr) in run(Path::new(dataset), Path::new(out), &TrainConfig::default())? {
        println!("{name}: {psnr:.2} dB");
    }
    Ok(())
}

/// Writes `splat.ply` and a picture of each held-out view; PSNR by view.
fn run(folder: &Path, out: &Path, config: &TrainConfig) -> Result<Vec<(String, f64)>, Box<dyn Error>> {
    // Any `ProgressSink` shows how far it is; this one says nothing.
    let progress = Progress::silent();
    let model = scene::io::find_model(folder).ok_or("no COLMAP model in the data set")?;
    let model = scene::io::read_model(&model)?;
    // Every 8th view by name is held out.
    let dataset = Dataset::load(&folder.join("images"), None, &model, &DatasetConfig::default(), &progress)?;
    let result = train(&dataset, config, None, &progress)?;
    std::fs::create_dir_all(out)?;
    scene::io::write_splat_ply(&out.join("splat.ply"), &result.gaussians)?;

    let mut renderer = Renderer::new(&result.gaussians)?;
    let mut scores = Vec::new();
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let render = renderer.render(&view.camera, &view.pose, &RenderOptions::default())?.rgb.to_rgb8();
        let photo = scene::io::load_rgb(&folder.join("images").join(&view.name))?;
        scores.push((view.name.clone(), scene::metrics::psnr(&render, &photo, None)?));
        render.save(out.join(&view.name).with_extension("png"))?;
    }
    Ok(scores)
}

#[test]
fn a_ring_of_photos_becomes_a_splat_that_shows_what_was_held_out() {
    use scene::CameraModel::SimplePinhole;
    use scene::synthetic::{TexturedScene, default_camera, photo_ring};
    let folder = std::env::temp_dir().join(format!("sat-recon-train-and-render-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("images")).unwrap();
    let camera = default_camera(SimplePinhole, 128, 96);
    let scene = TexturedScene::default();
    let (photos, mut model) = photo_ring(&scene, &camera, 16, 22.5);
    for (photo, image) in photos.iter().zip(model.images.values()) {
        photo.save(folder.join("images").join(&image.name)).unwrap();
    }
    // Points on the surface, as structure from motion would find them.
    let views: Vec<_> = model.images.values().map(|i| i.pose).collect();
    for (k, pose) in views.iter().enumerate() {
        for pixel in
            (0..96 * 128).step_by(97).map(|i| glam::DVec2::new(f64::from(i % 128), f64::from(i / 128)))
        {
            let Some(depth) = scene.depth(&camera, pose, pixel) else { continue };
            let position = pose.inverse().transform(camera.unproject(pixel).extend(1.0) * depth);
            let rgb = photos[k].get_pixel(pixel.x as u32, pixel.y as u32).0;
            let point = scene::ScenePoint { position, rgb, error_px: 0.0, track: vec![] };
            model.points.insert(model.points.len() as u64 + 1, point);
        }
    }
    add_tracks(&mut model);
    scene::io::write_model_bin(&model, &folder.join("sparse/0")).unwrap();
    let config = TrainConfig { iterations: 200, max_gaussians: 4000, ..TrainConfig::default() };
    let scores = run(&folder, &folder.join("out"), &config).unwrap();
    assert_eq!(scores.len(), 2);
    for (name, psnr) in scores {
        assert!(psnr > 18.0, "{name}: {psnr:.2} dB");
        assert!(folder.join("out").join(name).is_file());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// A model's points need two sightings each.
#[cfg(test)]
fn add_tracks(model: &mut scene::Reconstruction) {
    for (&id, point) in &mut model.points {
        for image in [1, 2] {
            let observations = &mut model.images.get_mut(&image).expect("two images").observations;
            point.track.push(scene::TrackElement { image, observation: observations.len() as u32 });
            observations.push(scene::Observation { pixel: glam::DVec2::ZERO, point: Some(id) });
        }
    }
}
