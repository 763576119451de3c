//! The splat in a browser: one self-contained page, or a server for this machine alone.

mod http;
pub mod server;

include!(concat!(env!("OUT_DIR"), "/bundle.rs"));

use anyhow::{Context, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use scene::{Reconstruction, overview};
use serde::Serialize;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Longest side of a photo in the page, pixels. Source: chosen by hand, never measured.
const PHOTO_SIZE: u32 = 640;
/// Most points of the sparse cloud in the page. Source: chosen by hand, never measured.
const MOST_POINTS: usize = 30_000;

/// An input camera as the page knows it.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ViewCamera {
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

/// The splat is a `.spz`; where it is fetched from, nothing where the page holds it.
#[derive(Clone, Debug, Serialize)]
struct Splat {
    url: Option<&'static str>,
}

#[derive(Clone, Debug, Default, Serialize)]
struct Points {
    positions: Vec<f32>,
    colors: Vec<u8>,
}

/// What the page shows.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ViewScene {
    title: String,
    splat: Splat,
    points: Points,
    cameras: Vec<ViewCamera>,
    up: [f64; 3],
    radius: f64,
    near: f64,
    far: f64,
    /// Whether opacity goes with the low-pass, as the splat was trained.
    antialias: bool,
}

/// Shares of the points that are nearer than the near and than the far depth of the page.
/// Source: chosen by hand, never measured.
const DEPTHS: [f64; 2] = [0.02, 0.98];
/// Median distance of the cameras from the middle of what they look at, in the page. Browsers'
/// splats are 16-bit and fixed-point numbers: this is where both are fine, whatever the units of
/// the scene are. Source: chosen by hand, never measured.
const RADIUS: f64 = 16.0;
/// Nothing is shown beyond this, in the page's units: it lies behind the far plane. Source:
/// viewer/src, the far plane.
const FARTHEST: f32 = 2000.0;

/// A finished run, as far as it is looked at, moved into the page's frame.
#[derive(Debug)]
pub(crate) struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// PINHOLE cameras that the splat was trained with.
    pub model: Reconstruction,
    /// The splat as `.spz`: a sixth of the bytes that a browser has to fetch, decode and sort into
    /// its textures.
    pub splat: Vec<u8>,
    /// Whether it was trained with --antialias.
    pub antialias: bool,
    /// Direction that is up.
    pub up: DVec3,
}

impl Run {
    /// Reads the model and the splat, which must be there; no browser should be handed it unread.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let mut gaussians = crate::pictures::need_splat(folder)?;
        let model = scene::io::read_model(&folder.join("undistorted/sparse/0"))?;
        anyhow::ensure!(!model.images.is_empty(), "{} has no cameras", folder.display());
        let page_from_world = overview::centred(&model, RADIUS);
        gaussians.transform(&page_from_world);
        let shown: Vec<bool> = gaussians.means.iter().map(|m| m.abs().max_element() < FARTHEST).collect();
        gaussians.retain(|i| shown[i]);
        let spz = scene::io::splats::encode_spz(&gaussians).map_err(anyhow::Error::msg)?;
        let model = page_from_world.transform_reconstruction(&model);
        let antialias = crate::pictures::trained_with_antialias(folder);
        let up = crate::record::up_of(folder, &model);
        Ok(Self { folder: folder.to_path_buf(), model, splat: spz, antialias, up })
    }

    /// The training image of the camera with this number in the page.
    pub(crate) fn photo(&self, index: usize) -> Option<PathBuf> {
        let image = self.model.images.values().nth(index)?;
        let name = scene::io::safe_name(&image.name).ok()?;
        self.inside(&format!("undistorted/images/{name}"))
    }

    /// A file of the run, if it lies in the run's folder: a link that leads out of it is none.
    fn inside(&self, name: &str) -> Option<PathBuf> {
        let path = self.folder.join(name).canonicalize().ok()?;
        (path.is_file() && path.starts_with(self.folder.canonicalize().ok()?)).then_some(path)
    }

    fn scene(&self, splat: Splat, photo: impl Fn(usize) -> Option<String>) -> ViewScene {
        let [near, far] =
            overview::depth_range(&self.model, DEPTHS[0], DEPTHS[1]).unwrap_or([0.5 * RADIUS, 2.0 * RADIUS]);
        let name = std::path::absolute(&self.folder).unwrap_or_else(|_| self.folder.clone());
        ViewScene {
            title: name.file_name().map_or_else(|| "splat".into(), |n| n.to_string_lossy().into_owned()),
            splat,
            points: self.points(),
            cameras: self.cameras(photo),
            up: self.up.to_array(),
            radius: RADIUS,
            near,
            far: far.max(near * 1.001),
            antialias: self.antialias,
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

/// Says what to do where the program holds no viewer.
fn check_bundle() -> Result<&'static [u8]> {
    BUNDLE.context(
        "this sat-recon was built without the viewer: install Node.js and npm, run 'make build' again",
    )
}

/// The viewer's script.
fn bundle() -> Result<String> {
    let mut script = String::new();
    flate2::read::GzDecoder::new(check_bundle()?).read_to_string(&mut script)?;
    Ok(script)
}

/// The script as a part of the page.
fn inline_script() -> Result<String> {
    Ok(format!("<script>{}</script>", bundle()?))
}

/// Fills the page in. What is put in cannot end its script. `script`: the element that runs the
/// viewer.
fn page(scene: &ViewScene, splat: &str, script: &str) -> Result<String> {
    let json = crate::report::html::json(scene)?.into_string();
    let title = maud::Render::render(&scene.title).into_string();
    let template = include_str!("../../viewer/page.html");
    let (head, rest) = template.split_once("{{title}}").context("the page has no title")?;
    let (style, rest) = rest.split_once("{{scene}}").context("the page has no scene")?;
    let (between, rest) = rest.split_once("{{splat}}").context("the page has no splat")?;
    let (before, end) = rest.split_once("{{bundle}}").context("the page has no script")?;
    Ok([head, &title, style, &json, between, splat, before, script, end].concat())
}

/// One HTML file that needs no network and no other file.
pub(crate) fn write_page(folder: &Path, target: &Path) -> Result<()> {
    check_bundle()?;
    let run = Run::open(folder)?;
    let photo = |index: usize| {
        let picture = scene::io::load_rgb(&run.photo(index)?).ok()?;
        Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(small_jpeg(&picture).ok()?)))
    };
    let scene = run.scene(Splat { url: None }, photo);
    crate::stage::write_whole(
        target,
        page(&scene, &STANDARD.encode(&run.splat), &inline_script()?)?.as_bytes(),
    )
}

