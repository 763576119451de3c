//! The surface of Gaussians: the depth at which a ray is half absorbed.
//!
//! Expected depth, which renderers give, lies between two surfaces at every edge and is drawn
//! towards whatever shines through; the median does not. Scalar f64, on the kernels of
//! `reference`, with tiles: it is for judging, not for drawing.
//!
//! ```
//! use glam::{Quat, Vec3};
//! use scene::{Camera, CameraModel, Gaussians, Pose};
//! use splat::surface::median_depth;
//!
//! let disc = Gaussians {
//!     means: vec![Vec3::new(0.0, 0.0, 2.0)],
//!     log_scales: vec![Vec3::new(0.0, 0.0, -6.0)],
//!     rotations: vec![Quat::IDENTITY],
//!     opacity_logits: vec![3.0],
//!     sh: vec![0.0; 3],
//!     sh_degree: 0,
//! };
//! let camera = Camera::centred(1, CameraModel::Pinhole, 32, 24, 30.0);
//! let depth = median_depth(&disc, &camera, &Pose::IDENTITY, 0.01, false);
//! assert!((depth[12 * 32 + 16].unwrap() - 2.0).abs() < 0.01);
//! ```

use crate::cpu::TILE;
use crate::dataset::{Dataset, MATTE_MARGIN_PX, Pixels};
use crate::reference::constants::{MAX_ALPHA, MAX_LOG_SCALE, MIN_ALPHA};
use crate::reference::project::{Projected, project};
use crate::reference::sort::sort;
use crate::reference::{GaussianGeometry, Options, Parameters, ReferenceView};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Gaussians, Pose};

/// Camera z, scene units, at which the transmittance along each pixel's ray falls to one half or
/// below, [height × width]: where the Gaussian that brings it there is densest along the ray (a
/// flat one is a plane, and not as far as its centre everywhere); `None` where it never does. The
/// camera must be without distortion; `antialias` as in training.
pub fn median_depth(
    gaussians: &Gaussians,
    camera: &Camera,
    pose: &Pose,
    near: f64,
    antialias: bool,
) -> Vec<Option<f64>> {
    let view = ReferenceView {
        rotation: DMat3::from_quat(pose.rotation),
        translation: pose.translation,
        focal: camera.focal(),
        centre: camera.principal_point(),
        width: camera.width as usize,
        height: camera.height as usize,
    };
    let parameters = Parameters::from_gaussians(gaussians);
    let options = Options { near, antialias, ..Options::default() };
    let projected: Vec<Option<Projected>> = (0..parameters.len())
        .into_par_iter()
        .map(|i| project(&parameters.geometry(i), &view, &options).filter(|p| p.opacity >= MIN_ALPHA))
        .collect();
    let order = sort(&projected);
    let solids: Vec<Solid> =
        (0..parameters.len()).into_par_iter().map(|i| Solid::new(&parameters.geometry(i), &view)).collect();
    let tiles = (view.width.div_ceil(TILE), view.height.div_ceil(TILE));
    let lists = lists(&projected, &order, tiles);
    let depth_of = |i: usize| {
        let (x, y) = (i % view.width, i / view.width);
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let ray = ((pixel - view.centre) / view.focal).extend(1.0);
        let list = &lists[y / TILE * tiles.0 + x / TILE];
        half_way(&projected, list, pixel).map(|i| solids[i].peak(ray))
    };
    (0..view.pixels()).into_par_iter().with_min_len(TILE * view.width.max(1)).map(depth_of).collect()
}

/// A Gaussian in the camera's frame.
#[derive(Clone, Copy)]
struct Solid {
    mean: DVec3,
    /// Σ⁻¹.
    precision: DMat3,
    /// It ends so far before and behind its centre, scene units.
    reach: f64,
}

/// Nothing of a Gaussian is looked for beyond so many standard deviations. Source: 99.7 % of it lie
/// within.
const REACH_SIGMAS: f64 = 3.0;

