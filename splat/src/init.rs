//! Where the first Gaussians are placed.

mod nearest;

use crate::dataset::{Dataset, View};
use crate::error::SplatError;
use crate::model::Model;
use crate::view::NEAREST;
use glam::{DVec3, Quat, Vec3};
use nearest::mean_square_distance;
use rand::Rng as _;
use scene::Gaussians;
use scene::gaussians::SH_C0;

/// Opacity of the first Gaussians. Source: chosen on short runs of fox (Kerbl et al. 2023 have
/// 0.1).
const OPACITY: f32 = 0.3;
/// Points of a sparse cloud with fewer than which it is not used. Source: chosen by hand, never
/// measured.
const LEAST_POINTS: usize = 16;

/// The cloud that is drawn where there is no sparse one.
struct RandomCloud {
    /// Gaussians that are placed. Source: chosen by hand, never measured.
    points: usize,
    /// Points drawn for them at most. Source: chosen by hand: one in 27 may lie inside the hull.
    candidates: usize,
    /// Radius of the ball in which they are drawn, distances of the cameras from what they look at.
    /// Source: chosen by hand, never measured.
    ball: f64,
    /// Matte (of 255) below which a view excludes a point. Source: 6 %, chosen by hand, never
    /// measured.
    empty: u8,
}

/// The values in force.
const RANDOM: RandomCloud = RandomCloud { points: 15_000, candidates: 400_000, ball: 0.6, empty: 16 };

/// A point stands alone where its neighbours are farther off than this share of its distance from
/// the nearest camera.
/// Source: docs/decisions/12, first sizes.
const ALONE: f32 = 0.2;
/// Scale of its first Gaussian, as a share of that distance. Source: see [`ALONE`].
const LARGEST: f32 = 0.05;
/// Squared scales are limited to this range, squared normalised units.
/// Source: a hundredth of a pixel of the widest lens, and ten times the scene.
const SQUARED_SCALES: [f32; 2] = [1e-10, 1e2];

/// A point, its colour, and the part it belongs to.
#[derive(Clone, Copy)]
struct FirstPoint {
    place: Vec3,
    rgb: [u8; 3],
    part: u8,
}

/// How many finite points the sparse cloud has; none where they are too few to be used.
pub(crate) fn cloud_points(dataset: &Dataset) -> Option<usize> {
    cloud(dataset).map(|points| points.len())
}

/// The finite points of the sparse cloud (normalised) with their colours; none where they are too
/// few to be used.
fn cloud(dataset: &Dataset) -> Option<Vec<FirstPoint>> {
    let moving = dataset.articulation.as_ref();
    let part = |i: usize| moving.and_then(|m| m.of_points.get(i)).copied().unwrap_or(0);
    let points = dataset.points.iter().enumerate().filter(|(_, (place, _))| place.is_finite());
    let points: Vec<FirstPoint> =
        points.map(|(i, &(place, rgb))| FirstPoint { place, rgb, part: part(i) }).collect();
    (points.len() >= LEAST_POINTS).then_some(points)
}

/// Gaussians at the sparse cloud's points or, without any, at random points inside the masks'
/// visual hull (or the cameras' common frustum). Isotropic; the scale is the root mean square
/// distance to the three nearest neighbours.
pub(crate) fn initial_model(dataset: &Dataset, max: usize, seed: u64) -> Result<Model, SplatError> {
    let points = cloud(dataset).unwrap_or_else(|| random_points(dataset, max.min(RANDOM.points), seed));
    if points.is_empty() {
        return Err(SplatError::NoGaussians("the cameras see no common space; check the poses".to_owned()));
    }
    let points = thinned(points, max, seed);
    let mut gaussians = at_points(&points);
    let cameras: Vec<Vec3> = dataset.views.iter().map(|v| v.view.position()).collect();
    limit_scales(&mut gaussians, &cameras);
    let mut model = Model::from_gaussians(&gaussians);
    if dataset.articulation.is_some() {
        model.part = points.iter().map(|p| p.part).collect();
    }
    Ok(model)
}

/// Points that stand alone, such as wrong ones far away, would become Gaussians that fill every
/// picture and that the others are trained against. They begin small; those of a thin background
/// stay as large as its gaps.
fn limit_scales(gaussians: &mut Gaussians, cameras: &[Vec3]) {
    let least = SQUARED_SCALES[0].sqrt();
    for (mean, scales) in gaussians.means.iter().zip(&mut gaussians.log_scales) {
        let nearest = cameras.iter().map(|c| c.distance_squared(*mean)).fold(f32::INFINITY, f32::min).sqrt();
        if nearest.is_finite() && scales.max_element() > (ALONE * nearest).max(least).ln() {
            *scales = Vec3::splat((LARGEST * nearest).max(least).ln());
        }
    }
}

/// At most `max` of the points, chosen at random.
fn thinned(mut points: Vec<FirstPoint>, max: usize, seed: u64) -> Vec<FirstPoint> {
    let mut rng = scene::rng::rng(seed, "thin", 0);
    while points.len() > max.max(1) {
        let i = rng.random_range(0..points.len());
        points.swap_remove(i);
    }
    points
}

