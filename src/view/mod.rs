//! The splat in a browser: one self-contained page, or a server for this machine alone.

pub mod server;

include!(concat!(env!("OUT_DIR"), "/bundle.rs"));

use anyhow::{Context, Result, bail};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use scene::{Gaussians, Reconstruction};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Longest side of a photo in the page, pixels.
const PHOTO_SIZE: u32 = 640;
/// Most points of the sparse cloud in the page.
const MOST_POINTS: usize = 30_000;

/// An input camera as the page knows it.
#[derive(Clone, Debug, Serialize)]
pub struct ViewCamera {
    name: String,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// `cam_from_world`, row-major.
    rotation: [f64; 9],
    translation: [f64; 3],
    /// Address of the photo.
    photo: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct Splat {
    /// The format, by its ending.
    name: &'static str,
    /// Where it is fetched from; not given where the page holds it.
    url: Option<&'static str>,
}

#[derive(Clone, Debug, Default, Serialize)]
struct Points {
    positions: Vec<f32>,
    colors: Vec<u8>,
}

/// What the page shows.
#[derive(Clone, Debug, Serialize)]
pub struct ViewScene {
    title: String,
    splat: Splat,
    points: Points,
    cameras: Vec<ViewCamera>,
    centre: [f64; 3],
    up: [f64; 3],
    radius: f64,
    near: f64,
    far: f64,
}

/// A finished run, as far as it is looked at.
#[derive(Debug)]
pub struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// PINHOLE cameras that the splat was trained with.
    pub model: Reconstruction,
    /// The splat, which no browser should be handed unread.
    pub gaussians: Gaussians,
}

impl Run {
    /// Reads the model; the splat must be there.
    pub fn open(folder: &Path) -> Result<Self> {
        let splat = folder.join("splat.ply");
        if !splat.is_file() {
            bail!("{} is missing; run 'sat-recon train' on this folder first", splat.display());
        }
        let model = scene::io::read_model(&folder.join("undistorted/sparse/0"))?;
        anyhow::ensure!(!model.images.is_empty(), "{} has no cameras", folder.display());
        let gaussians = scene::io::read_splat_ply(&splat)?;
        Ok(Self { folder: folder.to_path_buf(), model, gaussians })
    }

    /// The training image of the camera with this number in the page.
    pub fn photo(&self, index: usize) -> Option<PathBuf> {
        let image = self.model.images.values().nth(index)?;
        let name = scene::io::safe_name(&image.name).ok()?;
        self.inside(&format!("undistorted/images/{name}"))
    }

    /// A file of the run, if it lies in the run's folder: a link that leads out of it is none.
    pub fn inside(&self, name: &str) -> Option<PathBuf> {
        let path = self.folder.join(name).canonicalize().ok()?;
        (path.is_file() && path.starts_with(self.folder.canonicalize().ok()?)).then_some(path)
    }

    fn scene(&self, splat: Splat, photo: impl Fn(usize) -> Option<String>) -> ViewScene {
        let centres: Vec<DVec3> = self.model.images.values().map(|i| i.pose.centre()).collect();
        let points: Vec<DVec3> = self.model.points.values().map(|p| p.position).collect();
        let centre = if points.is_empty() { median(&centres) } else { median(&points) };
        let mut distances: Vec<f64> = centres.iter().map(|c| c.distance(centre)).collect();
        distances.sort_by(f64::total_cmp);
        let radius = distances[distances.len() / 2].max(1e-9);
        let up: DVec3 = self.model.images.values().map(|i| i.pose.rotation.conjugate() * -DVec3::Y).sum();
        let mut depths: Vec<f64> = points.iter().step_by(16).map(|p| p.distance(centres[0])).collect();
        depths.sort_by(f64::total_cmp);
        let depth = |q: usize, default: f64| depths.get(depths.len() * q / 100).copied().unwrap_or(default);
        let (near, far) = (depth(2, 0.5 * radius), depth(98, 2.0 * radius));
        let name = std::path::absolute(&self.folder).unwrap_or_else(|_| self.folder.clone());
        ViewScene {
            title: name.file_name().map_or_else(|| "splat".into(), |n| n.to_string_lossy().into_owned()),
            splat,
            points: self.points(),
            cameras: self.cameras(photo),
            centre: centre.to_array(),
            up: up.try_normalize().unwrap_or(-DVec3::Y).to_array(),
            radius,
            near,
            far: far.max(near * 1.001),
        }
    }

