//! A small perceptron without biases, evaluated for a block of samples whose activations stay in
//! the cache (Müller et al. 2022, "fully fused").

use crate::dense::{
    Product, WeightGradient, padded, padded_rows, product, rectify, transpose, weight_gradient,
};
use rand::Rng as _;
use scene::rng::Rng;

/// Widths of a perceptron with rectifiers between its layers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Mlp {
    /// Inputs, hidden layers, outputs: rounded up to whole panels.
    widths: Vec<usize>,
}

/// What a block's forward pass leaves for the backward pass; reused between blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Activations {
    /// The inputs, then each layer's outputs, [rows × width].
    pub(crate) layers: Vec<Vec<f32>>,
    /// Gradients of two neighbouring layers.
    above: Vec<f32>,
    below: Vec<f32>,
    packed: Vec<f32>,
}

/// The logistic function.
#[inline(always)]
pub(crate) fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl Mlp {
    /// Of the widths given.
    pub(crate) fn new(widths: &[usize]) -> Self {
        Self { widths: widths.iter().map(|&w| padded(w)).collect() }
    }

    /// Inputs, outputs and the place among the parameters, by layer.
    fn layers(
        &self,
    ) -> impl DoubleEndedIterator<Item = (usize, usize, std::ops::Range<usize>)> + ExactSizeIterator {
        let mut begin = 0;
        let layers: Vec<_> = self
            .widths
            .windows(2)
            .map(|w| {
                let range = begin..begin + w[0] * w[1];
                begin = range.end;
                (w[0], w[1], range)
            })
            .collect();
        layers.into_iter()
    }

    /// Number of weights.
    pub(crate) fn parameters(&self) -> usize {
        self.widths.windows(2).map(|w| w[0] * w[1]).sum()
    }

    /// Widths of the inputs and of each layer, as stored.
    pub(crate) fn widths(&self) -> &[usize] {
        &self.widths
    }

    /// Inputs as stored.
    pub(crate) fn inputs(&self) -> usize {
        self.widths[0]
    }

    /// Outputs as stored.
    pub(crate) fn outputs(&self) -> usize {
        self.widths[self.widths.len() - 1]
    }

    /// Random weights, uniform with the variance of Glorot and Bengio 2010.
    pub(crate) fn initial(&self, rng: &mut Rng) -> Vec<f32> {
        let mut all = Vec::with_capacity(self.parameters());
        for (inputs, outputs, range) in self.layers() {
            let bound = (6.0 / (inputs + outputs) as f32).sqrt();
            all.extend(range.map(|_| rng.random_range(-bound..bound)));
        }
        all
    }

    /// The weights as the backward pass reads them.
    pub(crate) fn transposed(&self, parameters: &[f32]) -> Vec<f32> {
        let mut all = vec![0.0; self.parameters()];
        for (inputs, outputs, range) in self.layers() {
            transpose(&parameters[range.clone()], inputs, outputs, &mut all[range]);
        }
        all
    }

    /// Makes room for `rows` samples; the rows that fill the last tile are 0.
    pub(crate) fn reserve(&self, rows: usize, activations: &mut Activations) {
        activations.layers.resize(self.widths.len(), Vec::new());
        for (layer, &width) in activations.layers.iter_mut().zip(&self.widths) {
            layer.resize(padded_rows(rows) * width, 0.0);
        }
        let inputs = &mut activations.layers[0];
        inputs[rows * self.widths[0]..].fill(0.0);
    }

    /// From the inputs, the first of the activations, to the outputs, the last of them.
    pub(crate) fn forward(&self, parameters: &[f32], activations: &mut Activations) {
        let last = self.widths.len() - 2;
        for (index, (inputs, outputs, range)) in self.layers().enumerate() {
            let (before, after) = activations.layers.split_at_mut(index + 1);
            product(Product {
                x: &before[index],
                inputs,
                panels: &parameters[range],
                bias: None,
                outputs,
                y: &mut after[0],
                relu: index < last,
            });
        }
    }

    /// From the gradient of the outputs (which is used up; the rows that fill the last tile are 0)
    /// to that of the weights, which is added to `gradient`, and of the inputs, which is returned.
    pub(crate) fn backward<'a>(
        &self,
        transposed: &[f32],
        activations: &'a mut Activations,
        of_outputs: &[f32],
        gradient: &mut [f32],
    ) -> &'a [f32] {
        let Activations { layers, above, below, packed } = activations;
        above.clear();
        above.extend_from_slice(of_outputs);
        for (index, (inputs, outputs, range)) in self.layers().enumerate().rev() {
            if index + 2 < self.widths.len() {
                rectify(above, &layers[index + 1]);
            }
            weight_gradient(WeightGradient {
                x: &layers[index],
                inputs,
                dy: above,
                outputs,
                grads: &mut gradient[range.clone()],
                bias: None,
                packed,
            });
            below.resize(above.len() / outputs * inputs, 0.0);
            product(Product {
                x: above,
                inputs: outputs,
                panels: &transposed[range],
                bias: None,
                outputs: inputs,
                y: below,
                relu: false,
            });
            std::mem::swap(above, below);
        }
        above
    }
}
