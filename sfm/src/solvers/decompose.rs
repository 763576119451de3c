//! Relative poses inside essential matrices and homographies.

use super::epipolar::ray_depths;
use super::linalg::svd3;
use glam::{DMat3, DVec3};
use scene::Pose;

/// The four `b_from_a` (unit translation) of an essential matrix, `R ∈ {U W Vᵀ, U Wᵀ Vᵀ}`,
/// `t = ± u₃`; `None` for zero or non-finite `E`. Hartley & Zisserman (2nd ed.),  9.6.2.
pub(super) fn poses_from_essential(e: &DMat3) -> Option<[Pose; 4]> {
    if !e.is_finite() || *e == DMat3::ZERO {
        return None;
    }
    let (u, _, v) = svd3(e);
    let (u, v) = (u * u.determinant().signum(), v * v.determinant().signum());
    let w = DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z);
    let (r1, r2, t) = (u * w * v.transpose(), u * w.transpose() * v.transpose(), u.z_axis);
    let poses = [(r1, t), (r1, -t), (r2, t), (r2, -t)].map(|(r, t)| Pose::from_matrix(r, t));
    poses.iter().all(Pose::is_finite).then_some(poses)
}

/// How a set of ray pairs votes on a relative pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cheirality {
    /// Pairs whose point lies in front of both cameras.
    pub in_front: usize,
    /// Pairs with enough parallax to tell.
    pub decided: usize,
}

/// Counts the pairs in front of both cameras. Pairs with less parallax than `min_angle` (radians)
/// cannot tell and are left out, unless the rays point in opposite directions: those count against
/// the pose.
pub(crate) fn cheirality(
    b_from_a: &Pose,
    rays: impl Iterator<Item = (DVec3, DVec3)>,
    min_angle: f64,
) -> Cheirality {
    let mut result = Cheirality::default();
    for (a, b) in rays {
        let turned = b_from_a.rotation * a;
        let parallax = turned.cross(b).length().atan2(turned.dot(b));
        if parallax < min_angle {
            continue;
        }
        result.decided += 1;
        if ray_depths(b_from_a, a, b).is_some_and(|(da, db)| da > 0.0 && db > 0.0) {
            result.in_front += 1;
        }
    }
    result
}

/// The pose of an essential matrix with the most points in front of both cameras, and its votes;
/// `None` where the best two tie (a twisted pair that the points cannot tell apart) or nothing has
/// parallax.
pub(crate) fn pose_from_essential(e: &DMat3, rays: &[(DVec3, DVec3)]) -> Option<(Pose, Cheirality)> {
    let mut votes: Vec<(Pose, Cheirality)> = poses_from_essential(e)?
        .into_iter()
        .map(|pose| (pose, cheirality(&pose, rays.iter().copied(), 1e-9)))
        .collect();
    votes.sort_by_key(|(_, v)| std::cmp::Reverse(v.in_front));
    (votes[0].1.in_front > votes[1].1.in_front).then(|| votes[0])
}

