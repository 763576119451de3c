//! Scales are held to what the training views sample, again and again: the finest detail that they
//! can tell is a floor for the scales of Gaussians.

use crate::error::SplatError;
use crate::model::{LOG_SCALE, Model};
use crate::reference::constants::JACOBIAN_MARGIN;
use crate::train::context::RuleContext;
use crate::train::evidence::SAMPLE;
use crate::train::schedule::EVERY;
use crate::view::PinholeView;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Variance of the smallest Gaussian, squared sampling intervals.
/// Source: Yu et al. 2024, Mip-Splatting, the 3D smoothing filter.
const VARIANCE: f32 = 0.2;

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct SmoothingRule {
    /// Times that its place in the schedule was passed.
    times: u32,
}

impl SmoothingRule {
    /// At its places in the schedule: no Gaussian is finer than what the views sample.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let due = f64::from(self.times + 1) * EVERY;
        if !step.setup.config.smoothing || step.position() < due.min(1.0) {
            return Ok(());
        }
        self.times = (step.position() / EVERY) as u32;
        let views = step.cameras();
        step.backend.edit(&mut |model, _| {
            raise_scales(model, &views);
        })
    }
}

/// Raises scales to `√0.2 / ν`, where `ν = max focal / depth` over the views that have the Gaussian
/// in their picture is the highest rate at which it was sampled, pixels a unit. What is finer is
/// not in the photos, and shows where the camera comes nearer. (Yu et al. 2024, Mip-Splatting,
/// section 5.1, convolves with that Gaussian instead; a floor needs no other opacity and leaves
/// what is larger as it is.) Returns how many were raised.
pub(crate) fn raise_scales(model: &mut Model, views: &[PinholeView]) -> usize {
    let every = views.len().div_ceil(SAMPLE).max(1);
    let some: Vec<&PinholeView> = views.iter().step_by(every).collect();
    let means: Vec<_> = (0..model.len).map(|i| model.mean(i)).collect();
    let floors: Vec<f32> = means.par_iter().map(|&x| least_log_scale(x, &some)).collect();
    let mut raised = vec![false; model.len];
    for axis in 0..3 {
        let plane = &mut model.geometry[LOG_SCALE + axis];
        for ((value, floor), raised) in plane.iter_mut().zip(&floors).zip(&mut raised) {
            *raised |= *value < *floor;
            *value = value.max(*floor);
        }
    }
    raised.iter().filter(|r| **r).count()
}

/// Logarithm of the least scale at `x`; minus infinity where no view has it.
fn least_log_scale(x: Vec3, views: &[&PinholeView]) -> f32 {
    let finest = views.iter().map(|v| sampling_rate(v, x)).fold(0.0, f32::max);
    if finest > 0.0 { (VARIANCE.sqrt() / finest).ln() } else { f32::NEG_INFINITY }
}

/// Pixels a unit at `x`; 0 where the view does not have it.
fn sampling_rate(view: &PinholeView, x: Vec3) -> f32 {
    let c = view.camera_point(x);
    let [px, py] = view.pixel(c);
    let seen = c.z > crate::camera::DEFAULT_NEAR && is_near(px, view.width) && is_near(py, view.height);
    if seen { view.focal[0].max(view.focal[1]) / c.z } else { 0.0 }
}

/// Whether a coordinate lies in a picture of that size or in the margin around it.
fn is_near(p: f32, size: usize) -> bool {
    let margin = JACOBIAN_MARGIN as f32;
    p >= -margin * size as f32 && p <= (1.0 + margin) * size as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat3, Quat};
    use scene::Gaussians;

    #[test]
    fn scales_are_raised_to_the_finest_sampling_and_not_where_nothing_samples() {
        let view = |z: f32| PinholeView {
            rotation: Mat3::IDENTITY,
            translation: Vec3::new(0.0, 0.0, z),
            focal: [100.0, 80.0],
            centre: [50.0, 40.0],
            width: 100,
            height: 80,
            parts: crate::parts::PartPlaces::NONE,
        };
        let means = vec![Vec3::ZERO, Vec3::new(0.0, 0.0, 6.0), Vec3::new(100.0, 0.0, 0.0)];
        let mut model = Model::from_gaussians(&Gaussians {
            log_scales: vec![Vec3::new(-9.0, -1.0, -9.0); 3],
            rotations: vec![Quat::IDENTITY; 3],
            opacity_logits: vec![0.0; 3],
            sh: vec![0.0; 9],
            sh_degree: 0,
            means,
        });
        assert_eq!(raise_scales(&mut model, &[view(4.0), view(2.0)]), 2);
        let scale = |axis: usize, i: usize| model.geometry[LOG_SCALE + axis][i];
        // Two units from the nearer camera, 50 pixels a unit; then eight units, 12.5.
        for (i, rate) in [(0, 50.0f32), (1, 12.5)] {
            assert!((scale(0, i) - (0.2f32.sqrt() / rate).ln()).abs() < 1e-5, "{}", scale(0, i));
            assert_eq!(scale(1, i), -1.0);
        }
        assert_eq!(scale(0, 2), -9.0);
    }
}
