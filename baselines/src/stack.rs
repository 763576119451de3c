//! A deep perceptron with biases, some of whose layers read inputs of the network again.

use crate::dense::{
    Product, WeightGradient, padded, padded_rows, product, rectify, transpose, weight_gradient,
};
use rand::Rng as _;
use scene::rng::Rng;
use std::ops::Range;

/// A layer as its network is described: the first columns of the layer before it, then an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LayerPlan {
    /// Columns taken of the layer before.
    pub(crate) taken: usize,
    /// Input of the network that stands beside them.
    pub(crate) input: Option<usize>,
    pub(crate) outputs: usize,
    /// Whether negative outputs become 0.
    pub(crate) relu: bool,
}

impl LayerPlan {
    /// A layer that reads `taken` columns of the one before.
    pub(crate) fn after(taken: usize, outputs: usize, relu: bool) -> Self {
        Self { taken, input: None, outputs, relu }
    }
}

/// A layer as stored.
#[derive(Clone, Debug, PartialEq, Eq)]
struct DenseLayer {
    taken: usize,
    input: Option<usize>,
    /// Columns of both together, whole panels.
    width: usize,
    outputs: usize,
    weights: Range<usize>,
    bias: Range<usize>,
    relu: bool,
    /// Columns that are not padding.
    fan_in: usize,
}

/// The network's shape.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Stack {
    inputs: Vec<usize>,
    layers: Vec<DenseLayer>,
}

/// What the forward pass of a block leaves for the backward pass; reused between blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct StackLayers {
    /// The network's inputs, [rows × width].
    pub(crate) inputs: Vec<Vec<f32>>,
    /// Each layer's outputs, [rows × width].
    pub(crate) outputs: Vec<Vec<f32>>,
    /// What layers read that read an input beside the layer before.
    joined: Vec<Vec<f32>>,
    /// Gradients of the inputs.
    pub(crate) of_inputs: Vec<Vec<f32>>,
    above: Vec<f32>,
    below: Vec<f32>,
    packed: Vec<f32>,
}

/// Gradient that enters the outputs of a layer from outside: a column, one value a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entering<'a> {
    pub(crate) layer: usize,
    pub(crate) column: usize,
    pub(crate) values: &'a [f32],
}

impl Stack {
    /// Of inputs so wide and the layers given; widths are rounded up to whole panels.
    pub(crate) fn new(inputs: &[usize], plans: &[LayerPlan]) -> Self {
        let (mut layers, mut begin) = (Vec::new(), 0);
        for plan in plans {
            let beside = plan.input.map_or(0, |i| inputs[i]);
            let (width, outputs) = (plan.taken + padded(beside), padded(plan.outputs));
            let weights = begin..begin + width * outputs;
            let bias = weights.end..weights.end + outputs;
            begin = bias.end;
            let LayerPlan { taken, input, relu, .. } = *plan;
            layers.push(DenseLayer {
                taken,
                input,
                width,
                outputs,
                weights,
                bias,
                relu,
                fan_in: taken + beside,
            });
        }
        Self { inputs: inputs.iter().map(|&w| padded(w)).collect(), layers }
    }

    /// The same layers for an adapter.
    #[cfg(feature = "gpu")]
    pub(crate) fn on_device(&self) -> crate::gpu::stack::DeviceStack {
        let layers = self.layers.iter().map(|l| crate::gpu::stack::DeviceLayer {
            taken: l.taken,
            beside: l.input.map(|i| (i, self.inputs[i])),
            outputs: l.outputs,
            weights: l.weights.start,
            bias: Some(l.bias.start),
            relu: l.relu,
        });
        crate::gpu::stack::DeviceStack::new(&self.inputs, layers.collect())
    }

    /// Number of weights and biases.
    pub(crate) fn parameters(&self) -> usize {
        self.layers.last().map_or(0, |l| l.bias.end)
    }

    /// Width of an input as stored.
    pub(crate) fn input_width(&self, input: usize) -> usize {
        self.inputs[input]
    }

    /// Outputs of a layer as stored.
    pub(crate) fn width(&self, layer: usize) -> usize {
        self.layers[layer].outputs
    }

    /// Where the weights and biases of a layer lie among the parameters.
    pub(crate) fn layer(&self, layer: usize) -> Range<usize> {
        self.layers[layer].weights.start..self.layers[layer].bias.end
    }

    /// Products of weights and sums, forward, for one row.
    pub(crate) fn operations(&self) -> usize {
        self.layers.iter().map(|l| 2 * l.width * l.outputs).sum()
    }

    /// Random weights and biases, uniform up to one over the root of the number of inputs.
    /// Source: the default of the programs of both papers' authors.
    pub(crate) fn initial(&self, rng: &mut Rng) -> Vec<f32> {
        let mut all = vec![0.0; self.parameters()];
        for layer in &self.layers {
            let bound = 1.0 / (layer.fan_in as f32).sqrt();
            all[layer.weights.start..layer.bias.end].fill_with(|| rng.random_range(-bound..bound));
        }
        all
    }

    /// The weights as the backward pass reads them.
    pub(crate) fn transposed(&self, parameters: &[f32]) -> Vec<f32> {
        let mut all = vec![0.0; self.parameters()];
        for l in &self.layers {
            transpose(&parameters[l.weights.clone()], l.width, l.outputs, &mut all[l.weights.clone()]);
        }
        all
    }

    /// Where weight (input, output) of a layer lies among the parameters, and its bias.
    #[cfg(test)]
    pub(crate) fn places(&self, layer: usize) -> (impl Fn(usize, usize) -> usize + '_, Range<usize>) {
        let l = &self.layers[layer];
        (move |i, o| l.weights.start + crate::dense::place(i, o, l.width), l.bias.clone())
    }

