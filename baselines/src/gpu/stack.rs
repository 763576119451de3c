//! Networks of dense layers on an adapter: the twin of [`crate::stack`] and [`crate::mlp`].

use super::device::{DeviceArray, FieldBatch, folded};
use super::kit::FieldKit;
use crate::adam::{AdamMoments, AdamRates};
use crate::error::FieldError;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// A side of the tile that a group of threads makes of a product. Source: as `dense.wgsl`.
const TILE: usize = 64;
/// Rows of which weight gradients are added up apart: few enough for many groups.
/// Source: chosen by hand, never measured.
const CHUNK: usize = 512;
/// Bits of the flags of a layer. Source: as `dense.wgsl`.
const RELU: u32 = 1;
/// The same for biases. Source: as `dense.wgsl`.
const BIAS: u32 = 2;

/// A layer as the kernels see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DeviceLayer {
    /// Columns read of the layer before.
    pub(crate) taken: usize,
    /// Input of the network that stands beside them, and its width as stored.
    pub(crate) beside: Option<(usize, usize)>,
    pub(crate) outputs: usize,
    /// Place of the weights among the parameters.
    pub(crate) weights: usize,
    /// Place of the biases, right behind the weights.
    pub(crate) bias: Option<usize>,
    pub(crate) relu: bool,
}

/// The uniform of `dense.wgsl`, field by field.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct DenseJob {
    rows: u32,
    taken: u32,
    before_width: u32,
    beside_width: u32,
    outputs: u32,
    weights: u32,
    bias: u32,
    flags: u32,
    columns: u32,
    chunk: u32,
    chunks: u32,
}

/// The uniform of `adam.wgsl`, field by field.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct AdamJob {
    count: u32,
    rate: f32,
    decay: f32,
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    kept: f32,
    begins: u32,
}

/// Parameters with their optimiser.
pub(crate) struct DeviceParameters {
    pub(crate) values: DeviceArray,
    first: DeviceArray,
    second: DeviceArray,
    average: DeviceArray,
    /// Sums of gradients in f32, or the two words of sums in fixed point; the other is empty.
    pub(crate) gradient: DeviceArray,
    pub(crate) sums: DeviceArray,
    count: usize,
    averaged: bool,
    fixed: bool,
}

impl DeviceParameters {
    /// Of parts that lie one behind the other; `fixed` where many threads add up gradients.
    pub(crate) fn new(
        kit: &FieldKit,
        parts: &[(&[f32], &AdamMoments)],
        fixed: bool,
    ) -> Result<Self, FieldError> {
        let device = &kit.device;
        let joined = |part: &dyn for<'a> Fn(&'a [f32], &'a AdamMoments) -> &'a [f32]| {
            parts.iter().flat_map(|(values, moments)| part(values, moments)).copied().collect::<Vec<f32>>()
        };
        let values = joined(&|values, _| values);
        let averaged = parts.iter().all(|(_, moments)| !moments.average.is_empty());
        Ok(Self {
            first: device.filled("first moments", &joined(&|_, m| &m.first))?,
            second: device.filled("second moments", &joined(&|_, m| &m.second))?,
            average: device.filled("average", &joined(&|values, m| m.shown(values)))?,
            gradient: device.array("gradient", if fixed { 0 } else { values.len() })?,
            sums: device.array("sums", if fixed { 2 * values.len() } else { 0 })?,
            count: values.len(),
            values: device.filled("parameters", &values)?,
            averaged,
            fixed,
        })
    }

