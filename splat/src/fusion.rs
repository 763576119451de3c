//! A triangle mesh of Gaussians: their surface as the input cameras see it, fused.
//!
//! Depths at half transmittance ([`crate::surface`]) of the input views, or depths that were
//! measured otherwise, the photos' colours, truncated signed distances, marching cubes
//! ([`scene::geometry::fuse`]); the way of 2DGS (Huang et al., SIGGRAPH 2024, section 4.3).
//!
//! ```no_run
//! use scene::{Gaussians, Progress};
//! use splat::fusion::{self, DepthSource};
//! use splat::Dataset;
//!
//! # fn mesh(gaussians: &Gaussians, dataset: &Dataset) -> Result<(), splat::SplatError> {
//! let (voxels, progress) = (fusion::DEFAULT_RESOLUTION, Progress::silent());
//! let depths = DepthSource::Splat { gaussians, antialias: false };
//! let mesh = fusion::fused_mesh(&depths, dataset, voxels, &progress)?;
//! println!("{} triangles", mesh.triangles.len());
//! # Ok(())
//! # }
//! ```

use crate::dataset::{AlphaMode, Dataset, MATTE_MARGIN_PX, Pixels, View};
use crate::error::SplatError;
use crate::outline::thin_parts;
use crate::quantile::{median, quantile};
use crate::reference::constants::DEFAULT_NEAR;
use crate::surface::median_depth;
use glam::DVec3;
use rayon::prelude::*;
use scene::geometry::{DepthMap, FusionOptions, Mesh, fuse};
use scene::sim3::Sim3;
use scene::{Camera, Gaussians, Pose, Progress};

/// Most voxels along the longest side of the object, unless asked for otherwise. Source:
/// docs/decisions/16.
pub const DEFAULT_RESOLUTION: u32 = 400;

/// How views are fused.
struct FusionLimits {
    /// Most views that are fused, spread evenly. Source: chosen by hand, never measured.
    most_views: usize,
    /// A voxel is at least so many pixels of the surface wide: seen aslant, pixels lie farther
    /// apart. Source: docs/decisions/16.
    pixels_of_a_voxel: f64,
    /// Distances are cut off here, voxels. Source: docs/decisions/16.
    truncation: f64,
    /// Surfaces are fused this much nearer to the cameras, voxels: sheets thinner than the errors
    /// of depths keep two sides. Source: docs/decisions/16.
    thicken: f64,
    /// Most memory of the volume, bytes. Source: docs/decisions/16.
    most_bytes: usize,
    /// Parts smaller than this share of the largest one's area are left out. Source:
    /// docs/decisions/21; a piece of an antenna is a few of them.
    least_part: f64,
    /// A surface is seen by at least this share of the views: half of them look at its back, and
    /// some are in each other's way. Source: chosen by hand, never measured.
    least_views: f64,
    /// Of the measured points, this share at either end says nothing of the object's size. Source:
    /// chosen by hand, never measured.
    tail: f64,
    /// Points of a map by which sizes are told, at most. Source: chosen by hand:
    /// [`FusionLimits::tail`] of it are 100.
    points_of_a_map: usize,
}

/// The values in force.
const LIMITS: FusionLimits = FusionLimits {
    most_views: 120,
    pixels_of_a_voxel: 1.5,
    truncation: 3.0,
    thicken: 1.5,
    most_bytes: 3 << 30,
    least_part: 0.0003,
    least_views: 0.05,
    tail: 0.005,
    points_of_a_map: 20_000,
};

/// Masks are white from here, of 255. Source: the middle.
const WHITE: u8 = 128;

/// Depths of a view: of a rectangle around the object, as nothing is known elsewhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredDepth {
    /// Columns and rows of the whole picture: those of one of the view's levels.
    pub size: [usize; 2],
    /// First column and row of the rectangle.
    pub corner: [usize; 2],
    /// Columns of the rectangle.
    pub columns: usize,
    /// [rows × columns] camera z, scene units; 0 where nothing is known.
    pub depth: Vec<f32>,
}

