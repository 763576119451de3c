//! The pose of a camera, and on request its focal length, that minimises a robust reprojection
//! error.

use super::levenberg::{Normal, cauchy, minimise};
use glam::{DQuat, DVec2, DVec3};
use scene::Pose;

/// A refined camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AbsoluteRefinement {
    /// `cam_from_world`.
    pub pose: Pose,
    /// Focal length, pixels.
    pub focal: f64,
}

/// The camera near `start` that minimises Cauchy's loss, of width `scale` px, of the reprojection
/// error over `indices`. `pixels`: ideal (undistorted) pixels from the principal point; `points`:
/// world. Six unknowns, or seven with `free_focal`. Points behind the starting camera are left out.
/// The start is returned where nothing is better.
pub(crate) fn refine_absolute(
    start: AbsoluteRefinement,
    pixels: &[DVec2],
    points: &[DVec3],
    indices: &[usize],
    free_focal: bool,
    scale: f64,
    max_iterations: usize,
) -> AbsoluteRefinement {
    let used: Vec<usize> =
        indices.iter().copied().filter(|&i| start.pose.transform(points[i]).z > 0.0).collect();
    let minimum = if free_focal { 4 } else { 3 };
    if used.len() < minimum || !start.pose.is_finite() {
        return start;
    }
    let evaluate = |state: &AbsoluteRefinement| {
        let mut normal = Normal::<7>::new();
        for &i in &used {
            let x = state.pose.transform(points[i]);
            if x.z.is_nan() || x.z <= 0.0 {
                return None;
            }
            let (u, v) = (x.x / x.z, x.y / x.z);
            let r = DVec2::new(u, v) * state.focal - pixels[i];
            let (cost, weight) = cauchy(r.length_squared(), scale);
            normal.add_cost(cost);
            let s = state.focal / x.z;
            let last = |value| if free_focal { value } else { 0.0 };
            // x_cam' = exp(ω) x_cam + τ; columns ω, τ, f.
            let f = state.focal;
            normal.add(r.x, &[-f * u * v, f * (1.0 + u * u), -f * v, s, 0.0, -s * u, last(u)], weight);
            normal.add(r.y, &[-f * (1.0 + v * v), f * u * v, f * u, 0.0, s, -s * v, last(v)], weight);
        }
        Some(normal)
    };
    let moved = |state: &AbsoluteRefinement, step: &[f64; 7]| {
        let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
        let shift = DVec3::new(step[3], step[4], step[5]);
        AbsoluteRefinement {
            pose: Pose {
                rotation: (turn * state.pose.rotation).normalize(),
                translation: turn * state.pose.translation + shift,
            },
            focal: state.focal + step[6],
        }
    };
    let refined = minimise(start, max_iterations, evaluate, moved);
    if refined.pose.is_finite() && refined.focal > 0.0 { refined } else { start }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::{normal, rotation, unit_vector};
    use rand::Rng as _;
    use scene::pose::rotation_angle;
    use scene::rng::rng;

    #[test]
    fn returns_to_the_exact_camera_and_focal_length_in_any_unit() {
        for seed in 0..100 {
            let mut r = rng(seed, "refine absolute", 0);
            let unit = [1e-6, 1.0, 1e6][seed as usize % 3];
            let focal = [128.0, 700.0, 32_000.0][seed as usize / 3 % 3];
            let truth = Pose::new(rotation(&mut r, 2.0), DVec3::new(0.1, 0.2, 5.0) * unit);
            let points: Vec<DVec3> =
                (0..50).map(|_| unit_vector(&mut r) * unit * r.random_range(0.5..2.0)).collect();
            let project = |x: DVec3| x.truncate() / x.z * focal;
            let pixels: Vec<DVec2> = points.iter().map(|p| project(truth.transform(*p))).collect();
            let turn = DQuat::from_scaled_axis(unit_vector(&mut r) * 0.02);
            let off = Pose::new(turn * truth.rotation, truth.translation + unit_vector(&mut r) * 0.05 * unit);
            let start = AbsoluteRefinement { pose: off, focal: focal * 1.1 };
            let all: Vec<usize> = (0..50).collect();
            let found = refine_absolute(start, &pixels, &points, &all, true, focal, 50);
            assert!((found.focal / focal - 1.0).abs() < 1e-6, "seed {seed}: {}", found.focal / focal);
            assert!(rotation_angle(found.pose.rotation, truth.rotation) < 1e-6, "seed {seed}");
            assert!(found.pose.translation.distance(truth.translation) < 1e-5 * unit, "seed {seed}");
            let fixed = refine_absolute(
                AbsoluteRefinement { focal, ..start },
                &pixels,
                &points,
                &all,
                false,
                focal,
                50,
            );
            assert_eq!(fixed.focal, focal, "seed {seed}");
            assert!(fixed.pose.translation.distance(truth.translation) < 1e-6 * unit, "seed {seed}");
        }
    }

    #[test]
    fn outliers_do_not_pull_it_far() {
        for seed in 0..50 {
            let mut r = rng(seed, "refine outliers", 0);
            let truth = Pose::new(rotation(&mut r, 2.0), DVec3::new(0.1, 0.2, 5.0));
            let points: Vec<DVec3> = (0..100).map(|_| unit_vector(&mut r) * 1.5).collect();
            let pixels: Vec<DVec2> = (0..100)
                .map(|i| {
                    let x = truth.transform(points[i]);
                    let wrong = if i < 10 { 50.0 } else { 0.3 };
                    x.truncate() / x.z * 700.0 + DVec2::new(normal(&mut r), normal(&mut r)) * wrong
                })
                .collect();
            let all: Vec<usize> = (0..100).collect();
            let start = AbsoluteRefinement { pose: truth, focal: 700.0 };
            let found = refine_absolute(start, &pixels, &points, &all, false, 1.0, 20);
            assert!(rotation_angle(found.pose.rotation, truth.rotation) < 2e-3, "seed {seed}");
        }
    }

    #[test]
    fn too_little_or_senseless_data_return_the_start() {
        let start = AbsoluteRefinement { pose: Pose::IDENTITY, focal: 700.0 };
        assert_eq!(refine_absolute(start, &[], &[], &[], false, 1.0, 10), start);
        let (pixels, points) = ([DVec2::NAN; 5], [DVec3::new(0.0, 0.0, 1.0); 5]);
        assert_eq!(refine_absolute(start, &pixels, &points, &[0, 1, 2, 3, 4], true, 1.0, 10), start);
        let behind = [DVec3::new(0.0, 0.0, -1.0); 5];
        assert_eq!(
            refine_absolute(start, &[DVec2::ZERO; 5], &behind, &[0, 1, 2, 3, 4], false, 1.0, 10),
            start
        );
    }
}
