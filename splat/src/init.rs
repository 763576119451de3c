//! Where the first Gaussians are placed.

mod nearest;

use crate::SplatError;
use crate::dataset::{Dataset, View};
use glam::{DMat3, DVec3, Quat, Vec3};
use nearest::mean_square_distance;
use rand::Rng as _;
use scene::Gaussians;
use scene::gaussians::SH_C0;

/// Opacity of the first Gaussians (3DGS: 0.1). Chosen on short runs of one capture.
pub const OPACITY: f32 = 0.3;
/// Points drawn where there is no sparse cloud.
const CANDIDATES: usize = 400_000;

/// Points of a sparse cloud with fewer than which it is not used.
const LEAST_POINTS: usize = 16;

/// The finite points of the sparse cloud (normalised) with their colours; none where they are too few to be used.
pub fn cloud(dataset: &Dataset) -> Option<Vec<(Vec3, [u8; 3])>> {
    let points: Vec<_> = dataset.points.iter().filter(|(p, _)| p.is_finite()).copied().collect();
    (points.len() >= LEAST_POINTS).then_some(points)
}

/// Gaussians at the sparse cloud's points (and at `hull_points` random ones inside the masks' visual hull) or, without any, at
/// random points inside the hull (or the cameras' common frustum). Isotropic; the scale is the root mean square distance to the three nearest neighbours.
pub fn initial_gaussians(
    dataset: &Dataset,
    max: usize,
    hull_points: usize,
    seed: u64,
) -> Result<Gaussians, SplatError> {
    let beside = if dataset.is_transparent() { hull_points } else { 0 };
    let mut points = match cloud(dataset) {
        None => random_points(dataset, max.min(RANDOM_POINTS), seed),
        Some(mut points) => {
            if beside > 0 {
                points.extend(random_points(dataset, beside, seed));
            }
            points
        }
    };
    if points.is_empty() {
        return Err(SplatError::NoGaussians("the cameras see no common space; check the poses".to_owned()));
    }
    thin(&mut points, max, seed);
    let mut gaussians = at_points(&points);
    let cameras: Vec<Vec3> = dataset.views.iter().map(|v| v.view.position()).collect();
    limit_scales(&mut gaussians, &cameras);
    Ok(gaussians)
}

/// A point stands alone where its neighbours are farther off than this share of its distance from the nearest camera.
const ALONE: f32 = 0.2;
/// Scale of its first Gaussian, as a share of that distance.
const LARGEST: f32 = 0.05;

/// Points that stand alone, such as wrong ones far away, would become Gaussians that fill every picture and that the others
/// are trained against. They begin small; those of a thin background stay as large as its gaps.
fn limit_scales(gaussians: &mut Gaussians, cameras: &[Vec3]) {
    for (mean, scales) in gaussians.means.iter().zip(&mut gaussians.log_scales) {
        let nearest = cameras.iter().map(|c| c.distance_squared(*mean)).fold(f32::INFINITY, f32::min).sqrt();
        if nearest.is_finite() && scales.max_element() > (ALONE * nearest).max(1e-5).ln() {
            *scales = Vec3::splat((LARGEST * nearest).max(1e-5).ln());
        }
    }
}

/// Gaussians placed where there is no sparse cloud.
const RANDOM_POINTS: usize = 15_000;

/// Keeps at most `max` points, chosen at random.
fn thin(points: &mut Vec<(Vec3, [u8; 3])>, max: usize, seed: u64) {
    let mut rng = scene::rng::rng(seed, "thin", 0);
    while points.len() > max.max(1) {
        let i = rng.random_range(0..points.len());
        points.swap_remove(i);
    }
}

fn at_points(points: &[(Vec3, [u8; 3])]) -> Gaussians {
    let positions: Vec<Vec3> = points.iter().map(|p| p.0).collect();
    let logit = (OPACITY / (1.0 - OPACITY)).ln();
    let scales = mean_square_distance(&positions);
    Gaussians {
        log_scales: scales.iter().map(|d| Vec3::splat(0.5 * d.clamp(1e-10, 1e2).ln())).collect(),
        rotations: vec![Quat::IDENTITY; points.len()],
        opacity_logits: vec![logit; points.len()],
        sh: points.iter().flat_map(|(_, rgb)| rgb.map(|c| (f32::from(c) / 255.0 - 0.5) / SH_C0)).collect(),
        sh_degree: 0,
        means: positions,
    }
}

