//! Where Gaussians are at a time: HexPlane features, then a small perceptron (Wu et al. 2024,
//! section 4.2).

#[cfg(feature = "gpu")]
use super::device::HeadsOnDevice;
use super::hexplane::{CHUNK, FEATURES, HexPlanes, LEVELS, Place, Smoothness};
use super::settings::MovingSettings;
use super::shape::{Moved, MovingShape, OUTPUTS};
use crate::FieldError;
use crate::adam::{AdamMoments, AdamRates};
use crate::stack::{LayerPlan, Stack, StackLayers};
use rayon::prelude::*;
use scene::rng::rng;
use splat::model::Planes;
#[cfg(feature = "gpu")]
use std::sync::Arc;

/// Planes and perceptron, and their optimiser.
#[derive(Clone, Debug)]
pub(super) struct Deformation {
    shape: MovingShape,
    smoothness: Smoothness,
    pub(super) stack: Stack,
    pub(super) planes: HexPlanes,
    pub(super) weights: Vec<f32>,
    pub(super) plane_moments: Vec<AdamMoments>,
    pub(super) weight_moments: AdamMoments,
    /// What evaluates the perceptron, where that is not this processor.
    #[cfg(feature = "gpu")]
    pub(super) heads: Option<Arc<HeadsOnDevice>>,
}

/// Gradients of planes and weights.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DeformationGradient {
    pub(super) planes: Vec<Vec<f32>>,
    pub(super) weights: Vec<f32>,
}

impl Deformation {
    /// One that moves nothing yet.
    pub(super) fn new(shape: MovingShape, settings: &MovingSettings, seed: u64) -> Self {
        // The paper's three heads lie beside each other.
        let (width, heads) = (settings.width, 3 * settings.width);
        let plans = [
            LayerPlan { input: Some(0), ..LayerPlan::after(0, width, true) },
            LayerPlan::after(width, heads, true),
            LayerPlan::after(heads, OUTPUTS, false),
        ];
        let stack = Stack::new(&[FEATURES * LEVELS], &plans);
        let mut weights = stack.initial(&mut rng(seed, "deformation", 0));
        weights[stack.layer(2)].fill(0.0);
        let planes = HexPlanes::new(shape.space, shape.times, seed);
        let plane_moments = planes.values.iter().map(|v| AdamMoments::new(v.len())).collect();
        let weight_moments = AdamMoments::new(weights.len());
        Self {
            shape,
            smoothness: settings.smoothness,
            stack,
            planes,
            weights,
            plane_moments,
            weight_moments,
            #[cfg(feature = "gpu")]
            heads: None,
        }
    }

    /// Numbers learnt.
    pub(super) fn parameters(&self) -> usize {
        self.weights.len() + self.planes.values.iter().map(Vec::len).sum::<usize>()
    }

    /// Where Gaussian `i` lies in the planes at a time.
    fn place(&self, rest: &Planes, i: usize, time: f32) -> Place {
        let domain = &self.shape.domain;
        let reach = 2.0 * domain.reach();
        let [x, y, z] = [0, 1, 2].map(|a| (rest[a][i] - domain.centre[a]) / reach + 0.5);
        [x, y, z, time]
    }

    /// Features of places, a row each.
    #[cfg(feature = "gpu")]
    fn encode(&self, places: &[Place], rows: &mut [f32]) {
        let rows = rows.par_chunks_mut(FEATURES * LEVELS * CHUNK).zip(places.par_chunks(CHUNK));
        rows.for_each(|(rows, places)| {
            let rows = rows.chunks_exact_mut(FEATURES * LEVELS);
            rows.zip(places).for_each(|(row, place)| self.planes.encode(place, row));
        });
    }

    /// Encodes places and evaluates the perceptron.
    fn evaluate(&self, places: &[Place], layers: &mut StackLayers) {
        self.stack.reserve(places.len(), layers);
        let rows = layers.inputs[0].chunks_exact_mut(FEATURES * LEVELS);
        rows.zip(places).for_each(|(row, place)| self.planes.encode(place, row));
        self.stack.forward(&self.weights, layers);
    }

    /// The perceptron's outputs at places, a row each.
    fn outputs(&self, places: &[Place]) -> Result<Vec<f32>, FieldError> {
        #[cfg(feature = "gpu")]
        if let Some(heads) = &self.heads {
            let mut features = vec![0.0; places.len() * FEATURES * LEVELS];
            self.encode(places, &mut features);
            return heads.outputs(&self.weights, &features);
        }
        let width = self.stack.width(2);
        let chunks = places.par_chunks(CHUNK).map_init(StackLayers::default, |layers, places| {
            self.evaluate(places, layers);
            layers.outputs[2][..places.len() * width].to_vec()
        });
        Ok(chunks.collect::<Vec<_>>().concat())
    }

