//! [`Backend`] on the CPU.

use super::loss::{LossInput, Shape, loss};
use super::adam::{SharedModel, SharedPlane, Sink, Statistics};
use super::project::{CameraConstants, Parameters};
use super::simd::Isa;
use super::workspace::Workspace;
use crate::backend::{Backend, KernelTimes, Scores, StepInput, StepOutput, Target};
use crate::model::{GEOMETRY, Model, padded};
use crate::{PinholeView, RenderOptions, RenderOutput, SplatError};
use rayon::prelude::*;
use scene::FloatImage;

/// Near plane where the options leave it open, normalised units.
pub const DEFAULT_NEAR: f32 = 0.01;

/// The CPU backend.
pub struct CpuBackend {
    isa: Isa,
    model: Model,
    /// What the steps since the last reset saw.
    pub statistics: Statistics,
    work: Workspace,
    times: KernelTimes,
    clock: fn() -> f64,
}

/// dL/d(parameters) in the layout of [`Model`].
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// By plane.
    pub geometry: [Vec<f32>; GEOMETRY],
    /// [N × K × 3].
    pub sh: Vec<f32>,
}

impl Default for CpuBackend {
    fn default() -> Self {
        Self::new(Isa::best())
    }
}

impl CpuBackend {
    /// An empty backend that uses the instruction set.
    pub fn new(isa: Isa) -> Self {
        let (statistics, work) = (Statistics::default(), Workspace::default());
        let times = KernelTimes::default();
        Self { isa, model: Model::default(), statistics, work, times, clock: crate::clock::wall_seconds }
    }

    /// What the statistics score Gaussians by.
    pub fn set_scores(&mut self, scores: Scores) {
        self.work.scores = scores;
    }

    /// Measures kernels with another clock (seconds), such as the CPU time of the process.
    pub fn set_clock(&mut self, clock: fn() -> f64) {
        self.clock = clock;
    }

    /// Gaussian–pixel pairs that the last picture took, with the unused lanes of vectors.
    pub fn gaussian_pixels(&self) -> u64 {
        self.work.gaussian_pixels(self.isa)
    }

    /// Seconds since `mark`, which moves to now.
    fn lap(&self, mark: &mut f64) -> f64 {
        let before = std::mem::replace(mark, (self.clock)());
        *mark - before
    }

    fn camera(&self, view: &PinholeView, options: &RenderOptions) -> CameraConstants {
        let degree = options.sh_degree.unwrap_or(3).min(self.model.sh_degree);
        CameraConstants::new(view, options, options.near.unwrap_or(DEFAULT_NEAR), degree)
    }

    /// Draws a view; of a picture that is only compared with a target, what counts of it.
    fn forward(
        &mut self,
        view: &PinholeView,
        camera: &CameraConstants,
        options: &RenderOptions,
        target: Option<&Target>,
        depth: bool,
    ) {
        let mut mark = (self.clock)();
        let n = self.model.len;
        self.work.project(self.isa, Parameters::of(&self.model), n, camera);
        self.times.project += self.lap(&mut mark);
        let work = &mut self.work;
        work.bins.fill(&work.keys, &work.records, view.width, view.height);
        self.times.sort += self.lap(&mut mark);
        let work = &mut self.work;
        let shape = Shape { width: view.width, height: view.height };
        work.resize(shape);
        work.limit(target, shape);
        work.forward(self.isa, options.background, depth);
        self.times.forward += self.lap(&mut mark);
    }

    /// dL/d(parameters) where dL/d(colour) is `gradient` ([height × width × 3]).
    pub fn gradients(&mut self, view: &PinholeView, options: &RenderOptions, gradient: &[f32]) -> Gradients {
        let camera = self.camera(view, options);
        self.forward(view, &camera, options, None, false);
        let stride = self.work.shape.stride();
        for (c, plane) in self.work.gradient.iter_mut().enumerate() {
            plane.fill(0.0);
            for (i, pixel) in gradient.chunks_exact(3).enumerate() {
                plane[i / view.width * stride + i % view.width] = pixel[c];
            }
        }
        self.work.backward(self.isa);
        let n = padded(self.model.len);
        let mut out =
            Gradients { geometry: std::array::from_fn(|_| vec![0.0; n]), sh: vec![0.0; self.model.sh.len()] };
        let planes = out.geometry.each_mut().map(|p| SharedPlane(p.as_mut_ptr()));
        let sh = SharedPlane(out.sh.as_mut_ptr());
        let unused = SharedPlane(std::ptr::null_mut());
        let shared =
            SharedModel { geometry: [planes; 3], sh: [sh; 3], steps: unused, statistics: [unused; 4] };
        self.work.optimise(self.isa, Parameters::of(&self.model), shared, &camera, Sink::Gradients, [0.0; 2]);
        out
    }

