//! Matches along the epipolar lines of images whose poses are known.

use crate::error::SfmError;
use crate::incremental::initial::calibration;
use crate::limits::WIDEST_ANGLE;
use crate::matching::{MatchConfig, PreparedSet, guided_match_prepared};
use crate::solvers::essential_from_pose;
use crate::triangulation::angle_between;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Features, Pose, Progress, TwoViewGeometry, TwoViewKind};
use std::collections::HashSet;

/// Images with their features and, where it is known, their pose.
pub(crate) struct PosedImages<'a> {
    pub features: &'a [Features],
    /// Positions of the features as the poses have them, pixels.
    pub keypoints: &'a [Vec<DVec2>],
    pub cameras: Vec<&'a Camera>,
    pub poses: Vec<Option<Pose>>,
}

impl PosedImages<'_> {
    /// The matches of `known` with those of `pairs` that lie within `band` pixels of their epipolar
    /// lines; pairs that are not known need `fewest`. Images that look far apart are left as they
    /// are.
    pub(crate) fn match_along_lines(
        &self,
        pairs: &[(usize, usize)],
        known: &[TwoViewGeometry],
        (band, fewest): (f64, usize),
        config: &MatchConfig,
        progress: &Progress,
    ) -> Result<Vec<TwoViewGeometry>, SfmError> {
        let prepared = PreparedSet::new(self.features);
        let ideal: Vec<Features> = (0..self.features.len()).map(|i| self.undistorted(i)).collect();
        progress.begin("matching along the lines of poses", pairs.len());
        let found: Result<Vec<Option<TwoViewGeometry>>, SfmError> = pairs
            .par_iter()
            .map(|&(a, b)| {
                progress.tick()?;
                let known = known.iter().find(|g| (g.a, g.b) == (a, b));
                let Some((f, b_from_a)) = self.line_between(a, b) else { return Ok(known.cloned()) };
                let Some((in_a, in_b)) = prepared.get(a).zip(prepared.get(b)) else { return Ok(None) };
                let (a_side, b_side) = ((&ideal[a], &*in_a), (&ideal[b], &*in_b));
                let matches = guided_match_prepared(a_side, b_side, &f, band, config);
                Ok(merge_geometry(known, (a, b), matches, &f, b_from_a, fewest))
            })
            .collect();
        Ok(found?.into_iter().flatten().collect())
    }

    /// The fundamental matrix between the ideal images of two cameras, and the pose of b in a;
    /// `None` where a pose is not known or they look far apart.
    fn line_between(&self, a: usize, b: usize) -> Option<(DMat3, Pose)> {
        let [pose_a, pose_b] = [self.poses[a]?, self.poses[b]?];
        let [axis_a, axis_b] = [pose_a, pose_b].map(|pose| pose.rotation.conjugate() * DVec3::Z);
        let b_from_a = pose_b.compose(&pose_a.inverse());
        let [k_a, k_b] = [a, b].map(|i| calibration(self.cameras[i]).inverse());
        let f = k_b.transpose() * essential_from_pose(&b_from_a) * k_a;
        (angle_between(axis_a, axis_b) <= WIDEST_ANGLE).then_some((f, b_from_a))
    }

    /// Keypoints where an ideal camera of the same focal length would see them.
    fn undistorted(&self, image: usize) -> Features {
        let camera = self.cameras[image];
        let keypoints = self.features[image].keypoints.clone();
        let mut result = Features { keypoints, descriptors: Vec::new() };
        for (k, pixel) in result.keypoints.iter_mut().zip(&self.keypoints[image]) {
            let p = camera.unproject(*pixel) * camera.focal() + camera.principal_point();
            (k.x, k.y) = (p.x as f32, p.y as f32);
        }
        result
    }
}

/// One-to-one matches: the pair's own inliers first, then what was found and does not contradict
/// them.
fn merge_geometry(
    known: Option<&TwoViewGeometry>,
    (a, b): (usize, usize),
    found: Vec<[u32; 2]>,
    f: &DMat3,
    b_from_a: Pose,
    fewest: usize,
) -> Option<TwoViewGeometry> {
    let mut inliers = known.map(|g| g.inliers.clone()).unwrap_or_default();
    let (of_a, of_b): (HashSet<u32>, HashSet<u32>) = inliers.iter().map(|m| (m[0], m[1])).unzip();
    let fresh: Vec<[u32; 2]> =
        found.into_iter().filter(|m| !of_a.contains(&m[0]) && !of_b.contains(&m[1])).collect();
    if known.is_none() && fresh.len() < fewest {
        return None;
    }
    inliers.extend(fresh);
    inliers.sort_unstable();
    if let Some(known) = known {
        return Some(TwoViewGeometry { inliers, ..known.clone() });
    }
    Some(TwoViewGeometry {
        a,
        b,
        kind: TwoViewKind::Calibrated,
        inliers,
        f: Some(*f),
        e: Some(essential_from_pose(&b_from_a)),
        h: None,
        b_from_a: Some(b_from_a),
        median_angle: 0.0,
    })
}