/// Motions `b_from_a` with `H ~ R + t nᵀ` whose plane lies in front of most of the `rays` of camera
/// a: one (pure rotation) or up to four; translations in units of the plane's distance from camera
/// a. `h` maps normalised coordinates of a to those of b and has a positive determinant. Ma,
/// Soatto, Košecká & Sastry, "An Invitation to 3-D Vision",  5.3.3 (cf. Malis & Vargas, INRIA
/// RR-6303).
pub(crate) fn motions_from_homography(h: &DMat3, rays: &[DVec3]) -> Vec<Pose> {
    let (u, s, v) = svd3(h);
    if !(s.is_finite() && s.z > 0.0 && h.determinant() > 0.0) {
        return Vec::new();
    }
    let h = *h * (1.0 / s.y);
    let (s1, s3) = (s.x / s.y, s.z / s.y);
    if s1 - s3 < 1e-9 {
        let rotation = u * v.transpose();
        return vec![Pose::from_matrix(rotation, DVec3::ZERO)];
    }
    let v = v * v.determinant().signum();
    let span = (s1 * s1 - s3 * s3).sqrt();
    let (p, q) = ((1.0 - s3 * s3).max(0.0).sqrt() / span, (s1 * s1 - 1.0).max(0.0).sqrt() / span);
    let mut result = Vec::with_capacity(4);
    for sign in [1.0, -1.0] {
        let axis = v.x_axis * p + v.z_axis * (sign * q);
        let normal = v.y_axis.cross(axis);
        let from = DMat3::from_cols(v.y_axis, axis, normal);
        let (y, a) = (h * v.y_axis, h * axis);
        let rotation = DMat3::from_cols(y, a, y.cross(a)) * from.transpose();
        let in_front = rays.iter().filter(|r| r.dot(normal) > 0.0).count();
        let normal = if 2 * in_front >= rays.len() { normal } else { -normal };
        let pose = Pose::from_matrix(rotation, (h - rotation) * normal);
        if pose.is_finite() {
            result.push(pose);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::essential_from_pose;
    use crate::solvers::testing::{Shape, angle, two_views};
    use scene::pose::rotation_angle;

    #[test]
    fn cheirality_picks_the_true_pose_of_four() {
        for seed in 0..100 {
            let s = two_views(seed, 20, Shape::General, 1.0);
            let rays: Vec<_> = s.a.iter().zip(&s.b).map(|(a, b)| (a.extend(1.0), b.extend(1.0))).collect();
            for sign in [1.0, -3.0] {
                let e = essential_from_pose(&s.b_from_a) * sign;
                let (pose, votes) = pose_from_essential(&e, &rays).unwrap();
                assert_eq!(votes.in_front, 20, "seed {seed}");
                assert!(rotation_angle(pose.rotation, s.b_from_a.rotation) < 1e-9, "seed {seed}");
                assert!(angle(pose.translation, s.b_from_a.translation) < 1e-9, "seed {seed}");
            }
        }
    }

    #[test]
    fn one_of_the_motions_of_a_homography_is_the_true_one() {
        for seed in 0..100 {
            let s = two_views(seed, 30, Shape::Plane, 1.0);
            let h = crate::solvers::homography_dlt(&s.a, &s.b).unwrap();
            let rays: Vec<DVec3> = s.a.iter().map(|p| p.extend(1.0)).collect();
            let motions = motions_from_homography(&h, &rays);
            assert!(motions.len() <= 4, "seed {seed}");
            let error = motions
                .iter()
                .map(|m| {
                    rotation_angle(m.rotation, s.b_from_a.rotation)
                        + angle(m.translation, s.b_from_a.translation)
                })
                .fold(f64::INFINITY, f64::min);
            assert!(error < 1e-6, "seed {seed}: {error}");
        }
    }

    #[test]
    fn a_rotation_is_a_homography_without_translation() {
        for seed in 0..100 {
            let s = two_views(seed, 30, Shape::NoBaseline, 1.0);
            let motions = motions_from_homography(&(s.b_from_a.matrix() * 2.0), &[DVec3::Z]);
            assert_eq!(motions.len(), 1, "seed {seed}");
            assert_eq!(motions[0].translation, DVec3::ZERO, "seed {seed}");
            assert!(rotation_angle(motions[0].rotation, s.b_from_a.rotation) < 1e-7, "seed {seed}");
        }
    }

    #[test]
    fn senseless_matrices_have_no_pose() {
        for bad in [DMat3::ZERO, DMat3::NAN, DMat3::from_cols(DVec3::INFINITY, DVec3::X, DVec3::Y)] {
            assert!(poses_from_essential(&bad).is_none());
            assert!(pose_from_essential(&bad, &[(DVec3::Z, DVec3::Z)]).is_none());
            assert!(motions_from_homography(&bad, &[DVec3::Z]).is_empty());
        }
        assert!(pose_from_essential(&DMat3::IDENTITY, &[]).is_none());
    }
}
