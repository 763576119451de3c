//! Single kernels to look at: what the screen holds of each Gaussian, the loss of a picture, the gradients.

use super::backend::GpuBackend;
use super::bound::Stage;
use super::layout::{Frame, PLAIN_GRADIENT};
use crate::backend::Target;
use crate::cpu::Gradients;
use crate::model::{GEOMETRY, padded};
use crate::{PinholeView, RenderOptions, SplatError};

/// A Gaussian on the screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnScreen {
    /// Centre, pixels.
    pub xy: [f32; 2],
    /// Σ'⁻¹ (xx, xy, yy), px⁻².
    pub conic: [f32; 3],
    /// Opacity, with the antialiasing's part.
    pub opacity: f32,
    /// Camera z.
    pub depth: f32,
    /// Colour, at least 0.
    pub rgb: [f32; 3],
}

impl GpuBackend {
    /// Kernel project: [N], nothing where a Gaussian is not seen.
    pub fn projected(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
    ) -> Result<Vec<Option<OnScreen>>, SplatError> {
        self.prepare(view, false)?;
        self.run(self.frame_of(view, options), Stage::Project..=Stage::Project)?;
        let Some((b, _)) = &self.buffers else { return Ok(Vec::new()) };
        let n = self.sizes.n;
        let flags: Vec<u32> = self.gpu.read(&b.flags, 0, n)?;
        let records: Vec<[f32; 12]> = self.gpu.read(&b.records, 0, n)?;
        let seen = |(r, &flag): (&[f32; 12], &u32)| {
            (flag == 1).then(|| OnScreen {
                xy: [r[0], r[1]],
                conic: [r[2], r[3], r[4]],
                opacity: r[5],
                depth: r[6],
                rgb: [r[8], r[9], r[10]],
            })
        };
        Ok(records.iter().zip(&flags).map(seen).collect())
    }

    /// Kernel loss of a picture [H × W × 3]: loss, mean squared error, dL/d(colour) [H × W × 3].
    pub fn loss(
        &mut self,
        view: &PinholeView,
        picture: &[f32],
        target: &Target,
        lambda: f32,
    ) -> Result<(f32, f32, Vec<f32>), SplatError> {
        self.prepare(view, true)?;
        let (flags, weights) = self.set_target(target);
        let pixels = view.width * view.height;
        let image: Vec<[f32; 4]> = picture.chunks_exact(3).map(|c| [c[0], c[1], c[2], 0.0]).collect();
        let inv_count = if weights > 0.0 { (1.0 / (3.0 * weights)) as f32 } else { 0.0 };
        let frame = self.frame_of(view, &RenderOptions::default());
        if let Some((b, _)) = &self.buffers {
            self.gpu.write(&b.image, 0, &image);
        }
        let frame = Frame { flags, lambda, inv_count, ..frame };
        let report = self.run(frame, Stage::Loss..=Stage::Loss)?;
        let (loss, mse) = report.loss(weights, lambda);
        let Some((b, _)) = &self.buffers else { return Ok((loss, mse, Vec::new())) };
        let planes: Vec<f32> = self.gpu.read(&b.gradient, 0, 3 * pixels)?;
        let gradient = (0..3 * pixels).map(|i| planes[i % 3 * pixels + i / 3]).collect();
        Ok((loss, mse, gradient))
    }

    /// dL/d(parameters) where dL/d(colour) is `gradient` [H × W × 3]. Adam's first moments are lost.
    pub fn gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Gradients, SplatError> {
        self.prepare(view, true)?;
        let frame = self.frame_of(view, options);
        self.run(frame, Stage::Project..=Stage::Forward)?;
        let (n, pixels) = (self.sizes.n, view.width * view.height);
        let plane = 4 * padded(n) as u64;
        let first_moments = GEOMETRY as u64 * plane;
        if let Some((b, _)) = &self.buffers {
            let planes: Vec<f32> = (0..3 * pixels).map(|i| gradient[i % pixels * 3 + i / pixels]).collect();
            self.gpu.write(&b.gradient, 0, &planes);
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            if n > 0 {
                encoder.clear_buffer(&b.geometry, first_moments, Some(first_moments));
            }
            encoder.clear_buffer(&b.sh_moments, 0, None);
            self.gpu.queue.submit([encoder.finish()]);
        }
        let frame = Frame { flags: frame.flags | PLAIN_GRADIENT, ..frame };
        self.run(frame, Stage::Backward..=Stage::Optimise)?;
        let Some((b, _)) = &self.buffers else { return Ok(Gradients::default()) };
        let all: Vec<f32> = self.gpu.read(&b.geometry, first_moments, GEOMETRY * padded(n))?;
        let geometry = std::array::from_fn(|p| all[p * padded(n)..(p + 1) * padded(n)].to_vec());
        let stride = self.sizes.sh_stride;
        let both: Vec<f32> = self.gpu.read(&b.sh_moments, 0, n * 2 * stride)?;
        let sh = both.chunks_exact(stride).step_by(2).flatten().copied().collect();
        Ok(Gradients { geometry, sh })
    }
}
