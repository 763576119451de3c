//! LPIPS: the distance of two images in the features of a classification network.
//!
//! Zhang, Isola, Efros, Shechtman, Wang, "The Unreasonable Effectiveness of Deep Features as a
//! Perceptual Metric", CVPR 2018, version 0.1 of its linear layers. The weights are the user's: a
//! `.safetensors` file with the backbone under torchvision's names (`features.0.weight`, …) and the
//! linear layers under those of the `lpips` package (`lin0.model.1.weight`, …).

mod convolution;
mod network;

use crate::metrics::MetricsError;
use image::{GrayImage, RgbImage};
pub use network::{Backbone, Lpips};

/// Mean by channel of inputs in [−1, 1]. Source: the `lpips` package 0.1, ScalingLayer.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
/// Deviation by channel of inputs in [−1, 1]. Source: the `lpips` package 0.1, ScalingLayer.
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps the normalisation of an all-zero feature finite. Source: the `lpips` package 0.1.
const EPSILON: f32 = 1e-10;

/// Feature maps: [channels, height, width].
#[derive(Clone, Debug)]
pub(crate) struct Maps {
    pub data: Vec<f32>,
    pub channels: usize,
    pub height: usize,
    pub width: usize,
}

impl Lpips {
    /// The distance of two images of the same size: 0 for equal ones, about 1 for unrelated ones.
    ///
    /// Per layer, the squared differences of unit-length features are weighted and averaged over
    /// the image; the layers are added. With a mask, each layer is averaged with the share of kept
    /// pixels (≥ 128) that fall into each of its cells as weight.
    pub fn distance(
        &self,
        a: &RgbImage,
        b: &RgbImage,
        mask: Option<&GrayImage>,
    ) -> Result<f64, MetricsError> {
        crate::metrics::check(a, b, mask, self.backbone.least_side())?;
        if mask.is_some_and(|m| m.as_raw().iter().all(|&v| v < 128)) {
            return Err(MetricsError::EmptyMask);
        }
        let (first, second) = (self.features(&normalised(a)), self.features(&normalised(b)));
        let layers = first.iter().zip(&second).zip(&self.linear);
        Ok(layers.map(|((a, b), weights)| layer_distance(a, b, weights, mask)).sum())
    }
}

/// 8-bit sRGB to [-1, 1], shifted and scaled by channel.
fn normalised(image: &RgbImage) -> Maps {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let mut data = vec![0.0; 3 * width * height];
    for (channel, plane) in data.chunks_exact_mut(width * height).enumerate() {
        for (value, pixel) in plane.iter_mut().zip(image.as_raw().chunks_exact(3)) {
            *value = (f32::from(pixel[channel]) / 127.5 - 1.0 - SHIFT[channel]) / SCALE[channel];
        }
    }
    Maps { data, channels: 3, height, width }
}

/// Weighted mean over the cells of `Σ_c w_c (â_c − b̂_c)²`, features scaled to unit length over the
/// channels.
fn layer_distance(a: &Maps, b: &Maps, weights: &[f32], mask: Option<&GrayImage>) -> f64 {
    let cells = a.width * a.height;
    let (la, lb) = (inverse_lengths(a), inverse_lengths(b));
    let mut distance = vec![0.0_f32; cells];
    for ((pa, pb), w) in a.data.chunks_exact(cells).zip(b.data.chunks_exact(cells)).zip(weights) {
        for i in 0..cells {
            let d = pa[i] * la[i] - pb[i] * lb[i];
            distance[i] += w * d * d;
        }
    }
    let weights = mask.map_or_else(|| vec![1.0; cells], |m| coverage(m, a.width, a.height));
    let weighted = weights.iter().zip(&distance).map(|(w, d)| w * f64::from(*d));
    weighted.sum::<f64>() / weights.iter().sum::<f64>()
}

/// For each cell the inverse of the feature's length over the channels.
fn inverse_lengths(maps: &Maps) -> Vec<f32> {
    let cells = maps.width * maps.height;
    let mut squares = vec![0.0_f32; cells];
    for plane in maps.data.chunks_exact(cells) {
        squares.iter_mut().zip(plane).for_each(|(s, v)| *s += v * v);
    }
    squares.into_iter().map(|s| 1.0 / (s.sqrt() + EPSILON)).collect()
}

/// Share of kept pixels in each cell of a `width × height` grid over the mask.
fn coverage(mask: &GrayImage, width: usize, height: usize) -> Vec<f64> {
    let mut kept = vec![0.0; width * height];
    let mut all = vec![0.0; width * height];
    let (mw, mh) = (mask.width() as usize, mask.height() as usize);
    for (i, &value) in mask.as_raw().iter().enumerate() {
        let cell = (i / mw * height / mh) * width + i % mw * width / mw;
        all[cell] += 1.0;
        kept[cell] += f64::from(u8::from(value >= 128));
    }
    kept.iter().zip(&all).map(|(k, n)| if *n > 0.0 { k / n } else { 0.0 }).collect()
}
