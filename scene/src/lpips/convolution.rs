//! The three operations of AlexNet's and VGG-16's feature extractors.

use super::Maps;
use rayon::prelude::*;

/// A convolution with bias and the ReLU behind it.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    /// [out, in, kernel, kernel].
    pub weights: Vec<f32>,
    /// [out].
    pub bias: Vec<f32>,
    pub inputs: usize,
    pub kernel: usize,
    pub stride: usize,
    pub padding: usize,
}

/// Values of the unfolded patches that are held at once by each thread (32 MiB).
/// Source: chosen by hand, never measured.
const PATCH_VALUES: usize = 8 << 20;

impl Convolution {
    /// `max(0, W * x + b)`, zeros outside the image. Patches are unfolded a band of rows at a time,
    /// so that each band is one matrix product [out × in·k²] · [in·k² × pixels].
    pub(crate) fn apply(&self, x: &Maps) -> Maps {
        let [height, width] =
            [x.height, x.width].map(|n| (n + 2 * self.padding - self.kernel) / self.stride + 1);
        let (outputs, depth) = (self.bias.len(), self.inputs * self.kernel * self.kernel);
        let rows = (PATCH_VALUES / (depth * width)).clamp(1, height);
        let bands: Vec<Vec<f32>> = (0..height.div_ceil(rows))
            .into_par_iter()
            .map(|band| {
                let (from, to) = (band * rows, ((band + 1) * rows).min(height));
                self.band(x, from, to, width)
            })
            .collect();
        let mut data = vec![0.0; outputs * height * width];
        for (channel, plane) in data.chunks_exact_mut(height * width).enumerate() {
            for (target, band) in plane.chunks_mut(rows * width).zip(&bands) {
                target.copy_from_slice(&band[channel * target.len()..][..target.len()]);
            }
        }
        Maps { data, channels: outputs, height, width }
    }

    /// Rows `from..to` of the result: [out, to − from, width].
    fn band(&self, x: &Maps, from: usize, to: usize, width: usize) -> Vec<f32> {
        let (outputs, pixels) = (self.bias.len(), (to - from) * width);
        let depth = self.inputs * self.kernel * self.kernel;
        let patches = self.unfold(x, from, to, width);
        let mut out = vec![0.0_f32; outputs * pixels];
        for (row, bias) in out.chunks_exact_mut(pixels).zip(&self.bias) {
            row.fill(*bias);
        }
        // SAFETY: the three matrices are row-major and exactly as large as the sizes and strides
        // say.
        unsafe {
            matrixmultiply::sgemm(
                outputs,
                depth,
                pixels,
                1.0,
                self.weights.as_ptr(),
                depth as isize,
                1,
                patches.as_ptr(),
                pixels as isize,
                1,
                1.0,
                out.as_mut_ptr(),
                pixels as isize,
                1,
            );
        }
        out.iter_mut().for_each(|v| *v = if *v > 0.0 { *v } else { 0.0 });
        out
    }

    /// The patches as columns: [in·k², (to − from)·width].
    fn unfold(&self, x: &Maps, from: usize, to: usize, width: usize) -> Vec<f32> {
        let pixels = (to - from) * width;
        let mut patches = vec![0.0_f32; self.inputs * self.kernel * self.kernel * pixels];
        for (row, target) in patches.chunks_exact_mut(pixels).enumerate() {
            let (channel, dy, dx) =
                (row / (self.kernel * self.kernel), row / self.kernel % self.kernel, row % self.kernel);
            let plane = &x.data[channel * x.height * x.width..][..x.height * x.width];
            for (line, y) in target.chunks_exact_mut(width).zip(from..to) {
                let Some(source_y) =
                    (y * self.stride + dy).checked_sub(self.padding).filter(|v| *v < x.height)
                else {
                    continue;
                };
                let source = &plane[source_y * x.width..][..x.width];
                for (i, value) in line.iter_mut().enumerate() {
                    if let Some(v) =
                        (i * self.stride + dx).checked_sub(self.padding).and_then(|at| source.get(at))
                    {
                        *value = *v;
                    }
                }
            }
        }
        patches
    }
}

/// The largest of each `size × size` window, every `stride`, windows inside the image only.
pub(crate) fn max_pool(x: &Maps, size: usize, stride: usize) -> Maps {
    let (height, width) = ((x.height - size) / stride + 1, (x.width - size) / stride + 1);
    let mut data = Vec::with_capacity(x.channels * height * width);
    for plane in x.data.chunks_exact(x.height * x.width) {
        for y in 0..height {
            for column in 0..width {
                let mut largest = f32::NEG_INFINITY;
                for line in plane.chunks_exact(x.width).skip(y * stride).take(size) {
                    largest = line[column * stride..][..size].iter().fold(largest, |m, v| m.max(*v));
                }
                data.push(largest);
            }
        }
    }
    Maps { data, channels: x.channels, height, width }
}
