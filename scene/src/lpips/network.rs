//! The two backbones, and their weights from a file.

use super::Maps;
use super::convolution::{Convolution, max_pool};
use crate::io::IoError;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;

/// The network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backbone {
    /// AlexNet (fast; the `lpips` package's default).
    Alex,
    /// VGG-16 (what the 3DGS literature reports).
    Vgg,
}

/// A convolution as torchvision numbers it, `(index, out, in, kernel, stride, padding)`, or a
/// pooling.
enum Layer {
    Conv(usize, usize, usize, usize, usize, usize),
    /// Window and stride.
    Pool(usize, usize),
    /// The features up to here are compared.
    Tap,
}

use Layer::{Conv, Pool, Tap};

const ALEX: [Layer; 12] = [
    Conv(0, 64, 3, 11, 4, 2),
    Tap,
    Pool(3, 2),
    Conv(3, 192, 64, 5, 1, 2),
    Tap,
    Pool(3, 2),
    Conv(6, 384, 192, 3, 1, 1),
    Tap,
    Conv(8, 256, 384, 3, 1, 1),
    Tap,
    Conv(10, 256, 256, 3, 1, 1),
    Tap,
];

const VGG: [Layer; 22] = [
    Conv(0, 64, 3, 3, 1, 1),
    Conv(2, 64, 64, 3, 1, 1),
    Tap,
    Pool(2, 2),
    Conv(5, 128, 64, 3, 1, 1),
    Conv(7, 128, 128, 3, 1, 1),
    Tap,
    Pool(2, 2),
    Conv(10, 256, 128, 3, 1, 1),
    Conv(12, 256, 256, 3, 1, 1),
    Conv(14, 256, 256, 3, 1, 1),
    Tap,
    Pool(2, 2),
    Conv(17, 512, 256, 3, 1, 1),
    Conv(19, 512, 512, 3, 1, 1),
    Conv(21, 512, 512, 3, 1, 1),
    Tap,
    Pool(2, 2),
    Conv(24, 512, 512, 3, 1, 1),
    Conv(26, 512, 512, 3, 1, 1),
    Conv(28, 512, 512, 3, 1, 1),
    Tap,
];

impl Backbone {
    /// "alex" or "vgg".
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// Images must have at least this many pixels a side for every layer to have a cell.
    pub(crate) fn least_side(self) -> u32 {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }

    fn layers(self) -> &'static [Layer] {
        match self {
            Self::Alex => &ALEX,
            Self::Vgg => &VGG,
        }
    }

    /// Every tensor a weights file must hold, with its shape.
    pub fn tensors(self) -> Vec<(String, Vec<usize>)> {
        let mut all = Vec::new();
        let (mut taps, mut channels) = (0, 0);
        for layer in self.layers() {
            match layer {
                Conv(index, out, inputs, kernel, ..) => {
                    all.push((format!("features.{index}.weight"), vec![*out, *inputs, *kernel, *kernel]));
                    all.push((format!("features.{index}.bias"), vec![*out]));
                    channels = *out;
                }
                Pool(..) => {}
                Tap => {
                    all.push((format!("lin{taps}.model.1.weight"), vec![1, channels, 1, 1]));
                    taps += 1;
                }
            }
        }
        all
    }
}

enum Step {
    Convolve(Convolution),
    Pool(usize, usize),
    Tap,
}

/// A network with its weights.
pub struct Lpips {
    /// Which network it is.
    pub backbone: Backbone,
    steps: Vec<Step>,
    /// Weight of each channel, by layer.
    pub(super) linear: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads a weights file; which network it is, is told from the shape of the first layer.
    pub fn load(path: &Path) -> Result<Self, IoError> {
        Self::parse(path, &crate::io::read_file(path)?)
    }

    /// The same, of the file's content. `path` names the file in messages.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, IoError> {
        let file = SafeTensors::deserialize(bytes).map_err(|e| {
            IoError::format(
                path,
                format!("not a safetensors file ({e}); make one with tools/lpips_weights.py"),
            )
        })?;
        let shape = file.tensor("features.0.weight").map(|t| t.shape().to_vec()).unwrap_or_default();
        let backbone = match shape.as_slice() {
            [64, 3, 11, 11] => Backbone::Alex,
            [64, 3, 3, 3] => Backbone::Vgg,
            other => {
                return Err(IoError::format(
                    path,
                    format!(
                        "features.0.weight has shape {other:?}; AlexNet's is [64, 3, 11, 11], VGG-16's [64, 3, 3, 3]; \
                         make the file with tools/lpips_weights.py"
                    ),
                ));
            }
        };
        Self::build(backbone, |name, shape| read_tensor(path, &file, name, shape))
    }

    /// A network whose tensors come from `values(name, shape)`, row-major.
    pub fn build<E>(
        backbone: Backbone,
        mut values: impl FnMut(&str, &[usize]) -> Result<Vec<f32>, E>,
    ) -> Result<Self, E> {
        let mut tensors = backbone.tensors().into_iter();
        let mut next = || -> Result<Vec<f32>, E> {
            let (name, shape) = tensors.next().unwrap_or_default();
            values(&name, &shape)
        };
        let (mut steps, mut linear) = (Vec::new(), Vec::new());
        for layer in backbone.layers() {
            steps.push(match *layer {
                Conv(_, _, inputs, kernel, stride, padding) => {
                    let (weights, bias) = (next()?, next()?);
                    Step::Convolve(Convolution { weights, bias, inputs, kernel, stride, padding })
                }
                Pool(size, stride) => Step::Pool(size, stride),
                Tap => {
                    linear.push(next()?);
                    Step::Tap
                }
            });
        }
        Ok(Self { backbone, steps, linear })
    }

    /// The features that are compared, one set of maps a layer.
    pub(super) fn features(&self, input: &Maps) -> Vec<Maps> {
        let mut taps = Vec::new();
        let mut x = input.clone();
        for step in &self.steps {
            match step {
                Step::Convolve(convolution) => x = convolution.apply(&x),
                Step::Pool(size, stride) => x = max_pool(&x, *size, *stride),
                Step::Tap => taps.push(x.clone()),
            }
        }
        taps
    }
}

fn read_tensor(path: &Path, file: &SafeTensors, name: &str, shape: &[usize]) -> Result<Vec<f32>, IoError> {
    let tensor: TensorView = file.tensor(name).map_err(|_| {
        IoError::format(path, format!("{name} is missing; make the file with tools/lpips_weights.py"))
    })?;
    if tensor.shape() != shape || tensor.dtype() != Dtype::F32 {
        let found = (tensor.dtype(), tensor.shape());
        return Err(IoError::format(
            path,
            format!("{name}: expected f32 of shape {shape:?}, found {found:?}"),
        ));
    }
    let values: Vec<f32> =
        tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    if values.iter().any(|v| !v.is_finite()) {
        return Err(IoError::not_finite(path, format!("a number of {name}")));
    }
    Ok(values)
}
