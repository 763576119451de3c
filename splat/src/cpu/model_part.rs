//! A model lent to the optimiser in parts, one a task.

use crate::backend::LearningRates;
use crate::model::{GEOMETRY, Model, padded};
use crate::parts::PartPulls;
use crate::statistics::Statistics;

/// Gaussians of a part at most, a multiple of every vector's lanes. Source: chosen by hand, never
/// measured.
pub(super) const PART: usize = 512;

/// The derivatives of a scalar with respect to the parameters, in the layout of [`Model`].
#[derive(Clone, Debug, Default)]
pub(crate) struct ModelGradient {
    /// By plane.
    pub(crate) geometry: [Vec<f32>; GEOMETRY],
    /// [N × K × 3].
    pub(crate) sh: Vec<f32>,
    /// With respect to the motions of parts.
    pub(crate) pulls: PartPulls,
}

impl ModelGradient {
    /// All zero, in the shape of a model.
    pub(super) fn zeros(model: &Model) -> Self {
        let n = padded(model.len);
        let (geometry, sh) = (std::array::from_fn(|_| vec![0.0; n]), vec![0.0; model.sh.len()]);
        Self { geometry, sh, pulls: PartPulls::default() }
    }
}

/// Some Gaussians of a model that one task works on.
pub(super) struct ModelPart<'a> {
    /// Number of the first one.
    pub(super) first: usize,
    /// How many there are.
    pub(super) count: usize,
    /// SH values of one Gaussian.
    pub(super) sh_stride: usize,
    /// Planes of the parameters, padded.
    pub(super) geometry: [&'a mut [f32]; GEOMETRY],
    /// [N × K × 3].
    pub(super) sh: &'a mut [f32],
    /// Parts of the object, of all Gaussians of the model; none where nothing moves.
    pub(super) of_object: &'a [u8],
    /// Where gradients go.
    pub(super) sink: GradientSink<'a>,
}

