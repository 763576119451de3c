//! Grey images at halved sizes, and samples between their pixels.

use super::window::{KltWindow, ReferencePatch, SIDE};
use crate::sift::LANES;
use scene::FloatImage;

/// The smallest side of a level, pixels.
/// Source: derived: twice the side of the window, so that it fits at more than one place.
pub(crate) const LEAST_SIDE: usize = 2 * (SIDE + 1);

/// One level.
#[derive(Clone, Debug, Default)]
pub(crate) struct PyramidLevel {
    pub width: usize,
    pub height: usize,
    /// [height × width].
    pub data: Vec<f32>,
}

impl PyramidLevel {
    /// Smoothed by the binomial 1 2 1 in both directions, which halves the noise and costs little
    /// detail.
    pub(crate) fn smooth(image: &FloatImage) -> Self {
        let (width, height) = (image.width, image.height);
        let source: Vec<f32> = image.data.iter().step_by(image.channels.max(1)).copied().collect();
        let mut across = vec![0.0; width * height];
        for (row, out) in source.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
            for x in 0..width {
                let (l, r) = (row[x.saturating_sub(1)], row[(x + 1).min(width - 1)]);
                out[x] = 0.25 * (l + r) + 0.5 * row[x];
            }
        }
        let mut data = vec![0.0; width * height];
        for y in 0..height {
            let rows = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
            let [above, own, below] = rows.map(|y| &across[y * width..(y + 1) * width]);
            for (x, out) in data[y * width..(y + 1) * width].iter_mut().enumerate() {
                *out = 0.25 * (above[x] + below[x]) + 0.5 * own[x];
            }
        }
        Self { width, height, data }
    }

    /// Row `y`.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Half the size: 1 3 3 1 in both directions about the corner that four pixels share, so that
    /// positions are exactly halved where pixel centres are at halves.
    pub(crate) fn halve(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut across = vec![0.0; width * self.height];
        for (y, out) in across.chunks_exact_mut(width.max(1)).enumerate().take(self.height) {
            let row = self.row(y);
            for (x, o) in out.iter_mut().enumerate() {
                *o = binomial(|k| row[(2 * x + k).saturating_sub(1).min(self.width - 1)]);
            }
        }
        let mut data = vec![0.0; width * height];
        for (y, out) in data.chunks_exact_mut(width.max(1)).enumerate().take(height) {
            let rows: [&[f32]; 4] = std::array::from_fn(|k| {
                let r = (2 * y + k).saturating_sub(1).min(self.height - 1);
                &across[r * width..(r + 1) * width]
            });
            for (x, o) in out.iter_mut().enumerate() {
                *o = binomial(|k| rows[k][x]);
            }
        }
        Self { width, height, data }
    }

    /// Bilinear samples of the window about the pixel position (x, y) and of the ring about it, row
    /// by row; `None` where they leave the image.
    #[inline(always)]
    pub(crate) fn patch(&self, x: f32, y: f32) -> Option<ReferencePatch> {
        let half = (SIDE / 2 + 1) as f32;
        // Sample i lies at pixel position x − half + i, whose index coordinate is half a pixel
        // less.
        let (left, top) = (x - half - 0.5, y - half - 0.5);
        if !(left >= 0.0 && top >= 0.0) {
            return None;
        }
        let (column, row) = (left as usize, top as usize);
        if column + SIDE + 2 >= self.width || row + SIDE + 2 >= self.height {
            return None;
        }
        let (fx, fy) = (left - column as f32, top - row as f32);
        let w = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let mut out = [0.0; (SIDE + 2) * (SIDE + 2)];
        for (j, line) in out.chunks_exact_mut(SIDE + 2).enumerate() {
            let start = (row + j) * self.width + column;
            let above = &self.data[start..start + SIDE + 3];
            let below = &self.data[start + self.width..start + self.width + SIDE + 3];
            for i in 0..SIDE + 2 {
                line[i] = w[0] * above[i] + w[1] * above[i + 1] + w[2] * below[i] + w[3] * below[i + 1];
            }
        }
        Some(out)
    }

    /// Bilinear samples of the window in padded rows; whether they lie in the image.
    #[inline(always)]
    pub(super) fn padded_window(&self, x: f32, y: f32, out: &mut KltWindow) -> bool {
        let (left, top) = (x - (SIDE / 2) as f32 - 0.5, y - (SIDE / 2) as f32 - 0.5);
        if !(left >= 0.0 && top >= 0.0) {
            return false;
        }
        let (column, row) = (left as usize, top as usize);
        if column + SIDE >= self.width || row + SIDE >= self.height {
            return false;
        }
        let (fx, fy) = (left - column as f32, top - row as f32);
        let mut line = [0.0f32; LANES + 1];
        for (j, out) in out.iter_mut().enumerate() {
            let start = (row + j) * self.width + column;
            // SIDE + 1 = LANES: a sample more than pixels, for those between.
            let above = &self.data[start..start + LANES];
            let below = &self.data[start + self.width..start + self.width + LANES];
            for i in 0..LANES {
                line[i] = above[i] + fy * (below[i] - above[i]);
            }
            for i in 0..LANES {
                out[i] = line[i] + fx * (line[i + 1] - line[i]);
            }
            out[SIDE] = 0.0;
        }
        true
    }
}

/// The mean of four samples by the weights 1 3 3 1.
#[inline(always)]
fn binomial(sample: impl Fn(usize) -> f32) -> f32 {
    0.125 * sample(0) + 0.375 * sample(1) + 0.375 * sample(2) + 0.125 * sample(3)
}

/// An image at full size and halved again and again.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pyramid {
    pub levels: Vec<PyramidLevel>,
}

impl Pyramid {
    pub(crate) fn new(image: &FloatImage, levels: usize) -> Self {
        let mut all = vec![PyramidLevel::smooth(image)];
        while all.len() < levels.max(1) {
            let next = all[all.len() - 1].halve();
            if next.width.min(next.height) < LEAST_SIDE {
                break;
            }
            all.push(next);
        }
        Self { levels: all }
    }
}
