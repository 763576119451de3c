//! The Gaussian scale space (Lowe 2004, section 3).

use super::blur::{LumaPlane, gaussian_blur, gaussian_double, halve};

/// Blur that a camera's image is assumed to have, pixels.
/// Source: Lowe 2004, section 3.3.
pub(super) const NOMINAL_BLUR: f32 = 0.5;
/// Blur of the first level of every octave, pixels of that octave.
/// Source: Lowe 2004, section 3.3.
const BASE_SIGMA: f32 = 1.6;

/// One octave: `scales + 3` levels of the same size; level `i` has blur `1.6 · 2^(i / scales)`
/// octave pixels.
#[derive(Debug, Default)]
pub(super) struct Octave {
    /// Blurred images, finest first.
    pub levels: Vec<LumaPlane>,
    /// Input pixels an octave pixel.
    pub step: f32,
    /// Input position of the centre of the octave's first pixel (the corner of the image is 0).
    pub origin: f32,
    /// Extrema are searched in so many levels.
    pub scales: usize,
}

impl Octave {
    /// Blur of a (fractional) level, octave pixels.
    pub(super) fn sigma(&self, level: f32) -> f32 {
        BASE_SIGMA * (level / self.scales as f32).exp2()
    }

    /// Difference of Gaussians `level + 1` minus `level`.
    #[inline(always)]
    pub(super) fn dog(&self, level: usize, x: usize, y: usize) -> f32 {
        self.levels[level + 1].at(x, y) - self.levels[level].at(x, y)
    }

    /// The first octave of an image, doubled or not. `step`: input pixels an image pixel.
    pub(super) fn first(&mut self, image: &LumaPlane, doubled: bool, scales: usize, step: f32) {
        self.prepare(scales);
        if doubled {
            let sigma = (BASE_SIGMA * BASE_SIGMA / 4.0 - NOMINAL_BLUR * NOMINAL_BLUR).sqrt();
            gaussian_double(image, sigma, &mut self.levels[0]);
            (self.step, self.origin) = (step / 2.0, step / 4.0);
        } else {
            let sigma = (BASE_SIGMA * BASE_SIGMA - NOMINAL_BLUR * NOMINAL_BLUR).sqrt();
            gaussian_blur(image, sigma, &mut self.levels[0]);
            (self.step, self.origin) = (step, step / 2.0);
        }
        self.fill();
    }

    /// The octave above: level `scales` of the finer one has twice the base blur; every second
    /// sample is kept.
    pub(super) fn next_of(&mut self, finer: &Self) {
        self.prepare(finer.scales);
        halve(&finer.levels[finer.scales], &mut self.levels[0]);
        (self.step, self.origin) = (finer.step * 2.0, finer.origin);
        self.fill();
    }

    fn prepare(&mut self, scales: usize) {
        self.scales = scales.max(1);
        self.levels.resize(self.scales + 3, LumaPlane::default());
    }

    fn fill(&mut self) {
        for i in 1..self.levels.len() {
            let (before, after) = (self.sigma(i as f32 - 1.0), self.sigma(i as f32));
            let (done, rest) = self.levels.split_at_mut(i);
            gaussian_blur(&done[i - 1], (after * after - before * before).sqrt(), &mut rest[0]);
        }
    }
}
