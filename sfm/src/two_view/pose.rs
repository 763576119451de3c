//! The relative pose of a verified pair.

use super::correspondences::{Correspondences, scaling};
use crate::solvers::linalg::svd3;
use crate::solvers::{
    Pairs, cheirality, essential_from_pose, motions_from_homography, pose_from_essential, refine_relative,
    sampson_sq,
};
use crate::statistics::median;
use glam::{DMat3, DQuat, DVec3};
use scene::Pose;

/// Relative poses that the models propose, each refined on the inliers; the one with the least
/// truncated Sampson error among those that see the points in front of both cameras. Unit
/// translation.
pub(crate) fn best_pose(
    all: &Correspondences,
    inliers: &[usize],
    essentials: &[DMat3],
    homography: Option<&DMat3>,
    threshold: f64,
) -> Option<Pose> {
    let rays: Vec<(DVec3, DVec3)> = inliers.iter().map(|&i| all.rays(i)).collect();
    let mut candidates: Vec<Pose> =
        essentials.iter().filter_map(|e| pose_from_essential(e, &rays).map(|(pose, _)| pose)).collect();
    if let Some(h) = homography {
        let rays_a: Vec<DVec3> = rays.iter().map(|r| r.0).collect();
        let motions = motions_from_homography(&all.homography_to_rays(h), &rays_a);
        candidates.extend(motions.into_iter().filter(|p| p.translation.length() > 1e-6));
    }
    let pairs = Pairs { a: &all.a, b: &all.b, indices: inliers };
    let mut best: Option<(f64, Pose)> = None;
    for candidate in candidates {
        let pose = refine_relative(&candidate, all.focal, pairs, 0.25 * threshold, 10);
        let votes = cheirality(&pose, rays.iter().copied(), 1e-9);
        if !pose.is_finite() || 2 * votes.in_front < votes.decided {
            continue;
        }
        let cost = truncated_cost(&pose, all, inliers, threshold);
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, pose));
        }
    }
    best.map(|(_, pose)| pose)
}

/// `Σ min(d², T²)` with Sampson's distance, pixels squared.
fn truncated_cost(pose: &Pose, all: &Correspondences, inliers: &[usize], threshold: f64) -> f64 {
    let [from_a, from_b] = all.focal.map(|f| scaling(1.0 / f));
    let f = from_b * essential_from_pose(pose) * from_a;
    inliers.iter().map(|&i| sampson_sq(&f, all.a[i], all.b[i]).min(threshold * threshold)).sum()
}

/// The rotation that alone explains the inliers of the homography `h` (scaled points) about as well
/// as it does: the cameras stand in one place. Focal lengths from half to twice the given ones are
/// tried, for a guessed one may be wrong. The rotation between two sets of unit rays: Arun, Huang &
/// Blostein, PAMI 1987.
pub(crate) fn pure_rotation(all: &Correspondences, inliers: &[usize], h: &DMat3) -> Option<DQuat> {
    let allowed = 1.5 * median(inliers.iter().map(|&i| transfer_px(h, all, i)).collect()) + 0.25;
    let mut best: Option<(f64, DQuat)> = None;
    for factor in [0.5, 0.6, 0.7, 0.84, 1.0, 1.2, 1.4, 1.7, 2.0] {
        let (to_b, from_a) =
            (scaling(factor * all.focal[1] / all.size), scaling(all.size / (factor * all.focal[0])));
        let mut correlation = DMat3::ZERO;
        for &i in inliers {
            let a = (all.a[i] / (factor * all.focal[0])).extend(1.0).normalize();
            let b = (all.b[i] / (factor * all.focal[1])).extend(1.0).normalize();
            correlation += DMat3::from_cols(b * a.x, b * a.y, b * a.z);
        }
        let (u, _, v) = svd3(&correlation);
        let handed = DVec3::new(1.0, 1.0, (u * v.transpose()).determinant().signum());
        let r = u * DMat3::from_diagonal(handed) * v.transpose();
        if !r.is_finite() {
            continue;
        }
        let m = to_b * r * from_a;
        let error = median(inliers.iter().map(|&i| transfer_px(&m, all, i)).collect());
        if error <= allowed && best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, DQuat::from_mat3(&r).normalize()));
        }
    }
    best.map(|(_, rotation)| rotation)
}

/// How far a homography of scaled points takes the first point of a match from the second, pixels.
fn transfer_px(h: &DMat3, all: &Correspondences, i: usize) -> f64 {
    let p = *h * (all.a[i] / all.size).extend(1.0);
    if p.z > 0.0 { (p.truncate() / p.z * all.size).distance(all.b[i]) } else { f64::INFINITY }
}

/// Median angle between the two rays of the matches, radians.
pub(crate) fn median_angle(b_from_a: &Pose, all: &Correspondences, inliers: &[usize]) -> f64 {
    let angles = inliers.iter().map(|&i| {
        let (a, b) = all.rays(i);
        let a = b_from_a.rotation * a;
        a.cross(b).length().atan2(a.dot(b))
    });
    median(angles.collect())
}