    /// A step of Adam, which leaves the gradients at 0.
    pub(crate) fn step<'a>(&mut self, kit: &'a FieldKit, batch: &mut FieldBatch<'a>, rates: &AdamRates) {
        let begins = rates.average.is_some() && !self.averaged;
        self.averaged |= begins;
        let job = AdamJob {
            count: self.count as u32,
            rate: rates.rate,
            decay: rates.decay,
            beta1: rates.settings.betas[0],
            beta2: rates.settings.betas[1],
            epsilon: rates.settings.epsilon,
            kept: rates.average.unwrap_or(-1.0),
            begins: u32::from(begins),
        };
        let arrays = [&self.values, &self.first, &self.second, &self.average, &self.gradient, &self.sums];
        batch.run((&kit.adam, usize::from(self.fixed)), &job, &arrays, folded(self.count, 256));
    }

    /// What pictures are made with.
    pub(crate) fn shown(&self) -> &DeviceArray {
        if self.averaged { &self.average } else { &self.values }
    }

    /// Reads all back into parts as [`Self::new`] took them.
    pub(crate) fn fetch(
        &self,
        kit: &FieldKit,
        parts: &mut [(&mut [f32], &mut AdamMoments)],
    ) -> Result<(), FieldError> {
        let read = |array| kit.device.read::<f32>(array, self.count);
        let all = [read(&self.values)?, read(&self.first)?, read(&self.second)?, read(&self.average)?];
        let mut begin = 0;
        for (values, moments) in parts {
            let range = begin..begin + values.len();
            begin = range.end;
            values.copy_from_slice(&all[0][range.clone()]);
            moments.first.copy_from_slice(&all[1][range.clone()]);
            moments.second.copy_from_slice(&all[2][range.clone()]);
            moments.average = if self.averaged { all[3][range].to_vec() } else { Vec::new() };
        }
        Ok(())
    }
}

#[cfg(test)]
impl DeviceParameters {
    /// The sums of gradients.
    pub(crate) fn read_gradient(&self, kit: &FieldKit) -> Vec<f32> {
        if !self.fixed {
            return kit.device.read(&self.gradient, self.count).unwrap();
        }
        let words: Vec<i64> = kit.device.read(&self.sums, self.count).unwrap();
        words.into_iter().map(|w| (w as f64 / (1u64 << 44) as f64) as f32).collect()
    }
}

/// A network's layers.
pub(crate) struct DeviceStack {
    layers: Vec<DeviceLayer>,
    /// Widths of the inputs as stored.
    inputs: Vec<usize>,
}

/// Activations of a network for so many rows, and their gradients.
pub(crate) struct DeviceLayers {
    pub(crate) inputs: Vec<DeviceArray>,
    pub(crate) outputs: Vec<DeviceArray>,
    pub(crate) of_inputs: Vec<DeviceArray>,
    pub(crate) of_outputs: Vec<DeviceArray>,
    partial: DeviceArray,
    nothing: DeviceArray,
}

impl DeviceStack {
    /// Of layers as they are stored.
    pub(crate) fn new(inputs: &[usize], layers: Vec<DeviceLayer>) -> Self {
        Self { layers, inputs: inputs.to_vec() }
    }

    /// Number of layers.
    pub(crate) fn len(&self) -> usize {
        self.layers.len()
    }

    /// Outputs of a layer as stored.
    pub(crate) fn width(&self, layer: usize) -> usize {
        self.layers[layer].outputs
    }

    /// Width of an input as stored.
    pub(crate) fn input_width(&self, input: usize) -> usize {
        self.inputs[input]
    }

    /// Makes room for so many rows; what is beside the rows' own values stays 0. Gradients take
    /// none where nothing is learnt.
    pub(crate) fn layers(
        &self,
        kit: &FieldKit,
        rows: usize,
        training: bool,
    ) -> Result<DeviceLayers, FieldError> {
        let array = |width: &usize| kit.device.array("activations", rows * width);
        let gradient = |width: &usize| kit.device.array("gradients", if training { rows * width } else { 0 });
        let widths: Vec<usize> = self.layers.iter().map(|l| l.outputs).collect();
        let largest = self.layers.iter().map(|l| (l.inputs() + 1) * l.outputs).max().unwrap_or(0);
        let partial = if training { rows.div_ceil(CHUNK) * largest } else { 0 };
        Ok(DeviceLayers {
            inputs: self.inputs.iter().map(array).collect::<Result<_, _>>()?,
            outputs: widths.iter().map(array).collect::<Result<_, _>>()?,
            of_inputs: self.inputs.iter().map(gradient).collect::<Result<_, _>>()?,
            of_outputs: widths.iter().map(gradient).collect::<Result<_, _>>()?,
            partial: kit.device.array("partial sums", partial)?,
            nothing: kit.device.array("nothing", 0)?,
        })
    }

