//! The splat in a browser: one self-contained page, or a server for this machine alone, which also
//! shows a run while it works.

mod browser;
mod http;
mod picture;
pub mod server;
mod watch;
mod work;

pub(crate) use server::Serving;
pub(crate) use watch::{StagePlace, Watch};

include!(concat!(env!("OUT_DIR"), "/bundle.rs"));

use anyhow::{Context, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use scene::sim3::Sim3;
use scene::{Gaussians, Reconstruction, overview};
use serde::Serialize;
use sfm::Articulation;
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
    /// Number of its frame on the page of a run that works.
    frame: Option<usize>,
    /// Number of its frame among those by which parts move.
    time_frame: Option<usize>,
}

/// A part that turns on a joint, as the page knows it.
#[derive(Clone, Debug, Serialize)]
struct ViewPart {
    name: String,
    /// Its first Gaussian, and the first one behind it.
    first: usize,
    end: usize,
    /// Direction of the axis, unit.
    axis: [f64; 3],
    /// A place on it.
    place: [f64; 3],
    /// By frame, degrees.
    angles: Vec<f64>,
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
    splat: Option<Splat>,
    points: Points,
    cameras: Vec<ViewCamera>,
    /// Empty where nothing moves.
    parts: Vec<ViewPart>,
    up: [f64; 3],
    radius: f64,
    near: f64,
    far: f64,
    /// Whether opacity goes with the low-pass, as the splat was trained.
    antialias: bool,
    /// Scene units that one unit of the page is.
    units_of_page: f64,
    /// Where the page's origin lies in the world, scene units; the axes are the world's.
    origin_of_page: [f64; 3],
    /// Address of the report, where there is one.
    report: Option<&'static str>,
}

/// The page of a run's splat that opens from disk.
pub(crate) const PAGE: &str = "view.html";
/// The report beside a page.
const REPORT: &str = "report.html";

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

/// A run, as far as it is looked at, moved into the page's frame.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// Cameras and points; PINHOLE cameras where the splat was trained with them.
    pub model: Reconstruction,
    /// From the run's world into the page.
    page_from_world: Sim3,
    /// The splat as `.spz`, where there is one: a sixth of the bytes that a browser has to fetch,
    /// decode and sort into its textures.
    pub splat: Option<Vec<u8>>,
    /// Whether it was trained with --antialias.
    pub antialias: bool,
    /// Direction that is up.
    pub up: DVec3,
    /// What moves, and how many Gaussians of each part are in `splat`, the body first.
    moving: Option<(Articulation, Vec<usize>)>,
}

