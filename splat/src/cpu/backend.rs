//! [`Backend`] on the CPU.

use super::densify::densify_by_edit;
use super::dispatch::Isa;
use super::loss::LossValue;
use super::model_part::{ModelGradient, ModelPart};
use super::workspace::KernelWorkspace;
use crate::backend::{Backend, KernelTimes, Round, StepInput, StepOutput, Target, check};
use crate::camera::PartCameras;
use crate::error::SplatError;
use crate::model::{Model, OPACITY, Planes};
use crate::statistics::Statistics;
use crate::view::{PinholeView, RenderOptions, RenderOutput};
use rayon::prelude::*;
use scene::FloatImage;

/// The CPU backend.
pub(crate) struct CpuBackend {
    isa: Isa,
    model: Model,
    statistics: Statistics,
    work: KernelWorkspace,
    times: KernelTimes,
    clock: fn() -> f64,
}

impl Default for CpuBackend {
    fn default() -> Self {
        Self::new(Isa::best())
    }
}

impl CpuBackend {
    /// An empty backend that uses the instruction set.
    pub(crate) fn new(isa: Isa) -> Self {
        Self {
            isa,
            model: Model::default(),
            statistics: Statistics::default(),
            work: KernelWorkspace::default(),
            times: KernelTimes::default(),
            clock: scene::clock::wall_seconds,
        }
    }

    /// Measures kernels with another clock (seconds), such as the CPU time of the process.
    pub(crate) fn set_clock(&mut self, clock: fn() -> f64) {
        self.clock = clock;
    }

    /// Gaussian–pixel pairs that the last picture took, with the unused lanes of vectors.
    pub(crate) fn gaussian_pixels(&self) -> u64 {
        self.work.gaussian_pixels(self.isa)
    }

    /// Seconds since `mark`, which moves to now.
    fn lap(&self, mark: &mut f64) -> f64 {
        let before = std::mem::replace(mark, (self.clock)());
        *mark - before
    }

    /// Draws a view; of a picture that is only compared with a target, what counts of it.
    fn forward(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        target: Option<&Target>,
        depth: bool,
    ) -> PartCameras {
        let cameras = PartCameras::new(view, options, self.model.sh_degree);
        let mut mark = (self.clock)();
        self.work.project(self.isa, &self.model, &cameras);
        self.times.project += self.lap(&mut mark);
        self.work.sort(view.width, view.height);
        self.times.sort += self.lap(&mut mark);
        self.work.forward(self.isa, options.background, target, depth);
        self.times.forward += self.lap(&mut mark);
        cameras
    }

    /// Forward, loss and its gradient back to the screen.
    fn compare(&mut self, input: &StepInput) -> (PartCameras, LossValue) {
        self.statistics.fit(self.model.len);
        let cameras = self.forward(input.view, &input.options, Some(&input.target), false);
        let mut mark = (self.clock)();
        self.work.set_target(self.isa, &input.target, input.options.background);
        let value = self.work.loss(self.isa, input.lambda_dssim);
        self.times.loss += self.lap(&mut mark);
        self.work.backward(self.isa);
        self.times.backward += self.lap(&mut mark);
        (cameras, value)
    }

    /// From the screen to the parameters, and Adam.
    fn optimise(&mut self, input: &StepInput, cameras: &PartCameras, value: LossValue) -> StepOutput {
        let mut mark = (self.clock)();
        let model = ModelPart::adam(&mut self.model, &mut self.statistics, input.rates);
        let (non_finite, pulls) = self.work.optimise(self.isa, model, cameras);
        self.times.optimise += self.lap(&mut mark);
        let [visible, pairs] = self.work.visible_and_pairs();
        StepOutput { loss: value.loss, mse: value.mse, visible, pairs, non_finite, pulls }
    }

    /// The Gaussians.
    pub(crate) fn model(&self) -> &Model {
        &self.model
    }

