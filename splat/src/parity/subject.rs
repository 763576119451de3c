//! What the suite needs of a backend, and who is tested.

use crate::backend::{Backend, StepInput, StepOutput};
use crate::camera::PartCameras;
use crate::cpu::dispatch::Isa;
use crate::cpu::loss::{LossInput, loss};
use crate::cpu::project::{CULLED, Project, Record, project};
use crate::cpu::tile::PlaneShape;
use crate::cpu::{CpuBackend, ModelGradient};
use crate::model::Model;
use crate::statistics::Statistics;
use crate::{PinholeView, RenderOptions, RenderOutput};
use scene::Gaussians;

/// A Gaussian on the screen as a backend sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Centre, pixels.
    pub(crate) xy: [f32; 2],
    /// Σ'⁻¹ (xx, xy, yy), px⁻².
    pub(crate) conic: [f32; 3],
    /// Camera z.
    pub(crate) depth: f32,
    /// Opacity, with the antialiasing's part.
    pub(crate) opacity: f32,
    /// Colour, at least 0.
    pub(crate) rgb: [f32; 3],
}

/// A backend under test.
pub(crate) trait Subject {
    fn name(&self) -> String;
    /// The backend itself, which nobody else uses meanwhile.
    fn with(&mut self, run: &mut dyn FnMut(&mut dyn Backend));
    /// How many of `steps` steps it is worth to take: an emulated adapter is slow.
    fn affordable(&self, steps: usize) -> usize {
        steps
    }
    /// Kernels project and sh: [N], nothing where culled (a backend may also cull what lies outside
    /// the picture).
    fn project(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> Vec<Option<Seen>>;
    /// Kernel loss: loss, mean squared error and dL/d(colour) [H × W × 3]. Targets and weights are
    /// multiples of 1/255.
    fn loss(
        &mut self,
        size: [usize; 2],
        rgb: &[f32],
        target: &[f32],
        weight: Option<&[f32]>,
        lambda: f32,
    ) -> (f32, f32, Vec<f32>);
    fn render(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> RenderOutput {
        let mut out = None;
        self.with(&mut |backend| {
            backend.upload(Model::from_gaussians(g), Statistics::default()).unwrap();
            out = Some(backend.render(view, options).unwrap());
        });
        out.unwrap()
    }
    /// From dL/d(colour) [H × W × 3].
    fn gradients(
        &mut self,
        g: &Gaussians,
        view: &PinholeView,
        options: &RenderOptions,
        d: &[f32],
    ) -> ModelGradient;
    /// A training step; the model is changed.
    fn step(&mut self, model: &mut Model, input: &StepInput) -> StepOutput {
        let mut out = None;
        self.with(&mut |backend| {
            backend.upload(std::mem::take(model), Statistics::default()).unwrap();
            out = Some(backend.step(input).unwrap());
            *model = backend.release().unwrap().0;
        });
        out.unwrap()
    }
}

/// Everyone who is tested here.
pub(crate) fn subjects() -> Vec<Box<dyn Subject>> {
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

    fn with(&mut self, run: &mut dyn FnMut(&mut dyn Backend)) {
        run(&mut self.backend);
    }

    fn project(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> Vec<Option<Seen>> {
        let model = Model::from_gaussians(g);
        let cameras = PartCameras::new(view, options, g.sh_degree);
        let (mut records, mut keys) = (vec![Record::default(); g.len()], vec![CULLED; g.len()]);
        let (r, k) = (&mut records, &mut keys);
        project(self.isa, &mut Project { model: &model, cameras: &cameras, start: 0, records: r, keys: k });
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
        let shape = PlaneShape { width, height };
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

    fn gradients(
        &mut self,
        g: &Gaussians,
        view: &PinholeView,
        options: &RenderOptions,
        d: &[f32],
    ) -> ModelGradient {
        self.backend.upload(Model::from_gaussians(g), Statistics::default()).unwrap();
        self.backend.gradients(view, options, d)
    }
}
