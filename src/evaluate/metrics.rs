//! The figures of one picture against its photo, their means and percentiles.

use crate::record::Metrics;
use anyhow::Result;
use image::{GrayImage, RgbImage};
use scene::lpips::{Backbone, Lpips};
use scene::metrics;

/// PSNR of a picture that equals its photo, dB: infinity has no place in JSON, nor in a mean. One
/// level in one pixel in ten thousand is 88 dB. Source: derived, above any picture that differs.
pub const EXACT_DB: f64 = 100.0;

/// A number with so many digits; a dash where there is none.
pub(crate) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".to_owned(), |v| format!("{v:.digits$}"))
}

/// One of the figures.
pub struct Figure {
    /// Heading.
    pub name: &'static str,
    /// Digits behind the point.
    pub digits: usize,
    /// Whether more is better.
    pub more_is_better: bool,
    /// Its value.
    pub of: fn(&Metrics) -> Option<f64>,
}

const fn figure(
    name: &'static str,
    digits: usize,
    more_is_better: bool,
    of: fn(&Metrics) -> Option<f64>,
) -> Figure {
    Figure { name, digits, more_is_better, of }
}

/// All figures, in the order of tables.
pub const FIGURES: [Figure; 8] = [
    figure("PSNR", 2, true, |m| Some(m.psnr)),
    figure("SSIM", 4, true, |m| Some(m.ssim)),
    figure("LPIPS alex", 4, false, |m| m.lpips_alex),
    figure("LPIPS vgg", 4, false, |m| m.lpips_vgg),
    figure("PSNR in mask", 2, true, |m| m.psnr_mask),
    figure("SSIM in mask", 4, true, |m| m.ssim_mask),
    figure("LPIPS alex in mask", 4, false, |m| m.lpips_alex_mask),
    figure("LPIPS vgg in mask", 4, false, |m| m.lpips_vgg_mask),
];

impl Figure {
    /// As it is shown; a dash where there is none.
    pub fn shown(&self, metrics: &Metrics) -> String {
        number((self.of)(metrics), self.digits)
    }
}

impl Metrics {
    /// Judges an 8-bit picture by its photo: full frame, and inside the mask where that keeps
    /// anything. An exact picture counts as [`EXACT_DB`].
    pub fn judge(
        render: &RgbImage,
        photo: &RgbImage,
        mask: Option<&GrayImage>,
        networks: &[Lpips],
    ) -> Result<Self> {
        let mut found = Self {
            psnr: metrics::psnr(render, photo, None)?.min(EXACT_DB),
            ssim: metrics::ssim(render, photo, None)?,
            psnr_mask: mask.and_then(|m| metrics::psnr(render, photo, Some(m)).ok()).map(|v| v.min(EXACT_DB)),
            ssim_mask: mask.and_then(|m| metrics::ssim(render, photo, Some(m)).ok()),
            ..Self::default()
        };
        for network in networks {
            let full = Some(network.distance(render, photo, None)?);
            let inside = mask.and_then(|m| network.distance(render, photo, Some(m)).ok());
            match network.backbone {
                Backbone::Alex => (found.lpips_alex, found.lpips_alex_mask) = (full, inside),
                Backbone::Vgg => (found.lpips_vgg, found.lpips_vgg_mask) = (full, inside),
            }
        }
        Ok(found)
    }

    /// Each figure by itself, over the views that have it.
    fn combined(all: &[Self], combine: impl Fn(Vec<f64>) -> f64) -> Self {
        let of = |pick: fn(&Self) -> Option<f64>| {
            let values: Vec<f64> = all.iter().filter_map(pick).collect();
            (!values.is_empty()).then(|| combine(values))
        };
        Self {
            psnr: of(|m| Some(m.psnr)).unwrap_or(0.0),
            ssim: of(|m| Some(m.ssim)).unwrap_or(0.0),
            psnr_mask: of(|m| m.psnr_mask),
            ssim_mask: of(|m| m.ssim_mask),
            lpips_alex: of(|m| m.lpips_alex),
            lpips_vgg: of(|m| m.lpips_vgg),
            lpips_alex_mask: of(|m| m.lpips_alex_mask),
            lpips_vgg_mask: of(|m| m.lpips_vgg_mask),
        }
    }

    /// Means over views (zeros without views).
    pub fn mean(all: &[Self]) -> Self {
        Self::combined(all, |values| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// What `percent` of the views stay below, each figure by itself; between two views
    /// interpolated linearly.
    pub fn percentile(all: &[Self], percent: u32) -> Self {
        Self::combined(all, |mut values| {
            values.sort_by(f64::total_cmp);
            let at = (values.len() - 1) as f64 * f64::from(percent) / 100.0;
            let (low, part) = (at.floor() as usize, at.fract());
            let high = values[(low + 1).min(values.len() - 1)];
            values[low] + part * (high - values[low])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_percentiles_take_each_figure_over_the_views_that_have_it() {
        let view = |psnr, psnr_mask| Metrics { psnr, psnr_mask, ..Metrics::default() };
        let all = [view(30.0, None), view(20.0, Some(25.0)), view(40.0, Some(35.0))];
        let mean = Metrics::mean(&all);
        assert_eq!((mean.psnr, mean.psnr_mask, mean.lpips_vgg), (30.0, Some(30.0), None));
        let low = Metrics::percentile(&all, 25);
        assert_eq!((low.psnr, low.psnr_mask), (25.0, Some(27.5)));
    }

    #[test]
    fn an_exact_picture_has_a_number_that_json_can_hold() {
        let black = RgbImage::new(16, 16);
        let exact = Metrics::judge(&black, &black, None, &[]).unwrap();
        assert_eq!((exact.psnr, exact.ssim), (EXACT_DB, 1.0));
    }
}