impl Solid {
    fn new(g: &GaussianGeometry, view: &ReferenceView) -> Self {
        let own = if g.rotation.length_squared() > 0.0 { g.rotation.normalize() } else { DQuat::IDENTITY };
        let axes = view.rotation * DMat3::from_quat(own);
        let scale = g.log_scale.map(|v| v.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp());
        let precision = axes * DMat3::from_diagonal(1.0 / (scale * scale)) * axes.transpose();
        let reach = REACH_SIGMAS * (axes.row(2) * scale).length();
        Self { mean: view.rotation * g.mean + view.translation, precision, reach }
    }

    /// Camera z at which the density along a ray (through the origin, z = 1) is largest: the `t`
    /// that minimises `(t d − μ)ᵀ Σ⁻¹ (t d − μ)`, within the Gaussian's reach.
    fn peak(&self, ray: DVec3) -> f64 {
        let towards = self.precision * ray;
        let t = towards.dot(self.mean) / towards.dot(ray);
        if t.is_nan() { self.mean.z } else { t.clamp(self.mean.z - self.reach, self.mean.z + self.reach) }
    }
}

/// The Gaussians that touch each tile, nearest first.
fn lists(projected: &[Option<Projected>], order: &[usize], (columns, rows): (usize, usize)) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); columns * rows];
    for &i in order {
        let Some(g) = projected[i] else { continue };
        let half = g.half_extent();
        let (low, high) = (g.xy - half, g.xy + half);
        if !low.is_finite() || !high.is_finite() || high.min_element() < 0.0 {
            continue;
        }
        if low.x >= (columns * TILE) as f64 || low.y >= (rows * TILE) as f64 {
            continue;
        }
        for y in tile_of(low.y, rows)..=tile_of(high.y, rows) {
            for x in tile_of(low.x, columns)..=tile_of(high.x, columns) {
                lists[y * columns + x].push(i as u32);
            }
        }
    }
    lists
}

/// The tile of a coordinate, or the nearest of so many.
fn tile_of(v: f64, tiles: usize) -> usize {
    ((v / TILE as f64).max(0.0) as usize).min(tiles - 1)
}

/// The Gaussian at which the transmittance falls to one half.
fn half_way(projected: &[Option<Projected>], list: &[u32], p: DVec2) -> Option<usize> {
    let mut transmittance = 1.0;
    for (i, g) in list.iter().filter_map(|&i| Some((i as usize, projected[i as usize]?))) {
        let d = g.xy - p;
        let power = 0.5 * (g.conic.x * d.x * d.x + g.conic.z * d.y * d.y) + g.conic.y * d.x * d.y;
        let alpha = (g.opacity * (-power).exp()).min(MAX_ALPHA);
        if power < 0.0 || alpha.is_nan() || alpha < MIN_ALPHA {
            continue;
        }
        transmittance *= 1.0 - alpha;
        if transmittance <= 0.5 {
            return Some(i);
        }
    }
    None
}

/// Share of the Gaussians' opacity whose centres lie outside the visual hull: black in the mask of
/// some view that has them in its frame. Held-out views count too. `None` where no view has a mask,
/// or nothing is opaque.
pub fn outside_hull(gaussians: &Gaussians, dataset: &Dataset) -> Option<f64> {
    if !dataset.is_transparent()
        || dataset.views.iter().all(|v| v.levels.first().is_none_or(|l| l.mask.is_none()))
    {
        return None;
    }
    let opacity = |i: usize| f64::from(gaussians.opacity(i));
    let all: f64 = (0..gaussians.len()).map(opacity).sum();
    let outside =
        (0..gaussians.len()).into_par_iter().filter(|&i| is_outside(gaussians.means[i].as_dvec3(), dataset));
    let outside: f64 = outside.map(opacity).sum();
    (all > 0.0).then_some(outside / all)
}

/// Whether some view that has a place (world frame) in its frame shows black there.
fn is_outside(x: DVec3, dataset: &Dataset) -> bool {
    dataset.views.iter().any(|view| {
        let pixels = view.levels.first();
        pixels.is_some_and(|p| is_black(p, view.camera.project(view.pose.transform(x))))
    })
}

