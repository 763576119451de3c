//! Single kernels to look at: what the screen holds of each Gaussian, the loss of a picture, the
//! gradients.

use super::backend::GpuBackend;
use super::bound::Stage;
use super::context::Gpu;
use super::layout::Frame;
use crate::adapter::Adapter;
use crate::backend::{Backend, Target};
use crate::cpu::ModelGradient;
use crate::error::SplatError;
use crate::parity::subject::Seen;
use crate::reference::constants::BETAS;
use crate::view::{PinholeView, RenderOptions};

impl GpuBackend {
    /// What it runs on.
    pub(crate) fn adapter(&self) -> &Adapter {
        &self.gpu.adapter
    }

    /// The device itself.
    pub(crate) fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Pages of the model, and photos that stay on the device.
    pub(crate) fn held(&self) -> [usize; 2] {
        [self.pages.as_ref().map_or(0, |p| p.list.len()), self.photos.count()]
    }

    /// Kernel project: \[N\], nothing where a Gaussian is not seen.
    pub(crate) fn projected(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
    ) -> Result<Vec<Option<Seen>>, SplatError> {
        self.prepare(view, false)?;
        self.run(self.frame_of(view, options), Stage::Project..=Stage::Project, None)?;
        let (Some((b, _)), n) = (&self.screen, self.gaussians()) else { return Ok(Vec::new()) };
        let flags: Vec<u32> = self.gpu.read(&b.flags, 0, n)?;
        let records: Vec<[f32; 8]> = self.gpu.read(&b.records, 0, n)?;
        let colours: Vec<[f32; 4]> = self.gpu.read(&b.colours, 0, n)?;
        let all = records.iter().zip(&colours).zip(&flags).map(|((r, c), &flag)| {
            (flag == 1).then(|| Seen {
                xy: [r[0], r[1]],
                conic: [r[2], r[3], r[4]],
                opacity: r[5],
                depth: r[6],
                rgb: [c[0], c[1], c[2]],
            })
        });
        Ok(all.collect())
    }

    /// Kernel loss of a picture [H × W × 3]: loss, mean squared error, dL/d(colour) [H × W × 3].
    pub(crate) fn loss(
        &mut self,
        view: &PinholeView,
        picture: &[f32],
        target: &Target,
        lambda: f32,
    ) -> Result<(f32, f32, Vec<f32>), SplatError> {
        self.prepare(view, true)?;
        self.settle_all()?;
        let Some(photo) = self.place(target) else { return Ok((0.0, 0.0, Vec::new())) };
        let (flags, weights) = (photo.flags, photo.weights);
        let pixels = view.width * view.height;
        let image: Vec<[f32; 4]> = picture.chunks_exact(3).map(|c| [c[0], c[1], c[2], 0.0]).collect();
        let inv_count = if weights > 0.0 { (1.0 / (3.0 * weights)) as f32 } else { 0.0 };
        let frame = self.frame_of(view, &RenderOptions::default());
        if let Some((b, _)) = &self.screen {
            self.gpu.write(&b.image, 0, &image);
        }
        let frame = Frame { flags, lambda, inv_count, ..frame };
        let report = self.run(frame, Stage::Loss..=Stage::Loss, Some(photo))?;
        let (loss, mse) = report.loss(weights, lambda);
        let Some((b, _)) = &self.screen else { return Ok((loss, mse, Vec::new())) };
        let gradient: Vec<[f32; 4]> = self.gpu.read(&b.image, 0, pixels)?;
        let gradient = gradient.iter().flat_map(|g| g[..3].to_vec()).collect();
        Ok((loss, mse, gradient))
    }

    /// dL/d(parameters) where dL/d(colour) is `gradient` [H × W × 3]. Adam's moments are lost.
    pub(crate) fn gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<ModelGradient, SplatError> {
        self.prepare(view, true)?;
        let (mut model, statistics) = self.download()?;
        let before = model.sh.clone();
        // Moments so large that no gradient changes them, past all correction: harmonics take steps
        // in proportion to their gradients, and so long that what they were counts for nothing.
        let (vast, long) = (80f32.exp2(), 40f32.exp2());
        model.sh_v.iter_mut().for_each(|plane| plane.fill(vast));
        model.steps.fill(1e6);
        self.upload(model, statistics)?;
        let size = (BETAS[1] as f32 * vast).sqrt();
        self.differentiate(view, options, gradient, size * long)?;
        let (mut model, _) = self.download()?;
        let share = (1.0 - BETAS[0]) as f32;
        model.geometry_m.iter_mut().flatten().for_each(|m| *m /= share);
        let sh = before.iter().zip(&model.sh).map(|(old, new)| (old - new) / long).collect();
        Ok(ModelGradient { geometry: model.geometry_m, sh, ..ModelGradient::default() })
    }
}