    fn cameras(&self, photo: impl Fn(usize) -> Option<String>) -> Vec<ViewCamera> {
        let images = self.model.images.values().enumerate();
        images
            .filter_map(|(index, image)| {
                let camera = self.model.cameras.get(&image.camera)?;
                let (focal, centre) = (camera.focal(), camera.principal_point());
                let rotation = glam::DMat3::from_quat(image.pose.rotation).transpose().to_cols_array();
                Some(ViewCamera {
                    name: image.name.clone(),
                    width: camera.width,
                    height: camera.height,
                    fx: focal.x,
                    fy: focal.y,
                    cx: centre.x,
                    cy: centre.y,
                    rotation,
                    translation: image.pose.translation.to_array(),
                    photo: photo(index),
                })
            })
            .collect()
    }

    fn points(&self) -> Points {
        let step = self.model.points.len().div_ceil(MOST_POINTS).max(1);
        let mut points = Points::default();
        for point in self.model.points.values().step_by(step) {
            points.positions.extend(point.position.as_vec3().to_array());
            points.colors.extend(point.rgb);
        }
        points
    }
}

fn median(points: &[DVec3]) -> DVec3 {
    let of = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    DVec3::new(of(0), of(1), of(2))
}

/// The viewer's script, or what to do without.
fn bundle() -> Result<&'static str> {
    BUNDLE.context(
        "this sat-recon was built without the viewer: install Node.js and npm, run 'make build' again",
    )
}

/// Fills the page in. What is put in cannot end its script.
fn page(scene: &ViewScene, splat: &str) -> Result<String> {
    let harmless = |text: &str| text.replace("</", "<\\/");
    let json = harmless(&serde_json::to_string(scene)?).replace("<!--", "<\\u0021--");
    let title = scene.title.replace('&', "&amp;").replace('<', "&lt;");
    let template = include_str!("../../viewer/page.html");
    let (head, rest) = template.split_once("{{title}}").context("the page has no title")?;
    let (style, rest) = rest.split_once("{{scene}}").context("the page has no scene")?;
    let (between, rest) = rest.split_once("{{splat}}").context("the page has no splat")?;
    let (before, end) = rest.split_once("{{bundle}}").context("the page has no script")?;
    Ok([head, &title, style, &json, between, splat, before, bundle()?, end].concat())
}

/// One HTML file that needs no network and no other file.
pub fn write_page(folder: &Path, target: &Path) -> Result<()> {
    bundle()?;
    let run = Run::open(folder)?;
    let photo = |index: usize| {
        let picture = scene::io::load_rgb(&run.photo(index)?).ok()?;
        Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(small_jpeg(&picture).ok()?)))
    };
    let scene = run.scene(Splat { name: "splat.ply", url: None }, photo);
    let splat = run.folder.join("splat.ply");
    let bytes = std::fs::read(&splat).with_context(|| format!("cannot read {}", splat.display()))?;
    crate::stage::write_whole(target, page(&scene, &STANDARD.encode(bytes))?.as_bytes())
}

fn small_jpeg(picture: &image::RgbImage) -> Result<Vec<u8>> {
    let (w, h) = picture.dimensions();
    let scale = (f64::from(PHOTO_SIZE) / f64::from(w.max(h))).min(1.0);
    let size = |v: u32| ((f64::from(v) * scale).round() as u32).max(1);
    let small = scene::io::resize_area(picture, size(w), size(h));
    let mut bytes = Vec::new();
    small.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 82))?;
    Ok(bytes)
}