    /// Gradients of the weights and of the features, a row a place, from those of the outputs.
    fn of_outputs(&self, places: &[Place], of_outputs: &[f32]) -> Result<[Vec<f32>; 2], FieldError> {
        #[cfg(feature = "gpu")]
        if let Some(heads) = &self.heads {
            let mut features = vec![0.0; places.len() * FEATURES * LEVELS];
            self.encode(places, &mut features);
            return heads.gradients(&self.weights, &features, of_outputs);
        }
        let (transposed, width) = (self.stack.transposed(&self.weights), self.stack.width(2));
        let parts: Vec<[Vec<f32>; 2]> = places
            .par_chunks(CHUNK)
            .zip(of_outputs.par_chunks(CHUNK * width))
            .map_init(StackLayers::default, |layers, (places, of_outputs)| {
                self.evaluate(places, layers);
                let mut padded = of_outputs.to_vec();
                padded.resize(layers.outputs[2].len(), 0.0);
                let mut gradient = vec![0.0; self.weights.len()];
                self.stack.backward(&transposed, layers, (&padded, &[]), &mut gradient, true);
                [gradient, layers.of_inputs[0][..places.len() * FEATURES * LEVELS].to_vec()]
            })
            .collect();
        let mut weights = vec![0.0f32; self.weights.len()];
        let mut of_rows = Vec::with_capacity(places.len() * FEATURES * LEVELS);
        for [gradient, rows] in parts {
            weights.iter_mut().zip(gradient).for_each(|(w, g)| *w += g);
            of_rows.extend(rows);
        }
        Ok([weights, of_rows])
    }

    /// Unit of what the outputs move.
    fn unit(&self, output: usize) -> f32 {
        if output < 3 { self.shape.domain.half } else { 1.0 }
    }

    /// What `count` Gaussians, whose geometry at rest is given, are at a time.
    pub(super) fn moved(&self, rest: &Planes, count: usize, time: f32) -> Result<Moved, FieldError> {
        let mut moved = Moved::rest(rest, count);
        let places: Vec<Place> = (0..count).map(|i| self.place(rest, i, time)).collect();
        let outputs = self.outputs(&places)?;
        for (i, row) in outputs.chunks_exact(self.stack.width(2)).enumerate() {
            for (output, value) in row[..OUTPUTS].iter().enumerate() {
                *moved.value_mut(output, i) += self.unit(output) * value;
            }
        }
        Ok(moved)
    }

    /// The gradient of planes and weights from that of the moved geometry.
    pub(super) fn gradient(
        &self,
        rest: &Planes,
        count: usize,
        time: f32,
        of_moved: &Moved,
    ) -> Result<DeformationGradient, FieldError> {
        let touched: Vec<usize> =
            (0..count).filter(|&i| (0..OUTPUTS).any(|output| of_moved.value(output, i) != 0.0)).collect();
        let places: Vec<Place> = touched.iter().map(|&i| self.place(rest, i, time)).collect();
        let width = self.stack.width(2);
        let mut of_outputs = vec![0.0; touched.len() * width];
        for (row, &i) in of_outputs.chunks_exact_mut(width).zip(&touched) {
            for (output, value) in row[..OUTPUTS].iter_mut().enumerate() {
                *value = self.unit(output) * of_moved.value(output, i);
            }
        }
        let [weights, of_rows] = self.of_outputs(&places, &of_outputs)?;
        let planes = self.planes.backward(&places, &of_rows, FEATURES * LEVELS);
        Ok(DeformationGradient { planes, weights })
    }

    /// A step of Adam on planes and weights, with what makes planes smooth.
    pub(super) fn step(
        &mut self,
        mut gradient: DeformationGradient,
        planes: &AdamRates,
        weights: &AdamRates,
    ) {
        self.planes.add_smoothness(&self.smoothness, &mut gradient.planes);
        let values = self.planes.values.par_iter_mut().zip(&mut gradient.planes);
        values
            .zip(&mut self.plane_moments)
            .for_each(|((values, gradient), moments)| moments.step(values, gradient, planes));
        self.weight_moments.step(&mut self.weights, &mut gradient.weights, weights);
    }
}
