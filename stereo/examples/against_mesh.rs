//! Stereo on a run's photos against the true mesh: `against_mesh RUN CASE [every=N] [NAME=NUMBER
//! ...]`.
//!
//! RUN: the output folder of a run (its `undistorted/`). CASE: a folder with `mesh.ply` and the
//! true cameras in `sparse/`. `every=N` takes every Nth photo. The other names are those of
//! `StereoSettings`. Prints processor seconds, and of depths and dense cloud how far they are from
//! the mesh; `pictures=FOLDER` writes depths, normals and errors of six views there.

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};
use scene::geometry::{Mesh, Surface, compare_points, seen_by};
use scene::sim3::{Sim3, robust_alignment};
use scene::{Camera, Pose, PosedPhoto, Progress, Reconstruction};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use stereo::{PlaneField, StereoSettings, dense_depths};

/// A photo with its matte.
struct Photo {
    camera: Camera,
    pose: Pose,
    rgb: Vec<u8>,
    mask: Option<Vec<u8>>,
}

/// The true shape, and the way into its frame.
struct Truth {
    mesh: Mesh,
    surface: Vec<DVec3>,
    mesh_from_model: Sim3,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, case, rest @ ..] = &arguments[..] else {
        return Err("against_mesh RUN CASE [NAME=NUMBER]".into());
    };
    let (mut settings, mut every, mut pictures) = (StereoSettings::default(), 1, None);
    for argument in rest {
        match argument.split_once('=').ok_or("NAME=NUMBER")? {
            ("every", n) => every = n.parse()?,
            ("pictures", folder) => pictures = Some(PathBuf::from(folder)),
            (name, number) => set(&mut settings, name, number.parse()?)?,
        }
    }
    let model = scene::io::read_model(&Path::new(run).join("undistorted/sparse/0"))?;
    let photos = photos(Path::new(run), &model, every)?;
    let views: Vec<PosedPhoto> = photos.iter().map(view).collect();
    let points: Vec<DVec3> = model.points.values().map(|p| p.position).collect();
    let before = cpu_s();
    let depths = dense_depths(&views, &points, &settings, &Progress::silent())?;
    println!("{} views of {}: {:.1} CPU s", views.len(), points.len(), cpu_s() - before);
    let truth = Truth::read(Path::new(case), &model, &photos)?;
    let pixels: usize = photos.iter().flat_map(|p| &p.mask).flatten().filter(|m| **m >= 128).count();
    let all: Vec<DVec3> = depths.fields.iter().zip(&photos).flat_map(|(f, p)| world_points(f, p)).collect();
    println!("{:.1} % of the mattes have a depth", 100.0 * all.len() as f64 / pixels.max(1) as f64);
    truth.judge("depths", &all);
    let cloud = depths.cloud(&views);
    truth.judge("dense cloud", &cloud.iter().map(|p| p.position).collect::<Vec<_>>());
    match pictures {
        Some(folder) => draw(&folder, &depths.fields, &photos, &truth),
        None => Ok(()),
    }
}

fn set(settings: &mut StereoSettings, name: &str, number: f64) -> Result<(), Box<dyn Error>> {
    match name {
        "neighbours" => settings.neighbours = number as usize,
        "best" => settings.best = number as usize,
        "levels" => settings.levels = number as u32,
        "rounds" => settings.rounds = number as u32,
        "first_rounds" => settings.first_rounds = number as u32,
        "geometric" => settings.geometric = number as f32,
        "outlines" => settings.outlines = number > 0.0,
        "hull" => settings.hull = number as f32,
        "smooth" => settings.smooth = number as f32,
        "noise" => settings.noise = number as f32,
        "sigma_grey" => settings.sigma_grey = number as f32,
        "agreeing" => settings.agreeing = number as u8,
        "witnesses" => settings.witnesses = number as usize,
        "most_cost" => settings.most_cost = number as f32,
        "px" => settings.tolerance.px = number as f32,
        "least_angle" => settings.angles_deg[0] = number,
        "most_angle" => settings.angles_deg[1] = number,
        _ => return Err(format!("no setting is called {name}").into()),
    }
    Ok(())
}

fn photos(run: &Path, model: &Reconstruction, every: usize) -> Result<Vec<Photo>, Box<dyn Error>> {
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let chosen = images.into_iter().step_by(every.max(1));
    let read = chosen.map(|image| {
        let rgb = scene::io::load_rgb(&run.join("undistorted/images").join(&image.name))?.into_raw();
        let mask = run.join("undistorted/masks").join(format!("{}.png", image.name));
        let mask = if mask.is_file() { Some(scene::io::load_mask(&mask)?.into_raw()) } else { None };
        Ok(Photo { camera: model.cameras[&image.camera].clone(), pose: image.pose, rgb, mask })
    });
    read.collect()
}

