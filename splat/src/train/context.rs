//! What a rule is given: the training between two steps.

use super::setup::TrainingSetup;
use super::state::{TrainingState, psnr};
use crate::backend::{Backend, Target};
use crate::dataset::AlphaMode;
use crate::error::SplatError;
use crate::view::{PinholeView, RenderOptions};
use glam::{Mat3, Quat, Vec3};

/// The training as rules see and change it.
pub(crate) struct RuleContext<'a> {
    pub(crate) setup: &'a TrainingSetup<'a>,
    pub(crate) backend: &'a mut dyn Backend,
    pub(crate) state: &'a mut TrainingState,
}

impl RuleContext<'_> {
    /// Position in the schedule, [0, 1].
    pub(crate) fn position(&self) -> f64 {
        self.state.place.position
    }

    /// How many steps the whole schedule will have, as far as can be told.
    pub(crate) fn expected_steps(&self) -> f64 {
        self.state.pace.steps(&self.state.place, self.setup.config)
    }

    /// Level in use now (0: full resolution), if a view has it.
    pub(crate) fn level(&self) -> u32 {
        self.state.place.level(self.setup.config.coarse_levels)
    }

    /// Camera and pose of a view as training sees it now.
    pub(crate) fn camera(&self, view: usize) -> PinholeView {
        let mut given = self.setup.dataset.views[view].view;
        let corrections = &self.state.corrections;
        if !corrections.joints.is_empty() {
            let joints = corrections.hinges.iter().zip(&corrections.joints);
            given.parts = joints.map(|(hinge, [angles, _])| hinge.place_at(angles[view])).collect();
        }
        let place = self.setup.views.binary_search(&view).ok();
        place.and_then(|p| self.state.corrections.poses.get(p)).map_or(given, |p| PinholeView {
            rotation: Mat3::from_quat(Quat::from_xyzw(p[0], p[1], p[2], p[3])),
            translation: Vec3::new(p[4], p[5], p[6]),
            ..given
        })
    }

    /// Cameras and poses of the training views as training sees them now.
    pub(crate) fn cameras(&self) -> Vec<PinholeView> {
        self.setup.views.iter().map(|&v| self.camera(v)).collect()
    }

    /// The gain of a training view: its photo shows the scene times this.
    pub(crate) fn gain(&self, view: usize) -> Option<[f32; 3]> {
        let place = self.setup.views.binary_search(&view).ok()?;
        self.state.corrections.gains.get(place).copied()
    }

    /// How training renders: over black, as the configuration has it.
    pub(crate) fn options(&self) -> RenderOptions {
        RenderOptions { antialias: self.setup.config.antialias, ..RenderOptions::default() }
    }

    /// PSNR of views at a level with spherical harmonics up to a degree, dB.
    pub(crate) fn psnr(
        &mut self,
        views: &[usize],
        level: u32,
        sh_degree: Option<u32>,
    ) -> Result<f64, SplatError> {
        let options = RenderOptions { sh_degree, ..self.options() };
        let mut sum = 0.0;
        for &v in views {
            let (camera, target) = self.photo(v, level);
            self.backend.set_gain(self.gain(v));
            sum += self.backend.mean_square_error(&camera, &target, &options)?;
        }
        Ok(psnr(sum / views.len().max(1) as f64))
    }
}

impl<'a> RuleContext<'a> {
    /// A view and its photo at the level in use or at full resolution.
    pub(crate) fn photo(&self, view: usize, level: u32) -> (PinholeView, Target<'a>) {
        let dataset = self.setup.dataset;
        let (pixels, level) = self.setup.photo(view, level);
        let target = Target {
            rgb: &pixels.rgb,
            mask: pixels.mask.as_deref(),
            transparent: dataset.alpha == AlphaMode::Transparent,
            photo: Some(view as u32),
        };
        (self.camera(view).at_level(level), target)
    }
}