fn at_points(points: &[FirstPoint]) -> Gaussians {
    let positions: Vec<Vec3> = points.iter().map(|p| p.place).collect();
    let logit = (OPACITY / (1.0 - OPACITY)).ln();
    let squares = mean_square_distance(&positions);
    let [least, most] = SQUARED_SCALES;
    Gaussians {
        log_scales: squares.iter().map(|d| Vec3::splat(0.5 * d.clamp(least, most).ln())).collect(),
        rotations: vec![Quat::IDENTITY; points.len()],
        opacity_logits: vec![logit; points.len()],
        sh: points.iter().flat_map(|p| p.rgb.map(|c| (f32::from(c) / 255.0 - 0.5) / SH_C0)).collect(),
        sh_degree: 0,
        means: positions,
    }
}

/// The point nearest to all optical axes (least squares) and the mean distance of the cameras from
/// it.
pub(crate) fn focus(views: &[&View]) -> Option<(DVec3, f64)> {
    let n = views.len() as f64;
    let axes =
        views.iter().map(|v| (v.view.position().as_dvec3(), v.view.rotation.row(2).as_dvec3().normalize()));
    let centre = scene::focus(axes).unwrap_or_else(|| {
        // Parallel axes: one unit in front of the mean camera.
        views.iter().map(|v| (v.view.position() + v.view.rotation.row(2)).as_dvec3()).sum::<DVec3>() / n
    });
    let distance = views.iter().map(|v| v.view.position().as_dvec3().distance(centre)).sum::<f64>() / n;
    (centre.is_finite() && distance > 0.0).then_some((centre, distance))
}

/// What a view shows at a point.
enum PointInView {
    Outside,
    Masked,
    Colour([u8; 3]),
}

fn look_at(view: &View, x: Vec3) -> PointInView {
    let c = view.view.camera_point(x);
    if c.z < NEAREST as f32 {
        return PointInView::Outside;
    }
    let [px, py] = view.view.pixel(c);
    if !view.view.contains([px, py]) {
        return PointInView::Outside;
    }
    let pixels = &view.levels[0];
    let at = py as usize * pixels.width + px as usize;
    if pixels.mask.as_ref().is_some_and(|m| m[at] < RANDOM.empty) {
        return PointInView::Masked;
    }
    PointInView::Colour([pixels.rgb[at * 3], pixels.rgb[at * 3 + 1], pixels.rgb[at * 3 + 2]])
}

/// Points of a ball about the cameras' focus that the views agree on ([`mean_colour`]).
fn random_points(dataset: &Dataset, wanted: usize, seed: u64) -> Vec<FirstPoint> {
    let views: Vec<&View> = dataset.views.iter().filter(|v| !v.held_out).collect();
    let Some((centre, distance)) = focus(&views) else { return Vec::new() };
    let mut rng = scene::rng::rng(seed, "random points", 0);
    let candidates =
        std::iter::repeat_with(|| centre.as_vec3() + in_ball(&mut rng) * (RANDOM.ball * distance) as f32);
    let agreed = candidates
        .take(RANDOM.candidates)
        .filter_map(|place| Some(FirstPoint { place, rgb: mean_colour(&views, place)?, part: 0 }));
    agreed.take(wanted).collect()
}

/// A point of the unit ball, uniform.
fn in_ball(rng: &mut scene::rng::Rng) -> Vec3 {
    loop {
        let u: [f32; 3] = std::array::from_fn(|_| rng.random_range(-1.0f32..1.0));
        let u = Vec3::from_array(u);
        if u.length_squared() <= 1.0 {
            return u;
        }
    }
}

/// Mean colour of a point over the views, where at most one mask excludes it and two views have it
/// in their pictures (fewer where there are fewer than three).
fn mean_colour(views: &[&View], x: Vec3) -> Option<[u8; 3]> {
    let (mut seen, mut masked, mut sum) = (0u32, 0u32, [0u32; 3]);
    for view in views {
        match look_at(view, x) {
            PointInView::Outside => {}
            PointInView::Masked => masked += 1,
            PointInView::Colour(rgb) => {
                seen += 1;
                rgb.iter().zip(&mut sum).for_each(|(&v, s)| *s += u32::from(v));
            }
        }
        if masked > 1 {
            return None;
        }
    }
    let enough = (seen + masked) as usize >= views.len().div_ceil(2).min(2);
    (seen > 0 && enough).then(|| sum.map(|s| (s / seen) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_far_from_all_others_fills_no_picture() {
        // A lattice before the camera, and a wrong point far behind it.
        let lattice = (0..60).map(|i| Vec3::new((i % 10) as f32 * 0.05, (i / 10) as f32 * 0.05, 2.0));
        let far = Vec3::new(0.0, 0.0, 40.0);
        let places = lattice.chain([far]);
        let points: Vec<FirstPoint> =
            places.map(|place| FirstPoint { place, rgb: [90; 3], part: 0 }).collect();
        let mut gaussians = at_points(&points);
        let before = gaussians.clone();
        assert!(before.log_scales[60].x.exp() > 9.0, "without a limit");
        limit_scales(&mut gaussians, &[Vec3::ZERO, Vec3::X]);
        assert!((gaussians.log_scales[60].x.exp() - LARGEST * 40.0).abs() < 1e-3);
        assert_eq!(
            gaussians.log_scales[..60],
            before.log_scales[..60],
            "those among others stay as they are"
        );
    }
}