fn small_jpeg(picture: &image::RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder =
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, crate::pictures::JPEG_QUALITY);
    scene::io::shrunk(picture, PHOTO_SIZE).write_with_encoder(encoder)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};
    use scene::Gaussians;
    use scene::sim3::Sim3;
    use scene::synthetic::{SyntheticOptions, synthetic_scene};

    /// Opens a run of a simulated scene at this scale, with three Gaussians: in the middle, beside
    /// it, at a million radii.
    fn opened(scale: f64) -> (Run, Gaussians) {
        let dir = std::env::temp_dir().join(format!("sat-recon-view-{scale}-{}", std::process::id()));
        std::fs::create_dir_all(dir.join("undistorted/sparse/0")).unwrap();
        let options = SyntheticOptions { num_points: 100, num_cameras: 6, ..Default::default() };
        let model = synthetic_scene(&options, 1).truth;
        let model = Sim3 { scale, ..Sim3::IDENTITY }.transform_reconstruction(&model);
        let centre = overview::centred(&model, RADIUS).inverse().translation;
        let mut g = Gaussians { sh_degree: 0, ..Default::default() };
        for x in [0.0, 0.5, 1e6] {
            g.means.push((centre + DVec3::X * x * scale).as_vec3());
            g.log_scales.push(Vec3::splat((0.1 * scale).ln() as f32));
            g.rotations.push(Quat::IDENTITY);
            g.opacity_logits.push(1.0);
            g.sh.extend([0.3; 3]);
        }
        scene::io::write_model_bin(&model, &dir.join("undistorted/sparse/0")).unwrap();
        scene::io::write_splat(&dir.join("splat.ply"), &g).unwrap();
        let run = Run::open(&dir).unwrap();
        std::fs::write(dir.join("page.spz"), &run.splat).unwrap();
        let shown = scene::io::read_splat(&dir.join("page.spz")).unwrap();
        std::fs::remove_dir_all(dir).unwrap();
        (run, shown)
    }

    #[test]
    fn a_page_is_the_same_whatever_the_units_of_the_scene() {
        let (expected, _) = opened(1.0);
        for scale in [1e-6, 1.0, 1e6] {
            let (run, shown) = opened(scale);
            assert_eq!(shown.len(), 2, "what lies behind the far plane is left out");
            assert!(shown.means[0].length() < 1e-3, "{scale}: {}", shown.means[0]);
            for (a, b) in run.model.images.values().zip(expected.model.images.values()) {
                assert!(a.pose.centre().distance(b.pose.centre()) < 1e-6, "{scale}");
            }
            let size = (shown.log_scales[0].x - shown.means[1].x.ln()).exp();
            assert!((size / 0.2 - 1.0).abs() < 0.04, "{scale}: {size}"); // .spz has 16 steps a factor of e
        }
    }
}