/// The point nearest to all optical axes (least squares) and the mean distance of the cameras from it.
pub(crate) fn focus(views: &[View]) -> Option<(DVec3, f64)> {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for v in views {
        let (c, d) = (v.view.position().as_dvec3(), v.view.rotation.row(2).as_dvec3().normalize());
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * c;
    }
    let n = views.len() as f64;
    let centre = if a.determinant().abs() > 1e-4 * n.powi(3) {
        a.inverse() * b
    } else {
        // Parallel axes: one unit in front of the mean camera.
        let ahead = |v: &View| (v.view.position() + v.view.rotation.row(2)).as_dvec3();
        views.iter().map(ahead).sum::<DVec3>() / n
    };
    let distance = views.iter().map(|v| v.view.position().as_dvec3().distance(centre)).sum::<f64>() / n;
    (centre.is_finite() && distance > 0.0).then_some((centre, distance))
}

/// What a view says about a point.
enum Sight {
    Outside,
    Masked,
    Seen([u8; 3]),
}

fn look(view: &View, x: Vec3) -> Sight {
    let v = &view.view;
    let c = v.rotation * x + v.translation;
    if c.z < 0.05 {
        return Sight::Outside;
    }
    let (px, py) = (v.focal[0] * c.x / c.z + v.centre[0], v.focal[1] * c.y / c.z + v.centre[1]);
    if px < 0.0 || py < 0.0 || px >= v.width as f32 || py >= v.height as f32 {
        return Sight::Outside;
    }
    let pixels = &view.levels[0];
    let at = py as usize * pixels.width + px as usize;
    if pixels.mask.as_ref().is_some_and(|m| m[at] < 16) {
        return Sight::Masked;
    }
    Sight::Seen([pixels.rgb[at * 3], pixels.rgb[at * 3 + 1], pixels.rgb[at * 3 + 2]])
}

/// Points of a ball about the cameras' focus that at most one mask excludes and two views have in their pictures (fewer
/// where there are fewer than three); colour: mean over the views.
fn random_points(dataset: &Dataset, wanted: usize, seed: u64) -> Vec<(Vec3, [u8; 3])> {
    let views: Vec<View> = dataset.views.iter().filter(|v| !v.held_out).cloned().collect();
    let Some((centre, distance)) = focus(&views) else { return Vec::new() };
    let mut rng = scene::rng::rng(seed, "random points", 0);
    let mut points = Vec::new();
    for _ in 0..CANDIDATES {
        let x = loop {
            let u: [f32; 3] = std::array::from_fn(|_| rng.random_range(-1.0f32..1.0));
            let u = Vec3::from_array(u);
            if u.length_squared() <= 1.0 {
                break centre.as_vec3() + u * (0.6 * distance) as f32;
            }
        };
        let (mut seen, mut masked, mut sum) = (0u32, 0u32, [0u32; 3]);
        for view in &views {
            match look(view, x) {
                Sight::Outside => {}
                Sight::Masked => masked += 1,
                Sight::Seen(rgb) => {
                    seen += 1;
                    rgb.iter().zip(&mut sum).for_each(|(&v, s)| *s += u32::from(v));
                }
            }
            if masked > 1 {
                break;
            }
        }
        if masked <= 1 && seen > 0 && 2 * (seen + masked) as usize >= views.len().min(4) {
            points.push((x, sum.map(|s| (s / seen) as u8)));
            if points.len() == wanted {
                break;
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_far_from_all_others_fills_no_picture() {
        // A lattice before the camera, and a wrong point far behind it.
        let lattice = (0..60).map(|i| Vec3::new((i % 10) as f32 * 0.05, (i / 10) as f32 * 0.05, 2.0));
        let mut points: Vec<(Vec3, [u8; 3])> = lattice.map(|p| (p, [90; 3])).collect();
        points.push((Vec3::new(0.0, 0.0, 40.0), [90; 3]));
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