/// What becomes of the gradients.
#[expect(clippy::large_enum_variant, reason = "it lives on the stack: a box would take memory in every step")]
pub(super) enum GradientSink<'a> {
    /// They are written here, and nothing moves.
    Gradient { geometry: [&'a mut [f32]; GEOMETRY], sh: &'a mut [f32] },
    /// A step of Adam.
    Adam(AdamPart<'a>),
}

/// Adam's state of some Gaussians, and their statistics.
pub(super) struct AdamPart<'a> {
    /// Step sizes.
    pub(super) rates: LearningRates,
    /// First moments of the geometry.
    pub(super) geometry_m: [&'a mut [f32]; GEOMETRY],
    /// Second moments of the geometry.
    pub(super) geometry_v: [&'a mut [f32]; GEOMETRY],
    /// Second moments of the constant harmonic by channel.
    pub(super) sh_v: [&'a mut [f32]; 3],
    /// Clocks.
    pub(super) steps: &'a mut [f32],
    /// Sums of the screen gradients' norms.
    pub(super) gradient: &'a mut [f32],
    /// Steps in which the Gaussian was visible.
    pub(super) visible: &'a mut [f32],
}

impl<'a> ModelPart<'a> {
    /// A whole model that takes a step.
    pub(super) fn adam(model: &'a mut Model, statistics: &'a mut Statistics, rates: LearningRates) -> Self {
        let (count, sh_stride) = (model.len, model.sh_stride());
        let sink = GradientSink::Adam(AdamPart {
            rates,
            geometry_m: slices(&mut model.geometry_m),
            geometry_v: slices(&mut model.geometry_v),
            sh_v: slices(&mut model.sh_v),
            steps: &mut model.steps,
            gradient: &mut statistics.gradient,
            visible: &mut statistics.visible,
        });
        let (geometry, sh) = (slices(&mut model.geometry), &mut model.sh);
        Self { first: 0, count, sh_stride, geometry, sh, of_object: &model.part, sink }
    }

    /// A whole model whose gradient is wanted.
    pub(super) fn gradient(model: &'a mut Model, out: &'a mut ModelGradient) -> Self {
        let (count, sh_stride) = (model.len, model.sh_stride());
        let sink = GradientSink::Gradient { geometry: slices(&mut out.geometry), sh: &mut out.sh };
        let (geometry, sh) = (slices(&mut model.geometry), &mut model.sh);
        Self { first: 0, count, sh_stride, geometry, sh, of_object: &model.part, sink }
    }

    /// Two parts of about the same size, unless it is small.
    pub(super) fn halve(self) -> (Self, Option<Self>) {
        if self.count <= PART {
            return (self, None);
        }
        let at = self.count.div_ceil(2).next_multiple_of(PART);
        let at_sh = at * self.sh_stride;
        let [geometry, geometry_rest] = split(self.geometry, at);
        let (sh, sh_rest) = self.sh.split_at_mut(at_sh);
        let (sink, sink_rest) = self.sink.split(at, at_sh);
        let (count, sh_stride) = (self.count - at, self.sh_stride);
        let rest = Self {
            first: self.first + at,
            count,
            sh_stride,
            geometry: geometry_rest,
            sh: sh_rest,
            of_object: self.of_object,
            sink: sink_rest,
        };
        (
            Self { first: self.first, count: at, sh_stride, geometry, sh, of_object: self.of_object, sink },
            Some(rest),
        )
    }
}

impl GradientSink<'_> {
    fn split(self, at: usize, at_sh: usize) -> (Self, Self) {
        match self {
            Self::Gradient { geometry, sh } => {
                let [geometry, geometry_rest] = split(geometry, at);
                let (sh, sh_rest) = sh.split_at_mut(at_sh);
                (Self::Gradient { geometry, sh }, Self::Gradient { geometry: geometry_rest, sh: sh_rest })
            }
            Self::Adam(part) => {
                let (part, rest) = part.split(at);
                (Self::Adam(part), Self::Adam(rest))
            }
        }
    }
}

impl AdamPart<'_> {
    fn split(self, at: usize) -> (Self, Self) {
        let [geometry_m, geometry_m_rest] = split(self.geometry_m, at);
        let [geometry_v, geometry_v_rest] = split(self.geometry_v, at);
        let [[steps, gradient, visible], rest] = split([self.steps, self.gradient, self.visible], at);
        let [sh_v, sh_v_rest] = split(self.sh_v, at);
        let rates = self.rates;
        let [steps_rest, gradient_rest, visible_rest] = rest;
        let rest = Self {
            rates,
            geometry_m: geometry_m_rest,
            geometry_v: geometry_v_rest,
            sh_v: sh_v_rest,
            steps: steps_rest,
            gradient: gradient_rest,
            visible: visible_rest,
        };
        (Self { rates, geometry_m, geometry_v, sh_v, steps, gradient, visible }, rest)
    }
}

fn slices<const N: usize>(planes: &mut [Vec<f32>; N]) -> [&mut [f32]; N] {
    planes.each_mut().map(|plane| plane.as_mut_slice())
}

/// What lies before `at` of each slice, and the rest.
fn split<const N: usize>(slices: [&mut [f32]; N], at: usize) -> [[&mut [f32]; N]; 2] {
    let mut halves = slices.map(|slice| slice.split_at_mut(at));
    let first = halves.each_mut().map(|half| std::mem::take(&mut half.0));
    [first, halves.map(|half| half.1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A model of `n` Gaussians of SH degree 1 whose clocks and coefficients tell their numbers.
    fn numbered(n: usize) -> Model {
        let mut model = Model { len: n, sh_degree: 1, ..Model::default() };
        let planes = [&mut model.geometry, &mut model.geometry_m, &mut model.geometry_v];
        planes.into_iter().flatten().for_each(|plane| plane.resize(padded(n), 0.0));
        model.steps = (0..padded(n)).map(|i| i as f32).collect();
        model.sh = (0..n * 12).map(|k| (k / 12) as f32).collect();
        model.sh_v.fill(model.steps.clone());
        model
    }

    fn parts<'a>(whole: ModelPart<'a>, out: &mut Vec<ModelPart<'a>>) {
        match whole.halve() {
            (part, None) => out.push(part),
            (first, Some(rest)) => {
                parts(first, out);
                parts(rest, out);
            }
        }
    }

    #[test]
    fn parts_are_all_of_the_model_and_each_holds_its_own_gaussians() {
        for n in [0, 1, 16, 511, 512, 513, 1024, 1025, 5000, 8193] {
            let (mut model, mut statistics) = (numbered(n), Statistics::default());
            statistics.reset(n);
            let mut all = Vec::new();
            parts(ModelPart::adam(&mut model, &mut statistics, LearningRates::default()), &mut all);
            let mut next = 0;
            for part in &all {
                assert_eq!(part.first, next, "{n}");
                assert!(part.count <= PART && part.first % 16 == 0, "{n}: {} at {}", part.count, part.first);
                let GradientSink::Adam(state) = &part.sink else { panic!("it takes a step") };
                assert!(state.steps.len() >= part.count && state.steps.len() % 16 == 0, "{n}");
                for i in 0..part.count {
                    let number = (part.first + i) as f32;
                    assert_eq!((state.steps[i], part.sh[12 * i]), (number, number), "{n}");
                    assert_eq!((state.sh_v[0][i], state.sh_v[2][i]), (number, number), "{n}");
                }
                next += part.count;
            }
            assert_eq!(next, n);
        }
    }
}
