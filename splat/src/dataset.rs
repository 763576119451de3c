//! The images in memory and the normalised frame in which the trainer works.

pub(crate) mod joint;

pub(crate) use joint::{Joint, JointPlace};

use crate::error::SplatError;
use crate::parts::{MOST_PARTS, PartPlace, PartPlaces};
use crate::quantile::median;
use crate::view::{PinholeView, level_size};
use clap::{Args, ValueEnum};
use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;
use scene::{Camera, CameraModel, Gaussians, PosedImage, Progress, Reconstruction};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What a mask or an alpha channel means in training.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlphaMode {
    /// Nothing is there: the background shows through
    Transparent,
    /// Anything may be there: the pixels do not count
    Ignore,
}

/// What the splat is trained on.
#[derive(Args, Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DatasetConfig {
    /// What masks and alpha channels mean in training
    #[arg(long, value_enum, default_value_t = AlphaMode::Transparent, help_heading = "Splat")]
    pub alpha: AlphaMode,
    /// Hold out every Nth view by sorted name for evaluation (0: none)
    /// [default: the data set's own split, else 8]
    #[arg(long, value_name = "N", help_heading = "Splat")]
    pub test_every: Option<usize>,
    /// Hold out all views from within so many degrees instead, around the first by name
    #[arg(
        long,
        value_name = "DEG",
        conflicts_with = "test_every",
        value_parser = clap::value_parser!(u16).range(1..=180),
        help_heading = "Splat"
    )]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub test_sector: Option<u16>,
    /// Names of the views that are held out by `test_sector` or by the data set's own split; empty
    /// where there is neither.
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub test_views: BTreeSet<String>,
}

/// Every how manieth view is held out. Source: Kerbl et al. 2023 (as Mip-NeRF 360 does).
const TEST_EVERY: usize = 8;
/// What lies so near to the edge of a matte may be on either side, pixels: mattes and poses are no
/// more exact, and a rod is no wider. Source: docs/decisions/16.
pub(crate) const MATTE_MARGIN_PX: usize = 2;
/// Cameras that lie nearer to each other than this share of the points' distance stand at one
/// place.
/// Source: chosen by hand, never measured.
const AT_ONE_PLACE: f64 = 0.02;
/// Resolutions kept of each view: full to 1/8. Source: `--coarse-levels` is 2 by default.
pub(crate) const LEVELS: u32 = 4;

/// Colour of points that have none yet. Source: any will do.
const GREY: [u8; 3] = [128; 3];

impl Default for DatasetConfig {
    fn default() -> Self {
        Self {
            alpha: AlphaMode::Transparent,
            test_every: None,
            test_sector: None,
            test_views: BTreeSet::new(),
        }
    }
}

impl DatasetConfig {
    /// Every how manieth view is held out; `None` where [`Self::test_views`] says which.
    pub fn every(&self) -> Option<usize> {
        let has_split = self.test_every.is_none() && !self.test_views.is_empty();
        (!has_split).then(|| self.test_every.unwrap_or(TEST_EVERY))
    }

    /// Whether the view of this name, with this place among all, sorted by name, is held out (a
    /// view that is alone is not).
    pub fn holds_out(&self, name: &str, index: usize, views: usize) -> bool {
        match self.every() {
            None => self.test_views.contains(name),
            Some(every) => every > 0 && views > 1 && index.is_multiple_of(every),
        }
    }
}

/// The pixels of a view at one resolution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pixels {
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
    /// [height × width × 3] sRGB, straight (not premultiplied) where there is a mask.
    pub rgb: Vec<u8>,
    /// [height × width] mask or alpha, white = keep.
    pub mask: Option<Vec<u8>>,
}

impl Pixels {
    /// Makes black what the mask cuts out entirely. Pages of zeros that nobody has written to take
    /// no memory: what lies above and below an object costs nothing.
    fn clear(&mut self) {
        let Some(mask) = &mut self.mask else { return };
        let (mut rgb, mut kept) = (vec![0; self.rgb.len()], vec![0; mask.len()]);
        for i in (0..mask.len()).filter(|&i| mask[i] > 0) {
            kept[i] = mask[i];
            rgb[3 * i..3 * i + 3].copy_from_slice(&self.rgb[3 * i..3 * i + 3]);
        }
        (self.rgb, *mask) = (rgb, kept);
    }
}

