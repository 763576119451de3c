//! Gradients that nobody steps along: of a picture's colours with given weights.

use super::backend::GpuBackend;
use super::bound::Stage;
use super::layout::Frame;
use crate::error::SplatError;
use crate::model::{GEOMETRY, OPACITY};
use crate::reference::constants::BETAS;
use crate::view::{PinholeView, RenderOptions};

impl GpuBackend {
    /// Leaves (1 − β₁) dL/d(geometry) in the first moments, where dL/d(colour) is `gradient`
    /// [H × W × 3]; the harmonics take a step at `sh_rate`. Adam's moments are lost.
    pub(super) fn differentiate(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
        sh_rate: f32,
    ) -> Result<(), SplatError> {
        self.prepare(view, true)?;
        let frame = Frame { rate_sh0: sh_rate, rate_sh_rest: sh_rate, ..self.frame_of(view, options) };
        self.run(frame, Stage::Project..=Stage::Forward, None)?;
        let (Some((b, _)), Some(pages)) = (&self.screen, &self.pages) else { return Ok(()) };
        // What the loss leaves in the picture's place: dL/dC and C · dL/dC.
        let image: Vec<[f32; 4]> = self.gpu.read(&b.image, 0, view.width * view.height)?;
        let weighted =
            |(c, g): (&[f32; 4], &[f32])| [g[0], g[1], g[2], g[0] * c[0] + g[1] * c[1] + g[2] * c[2]];
        let gradient: Vec<[f32; 4]> = image.iter().zip(gradient.chunks_exact(3)).map(weighted).collect();
        self.gpu.write(&b.image, 0, &gradient);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for page in &pages.list {
            let moments = 4 * GEOMETRY as u64 * u64::from(page.job.stride);
            encoder.clear_buffer(&page.geometry, moments, Some(moments));
        }
        self.gpu.queue.submit([encoder.finish()]);
        // The other rates are zero: no shape moves, and
        // the first moments become (1 − β₁) times the gradient.
        self.run(frame, Stage::Backward..=Stage::Optimise, None)?;
        Ok(())
    }

    /// dL/d(logit of the opacity), by Gaussian; see [`Self::differentiate`].
    pub(super) fn logit_gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Vec<f32>, SplatError> {
        self.differentiate(view, options, gradient, 0.0)?;
        let mut all = Vec::with_capacity(self.sizes.room);
        for page in self.pages.iter().flat_map(|p| &p.list) {
            let plane = 4 * (GEOMETRY + OPACITY) as u64 * u64::from(page.job.stride);
            all.extend(self.gpu.read::<f32>(&page.geometry, plane, page.job.count as usize)?);
        }
        let share = (1.0 - BETAS[0]) as f32;
        all.iter_mut().for_each(|m| *m /= share);
        Ok(all)
    }
}