impl Run {
    /// Reads the model and the splat, which must be there; no browser should be handed it unread.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let gaussians = crate::pictures::need_splat(folder)?;
        let model = scene::io::read_model(&folder.join("undistorted/sparse/0"))?;
        anyhow::ensure!(!model.images.is_empty(), "{} has no cameras", folder.display());
        let up = crate::record::up_of(folder, &model);
        let mut run = Self::of_model(folder, &model, up);
        run.antialias = crate::pictures::trained_with_antialias(folder)?;
        let parts = crate::parts::read_moving(folder, &gaussians)?;
        let (splat, shown) = run.encode(gaussians)?;
        run.moving = parts.map(|parts| {
            let labels = crate::parts::labels(&parts);
            let count =
                |part| labels.iter().zip(&shown).filter(|(l, s)| usize::from(**l) == part && **s).count();
            let counts = (0..parts.gaussians.len()).map(count).collect();
            (parts, counts)
        });
        run.splat = Some(splat);
        Ok(run)
    }

    /// Cameras and points without a splat.
    fn of_model(folder: &Path, model: &Reconstruction, up: DVec3) -> Self {
        let page_from_world = overview::centred(model, RADIUS);
        let model = page_from_world.transform_reconstruction(model);
        Self {
            folder: folder.to_path_buf(),
            model,
            page_from_world,
            splat: None,
            antialias: false,
            up,
            moving: None,
        }
    }

    /// Gaussians of the run's world as a browser gets them, and which of them it gets.
    fn encode(&self, mut gaussians: Gaussians) -> Result<(Vec<u8>, Vec<bool>)> {
        gaussians.transform(&self.page_from_world);
        let shown: Vec<bool> = gaussians.means.iter().map(|m| m.abs().max_element() < FARTHEST).collect();
        gaussians.retain(|i| shown[i]);
        Ok((scene::io::splats::encode_spz(&gaussians).map_err(anyhow::Error::msg)?, shown))
    }

    /// The parts that move, in the page's frame.
    fn parts(&self) -> Vec<ViewPart> {
        let Some((moving, counts)) = &self.moving else { return Vec::new() };
        let ends: Vec<usize> = counts
            .iter()
            .scan(0, |sum, n| {
                *sum += n;
                Some(*sum)
            })
            .collect();
        let parts = moving.parts.iter().zip(ends.windows(2)).enumerate();
        let shown = parts.map(|(k, (part, ends))| ViewPart {
            name: format!("part {}", k + 1),
            first: ends[0],
            end: ends[1],
            axis: (self.page_from_world.rotation * DVec3::from(part.axis)).to_array(),
            place: self.page_from_world.transform(DVec3::from(part.place)).to_array(),
            angles: part.angles_deg.clone(),
        });
        shown.collect()
    }

    /// The training image of the camera with this number in the page.
    pub(crate) fn photo(&self, index: usize) -> Option<PathBuf> {
        let image = self.model.images.values().nth(index)?;
        let name = scene::io::safe_name(&image.name).ok()?;
        inside(&self.folder, &format!("undistorted/images/{name}"))
    }

    /// What the page shows. `splat`: where it comes from, if there is one.
    fn scene(&self, splat: Option<Splat>, photo: impl Fn(usize) -> Option<String>) -> ViewScene {
        let [near, far] =
            overview::depth_range(&self.model, DEPTHS[0], DEPTHS[1]).unwrap_or([0.5 * RADIUS, 2.0 * RADIUS]);
        let name = std::path::absolute(&self.folder).unwrap_or_else(|_| self.folder.clone());
        let world_from_page = self.page_from_world.inverse();
        ViewScene {
            title: name.file_name().map_or_else(|| "splat".into(), |n| n.to_string_lossy().into_owned()),
            splat,
            points: self.points(),
            cameras: self.cameras(photo),
            parts: self.parts(),
            up: self.up.to_array(),
            radius: RADIUS,
            near,
            far: far.max(near * 1.001),
            antialias: self.antialias,
            units_of_page: world_from_page.scale,
            origin_of_page: world_from_page.translation.to_array(),
            report: self.folder.join(REPORT).is_file().then_some(REPORT),
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
                    frame: None,
                    time_frame: self.moving.as_ref().and_then(|(moving, _)| moving.number(&image.name)),
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

/// A file of a folder, if it lies in it: a link that leads out of it is none.
fn inside(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name).canonicalize().ok()?;
    (path.is_file() && path.starts_with(folder.canonicalize().ok()?)).then_some(path)
}

/// Says what to do where the program holds no viewer.
fn check_bundle() -> Result<&'static [u8]> {
    BUNDLE.context("this sat-recon was built without viewer/viewer.js.gz: check it out, or run 'make viewer'")
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

/// A training image, small, as a part of the page; `None` where there is none. One that cannot be
/// read is an error: a page without it would be taken for a whole one by all later runs.
fn inline_photo(run: &Run, index: usize) -> Result<Option<String>> {
    let Some(path) = run.photo(index) else { return Ok(None) };
    let small = picture::jpeg(&scene::io::shrunk(&scene::io::load_rgb(&path)?, PHOTO_SIZE))?;
    Ok(Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(small))))
}

/// One HTML file that needs no network and no other file. `up`: where no record says it yet.
pub(crate) fn write_page(folder: &Path, target: &Path, up: Option<DVec3>) -> Result<()> {
    check_bundle()?;
    let mut run = Run::open(folder)?;
    run.up = up.unwrap_or(run.up);
    let photos = (0..run.model.images.len()).map(|i| inline_photo(&run, i)).collect::<Result<Vec<_>>>()?;
    let mut scene = run.scene(Some(Splat { url: None }), |index| photos[index].clone());
    // A run writes its report after the page.
    let is_beside = target.parent() == Some(folder);
    scene.report = is_beside.then_some(REPORT);
    let splat = STANDARD.encode(run.splat.as_deref().unwrap_or_default());
    crate::stage::write_whole(target, page(&scene, &splat, &inline_script()?)?.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};
    use scene::Gaussians;
    use scene::sim3::Sim3;
    use scene::synthetic::{SyntheticOptions, synthetic_scene};

    /// The folder of a run of a simulated scene at this scale, with three Gaussians: in the middle,
    /// beside it, at a million radii.
    fn simulated(name: &str, scale: f64) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("sat-recon-view-{name}-{scale}-{}", std::process::id()));
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
        dir
    }

    fn opened(scale: f64) -> (Run, Gaussians) {
        let dir = simulated("units", scale);
        let run = Run::open(&dir).unwrap();
        std::fs::write(dir.join("page.spz"), run.splat.as_deref().unwrap()).unwrap();
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

    #[test]
    fn no_page_is_written_without_a_photo_that_cannot_be_read() {
        let dir = simulated("photo", 1.0);
        let (page, photos) = (dir.join(PAGE), dir.join("undistorted/images"));
        let first = Run::open(&dir).unwrap().model.images.values().next().unwrap().name.clone();
        std::fs::create_dir_all(&photos).unwrap();
        std::fs::write(photos.join(&first), b"no picture").unwrap();
        let error = format!("{:#}", write_page(&dir, &page, None).unwrap_err());
        assert!(error.contains(&first) && !page.exists(), "{error}");
        std::fs::remove_file(photos.join(&first)).unwrap();
        write_page(&dir, &page, None).unwrap();
        assert!(page.is_file(), "one that is not there is left out");
        std::fs::remove_dir_all(dir).unwrap();
    }
}