/// A posed image.
#[derive(Clone, Debug)]
pub struct View {
    /// File name in the model.
    pub name: String,
    /// The camera as the model has it.
    pub camera: Camera,
    /// The pose as the model has it (`cam_from_world`, world frame).
    pub pose: scene::Pose,
    /// The camera and pose in the normalised frame.
    pub view: PinholeView,
    /// Pixels at full, half, quarter … resolution.
    pub levels: Vec<Pixels>,
    /// Whether it is held out.
    pub held_out: bool,
}

/// `x_normalised = scale · (x_world − centre)`: the cameras' mean centre becomes the origin and the
/// farthest camera lies at distance 1 (with one camera: the points' median distance is 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NormalisedFrame {
    /// World frame, scene units.
    pub centre: DVec3,
    /// Normalised units a scene unit.
    pub scale: f64,
}

/// What moves in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MovingParts {
    /// A joint for each part.
    pub joints: Vec<Joint>,
    /// The part of each point of the cloud, 0: the body.
    pub of_points: Vec<u8>,
    /// When each view was taken; the usual time between two frames is 1.
    pub times: Vec<f64>,
    /// How many Gaussians the body has, and each part after it, once they are trained.
    pub gaussians: Vec<usize>,
}

impl MovingParts {
    /// Where the parts stand in a view where the angles are these, one for each joint.
    pub(crate) fn places(&self, angles: impl Iterator<Item = f64>) -> PartPlaces {
        self.joints.iter().zip(angles).map(|(joint, angle)| joint.at().place_at(angle)).collect()
    }
}

/// Everything training needs.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Sorted by name.
    pub views: Vec<View>,
    /// The sparse cloud in the normalised frame.
    pub points: Vec<(Vec3, [u8; 3])>,
    /// Normalised from world.
    pub normalisation: NormalisedFrame,
    /// What masks mean.
    pub alpha: AlphaMode,
    /// What moves against the body; the views say where it stands.
    pub articulation: Option<MovingParts>,
}

impl Dataset {
    /// Loads the images of a reconstruction (PINHOLE or SIMPLE_PINHOLE cameras), with the masks of
    /// `mask_dir` (`a.png`, `a.jpg.png` or `a.mask.png` for `a.jpg`) or, failing that, the images'
    /// alpha channels.
    pub fn load(
        image_dir: &Path,
        mask_dir: Option<&Path>,
        model: &Reconstruction,
        config: &DatasetConfig,
        progress: &Progress,
    ) -> Result<Self, SplatError> {
        let mut images: Vec<&PosedImage> = model.images.values().collect();
        images.sort_by(|a, b| a.name.cmp(&b.name));
        progress.begin("load images", images.len());
        let normalisation = NormalisedFrame::of(model);
        let load = |(index, image): (usize, &&PosedImage)| {
            let held_out = config.holds_out(&image.name, index, images.len());
            let mut view = load_view(image_dir, mask_dir, model, image, &normalisation, held_out)?;
            progress.tick()?;
            if config.alpha == AlphaMode::Transparent {
                view.levels.iter_mut().for_each(Pixels::clear);
            }
            Ok(view)
        };
        let views = images.par_iter().enumerate().map(load).collect::<Result<Vec<_>, SplatError>>()?;
        if views.iter().all(|v| v.held_out) {
            return Err(SplatError::TooFewViews(0));
        }
        if let Some(folder) = mask_dir
            && views.iter().all(|v| v.levels[0].mask.is_none())
        {
            return Err(SplatError::NoMasks { images: views.len(), folder: folder.to_owned() });
        }
        let points = model.points.values().map(|p| (normalisation.point(p.position), p.rgb)).collect();
        Ok(Self { views, points, normalisation, alpha: config.alpha, articulation: None })
    }

    /// Adds parts that move (world frame) with points on them, by part, and where they stand in
    /// each view; parts beyond the most that there may be are left out.
    pub fn articulate(&mut self, mut moving: MovingParts, points: &[Vec<DVec3>]) {
        moving.joints.truncate(MOST_PARTS);
        moving.of_points = vec![0; self.points.len()];
        for (part, (joint, points)) in (1..).zip(moving.joints.iter_mut().zip(points)) {
            joint.place = self.normalisation.point(joint.place).as_dvec3();
            joint.unsure[1] *= self.normalisation.scale;
            self.points.extend(points.iter().map(|&x| (self.normalisation.point(x), GREY)));
            moving.of_points.resize(self.points.len(), part);
        }
        self.place_parts(moving);
    }