fn view(photo: &Photo) -> PosedPhoto<'_> {
    PosedPhoto { camera: &photo.camera, pose: photo.pose, rgb: &photo.rgb, mask: photo.mask.as_deref() }
}

/// The points that a view's pixels see.
fn world_points(field: &PlaneField, photo: &Photo) -> Vec<DVec3> {
    (0..field.depth.len()).filter_map(|i| world_point(field, photo, i)).collect()
}

fn world_point(field: &PlaneField, photo: &Photo, i: usize) -> Option<DVec3> {
    let (x, y) = field.place(i);
    let ray =
        (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - field.camera.principal_point()) / field.camera.focal();
    let z = f64::from(field.depth[i]);
    (z > 0.0).then(|| photo.pose.inverse().transform(ray.extend(1.0) * z))
}

impl Truth {
    fn read(case: &Path, model: &Reconstruction, photos: &[Photo]) -> Result<Self, Box<dyn Error>> {
        let mesh = scene::io::read_mesh(&case.join("mesh.ply"))?;
        let cameras = scene::io::read_truth(&case.join("sparse"))?;
        let by_name: BTreeMap<_, _> =
            cameras.images.values().map(|i| (stem(&i.name), i.pose.centre())).collect();
        let pairs = model.images.values();
        let (ours, theirs): (Vec<_>, Vec<_>) =
            pairs.filter_map(|i| Some((i.pose.centre(), *by_name.get(&stem(&i.name))?))).unzip();
        let (mesh_from_model, _) = robust_alignment(&ours, &theirs).ok_or("too few true cameras")?;
        let moved: Vec<(&Camera, Pose)> =
            photos.iter().map(|p| (&p.camera, mesh_from_model.transform_pose(&p.pose))).collect();
        let surface = seen_by(&mesh.sample(200_000, 0), &mesh, &moved, 0.005 * mesh.size());
        Ok(Self { mesh, surface, mesh_from_model })
    }

    fn judge(&self, name: &str, points: &[DVec3]) {
        // As many as tell the shares to a tenth of a per cent.
        let step = (points.len() / 200_000).max(1);
        let points: Vec<DVec3> =
            points.iter().step_by(step).map(|p| self.mesh_from_model.transform(*p)).collect();
        let Some(e) = compare_points(&points, &self.mesh, &self.surface, &[], 1.0) else { return };
        println!(
            "{name}: accuracy {:.3} / {:.3} %, completeness {:.3} / {:.3} %, precision {:.1} %, recall {:.1} %, F-score {:.1} %, at half the distance {:.1} %",
            e.accuracy_mean_pct,
            e.accuracy_median_pct,
            e.completeness_mean_pct,
            e.completeness_median_pct,
            e.precision_pct,
            e.recall_pct,
            e.f_score_pct,
            e.f_score_half_pct
        );
    }
}

fn stem(name: &str) -> String {
    Path::new(name).file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

/// Photo, normals, errors (blue: below 0.25 % of the size; green to red: up to 2 %) and costs.
fn draw(folder: &Path, fields: &[PlaneField], photos: &[Photo], truth: &Truth) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let triangles = Surface::new(&truth.mesh);
    for k in (0..fields.len()).step_by((fields.len() / 6).max(1)) {
        let (field, photo) = (&fields[k], &photos[k]);
        let (w, n) = (field.width as u32, field.depth.len());
        let mut picture = RgbImage::new(4 * w, n as u32 / w.max(1));
        for i in 0..n {
            let (x, y) = (i as u32 % w, i as u32 / w);
            let (column, row) = field.place(i);
            let at = 3 * (row * field.camera.width as usize + column);
            picture.put_pixel(x, y, Rgb([0, 1, 2].map(|c| photo.rgb[at + c])));
            let likeness = (255.0 * (1.0 - field.cost[i].clamp(0.0, 1.0))) as u8;
            picture.put_pixel(x + 3 * w, y, Rgb([likeness; 3]));
            let Some(p) = world_point(field, photo, i) else { continue };
            let normal = field.normal[i].to_array();
            picture.put_pixel(x + w, y, Rgb(normal.map(|v| ((0.5 - 0.5 * v) * 255.0) as u8)));
            let off = 100.0 * triangles.distance(truth.mesh_from_model.transform(p)) / truth.mesh.size();
            let red = (255.0 * (off / 2.0).min(1.0)) as u8;
            picture.put_pixel(x + 2 * w, y, Rgb([red, 255 - red, if off < 0.25 { 255 } else { 0 }]));
        }
        picture.save(folder.join(format!("{k:03}.png")))?;
    }
    Ok(())
}

/// Processor time of this process so far, seconds (0 where the system does not tell).
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = text.rsplit(')').next().into_iter().flat_map(|rest| rest.split_whitespace().skip(11).take(2));
    ticks.filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}