impl MeasuredDepth {
    /// What is known at a place of the whole picture.
    pub fn at(&self, x: usize, y: usize) -> Option<f32> {
        let column = x.checked_sub(self.corner[0]).filter(|c| *c < self.columns)?;
        let row = y.checked_sub(self.corner[1])?;
        self.depth.get(row * self.columns + column).copied().filter(|z| *z > 0.0)
    }

    /// The pixels of the whole picture at which something is known, and their depths.
    fn known(&self) -> impl Iterator<Item = (usize, f32)> {
        let all = self.depth.iter().enumerate().filter(|(_, z)| **z > 0.0);
        all.map(|(i, z)| {
            let (x, y) = (self.corner[0] + i % self.columns, self.corner[1] + i / self.columns);
            (y * self.size[0] + x, *z)
        })
    }
}

/// Where the depths that are fused come from.
#[derive(Clone, Copy, Debug)]
pub enum DepthSource<'a> {
    /// The Gaussians (world frame) alone.
    Splat {
        /// The scene.
        gaussians: &'a Gaussians,
        /// As in training.
        antialias: bool,
    },
    /// Depths of every view of the data set.
    Measured(&'a [MeasuredDepth]),
}

/// The surface of a scene as the views of the data set see it, with the photos' colours; world
/// frame, no triangles where nothing is half opaque or measured. `resolution`: voxels along the
/// longest side of what is seen, which without mattes ends at the cameras' distance; fewer where a
/// voxel would be smaller than a pixel, because surfaces seen through gaps are full of holes.
/// Where a matte is black, nothing is.
pub fn fused_mesh(
    source: &DepthSource,
    dataset: &Dataset,
    resolution: u32,
    progress: &Progress,
) -> Result<Mesh, SplatError> {
    // In the normalised frame no number is too small or too large, whatever the units are.
    let n = &dataset.normalisation;
    let normalised = Sim3 { scale: n.scale, translation: -n.scale * n.centre, ..Sim3::IDENTITY };
    let gaussians = source.gaussians().map(|(g, antialias)| (n.normalise(g.clone()), antialias));
    let count = dataset.views.len().min(LIMITS.most_views);
    progress.begin("depth maps", count);
    let mut maps = Vec::with_capacity(count);
    for k in 0..count {
        let at = k * dataset.views.len() / count;
        let view = ViewSource {
            view: &dataset.views[at],
            pose: normalised.transform_pose(&dataset.views[at].pose),
            gaussians: gaussians.as_ref().map(|(g, antialias)| (g, *antialias)),
            measured: source.measured().and_then(|m| m.get(at)),
            scale: n.scale,
        };
        maps.extend(view.depth_map(dataset.alpha, resolution));
        progress.tick()?;
    }
    if !dataset.is_transparent() {
        crop(&mut maps);
    }
    let size = extent(&maps);
    if !(size > 0.0 && size.is_finite()) {
        return Ok(Mesh::default());
    }
    let pixel = pixel(&maps);
    let options = FusionOptions {
        voxel: (size / f64::from(resolution.max(2))).max(LIMITS.pixels_of_a_voxel * pixel),
        truncation: LIMITS.truncation,
        thicken: LIMITS.thicken,
        // The error of a few views is no surface, where there are others to contradict it.
        least_views: match maps.len() {
            0..3 => 1,
            n => (n as f64 * LIMITS.least_views).round().max(2.0) as u8,
        },
        most_bytes: LIMITS.most_bytes,
    };
    if dataset.is_transparent() {
        maps.par_iter_mut().for_each(|map| outline(map, options.truncation * options.voxel / pixel));
    }
    let mut mesh = fuse(&maps, &options, progress)?;
    mesh.keep_large_parts(LIMITS.least_part);
    let world = normalised.inverse();
    mesh.vertices.iter_mut().for_each(|v| *v = world.transform(*v));
    Ok(mesh)
}