    /// The same in the frame of the Gaussians, without points.
    pub(crate) fn place_parts(&mut self, moving: MovingParts) {
        for (index, view) in self.views.iter_mut().enumerate() {
            view.view.parts = moving.places(moving.joints.iter().map(|joint| joint.angles[index]));
        }
        self.articulation = Some(moving);
    }

    /// Indices of the views to train on.
    pub fn training_views(&self) -> Vec<usize> {
        (0..self.views.len()).filter(|&i| !self.views[i].held_out).collect()
    }

    /// Whether a background shows through somewhere.
    pub fn is_transparent(&self) -> bool {
        self.alpha == AlphaMode::Transparent && self.views.iter().any(|v| v.levels[0].mask.is_some())
    }
}

impl NormalisedFrame {
    /// Of a reconstruction: from its cameras, from its points where the cameras stand at one place.
    pub fn of(model: &Reconstruction) -> Self {
        let centres: Vec<DVec3> = model.images.values().map(|i| i.pose.centre()).collect();
        let n = centres.len().max(1) as f64;
        let centre = centres.iter().sum::<DVec3>() / n;
        let radius = centres.iter().map(|c| c.distance(centre)).fold(0.0, f64::max);
        let distances = model.points.values().map(|p| p.position.distance(centre)).collect();
        let size = match median(distances) {
            Some(median) if radius <= AT_ONE_PLACE * median => median,
            _ => radius,
        };
        let scale = if size > 0.0 && size.is_finite() { 1.0 / size } else { 1.0 };
        Self { centre, scale }
    }

    /// A motion of the world.
    pub(crate) fn part_place(&self, motion: &scene::Pose) -> PartPlace {
        let r = motion.matrix();
        let translation = (r * self.centre + motion.translation - self.centre) * self.scale;
        PartPlace { rotation: mat3(r), translation: translation.as_vec3() }
    }

    /// A point of the world.
    pub(crate) fn point(&self, x: DVec3) -> Vec3 {
        ((x - self.centre) * self.scale).as_vec3()
    }

    /// A camera of the world (pinhole).
    pub fn view(&self, camera: &Camera, pose: &scene::Pose) -> PinholeView {
        let r = pose.matrix();
        let (f, c) = (camera.focal().as_vec2(), camera.principal_point().as_vec2());
        PinholeView {
            rotation: mat3(r),
            translation: ((r * self.centre + pose.translation) * self.scale).as_vec3(),
            focal: f.to_array(),
            centre: c.to_array(),
            width: camera.width as usize,
            height: camera.height as usize,
            parts: PartPlaces::NONE,
        }
    }

    /// Gaussians of the normalised frame in the world.
    pub(crate) fn denormalise(&self, mut g: Gaussians) -> Gaussians {
        let shift = self.scale.ln() as f32;
        for mean in &mut g.means {
            *mean = (mean.as_dvec3() / self.scale + self.centre).as_vec3();
        }
        g.log_scales.iter_mut().for_each(|s| *s -= Vec3::splat(shift));
        g
    }

    /// Gaussians of the world in the normalised frame.
    pub fn normalise(&self, mut g: Gaussians) -> Gaussians {
        let shift = self.scale.ln() as f32;
        g.means.iter_mut().for_each(|mean| *mean = self.point(mean.as_dvec3()));
        g.log_scales.iter_mut().for_each(|s| *s += Vec3::splat(shift));
        g
    }
}

fn mat3(m: DMat3) -> Mat3 {
    Mat3::from_cols(m.x_axis.as_vec3(), m.y_axis.as_vec3(), m.z_axis.as_vec3())
}

fn pinhole_camera<'a>(model: &'a Reconstruction, image: &PosedImage) -> Result<&'a Camera, SplatError> {
    let Some(camera) = model.cameras.get(&image.camera) else {
        return Err(SplatError::NotPinhole {
            name: image.name.clone(),
            camera: image.camera,
            model: "missing",
        });
    };
    match camera.model {
        CameraModel::Pinhole | CameraModel::SimplePinhole => Ok(camera),
        _ if camera.distortion().iter().all(|&k| k == 0.0) => Ok(camera),
        other => {
            Err(SplatError::NotPinhole { name: image.name.clone(), camera: camera.id, model: other.name() })
        }
    }
}