/// Whether the mask is black all around a pixel of the frame.
fn is_black(pixels: &Pixels, at: Option<DVec2>) -> bool {
    let (Some(mask), Some(at)) = (&pixels.mask, at) else { return false };
    let (w, h) = (pixels.width as i64, pixels.height as i64);
    let (x, y) = (at.x.floor() as i64, at.y.floor() as i64);
    if !(0..w).contains(&x) || !(0..h).contains(&y) {
        return false;
    }
    let m = MATTE_MARGIN_PX as i64;
    let rows = (y - m).max(0)..(y + m + 1).min(h);
    let columns = (x - m).max(0) as usize..(x + m + 1).min(w) as usize;
    rows.map(|y| &mask[(y * w) as usize..]).all(|row| row[columns.clone()].iter().all(|v| *v == 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{self, rasterise::contributions};
    use glam::{Quat, Vec3};
    use rand::Rng;
    use scene::CameraModel;
    use scene::geometry::points_of;

    fn cloud(seed: u64, n: usize) -> Gaussians {
        let mut r = scene::rng::rng(seed, "surface", 0);
        let mut g = Gaussians { sh_degree: 0, ..Gaussians::default() };
        for _ in 0..n {
            let mut v = |a: f32, b: f32| r.random_range(a..b);
            g.means.push(Vec3::new(v(-2.0, 2.0), v(-2.0, 2.0), v(3.0, 9.0)));
            g.log_scales.push(Vec3::new(v(-3.0, -0.5), v(-3.0, -0.5), v(-3.0, -0.5)));
            g.rotations.push(Quat::from_xyzw(v(-1.0, 1.0), v(-1.0, 1.0), v(-1.0, 1.0), 1.0));
            g.opacity_logits.push(v(-3.0, 3.0));
            g.sh.extend([0.0; 3]);
        }
        g
    }

    /// Where along a pixel's ray a Gaussian is densest, by trying.
    fn densest(p: &Parameters, i: usize, view: &ReferenceView, pixel: DVec2) -> f64 {
        let g = p.geometry(i);
        let ray = ((pixel - view.centre) / view.focal).extend(1.0);
        let sigmas = |z: f64| {
            let world = view.rotation.transpose() * (ray * z - view.translation);
            (g.rotation.normalize().conjugate() * (world - g.mean) / g.log_scale.exp()).length()
        };
        let middle = (view.rotation * g.mean + view.translation).z;
        let tried = (0..8000).map(|k| middle - 4.0 + 0.001 * f64::from(k));
        let best = tried.min_by(|a, b| sigmas(*a).total_cmp(&sigmas(*b))).unwrap();
        let m = DMat3::from_quat(g.rotation.normalize()) * DMat3::from_diagonal(g.log_scale.exp());
        let reach = 3.0 * (m.transpose() * view.rotation.transpose().z_axis).length();
        best.clamp(middle - reach, middle + reach)
    }

    #[test]
    fn the_median_is_where_the_specification_is_half_absorbed() {
        let camera = Camera::centred(1, CameraModel::Pinhole, 50, 37, 40.0);
        for seed in 0..5 {
            let gaussians = cloud(seed, 60);
            let pose = Pose::look_at(DVec3::new(0.4, -0.3, 0.1), DVec3::new(0.0, 0.0, 6.0), -DVec3::Y);
            let depth = median_depth(&gaussians, &camera, &pose, 0.01, false);
            let view = ReferenceView {
                rotation: DMat3::from_quat(pose.rotation),
                translation: pose.translation,
                focal: camera.focal(),
                centre: camera.principal_point(),
                width: 50,
                height: 37,
            };
            let p = Parameters::from_gaussians(&gaussians);
            let whole = reference::render(&p, &view, &Options::default());
            let mut found = 0;
            for (i, z) in depth.iter().enumerate() {
                let centre = DVec2::new((i % 50) as f64 + 0.5, (i / 50) as f64 + 0.5);
                let (list, _) = contributions(&whole.projected, &whole.order, centre);
                let half = list.iter().find(|c| c.transmittance * (1.0 - c.alpha) <= 0.5);
                let expected = half.map(|c| densest(&p, c.gaussian, &view, centre));
                assert_eq!(z.is_some(), expected.is_some(), "seed {seed}, pixel {i}");
                let off = z.zip(expected).map_or(0.0, |(z, e)| (z - e).abs());
                assert!(off < 2e-3, "seed {seed}, pixel {i}: {z:?} {expected:?}");
                found += usize::from(z.is_some());
            }
            assert!((50..50 * 37).contains(&found), "{found}");
        }
    }

    #[test]
    fn opacity_outside_the_silhouettes_is_counted() {
        let pixels = |black_from: usize| Pixels {
            width: 40,
            height: 30,
            rgb: vec![0; 3600],
            mask: Some((0..1200).map(|i| if i % 40 < black_from { 255 } else { 0 }).collect()),
        };
        let camera = Camera::centred(1, CameraModel::Pinhole, 40, 30, 40.0);
        let view = |black_from: usize| crate::View {
            name: String::new(),
            camera: camera.clone(),
            pose: Pose::IDENTITY,
            view: crate::PinholeView {
                rotation: glam::Mat3::IDENTITY,
                translation: Vec3::ZERO,
                focal: [40.0; 2],
                centre: [20.0, 15.0],
                width: 40,
                height: 30,
                parts: crate::parts::PartPlaces::NONE,
            },
            levels: vec![pixels(black_from)],
            held_out: false,
        };
        let mut dataset = Dataset {
            views: vec![view(40), view(20)],
            points: Vec::new(),
            normalisation: crate::dataset::NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 },
            alpha: crate::AlphaMode::Transparent,
            articulation: None,
        };
        let mut g = cloud(0, 4);
        // In the white half, in the margin beside it, in the black half, outside the frame.
        for (mean, x) in g.means.iter_mut().zip([10.5, 21.5, 30.5, 60.0]) {
            *mean = Vec3::new((x - 20.0) / 40.0, 0.0, 1.0);
        }
        g.opacity_logits = vec![0.0, 1.0, 2.0, 0.0];
        let all: f64 = (0..4).map(|i| f64::from(g.opacity(i))).sum();
        let share = outside_hull(&g, &dataset).unwrap();
        assert!((share - f64::from(g.opacity(2)) / all).abs() < 1e-12, "{share}");
        dataset.views.iter_mut().for_each(|v| v.levels[0].mask = None);
        assert_eq!(outside_hull(&g, &dataset), None);
    }

    #[test]
    fn an_opaque_sheet_gives_points_on_itself() {
        let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 60.0);
        let pose = Pose::look_at(DVec3::new(0.5, 0.2, -1.0), DVec3::new(0.0, 0.0, 4.0), -DVec3::Y);
        let mut g = Gaussians { sh_degree: 0, ..Gaussians::default() };
        for i in 0..100 {
            for j in 0..100 {
                g.means.push(Vec3::new(i as f32 * 0.06 - 3.0, j as f32 * 0.06 - 3.0, 4.0));
                g.log_scales.push(Vec3::new(0.06_f32.ln(), 0.06_f32.ln(), 1e-3_f32.ln()));
                g.rotations.push(Quat::IDENTITY);
                g.opacity_logits.push(4.0);
                g.sh.extend([0.0; 3]);
            }
        }
        let points = points_of(&median_depth(&g, &camera, &pose, 0.01, false), &camera, &pose);
        assert!(points.len() > 2500, "{}", points.len());
        // A pixel takes the depth of a Gaussian's centre, which on a sheet seen aslant is not quite
        // its own.
        assert!(points.iter().all(|p| (p.z - 4.0).abs() < 0.05), "{points:?}");
    }
}