    fn job(&self, index: usize, rows: usize) -> DenseJob {
        let layer = &self.layers[index];
        DenseJob {
            rows: rows as u32,
            taken: layer.taken as u32,
            before_width: index.checked_sub(1).map_or(0, |i| self.layers[i].outputs) as u32,
            beside_width: layer.beside.map_or(0, |b| b.1) as u32,
            outputs: layer.outputs as u32,
            weights: layer.weights as u32,
            bias: layer.bias.unwrap_or(0) as u32,
            flags: if layer.relu { RELU } else { 0 } | if layer.bias.is_some() { BIAS } else { 0 },
            columns: layer.inputs() as u32,
            chunk: CHUNK as u32,
            chunks: rows.div_ceil(CHUNK) as u32,
        }
    }

    /// What a layer reads: of the layer before, and beside it.
    fn read<'a>(&self, index: usize, layers: &'a DeviceLayers) -> [&'a DeviceArray; 2] {
        let before = index.checked_sub(1).filter(|_| self.layers[index].taken > 0);
        [
            before.map_or(&layers.nothing, |i| &layers.outputs[i]),
            self.layers[index].beside.map_or(&layers.nothing, |(i, _)| &layers.inputs[i]),
        ]
    }

    /// From the inputs to the outputs of some layers.
    pub(crate) fn forward<'a>(
        &self,
        (kit, batch): (&'a FieldKit, &mut FieldBatch<'a>),
        parameters: &DeviceArray,
        layers: &DeviceLayers,
        rows: usize,
        which: Range<usize>,
    ) {
        for index in which {
            let [before, beside] = self.read(index, layers);
            let arrays = [parameters, before, beside, &layers.outputs[index]];
            let groups = [tiles(rows), tiles(self.layers[index].outputs), 1];
            batch.run((&kit.forward, 0), &self.job(index, rows), &arrays, groups);
        }
    }

    /// Sets all gradients of activations to 0: before what enters from outside is written.
    pub(crate) fn clear(&self, batch: &mut FieldBatch, layers: &DeviceLayers) {
        layers.of_outputs.iter().chain(&layers.of_inputs).for_each(|array| batch.clear(array));
    }

    /// From the gradients of outputs, which were written after [`Self::clear`], to those of the
    /// parameters, which are added, and of the inputs that are `wanted`.
    pub(crate) fn backward<'a>(
        &self,
        (kit, batch): (&'a FieldKit, &mut FieldBatch<'a>),
        parameters: &DeviceParameters,
        layers: &DeviceLayers,
        rows: usize,
        wanted: &[bool],
    ) {
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let mut job = self.job(index, rows);
            let [before, beside] = self.read(index, layers);
            let (of_own, own) = (&layers.of_outputs[index], &layers.outputs[index]);
            let arrays = [before, beside, of_own, own, &layers.partial, &parameters.gradient];
            let chunks = job.chunks;
            let groups = [tiles(layer.inputs()), tiles(layer.outputs), chunks];
            batch.run((&kit.weights, 0), &job, &arrays, groups);
            if layer.bias.is_some() {
                batch.run((&kit.weights, 1), &job, &arrays, [tiles(layer.outputs), 1, chunks]);
            }
            batch.run((&kit.weights, 2), &job, &arrays, folded((layer.inputs() + 1) * layer.outputs, 256));
            let beside = layer.beside.filter(|(i, _)| wanted[*i]);
            if beside.is_none() {
                job.columns = job.taken;
            }
            let before = index.checked_sub(1).filter(|_| layer.taken > 0);
            // No array may be written through two bindings.
            let spare = &layers.partial;
            let of_before = before.map_or(spare, |i| &layers.of_outputs[i]);
            let of_beside = beside.map_or(&parameters.sums, |(i, _)| &layers.of_inputs[i]);
            let arrays = [&parameters.values, of_own, own, of_before, of_beside];
            let groups = [tiles(rows), tiles(job.columns as usize), 1];
            batch.run((&kit.backward, 0), &job, &arrays, groups);
        }
    }
}

impl DeviceLayer {
    fn inputs(&self) -> usize {
        self.taken + self.beside.map_or(0, |b| b.1)
    }
}

/// Groups along a side of a product.
fn tiles(side: usize) -> u32 {
    side.div_ceil(TILE) as u32
}
