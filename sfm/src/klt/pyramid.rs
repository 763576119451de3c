//! Grey images at halved sizes, and samples between their pixels.

use super::window::{HALF, KltWindow, SIDE, WIDE};
use scene::FloatImage;

/// One level.
#[derive(Clone, Debug, Default)]
pub(crate) struct PyramidLevel {
    pub width: usize,
    pub height: usize,
    /// [height × width].
    pub data: Vec<f32>,
}

impl PyramidLevel {
    /// Smoothed by the binomial 1 2 1 in both directions, which halves the noise and costs little detail.
    pub fn smooth(image: &FloatImage) -> Self {
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
            let row = |y: usize| &across[y * width..(y + 1) * width];
            let (above, own, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
            for (x, out) in data[y * width..(y + 1) * width].iter_mut().enumerate() {
                *out = 0.25 * (above[x] + below[x]) + 0.5 * own[x];
            }
        }
        Self { width, height, data }
    }

    /// Half the size: 1 3 3 1 in both directions about the corner that four pixels share, so that positions are
    /// exactly halved where pixel centres are at halves.
    pub fn halve(&self) -> Self {
        const W: [f32; 4] = [0.125, 0.375, 0.375, 0.125];
        let (width, height) = (self.width / 2, self.height / 2);
        let mut across = vec![0.0; width * self.height];
        for (y, out) in across.chunks_exact_mut(width.max(1)).enumerate().take(self.height) {
            let row = &self.data[y * self.width..(y + 1) * self.width];
            for (x, o) in out.iter_mut().enumerate() {
                let at = |k: usize| row[(2 * x + k).saturating_sub(1).min(self.width - 1)];
                *o = (0..4).map(|k| W[k] * at(k)).sum();
            }
        }
        let mut data = vec![0.0; width * height];
        for (y, out) in data.chunks_exact_mut(width.max(1)).enumerate().take(height) {
            let rows: [&[f32]; 4] = std::array::from_fn(|k| {
                let r = (2 * y + k).saturating_sub(1).min(self.height - 1);
                &across[r * width..(r + 1) * width]
            });
            for (x, o) in out.iter_mut().enumerate() {
                *o = (0..4).map(|k| W[k] * rows[k][x]).sum();
            }
        }
        Self { width, height, data }
    }

    /// Bilinear samples on a square of `side` about the pixel position (x, y), row by row; `false` where the square
    /// leaves the image.
    #[inline(always)]
    pub fn window(&self, x: f32, y: f32, side: usize, out: &mut [f32]) -> bool {
        let half = (side / 2) as f32;
        // Sample i lies at pixel position x − half + i, whose index coordinate is half a pixel less.
        let (left, top) = (x - half - 0.5, y - half - 0.5);
        if !(left >= 0.0 && top >= 0.0) {
            return false;
        }
        let (column, row) = (left as usize, top as usize);
        if column + side >= self.width || row + side >= self.height {
            return false;
        }
        let (fx, fy) = (left - column as f32, top - row as f32);
        let w = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        for (j, line) in out.chunks_exact_mut(side).enumerate().take(side) {
            let start = (row + j) * self.width + column;
            let above = &self.data[start..start + side + 1];
            let below = &self.data[start + self.width..start + self.width + side + 1];
            for i in 0..side {
                line[i] = w[0] * above[i] + w[1] * above[i + 1] + w[2] * below[i] + w[3] * below[i + 1];
            }
        }
        true
    }
}

impl PyramidLevel {
    /// [`PyramidLevel::window`] of [`SIDE`] pixels in padded rows.
    #[inline(always)]
    pub(super) fn padded_window(&self, x: f32, y: f32, out: &mut KltWindow) -> bool {
        let (left, top) = (x - HALF as f32 - 0.5, y - HALF as f32 - 0.5);
        if !(left >= 0.0 && top >= 0.0) {
            return false;
        }
        let (column, row) = (left as usize, top as usize);
        if column + SIDE >= self.width || row + SIDE >= self.height {
            return false;
        }
        let (fx, fy) = (left - column as f32, top - row as f32);
        let mut line = [0.0f32; WIDE + 1];
        for (j, out) in out.iter_mut().enumerate() {
            let start = (row + j) * self.width + column;
            // SIDE + 1 = WIDE: a sample more than pixels, for those between.
            let above = &self.data[start..start + WIDE];
            let below = &self.data[start + self.width..start + self.width + WIDE];
            for i in 0..WIDE {
                line[i] = above[i] + fy * (below[i] - above[i]);
            }
            for i in 0..WIDE {
                out[i] = line[i] + fx * (line[i + 1] - line[i]);
            }
            out[SIDE] = 0.0;
        }
        true
    }
}

/// An image at full size and halved again and again.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pyramid {
    pub levels: Vec<PyramidLevel>,
}

impl Pyramid {
    pub fn new(image: &FloatImage, levels: usize) -> Self {
        let mut all = vec![PyramidLevel::smooth(image)];
        while all.len() < levels.max(1) {
            let next = all[all.len() - 1].halve();
            if next.width.min(next.height) < 32 {
                break;
            }
            all.push(next);
        }
        Self { levels: all }
    }
}
