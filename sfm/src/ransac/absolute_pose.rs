//! Camera poses for the RANSAC loop.

use super::{Estimator, RansacConfig, RansacResult, ransac};
use crate::solvers::{AbsoluteRefinement, p3p, refine_absolute};
use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Pose};

/// Finds the pose of a calibrated camera. The threshold is in pixels, the residual the reprojection
/// error.
pub(super) struct AbsolutePoseEstimator {
    pixels: Vec<DVec2>,
    rays: Vec<DVec3>,
    points: Vec<DVec3>,
    focal: f64,
    loss_scale: f64,
}

impl AbsolutePoseEstimator {
    /// For ideal (undistorted) pixels from the principal point, the world points they see and the
    /// focal length in pixels. Refinement uses a robust loss of width `loss_scale` px.
    pub(super) fn new(pixels: Vec<DVec2>, points: Vec<DVec3>, focal: f64, loss_scale: f64) -> Self {
        let rays = pixels.iter().map(|p| (*p / focal).extend(1.0).normalize()).collect();
        Self { pixels, rays, points, focal, loss_scale }
    }
}

/// A pose and its rotation as a matrix, which is quicker to apply.
#[derive(Clone, Copy, Debug)]
pub(super) struct AbsoluteModel {
    pose: Pose,
    rotation: DMat3,
}

impl From<Pose> for AbsoluteModel {
    fn from(pose: Pose) -> Self {
        Self { pose, rotation: DMat3::from_quat(pose.rotation) }
    }
}

impl Estimator for AbsolutePoseEstimator {
    type Model = AbsoluteModel;

    fn sample_size(&self) -> usize {
        3
    }

    fn num_data(&self) -> usize {
        self.pixels.len().min(self.points.len())
    }

    fn solve(&self, sample: &[usize], models: &mut Vec<AbsoluteModel>) {
        let Ok(sample) = <[usize; 3]>::try_from(sample) else { return };
        let poses = p3p(&sample.map(|i| self.rays[i]), &sample.map(|i| self.points[i]));
        models.extend(poses.into_iter().map(AbsoluteModel::from));
    }

    #[inline]
    fn residual_sq(&self, model: &AbsoluteModel, i: usize) -> f64 {
        let x = model.rotation * self.points[i] + model.pose.translation;
        if x.z > 0.0 {
            (x.truncate() * (self.focal / x.z)).distance_squared(self.pixels[i])
        } else {
            f64::INFINITY
        }
    }

    fn refine(&self, model: &AbsoluteModel, inliers: &[usize]) -> Option<AbsoluteModel> {
        let start = AbsoluteRefinement { pose: model.pose, focal: self.focal };
        let refined = refine_absolute(start, &self.pixels, &self.points, inliers, false, self.loss_scale, 8);
        Some(refined.pose.into())
    }
}

/// `cam_from_world` of a camera from pixels and the world points they see; the inliers are indices
/// into both. Pairs with a number that is not finite are outliers. The threshold of `config` is in
/// pixels.
pub(crate) fn estimate_absolute_pose(
    camera: &Camera,
    pixels: &[DVec2],
    points: &[DVec3],
    config: &RansacConfig,
    stream_index: u64,
) -> Option<RansacResult<Pose>> {
    let focal = camera.mean_focal();
    let usable: Vec<usize> = (0..pixels.len().min(points.len()))
        .filter(|&i| pixels[i].is_finite() && points[i].is_finite())
        .collect();
    let ideal = usable.iter().map(|&i| camera.unproject(pixels[i]) * focal).collect();
    let world = usable.iter().map(|&i| points[i]).collect();
    let estimator = AbsolutePoseEstimator::new(ideal, world, focal, config.threshold / 4.0);
    let RansacResult { model, inliers, score } = ransac(&estimator, config, stream_index)?;
    let inliers = inliers.into_iter().map(|i| usable[i]).collect();
    Some(RansacResult { model: model.pose, inliers, score })
}
