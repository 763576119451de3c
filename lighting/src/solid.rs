//! A splat as a solid: what is opaque.

use glam::DVec3;
use scene::{Camera, Gaussians, Pose};
use splat::surface::median_depth;

/// Share of the median distance before which nothing is seen. Source: splat's own near plane.
const NEAR: f64 = 0.01;

/// The Gaussians of a scene, world frame.
#[derive(Clone, Copy, Debug)]
pub struct SolidSplat<'a> {
    /// The scene.
    pub gaussians: &'a Gaussians,
    /// As in training.
    pub antialias: bool,
}

impl SolidSplat<'_> {
    /// Camera z of the surface in each pixel, scene units.
    pub(crate) fn depth(&self, camera: &Camera, pose: &Pose) -> Vec<Option<f64>> {
        let near = NEAR * self.gaussians.median_distance(pose.centre());
        median_depth(self.gaussians, camera, pose, near, self.antialias)
    }

    /// Whether a Gaussian is more opaque than not.
    pub(crate) fn is_opaque(&self, i: usize) -> bool {
        self.gaussians.opacity_logits[i] > 0.0
    }

    /// The centre of a Gaussian.
    pub(crate) fn place(&self, i: usize) -> DVec3 {
        self.gaussians.means[i].as_dvec3()
    }

    /// The ball around what is opaque; `None` where nothing is or it has no size.
    pub(crate) fn ball(&self) -> Option<Ball> {
        let opaque = (0..self.gaussians.len()).filter(|&i| self.is_opaque(i));
        let places: Vec<DVec3> = opaque.map(|i| self.place(i)).filter(|p| p.is_finite()).collect();
        let low = places.iter().copied().reduce(DVec3::min)?;
        let high = places.iter().copied().reduce(DVec3::max)?;
        let centre = (low + high) / 2.0;
        let radius = places.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
        (radius > 0.0 && radius.is_finite()).then_some(Ball { centre, radius })
    }
}

/// A ball, world frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ball {
    pub(crate) centre: DVec3,
    /// Scene units.
    pub(crate) radius: f64,
}
