//! What the suite needs of a backend, and who is tested.

use scene::Gaussians;
use crate::backend::{Backend, StepInput, StepOutput};
use crate::cpu::loss::{LossInput, Shape, loss};
use crate::cpu::project::{CULLED, CameraConstants, Parameters, Project, Record, project};
use crate::cpu::simd::Isa;
use crate::cpu::{CpuBackend, DEFAULT_NEAR};
use crate::model::{GEOMETRY, Model};
use crate::{PinholeView, RenderOptions, RenderOutput};

/// A Gaussian on the screen as a backend sees it.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub xy: [f32; 2],
    pub conic: [f32; 3],
    pub depth: f32,
    pub opacity: f32,
    pub rgb: [f32; 3],
}

/// dL/d(parameters): [plane][Gaussian] in the order of [`Model`], and SH.
pub struct Gradient {
    pub geometry: [Vec<f32>; GEOMETRY],
    pub sh: Vec<f32>,
}

/// A backend under test.
pub trait Subject {
    fn name(&self) -> String;
    /// How many of `steps` steps it is worth to take: an emulated adapter is slow.
    fn affordable(&self, steps: usize) -> usize {
        steps
    }
    /// Kernels project and sh: [N], nothing where culled (a backend may also cull what lies outside the picture).
    fn project(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> Vec<Option<Seen>>;
    /// Kernel loss: loss, mean squared error and dL/d(colour) [H × W × 3]. Targets and weights are multiples of 1/255.
    fn loss(
        &mut self,
        size: [usize; 2],
        rgb: &[f32],
        target: &[f32],
        weight: Option<&[f32]>,
        lambda: f32,
    ) -> (f32, f32, Vec<f32>);
    fn render(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> RenderOutput;
    /// From dL/d(colour) [H × W × 3].
    fn gradients(
        &mut self,
        g: &Gaussians,
        view: &PinholeView,
        options: &RenderOptions,
        d: &[f32],
    ) -> Gradient;
    /// A training step; the model is changed.
    fn step(&mut self, model: &mut Model, input: &StepInput) -> StepOutput;
}

/// Everyone who is tested here.
pub fn subjects() -> Vec<Box<dyn Subject>> {
    let cpu = |isa| Box::new(Cpu { isa, backend: CpuBackend::new(isa) }) as Box<dyn Subject>;
    #[allow(unused_mut)]
    let mut all: Vec<_> = Isa::available().into_iter().map(cpu).collect();
    #[cfg(feature = "gpu")]
    all.push(Box::new(super::gpu::Adapter));
    all
}

struct Cpu {
    isa: Isa,
    backend: CpuBackend,
}

impl Subject for Cpu {
    fn name(&self) -> String {
        format!("cpu {:?}", self.isa.kind())
    }

    fn project(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> Vec<Option<Seen>> {
        let model = Model::from_gaussians(g);
        let degree = options.sh_degree.unwrap_or(3).min(g.sh_degree);
        let camera = CameraConstants::new(view, options, options.near.unwrap_or(DEFAULT_NEAR), degree);
        let (mut records, mut keys) = (vec![Record::default(); g.len()], vec![CULLED; g.len()]);
        let parameters = Parameters::of(&model);
        let (r, k) = (&mut records, &mut keys);
        project(self.isa, &mut Project { parameters, camera: &camera, start: 0, records: r, keys: k });
        let ln2 = std::f32::consts::LN_2;
        let seen = |(r, &k): (&Record, &u32)| {
            (k != CULLED).then(|| Seen {
                xy: [r.x, r.y],
                conic: [2.0 * ln2 * r.half_xx, ln2 * r.xy, 2.0 * ln2 * r.half_yy],
                depth: r.depth,
                opacity: r.log2_opacity.exp2(),
                rgb: r.rgb,
            })
        };
        records.iter().zip(&keys).map(seen).collect()
    }

    fn loss(
        &mut self,
        [width, height]: [usize; 2],
        rgb: &[f32],
        target: &[f32],
        weight: Option<&[f32]>,
        lambda: f32,
    ) -> (f32, f32, Vec<f32>) {
        let shape = Shape { width, height };
        let at = |i: usize| i / width * shape.stride() + i % width;
        let plane = |values: &[f32], step: usize, c: usize| {
            let mut plane = vec![0.0; shape.plane()];
            (0..width * height).for_each(|i| plane[at(i)] = values[i * step + c]);
            plane
        };
        let weight = weight.map(|w| plane(w, 1, 0));
        let x: [Vec<f32>; 3] = std::array::from_fn(|c| plane(rgb, 3, c));
        let mut y: [Vec<f32>; 3] = std::array::from_fn(|c| plane(target, 3, c));
        if let Some(w) = &weight {
            // The kernel's contract: pixels of weight 0 have the colour that was rendered.
            for (y, x) in y.iter_mut().zip(&x) {
                (0..y.len()).filter(|&i| w[i] == 0.0).for_each(|i| y[i] = x[i]);
            }
        }
        let mut gradient: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; shape.plane()]);
        let input = LossInput { shape, rgb: &x, target: &y, weight: weight.as_deref(), lambda };
        let value = loss(self.isa, &input, &mut gradient, &mut Vec::new());
        let interleaved = (0..width * height * 3).map(|i| gradient[i % 3][at(i / 3)]).collect();
        (value.loss, value.mse, interleaved)
    }

    fn render(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> RenderOutput {
        self.backend.upload(Model::from_gaussians(g));
        self.backend.render(view, options)
    }

    fn gradients(
        &mut self,
        g: &Gaussians,
        view: &PinholeView,
        options: &RenderOptions,
        d: &[f32],
    ) -> Gradient {
        self.backend.upload(Model::from_gaussians(g));
        let out = self.backend.gradients(view, options, d);
        Gradient { geometry: out.geometry, sh: out.sh }
    }

    fn step(&mut self, model: &mut Model, input: &StepInput) -> StepOutput {
        self.backend.upload(std::mem::take(model));
        let out = self.backend.step(input).unwrap();
        *model = self.backend.model().clone();
        out
    }
}