fn load_view(
    image_dir: &Path,
    mask_dir: Option<&Path>,
    model: &Reconstruction,
    image: &PosedImage,
    frame: &NormalisedFrame,
    held_out: bool,
) -> Result<View, SplatError> {
    let camera = pinhole_camera(model, image)?;
    let pixels = load_pixels(image_dir, mask_dir, image, camera)?;
    Ok(View {
        name: image.name.clone(),
        camera: camera.clone(),
        pose: image.pose,
        view: frame.view(camera, &image.pose),
        levels: pyramid(pixels),
        held_out,
    })
}

fn load_pixels(
    image_dir: &Path,
    mask_dir: Option<&Path>,
    image: &PosedImage,
    camera: &Camera,
) -> Result<Pixels, SplatError> {
    let relative = Path::new(scene::io::safe_name(&image.name)?);
    let loaded = scene::io::load_image(&image_dir.join(relative))?;
    let found = loaded.rgb.dimensions();
    let expected = (camera.width, camera.height);
    if found != expected {
        return Err(SplatError::ImageSize { name: image.name.clone(), found, expected });
    }
    let mask = match mask_dir.and_then(|dir| mask_path(dir, relative)) {
        Some(path) => {
            let mask = scene::io::load_mask(&path)?;
            if mask.dimensions() != expected {
                let name = format!("the mask of {}", image.name);
                return Err(SplatError::ImageSize { name, found: mask.dimensions(), expected });
            }
            Some(mask.into_raw())
        }
        None => loaded.alpha.map(|a| a.into_raw()).filter(|a| a.iter().any(|&v| v < 255)),
    };
    Ok(Pixels { width: found.0 as usize, height: found.1 as usize, rgb: loaded.rgb.into_raw(), mask })
}

/// The mask of an image in the namings in use: `a.png`, `a.jpg.png`, `a.mask.png`, or the same
/// name.
fn mask_path(dir: &Path, relative: &Path) -> Option<PathBuf> {
    let name = relative.to_string_lossy().into_owned();
    let stem = relative.with_extension("").to_string_lossy().into_owned();
    [format!("{name}.png"), format!("{stem}.png"), format!("{stem}.mask.png"), name]
        .iter()
        .map(|n| dir.join(n))
        .find(|p| p.is_file())
}

/// Full, half, quarter … resolution.
pub fn pyramid(full: Pixels) -> Vec<Pixels> {
    let mut levels = vec![full];
    for level in 1..LEVELS {
        let next = shrink(&levels[0], level);
        levels.push(next);
    }
    levels
}

/// Area average over blocks of 2^level pixels; colours weighted with the mask, so that what is
/// transparent does not bleed in.
pub(crate) fn shrink(full: &Pixels, level: u32) -> Pixels {
    let (width, height) = (level_size(full.width, level), level_size(full.height, level));
    let mut rgb = Vec::with_capacity(width * height * 3);
    let mut mask = full.mask.as_ref().map(|_| Vec::with_capacity(width * height));
    for y in 0..height {
        let rows = block(y, height, full.height);
        for x in 0..width {
            let (colour, cover) = mean_of_block(full, rows.clone(), block(x, width, full.width));
            rgb.extend(colour);
            if let Some(mask) = &mut mask {
                mask.push(cover);
            }
        }
    }
    Pixels { width, height, rgb, mask }
}

/// The pixels of a side of `full` that make pixel `i` of `small`, at least one.
fn block(i: usize, small: usize, full: usize) -> Range<usize> {
    let start = i * full / small;
    start..((i + 1) * full / small).max(start + 1)
}

/// Mean colour, weighted with the mask unless that is black, and mean of the mask (white without
/// one).
fn mean_of_block(full: &Pixels, rows: Range<usize>, columns: Range<usize>) -> ([u8; 3], u8) {
    let (mut sum, mut weight, mut plain, mut count) = ([0u32; 3], 0u32, [0u32; 3], 0u32);
    for i in rows.flat_map(|r| columns.clone().map(move |c| r * full.width + c)) {
        let w = full.mask.as_ref().map_or(255, |m| u32::from(m[i]));
        weight += w;
        count += 1;
        for c in 0..3 {
            sum[c] += w * u32::from(full.rgb[i * 3 + c]);
            plain[c] += u32::from(full.rgb[i * 3 + c]);
        }
    }
    let (sum, w) = if weight > 0 { (sum, weight) } else { (plain, count) };
    (sum.map(|s| ((s + w / 2) / w) as u8), ((weight + count / 2) / count) as u8)
}

#[cfg(test)]
mod tests;