    /// What was seen of them.
    pub(crate) fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Puts the geometry given in the place of the model's, which is given back.
    pub(crate) fn swap_geometry(&mut self, other: &mut Planes) -> Result<(), SplatError> {
        if other.iter().zip(&self.model.geometry).any(|(o, own)| o.len() != own.len()) {
            let reason = "a plane has another length than the number of Gaussians asks for";
            return Err(SplatError::InvalidGaussians(reason.to_owned()));
        }
        std::mem::swap(&mut self.model.geometry, other);
        Ok(())
    }

    /// Adds a tint ([N × 3]) to the constant terms of the spherical harmonics; returns what they
    /// were.
    pub(crate) fn add_tint(&mut self, tint: &[f32]) -> Result<Vec<f32>, SplatError> {
        if tint.len() != 3 * self.model.len {
            let reason = "a tint has another length than the number of Gaussians asks for";
            return Err(SplatError::InvalidGaussians(reason.to_owned()));
        }
        let mut rest = Vec::with_capacity(tint.len());
        let stride = self.model.sh_stride();
        for (sh, tint) in self.model.sh.chunks_exact_mut(stride).zip(tint.chunks_exact(3)) {
            rest.extend_from_slice(&sh[..3]);
            sh.iter_mut().zip(tint).for_each(|(s, t)| *s += t);
        }
        Ok(rest)
    }

    /// Takes the tint back: exactly, where the terms were not changed.
    pub(crate) fn remove_tint(&mut self, rest: &[f32], tint: &[f32]) {
        let stride = self.model.sh_stride();
        let tints = rest.chunks_exact(3).zip(tint.chunks_exact(3));
        for (sh, (rest, tint)) in self.model.sh.chunks_exact_mut(stride).zip(tints) {
            for ((s, r), t) in sh.iter_mut().zip(rest).zip(tint) {
                *s = r + (*s - (r + t));
            }
        }
    }

    /// A step with the geometry `moved` and a tint, which become their own gradients; the model's
    /// is changed as those would be.
    pub(crate) fn step_moved(
        &mut self,
        input: &StepInput,
        moved: &mut Planes,
        tint: &mut [f32],
    ) -> Result<StepOutput, SplatError> {
        let mut gradient = ModelGradient::zeros(&self.model);
        self.swap_geometry(moved)?;
        let tinted = self.add_tint(tint);
        if tinted.is_err() {
            self.swap_geometry(moved)?;
        }
        let colours = tinted?;
        let before = self.model.geometry.clone();
        let (cameras, value) = self.compare(input);
        self.work.optimise(self.isa, ModelPart::gradient(&mut self.model, &mut gradient), &cameras);
        let output = self.optimise(input, &cameras, value);
        for ((rest, after), before) in moved.iter_mut().zip(&self.model.geometry).zip(&before) {
            for ((r, a), b) in rest.iter_mut().zip(after).zip(before) {
                *r += a - b;
            }
        }
        std::mem::swap(&mut self.model.geometry, moved);
        self.remove_tint(&colours, tint);
        *moved = gradient.geometry;
        let of_sh = gradient.sh.chunks_exact(self.model.sh_stride());
        of_sh.zip(tint.chunks_exact_mut(3)).for_each(|(of_sh, tint)| tint.copy_from_slice(&of_sh[..3]));
        Ok(output)
    }

    /// dL/d(parameters) where dL/d(colour) is `gradient` ([height × width × 3]).
    #[cfg_attr(not(test), expect(dead_code, reason = "the tests compare them with the reference"))]
    pub(crate) fn gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> ModelGradient {
        let cameras = self.forward(view, options, None, false);
        self.work.set_gradient(gradient);
        self.work.backward(self.isa);
        let mut out = ModelGradient::zeros(&self.model);
        let part = ModelPart::gradient(&mut self.model, &mut out);
        (_, out.pulls) = self.work.optimise(self.isa, part, &cameras);
        out
    }
}

impl Backend for CpuBackend {
    fn name(&self) -> String {
        format!("processor, {:?}", self.isa.kind())
    }

    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError> {
        check(&model, &statistics)?;
        (self.model, self.statistics) = (model, statistics);
        Ok(())
    }

