//! The pose of a camera, and on request its focal length, that minimises a robust reprojection error.

use super::levenberg::{Normal, cauchy, minimise};
use glam::{DQuat, DVec2, DVec3};
use scene::Pose;

/// A refined camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AbsoluteRefinement {
    /// `cam_from_world`.
    pub pose: Pose,
    /// Focal length, pixels.
    pub focal: f64,
}

/// The camera near `start` that minimises Cauchy's loss, of width `scale` px, of the reprojection error over
/// `indices`. `pixels`: ideal (undistorted) pixels from the principal point; `points`: world. Six unknowns, or
/// seven with `free_focal`. Points behind the starting camera are left out. The start is returned where nothing
/// is better.
pub fn refine_absolute(
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
            if !(x.z > 0.0) {
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