    /// Mean squared error of a picture against a target, over its pixels that count; statistics stay as they are.
    pub fn mean_square_error(&mut self, view: &PinholeView, target: &Target, options: &RenderOptions) -> f64 {
        let camera = self.camera(view, options);
        self.forward(view, &camera, options, Some(target), false);
        self.work.set_target(self.isa, target, options.background);
        let weighted = target.mask.is_some() && !target.transparent;
        let work = &mut self.work;
        let input = LossInput {
            shape: work.shape,
            rgb: &work.rgb,
            target: &work.target,
            weight: weighted.then_some(work.weight.as_slice()),
            lambda: 0.0,
        };
        f64::from(loss(self.isa, &input, &mut work.gradient, &mut work.parts).mse)
    }

    /// Sums over the pixels that count, by channel: Σ r t, Σ r², Σ t² of the rendering r and the photo t (no gain).
    pub fn products(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> [[f64; 3]; 3] {
        self.set_gain(None);
        let camera = self.camera(view, options);
        self.forward(view, &camera, options, Some(target), false);
        self.work.set_target(self.isa, target, options.background);
        let weighted = target.mask.is_some() && !target.transparent;
        let (work, stride) = (&self.work, self.work.shape.stride());
        let mut sums = [[0.0; 3]; 3];
        for (c, (r, t)) in work.rgb.iter().zip(&work.target).enumerate() {
            for y in 0..view.height {
                let row = y * stride..y * stride + view.width;
                for i in row {
                    let w = if weighted { f64::from(work.weight[i]) } else { 1.0 };
                    let (r, t) = (f64::from(r[i]), f64::from(t[i]));
                    sums[0][c] += w * r * t;
                    sums[1][c] += w * r * r;
                    sums[2][c] += w * t * t;
                }
            }
        }
        sums
    }

    /// The gain of the view to come: its photo shows the scene times this, so that targets are divided by it.
    pub fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        self.work.gain = gain;
    }

    /// The loss of the last rendering against a target, and dL/d(colour) into the workspace.
    fn loss(&mut self, input: &StepInput) -> super::loss::LossValue {
        self.work.set_target(self.isa, &input.target, input.options.background);
        let weighted = input.target.mask.is_some() && !input.target.transparent;
        let work = &mut self.work;
        let input = LossInput {
            shape: work.shape,
            rgb: &work.rgb,
            target: &work.target,
            weight: weighted.then_some(work.weight.as_slice()),
            lambda: input.lambda_dssim,
        };
        loss(self.isa, &input, &mut work.gradient, &mut work.parts)
    }

    fn shared(&mut self) -> SharedModel {
        let planes = |p: &mut [Vec<f32>; GEOMETRY]| p.each_mut().map(|p| SharedPlane(p.as_mut_ptr()));
        let m = &mut self.model;
        let s = &mut self.statistics;
        let plane = |p: &mut Vec<f32>| SharedPlane(p.as_mut_ptr());
        SharedModel {
            geometry: [planes(&mut m.geometry), planes(&mut m.geometry_m), planes(&mut m.geometry_v)],
            sh: [plane(&mut m.sh), plane(&mut m.sh_m), plane(&mut m.sh_v)],
            steps: plane(&mut m.steps),
            statistics: [
                plane(&mut s.gradient),
                plane(&mut s.visible),
                plane(&mut s.weight),
                plane(&mut s.radius),
            ],
        }
    }
}

impl CpuBackend {
    /// Takes parameters and moments; statistics begin anew.
    pub fn upload(&mut self, model: Model) {
        self.statistics.reset(model.len);
        self.model = model;
    }