    /// Makes room for `rows` rows; the inputs of those that fill the last tile are 0.
    pub(crate) fn reserve(&self, rows: usize, layers: &mut StackLayers) {
        let whole = padded_rows(rows);
        let widths = self.layers.iter().map(|l| l.outputs);
        for (buffers, widths) in [
            (&mut layers.inputs, self.inputs.clone()),
            (&mut layers.outputs, widths.collect()),
            (
                &mut layers.joined,
                self.layers.iter().map(|l| if l.is_joined() { l.width } else { 0 }).collect(),
            ),
        ] {
            buffers.resize(widths.len(), Vec::new());
            for (buffer, &width) in buffers.iter_mut().zip(&widths) {
                buffer.resize(whole * width, 0.0);
            }
        }
        for (input, &width) in layers.inputs.iter_mut().zip(&self.inputs) {
            input[rows * width..].fill(0.0);
        }
    }

    /// From the inputs to the outputs of all layers.
    pub(crate) fn forward(&self, parameters: &[f32], layers: &mut StackLayers) {
        for (index, layer) in self.layers.iter().enumerate() {
            self.join(index, layers);
            let StackLayers { inputs, outputs, joined, .. } = layers;
            let (before, after) = outputs.split_at_mut(index);
            product(Product {
                x: layer.read(before, inputs, &joined[index]),
                inputs: layer.width,
                panels: &parameters[layer.weights.clone()],
                bias: Some(&parameters[layer.bias.clone()]),
                outputs: layer.outputs,
                y: &mut after[0],
                relu: layer.relu,
            });
        }
    }

    /// Puts side by side what a layer reads.
    fn join(&self, index: usize, layers: &mut StackLayers) {
        let layer = &self.layers[index];
        let Some(input) = layer.input.filter(|_| layer.taken > 0) else { return };
        let StackLayers { inputs, outputs, joined, .. } = layers;
        let before = outputs[index - 1].chunks_exact(self.layers[index - 1].outputs);
        let rows = joined[index].chunks_exact_mut(layer.width);
        for ((row, before), beside) in rows.zip(before).zip(inputs[input].chunks_exact(self.inputs[input])) {
            row[..layer.taken].copy_from_slice(&before[..layer.taken]);
            row[layer.taken..].copy_from_slice(beside);
        }
    }

    /// From the gradient of the last layer's outputs (the rows that fill the last tile are 0) and
    /// of others' to that of weights and biases, which is added to `gradient`, and, where they are
    /// `wanted`, to those of the inputs.
    pub(crate) fn backward(
        &self,
        transposed: &[f32],
        layers: &mut StackLayers,
        (of_outputs, entering): (&[f32], &[Entering]),
        gradient: &mut [f32],
        wanted: bool,
    ) {
        let StackLayers { inputs, outputs, joined, of_inputs, above, below, packed } = layers;
        of_inputs.resize(self.inputs.len(), Vec::new());
        for (sum, input) in of_inputs.iter_mut().zip(inputs.iter()) {
            sum.clear();
            sum.resize(input.len(), 0.0);
        }
        above.clear();
        above.extend_from_slice(of_outputs);
        for (index, layer) in self.layers.iter().enumerate().rev() {
            for e in entering.iter().filter(|e| e.layer == index) {
                let rows = above.chunks_exact_mut(layer.outputs).zip(e.values);
                rows.for_each(|(row, v)| row[e.column] += v);
            }
            let (before, own) = outputs.split_at(index);
            if layer.relu {
                rectify(above, &own[0]);
            }
            let (of_weights, of_bias) =
                gradient[layer.weights.start..layer.bias.end].split_at_mut(layer.weights.len());
            weight_gradient(WeightGradient {
                x: layer.read(before, inputs, &joined[index]),
                inputs: layer.width,
                dy: above,
                outputs: layer.outputs,
                grads: of_weights,
                bias: Some(of_bias),
                packed,
            });
            if index == 0 && !wanted {
                return;
            }
            below.resize(above.len() / layer.outputs * layer.width, 0.0);
            product(Product {
                x: above,
                inputs: layer.outputs,
                panels: &transposed[layer.weights.clone()],
                bias: None,
                outputs: layer.width,
                y: below,
                relu: false,
            });
            let width = index.checked_sub(1).map_or(0, |i| self.layers[i].outputs);
            layer.part(below, above, width, of_inputs);
        }
    }
}

impl DenseLayer {
    /// Whether what it reads lies in no one place.
    fn is_joined(&self) -> bool {
        self.taken > 0 && self.input.is_some()
    }

    /// What it reads.
    fn read<'a>(&self, before: &'a [Vec<f32>], inputs: &'a [Vec<f32>], joined: &'a [f32]) -> &'a [f32] {
        match (self.input, before.last()) {
            (None, Some(before)) => before,
            (Some(input), _) if self.taken == 0 => &inputs[input],
            _ => joined,
        }
    }

    /// Parts the gradient of what it read (which is used up) into that of the layer before, `width`
    /// wide, and of the input.
    fn part(&self, joined: &mut Vec<f32>, before: &mut Vec<f32>, width: usize, of_inputs: &mut [Vec<f32>]) {
        let Some(input) = self.input else { return std::mem::swap(before, joined) };
        let rows = joined.chunks_exact(self.width);
        before.clear();
        before.resize(rows.len() * width, 0.0);
        if self.taken > 0 {
            for (to, from) in before.chunks_exact_mut(width).zip(rows.clone()) {
                to[..self.taken].copy_from_slice(&from[..self.taken]);
            }
        }
        let sums = of_inputs[input].chunks_exact_mut(self.width - self.taken);
        for (sum, row) in sums.zip(rows) {
            sum.iter_mut().zip(&row[self.taken..]).for_each(|(s, r)| *s += r);
        }
    }
}
