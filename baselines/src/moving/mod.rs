//! 4DGS: Gaussians at rest, moved to each time by HexPlane features and a small perceptron (Wu et
//! al., "4D Gaussian Splatting for Real-Time Dynamic Scene Rendering", CVPR 2024).

mod deformation;
#[cfg(feature = "gpu")]
mod device;
mod hexplane;
mod settings;
mod shape;
mod store;
mod train;

#[cfg(all(test, feature = "gpu"))]
mod device_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod twin_tests;

use crate::FieldError;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
#[cfg(feature = "gpu")]
use crate::gpu::FieldKit;
use crate::rays::PhotoRays;
use deformation::Deformation;
use serde_json::Value;
use settings::MovingSettings;
pub(crate) use shape::MovingShape;
use splat::moved::MovedGaussians;
use splat::{Dataset, PinholeView, RenderOptions, RenderOutput};
#[cfg(feature = "gpu")]
use std::sync::Arc;
use std::sync::Mutex;

/// Moving Gaussians.
pub(crate) struct Moving {
    shape: MovingShape,
    settings: MovingSettings,
    gaussians: MovedGaussians,
    deformation: Deformation,
    /// Rounds of densification done.
    rounds: u32,
    /// A copy to make pictures with, made when there is one to make.
    shown: Mutex<Option<MovedGaussians>>,
}

impl Moving {
    /// Untrained; without a data set there are no Gaussians yet.
    pub(crate) fn new(shape: MovingShape, dataset: Option<&Dataset>, seed: u64) -> Result<Self, FieldError> {
        let settings = MovingSettings::default();
        let first = dataset.map(|d| shape.first_gaussians(&settings.first, d, seed));
        let gaussians = first.transpose()?.unwrap_or_default();
        let deformation = Deformation::new(shape, &settings, seed);
        Ok(Self { shape, settings, gaussians, deformation, rounds: 0, shown: Mutex::new(None) })
    }

    /// The same with the perceptron on an adapter.
    #[cfg(feature = "gpu")]
    pub(crate) fn on_device(mut self, kit: &Arc<FieldKit>) -> Result<Self, FieldError> {
        self.deformation.heads = Some(Arc::new(device::HeadsOnDevice::new(&self.deformation.stack, kit)?));
        Ok(self)
    }

    fn picture(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        let mut moved =
            self.deformation.moved(&self.gaussians.model().geometry, self.gaussians.model().len, time)?;
        let mut shown = self.shown.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let gaussians = match &mut *shown {
            Some(gaussians) => gaussians,
            none => none.insert(MovedGaussians::new(self.gaussians.model().clone())?),
        };
        let options = RenderOptions { background, ..RenderOptions::default() };
        Ok(gaussians.render(&mut moved.geometry, &moved.tint, view, &options)?)
    }
}

impl RadianceField for Moving {
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        *self.shown.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner) = None;
        self.step(photos, place)
    }

    fn render(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        self.picture(view, time, background)
    }

    fn most_steps(&self, photos: usize) -> f64 {
        self.settings.passes * photos as f64
    }

    fn size(&self) -> usize {
        let model = self.gaussians.model();
        self.deformation.parameters() + model.len * splat::model::GEOMETRY + model.sh.len()
    }

    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        self.kept_arrays(kept)
    }

    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, notes: &Value) -> Result<(), String> {
        self.take_arrays(kept, arrays, notes)
    }
}
