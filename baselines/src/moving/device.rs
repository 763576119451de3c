//! The perceptron of moving Gaussians on a graphics adapter. HexPlanes, optimiser and Gaussians
//! stay with the processor: the perceptron is 20 times the arithmetic of the planes.

use crate::FieldError;
use crate::adam::AdamMoments;
use crate::gpu::FieldKit;
use crate::gpu::stack::{DeviceLayers, DeviceParameters, DeviceStack};
use crate::stack::Stack;
use std::sync::{Arc, Mutex, PoisonError};

/// Rows whose activations are held at a time. Source: chosen by hand: 160 MB in training.
const GROUP: usize = 1 << 16;

/// Arrays of a group of Gaussians.
struct HeadsWork {
    rows: usize,
    training: bool,
    layers: DeviceLayers,
    parameters: DeviceParameters,
}

/// The perceptron on an adapter, without its parameters.
pub(super) struct HeadsOnDevice {
    kit: Arc<FieldKit>,
    stack: DeviceStack,
    work: Mutex<HeadsWork>,
}

impl std::fmt::Debug for HeadsOnDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "heads on {}", self.kit.device.name())
    }
}

impl HeadsOnDevice {
    /// Of a network.
    pub(super) fn new(stack: &Stack, kit: &Arc<FieldKit>) -> Result<Self, FieldError> {
        let (none, moments) = (vec![0.0; stack.parameters()], AdamMoments::default());
        let stack = stack.on_device();
        let layers = stack.layers(kit, 0, false)?;
        let parameters = DeviceParameters::new(kit, &[(&none, &moments)], false)?;
        let work = Mutex::new(HeadsWork { rows: 0, training: false, layers, parameters });
        Ok(Self { kit: kit.clone(), stack, work })
    }

    /// Makes room for rows of features and puts them and the weights in place.
    fn prepare(
        &self,
        work: &mut HeadsWork,
        weights: &[f32],
        features: &[f32],
        training: bool,
    ) -> Result<usize, FieldError> {
        let rows = features.len() / self.stack.input_width(0);
        if rows > work.rows || training && !work.training {
            (work.rows, work.training) = (work.rows.max(rows.next_power_of_two()), training || work.training);
            work.layers = self.stack.layers(&self.kit, work.rows, work.training)?;
        }
        self.kit.device.write(&work.parameters.values, weights);
        self.kit.device.write(&work.layers.inputs[0], features);
        Ok(rows)
    }

    /// The last layer's outputs for rows of features.
    pub(super) fn outputs(&self, weights: &[f32], features: &[f32]) -> Result<Vec<f32>, FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let (last, mut all) = (self.stack.len() - 1, Vec::new());
        for features in features.chunks(GROUP * self.stack.input_width(0)) {
            let rows = self.prepare(&mut work, weights, features, false)?;
            let mut batch = self.kit.device.batch();
            let parameters = &work.parameters.values;
            self.stack.forward((&self.kit, &mut batch), parameters, &work.layers, rows, 0..last + 1);
            batch.submit()?;
            all.extend(
                self.kit.device.read::<f32>(&work.layers.outputs[last], rows * self.stack.width(last))?,
            );
        }
        Ok(all)
    }

    /// Gradients of the weights and of the features from those of the outputs.
    pub(super) fn gradients(
        &self,
        weights: &[f32],
        features: &[f32],
        of_outputs: &[f32],
    ) -> Result<[Vec<f32>; 2], FieldError> {
        let mut work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let (device, last, width) = (&self.kit.device, self.stack.len() - 1, self.stack.input_width(0));
        let mut of_features = Vec::with_capacity(features.len());
        let mut batch = device.batch();
        batch.clear(&work.parameters.gradient);
        batch.submit()?;
        let groups = features.chunks(GROUP * width).zip(of_outputs.chunks(GROUP * self.stack.width(last)));
        for (features, of_outputs) in groups {
            let rows = self.prepare(&mut work, weights, features, true)?;
            let mut batch = device.batch();
            self.stack.clear(&mut batch, &work.layers);
            batch.submit()?;
            device.write(&work.layers.of_outputs[last], of_outputs);
            let mut batch = device.batch();
            let (layers, parameters) = (&work.layers, &work.parameters);
            self.stack.forward((&self.kit, &mut batch), &parameters.values, layers, rows, 0..last + 1);
            self.stack.backward((&self.kit, &mut batch), parameters, layers, rows, &[true]);
            batch.submit()?;
            of_features.extend(device.read::<f32>(&layers.of_inputs[0], rows * width)?);
        }
        Ok([device.read(&work.parameters.gradient, weights.len())?, of_features])
    }
}