    /// The present parameters and moments.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Renders the Gaussians.
    pub fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> RenderOutput {
        let camera = self.camera(view, options);
        self.forward(view, &camera, options, None, true);
        let (w, h, stride) = (view.width, view.height, self.work.shape.stride());
        let mut out = RenderOutput {
            rgb: FloatImage::zeros(w, h, 3),
            alpha: FloatImage::zeros(w, h, 1),
            depth: FloatImage::zeros(w, h, 1),
        };
        let work = &self.work;
        let rows = out.rgb.data.par_chunks_mut(3 * w.max(1)).zip(out.alpha.data.par_chunks_mut(w.max(1)));
        rows.zip(out.depth.data.par_chunks_mut(w.max(1))).enumerate().for_each(
            |(y, ((rgb, alphas), depths))| {
                let row = y * stride..y * stride + w;
                let planes = work.rgb.each_ref().map(|plane| &plane[row.clone()]);
                let (clear, far) = (&work.transmittance[row.clone()], &work.depth[row]);
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
        out
    }
}

impl Backend for CpuBackend {
    fn name(&self) -> String {
        format!("processor, {:?}", self.isa.kind())
    }

    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError> {
        self.model = model;
        self.statistics = statistics;
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
        change(&mut self.model, &mut self.statistics);
        Ok(())
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
        Ok(Self::render(self, view, options))
    }

    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        if self.statistics.gradient.len() != padded(self.model.len) {
            self.statistics.reset(self.model.len);
        }
        let camera = self.camera(input.view, &input.options);
        self.forward(input.view, &camera, &input.options, Some(&input.target), false);
        let mut mark = (self.clock)();
        let value = self.loss(input);
        self.times.loss += self.lap(&mut mark);
        self.work.backward(self.isa);
        self.times.backward += self.lap(&mut mark);
        let visible = self.work.bins.order.len();
        let share = 1.0 / visible.max(1) as f32;
        let penalties = [input.opacity_penalty * share, input.scale_penalty * share];
        let (parameters, shared) = (Parameters::of(&self.model), self.shared());
        let non_finite =
            self.work.optimise(self.isa, parameters, shared, &camera, Sink::Adam(input.rates), penalties);
        self.times.optimise += self.lap(&mut mark);
        let pairs = self.work.bins.list.len();
        Ok(StepOutput { loss: value.loss, mse: value.mse, visible, pairs, non_finite })
    }

    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError> {
        Ok(Self::mean_square_error(self, view, target, options))
    }

    fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        Self::set_gain(self, gain);
    }

    fn products(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<[[f64; 3]; 3], SplatError> {
        Ok(Self::products(self, view, target, options))
    }

    fn set_scores(&mut self, scores: Scores) -> Result<(), SplatError> {
        Self::set_scores(self, scores);
        Ok(())
    }

    fn times(&self) -> KernelTimes {
        self.times
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::rasterise::SUMS;
    use glam::{Mat3, Quat, Vec3};
    use rand::Rng as _;
    use scene::Gaussians;

    fn gaussians(n: usize) -> Gaussians {
        let mut rng = scene::rng::rng(3, "reach", 0);
        let mut of =
            |low: f32, high: f32| Vec3::from_array(std::array::from_fn(|_| rng.random_range(low..high)));
        let mut g = Gaussians::default();
        for _ in 0..n {
            g.means.push(of(-1.0, 1.0));
            g.log_scales.push(of(-4.0, -1.5));
            g.rotations.push(Quat::from_scaled_axis(of(-1.0, 1.0)));
            g.opacity_logits.push(of(-2.0, 2.0).x);
            g.sh.extend(of(-1.0, 1.0).to_array());
        }
        g
    }

    /// A picture whose weights leave most tiles out has the gradients that it has when all tiles are drawn.
    #[test]
    fn tiles_that_no_weight_reaches_have_no_part_in_the_gradient() {
        let (width, height) = (100, 70);
        let view = PinholeView {
            rotation: Mat3::IDENTITY,
            translation: Vec3::new(0.0, 0.0, 3.0),
            focal: [90.0; 2],
            centre: [50.0, 35.0],
            width,
            height,
        };
        let rgb: Vec<u8> = (0..width * height * 3).map(|i| (i * 37 % 251) as u8).collect();
        let mask: Vec<u8> = (0..width * height)
            .map(|i| if (30..44).contains(&(i % width)) && i / width > 50 { 200 } else { 0 })
            .collect();
        let target = Target { rgb: &rgb, mask: Some(&mask), transparent: false, photo: None };
        let options = RenderOptions::default();
        let mut backend = CpuBackend::default();
        backend.upload(Model::from_gaussians(&gaussians(300)));
        let camera = backend.camera(&view, &options);
        let input = StepInput {
            view: &view,
            target,
            options,
            rates: Default::default(),
            lambda_dssim: 0.2,
            opacity_penalty: 0.0,
            scale_penalty: 0.0,
        };
        let mut found: Vec<(f32, Vec<[f32; SUMS]>, usize)> = Vec::new();
        for counted in [None, Some(&target)] {
            backend.forward(&view, &camera, &options, counted, false);
            let loss = backend.loss(&input).loss;
            backend.work.backward(backend.isa);
            let drawn = backend.work.used.iter().filter(|&&u| u > 0).count();
            found.push((loss, backend.work.sums.clone(), drawn));
        }
        assert!(found[0].2 > 30 && found[1].2 <= 9, "{} and {} tiles", found[0].2, found[1].2);
        assert_eq!(found[0].0, found[1].0);
        assert!(found[0].1.iter().any(|sums| sums[0] != 0.0));
        for (all, some) in found[0].1.iter().zip(&found[1].1) {
            assert_eq!(all[..9], some[..9]);
        }
    }
}