impl<'a> DepthSource<'a> {
    fn gaussians(&self) -> Option<(&'a Gaussians, bool)> {
        match *self {
            Self::Measured(_) => None,
            Self::Splat { gaussians, antialias } => Some((gaussians, antialias)),
        }
    }

    fn measured(&self) -> Option<&'a [MeasuredDepth]> {
        match *self {
            Self::Splat { .. } => None,
            Self::Measured(measured) => Some(measured),
        }
    }
}

/// What is known of a view's depths.
struct ViewSource<'a> {
    view: &'a View,
    /// Normalised frame.
    pose: Pose,
    /// Normalised, and whether they were trained with antialiasing.
    gaussians: Option<(&'a Gaussians, bool)>,
    measured: Option<&'a MeasuredDepth>,
    /// Normalised units a scene unit.
    scale: f64,
}

impl<'a> ViewSource<'a> {
    /// At the level of what was measured, else at that whose pixels are not much finer than the
    /// voxels will be.
    fn depth_map(&self, alpha: AlphaMode, resolution: u32) -> Option<DepthMap<'a>> {
        // Twice as fine as voxels may be.
        let most = (2.0 * LIMITS.pixels_of_a_voxel * f64::from(resolution)) as usize;
        let levels = &self.view.levels;
        let pixels = match self.measured {
            Some(m) => levels.iter().find(|p| [p.width, p.height] == m.size)?,
            None => levels.iter().find(|p| p.width.max(p.height) <= most).or(levels.last())?,
        };
        let camera = self.view.camera.scaled(pixels.width as u32, pixels.height as u32);
        let mut depth =
            self.splat_depth(&camera).unwrap_or_else(|| vec![f32::NAN; pixels.width * pixels.height]);
        for (i, known) in self.measured.iter().flat_map(|m| m.known()) {
            if let Some(z) = depth.get_mut(i) {
                *z = (f64::from(known) * self.scale) as f32;
            }
        }
        blank(&mut depth, pixels, alpha);
        Some(DepthMap { camera, pose: self.pose, depth, outline: Vec::new(), rgb: (&pixels.rgb).into() })
    }

    fn splat_depth(&self, camera: &Camera) -> Option<Vec<f32>> {
        let (gaussians, antialias) = self.gaussians?;
        let near = DEFAULT_NEAR * gaussians.median_distance(self.pose.centre());
        let depth = median_depth(gaussians, camera, &self.pose, near, antialias);
        Some(depth.into_iter().map(|z| z.map_or(f32::NAN, |z| z as f32)).collect())
    }
}

/// What a black mask says of the depths: nothing, or that the ray is empty (less surely so near to
/// white).
fn blank(depth: &mut [f32], pixels: &Pixels, alpha: AlphaMode) {
    let Some(mask) = &pixels.mask else { return };
    let near_white = near_white(mask, pixels.width);
    for ((z, m), near) in depth.iter_mut().zip(mask).zip(near_white) {
        if *m < WHITE {
            *z = match (alpha, near) {
                (AlphaMode::Ignore, _) => f32::NAN,
                (AlphaMode::Transparent, false) => f32::INFINITY,
                (AlphaMode::Transparent, true) => f32::NEG_INFINITY,
            };
        }
    }
}

/// Whether some pixel within the margin (a square) is white, [height × width].
fn near_white(mask: &[u8], width: usize) -> Vec<bool> {
    let m = MATTE_MARGIN_PX;
    let white: Vec<bool> = mask.iter().map(|v| *v >= WHITE).collect();
    let rows = white.chunks(width).flat_map(|row| {
        (0..row.len()).map(move |x| row[x.saturating_sub(m)..(x + m + 1).min(row.len())].contains(&true))
    });
    let rows: Vec<bool> = rows.collect();
    (0..rows.len())
        .map(|i| {
            let first = i.max(m * width + i % width) - m * width;
            (first..rows.len().min(i + m * width + 1)).step_by(width).any(|j| rows[j])
        })
        .collect()
}

