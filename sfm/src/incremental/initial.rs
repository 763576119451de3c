//! The first pair: chosen by evidence, tried with several focal lengths where none is known.

use super::adjust::{Adjustment, adjust};
use super::state::{MapState, MappingInput};
use crate::error::SfmError;
use crate::solvers::{Pairs, pose_from_essential, refine_relative};
use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Pose, Progress, TwoViewGeometry, TwoViewKind};

/// Angle from which on a wider baseline makes a pair no better, radians.
/// Source: chosen by hand, never measured.
const WIDE_ANGLE: f64 = 0.2;

/// Verified pairs from which a model may start, best first: many inliers, a wide median angle,
/// neither a rotation nor a watermark; planes only after all else.
pub(crate) fn rank_pairs(geometries: &[TwoViewGeometry]) -> Vec<usize> {
    let mut ranked: Vec<(f64, usize)> = geometries.iter().map(promise).zip(0..).collect();
    ranked.retain(|(s, _)| *s > 0.0);
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    ranked.into_iter().map(|(_, i)| i).collect()
}

/// How much a pair promises as a start; 0 where it cannot be one.
fn promise(g: &TwoViewGeometry) -> f64 {
    let kind = match g.kind {
        TwoViewKind::Calibrated | TwoViewKind::Uncalibrated => 1.0,
        TwoViewKind::Planar => 0.3,
        TwoViewKind::Panoramic | TwoViewKind::Watermark | TwoViewKind::Degenerate => 0.0,
    };
    let angle = if g.median_angle > 0.0 { g.median_angle.min(WIDE_ANGLE) / WIDE_ANGLE } else { 0.2 };
    kind * angle * g.inliers.len().min(1000) as f64
}

/// The model of two images: their relative pose for the present intrinsics, and the points both
/// see. `None` where too few points stand.
pub(crate) fn start(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    geometry: &TwoViewGeometry,
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    let (a, b) = (geometry.a, geometry.b);
    let (camera_a, camera_b) = (&cameras[input.camera_of[a]], &cameras[input.camera_of[b]]);
    let Some(pose) = relative_pose(input, [camera_a, camera_b], geometry) else { return Ok(None) };
    let mut state = MapState::new(input, cameras.to_vec());
    state.register(a, Pose::IDENTITY);
    state.register(b, pose);
    state.grow_image(input, a);
    if state.live().count() < input.config.min_observations {
        return Ok(None);
    }
    let fixed = cameras.iter().map(|c| vec![false; c.params.len()]).collect();
    adjust(&mut state, input, &Adjustment::growing(fixed, Vec::new()), progress)?;
    state.filter(input, input.config.max_reprojection_px);
    Ok((state.live().count() >= input.config.min_observations).then_some(state))
}

/// The matrix `K` of a camera without its distortion.
pub(crate) fn calibration(c: &Camera) -> DMat3 {
    let (f, p) = (c.focal(), c.principal_point());
    DMat3::from_cols(DVec3::X * f.x, DVec3::Y * f.y, DVec3::new(p.x, p.y, 1.0))
}

/// `b_from_a` with unit translation from the pair's fundamental matrix (else its essential matrix
/// or its pose) and the present focal lengths, refined on the inliers.
pub(crate) fn relative_pose(
    input: &MappingInput<'_>,
    [ca, cb]: [&Camera; 2],
    geometry: &TwoViewGeometry,
) -> Option<Pose> {
    let (fa, fb) = (ca.mean_focal(), cb.mean_focal());
    let (of_a, of_b) = (&input.keypoints[geometry.a], &input.keypoints[geometry.b]);
    let mut pairs: Vec<(DVec2, DVec2)> = Vec::with_capacity(geometry.inliers.len());
    for m in &geometry.inliers {
        if let (Some(u), Some(v)) = (of_a.get(m[0] as usize), of_b.get(m[1] as usize)) {
            pairs.push((ca.unproject(*u), cb.unproject(*v)));
        }
    }
    let rays: Vec<(DVec3, DVec3)> =
        pairs.iter().map(|(u, v)| (u.extend(1.0).normalize(), v.extend(1.0).normalize())).collect();
    let from_f = geometry.f.map(|f| calibration(cb).transpose() * f * calibration(ca));
    let essential = from_f.or(geometry.e);
    let found = essential.and_then(|e| pose_from_essential(&e, &rays)).map(|(pose, _)| pose);
    let start = if geometry.kind == TwoViewKind::Planar {
        geometry.b_from_a.or(found)
    } else {
        found.or(geometry.b_from_a)
    };
    let start = start.filter(|p| p.translation.length() > 0.0)?;
    let (u, v): (Vec<DVec2>, Vec<DVec2>) = pairs.iter().map(|(u, v)| (*u * fa, *v * fb)).unzip();
    let indices: Vec<usize> = (0..u.len()).collect();
    let refined = refine_relative(&start, [fa, fb], Pairs { a: &u, b: &v, indices: &indices }, 1.0, 20);
    Some(refined).filter(Pose::is_finite)
}