    fn download(&mut self) -> Result<(Model, Statistics), SplatError> {
        Ok((self.model.clone(), self.statistics.clone()))
    }

    fn release(&mut self) -> Result<(Model, Statistics), SplatError> {
        Ok((std::mem::take(&mut self.model), std::mem::take(&mut self.statistics)))
    }

    fn show(&mut self, look: &mut dyn FnMut(&Model, &Statistics)) -> Result<(), SplatError> {
        look(&self.model, &self.statistics);
        Ok(())
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Model, &mut Statistics)) -> Result<(), SplatError> {
        let (mut model, mut statistics) = self.release()?;
        change(&mut model, &mut statistics);
        statistics.fit(model.len);
        self.upload(model, statistics)
    }

    fn densify(&mut self, round: &Round) -> Result<usize, SplatError> {
        let unseen = densify_by_edit(self, round)?;
        self.model.sort_in_space();
        Ok(unseen)
    }

    fn gaussians(&self) -> usize {
        self.model.len
    }

    fn sh_degree(&self) -> u32 {
        self.model.sh_degree
    }

    fn capacity(&self, _: u32, _: usize) -> Option<(usize, String)> {
        None
    }

    fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<RenderOutput, SplatError> {
        self.forward(view, options, None, true);
        let (w, h) = (view.width, view.height);
        let mut out = RenderOutput {
            rgb: FloatImage::zeros(w, h, 3),
            alpha: FloatImage::zeros(w, h, 1),
            depth: FloatImage::zeros(w, h, 1),
        };
        let drawn = self.work.drawn();
        let rows = out.rgb.data.par_chunks_mut(3 * w.max(1)).zip(out.alpha.data.par_chunks_mut(w.max(1)));
        rows.zip(out.depth.data.par_chunks_mut(w.max(1))).enumerate().for_each(
            |(y, ((rgb, alphas), depths))| {
                let row = y * drawn.stride..y * drawn.stride + w;
                let planes = drawn.rgb.each_ref().map(|plane| &plane[row.clone()]);
                let (clear, far) = (&drawn.transmittance[row.clone()], &drawn.depth[row]);
                for x in 0..w {
                    for c in 0..3 {
                        rgb[x * 3 + c] = planes[c][x];
                    }
                    let alpha = 1.0 - clear[x];
                    alphas[x] = alpha;
                    depths[x] = if alpha > 0.0 { far[x] / alpha } else { 0.0 };
                }
            },
        );
        Ok(out)
    }

    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        let (cameras, value) = self.compare(input);
        Ok(self.optimise(input, &cameras, value))
    }

    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError> {
        self.forward(view, options, Some(target), false);
        self.work.set_target(self.isa, target, options.background);
        Ok(f64::from(self.work.loss(self.isa, 0.0).mse))
    }

    fn opacity_gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Vec<f32>, SplatError> {
        self.forward(view, options, None, false);
        self.work.set_gradient(gradient);
        self.work.backward(self.isa);
        // dL/dlogit = (1 − o) · o dL/do, of which the pairs have the sums.
        let logits = self.model.geometry[OPACITY][..self.model.len].iter();
        let sums = (0..self.model.len).map(|i| self.work.opacity_sum(i));
        Ok(logits.zip(sums).map(|(l, sum)| sum / (1.0 + l.exp())).collect())
    }

    fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        self.work.gain = gain;
    }

    fn products(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<[[f64; 3]; 3], SplatError> {
        self.set_gain(None);
        self.forward(view, options, Some(target), false);
        self.work.set_target(self.isa, target, options.background);
        let (drawn, wanted) = (self.work.drawn(), self.work.target());
        let mut sums = [[0.0; 3]; 3];
        for (c, (r, t)) in drawn.rgb.iter().zip(wanted.target).enumerate() {
            for y in 0..view.height {
                for i in y * drawn.stride..y * drawn.stride + view.width {
                    let w = wanted.weight.map_or(1.0, |weight| f64::from(weight[i]));
                    let (r, t) = (f64::from(r[i]), f64::from(t[i]));
                    sums[0][c] += w * r * t;
                    sums[1][c] += w * r * r;
                    sums[2][c] += w * t * t;
                }
            }
        }
        Ok(sums)
    }

    fn times(&self) -> KernelTimes {
        self.times
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::LearningRates;
    use crate::model::{MEAN, padded};
    use glam::{Mat3, Quat, Vec3};
    use scene::Gaussians;

    fn model(n: usize) -> Model {
        Model::from_gaussians(&Gaussians {
            means: vec![Vec3::ZERO; n],
            log_scales: vec![Vec3::splat(-2.0); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![0.0; n],
            sh: vec![0.5; 3 * n],
            sh_degree: 0,
        })
    }

    fn view() -> PinholeView {
        PinholeView {
            rotation: Mat3::IDENTITY,
            translation: Vec3::Z * 3.0,
            focal: [40.0; 2],
            centre: [20.0, 15.0],
            width: 40,
            height: 30,
            parts: crate::parts::PartPlaces::NONE,
        }
    }

    fn step(backend: &mut CpuBackend, rgb: &[u8]) -> StepOutput {
        let input = StepInput {
            view: &view(),
            target: Target { rgb, mask: None, transparent: false, photo: None },
            options: RenderOptions::default(),
            rates: LearningRates::default(),
            lambda_dssim: 0.2,
        };
        backend.step(&input).unwrap()
    }

    #[test]
    fn models_and_statistics_of_wrong_lengths_are_refused() {
        let broken: [fn(&mut Model, &mut Statistics); 10] = [
            |m, _| m.len += 100,
            |m, _| m.sh_degree = 1,
            |m, _| m.sh_degree = 4,
            |m, _| m.geometry[MEAN].truncate(5),
            |m, _| m.geometry_m[3].clear(),
            |m, _| m.geometry_v[10].truncate(16),
            |m, _| m.sh.truncate(7),
            |m, _| m.sh_v[2].clear(),
            |m, _| m.steps.truncate(31),
            |_, s| s.visible.truncate(16),
        ];
        for (k, change) in broken.into_iter().enumerate() {
            let (mut m, mut s) = (model(20), Statistics::default());
            s.reset(20);
            change(&mut m, &mut s);
            let mut backend = CpuBackend::default();
            assert!(matches!(backend.upload(m, s), Err(SplatError::InvalidGaussians(_))), "{k}");
            assert_eq!(backend.gaussians(), 0, "{k}: what was refused is not held");
        }
    }

    #[test]
    fn an_edit_that_breaks_the_model_is_an_error_and_nothing_is_drawn_of_it() {
        let mut backend = CpuBackend::default();
        backend.upload(model(20), Statistics::default()).unwrap();
        assert!(backend.edit(&mut |model, _| model.len = 1000).is_err());
        assert_eq!(step(&mut backend, &[9; 3600]).visible, 0);
    }

    #[test]
    fn an_edit_that_changes_the_number_of_gaussians_forgets_what_was_seen_of_them() {
        let mut backend = CpuBackend::default();
        backend.upload(model(20), Statistics::default()).unwrap();
        assert_eq!(step(&mut backend, &[9; 3600]).visible, 20);
        backend
            .edit(&mut |model, _| {
                model.append(&vec![(Model::row(Vec3::X, Vec3::ZERO, Quat::IDENTITY, 0.0), 3); 50])
            })
            .unwrap();
        let (_, statistics) = backend.download().unwrap();
        assert_eq!(statistics.visible, vec![0.0; padded(70)]);
        assert_eq!(step(&mut backend, &[9; 3600]).visible, 70);
    }

    #[test]
    #[should_panic]
    fn a_target_of_another_size_than_the_view_is_never_read_beyond_its_end() {
        let mut backend = CpuBackend::default();
        backend.upload(model(20), Statistics::default()).unwrap();
        step(&mut backend, &[9; 3599]);
    }
}