/// Finds the parts of a map that are thinner than the truncation, pixels.
fn outline(map: &mut DepthMap<'_>, truncation: f64) {
    let white: Vec<bool> = map.depth.iter().map(|z| !z.is_infinite()).collect();
    map.outline = thin_parts(&white, map.camera.width as usize, truncation / 2.0);
}

/// The points of every map; their number a map is bounded.
fn points(maps: &[DepthMap<'_>]) -> Vec<DVec3> {
    maps.par_iter().flat_map_iter(points_of_map).collect()
}

fn points_of_map(map: &DepthMap<'_>) -> Vec<DVec3> {
    let world_from_cam = map.pose.inverse();
    let step = map.depth.len().div_ceil(LIMITS.points_of_a_map).max(1);
    (0..map.depth.len()).step_by(step).filter_map(|i| map.point(i, &world_from_cam)).collect()
}

/// Without mattes the object is what lies around the middle, as far as the cameras are from it.
fn crop(maps: &mut [DepthMap<'_>]) {
    let points = points(maps);
    let [x, y, z] = [0, 1, 2].map(|axis| median(points.iter().map(|p| p[axis]).collect()));
    let (Some(x), Some(y), Some(z)) = (x, y, z) else { return };
    let centre = DVec3::new(x, y, z);
    let distances = maps.iter().map(|m| m.pose.centre().distance(centre)).collect();
    let Some(radius) = median(distances) else { return };
    maps.par_iter_mut().for_each(|map| {
        let (world_from_cam, eye) = (map.pose.inverse(), map.pose.centre());
        for i in 0..map.depth.len() {
            let point = map.point(i, &world_from_cam);
            if let Some(p) = point.filter(|p| p.distance(centre) > radius) {
                // A ray that went on behind the middle found it empty; one that ended before it
                // says nothing.
                let passed = p.distance(eye) > centre.distance(eye);
                map.depth[i] = if passed { f32::INFINITY } else { f32::NAN };
            }
        }
    });
}

/// Longest side of the box around what was measured but for its tails; 0 where that is nothing.
fn extent(maps: &[DepthMap<'_>]) -> f64 {
    let points = points(maps);
    (0..3)
        .filter_map(|axis| {
            let along: Vec<f64> = points.iter().map(|p| p[axis]).collect();
            Some(quantile(along.clone(), 1.0 - LIMITS.tail)? - quantile(along, LIMITS.tail)?)
        })
        .fold(0.0, f64::max)
}

/// Side of a pixel on the surface, median over the views.
fn pixel(maps: &[DepthMap<'_>]) -> f64 {
    let sizes = maps.iter().filter_map(|map| {
        let seen = map.depth.iter().filter(|z| **z > 0.0 && z.is_finite()).map(|z| f64::from(*z)).collect();
        Some(median(seen)? / map.camera.mean_focal())
    });
    median(sizes.collect()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_is_known_at_its_place_and_nowhere_else() {
        let depth = vec![0.0, 2.0, 3.0, 4.0];
        let stereo = MeasuredDepth { size: [4, 3], corner: [2, 1], columns: 2, depth };
        assert_eq!(stereo.known().collect::<Vec<_>>(), [(7, 2.0), (10, 3.0), (11, 4.0)]);
        assert_eq!(
            [stereo.at(3, 1), stereo.at(2, 2), stereo.at(2, 1), stereo.at(1, 1)],
            [Some(2.0), Some(3.0), None, None,]
        );
    }

    #[test]
    fn the_margin_of_a_matte_is_a_square_and_ends_at_the_border() {
        let (w, h) = (9, 7);
        let mut mask = vec![0; w * h];
        mask[4 * w + 8] = 255;
        let near = near_white(&mask, w);
        assert_eq!(near.len(), w * h);
        for (i, &found) in near.iter().enumerate() {
            let (x, y) = (i % w, i / w);
            assert_eq!(found, x >= 6 && (2..=6).contains(&y), "{x} {y}");
        }
        assert!(near_white(&[], 1).is_empty());
    }
}
