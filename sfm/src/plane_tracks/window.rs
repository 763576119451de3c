//! Where a window of the common picture lies in that of one image: correlation at whole squares,
//! then Lucas & Kanade (1981) with the common picture's gradients, which have less noise (inverse
//! compositional: Baker & Matthews 2004).

use super::sheet::SheetPicture;
use glam::{DMat2, DVec2};

/// Half of a window's side less a half, squares.
/// Source: docs/decisions/11; sides of 19 and 33 squares did as well.
pub(crate) const HALF: usize = 12;
/// Side of a window, squares.
/// Source: derivation from [`HALF`].
const SIDE: usize = 2 * HALF + 1;
/// Least correlation.
/// Source: docs/decisions/11; 0.3 was worse.
const CORRELATION: f32 = 0.4;

/// A window of the common picture, its mean taken off.
pub(crate) struct PlaneWindow {
    /// Its middle square, from the corner.
    pub middle: [usize; 2],
    values: Vec<f32>,
    /// Their root sum of squares.
    norm: f32,
    gradients: Vec<[f32; 2]>,
    /// Inverse of the sum of the gradients' products.
    inverse: DMat2,
}

/// Where a window was found: how far from its own place, squares, and the covariance of that if the
/// noise of its squares is independent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowShift {
    pub by: DVec2,
    pub covariance: DMat2,
}

impl PlaneWindow {
    /// `None` where the picture is not known or shows nothing.
    pub(crate) fn of(picture: &SheetPicture, side: usize, middle: [usize; 2]) -> Option<Self> {
        let [left, top] = [middle[0].checked_sub(HALF + 1)?, middle[1].checked_sub(HALF + 1)?];
        if left + SIDE + 2 > side || top + SIDE + 2 > side {
            return None;
        }
        let (mut values, mut gradients) = (Vec::with_capacity(SIDE * SIDE), Vec::with_capacity(SIDE * SIDE));
        for y in top + 1..=top + SIDE {
            for x in left + 1..=left + SIDE {
                let i = y * side + x;
                values.push(picture[i]);
                let across = 0.5 * (picture[i + 1] - picture[i - 1]);
                gradients.push([across, 0.5 * (picture[i + side] - picture[i - side])]);
            }
        }
        let norm = centre(&mut values);
        let mut sums = [0.0f64; 3];
        for g in &gradients {
            let [x, y] = g.map(f64::from);
            sums = [sums[0] + x * x, sums[1] + x * y, sums[2] + y * y];
        }
        let products = DMat2::from_cols_array(&[sums[0], sums[1], sums[1], sums[2]]);
        let round = products.determinant() > 0.01 * (0.5 * (sums[0] + sums[2])).powi(2);
        let inverse = products.inverse();
        (norm > 0.0 && norm.is_finite() && round && inverse.is_finite()).then_some(Self {
            middle,
            values,
            norm,
            gradients,
            inverse,
        })
    }

    /// Its middle, squares from the corner.
    pub(crate) fn centre(&self) -> DVec2 {
        DVec2::new(self.middle[0] as f64, self.middle[1] as f64) + 0.5
    }

    /// Looks for it up to so many squares from its place.
    pub(crate) fn find(&self, picture: &SheetPicture, side: usize, farthest: usize) -> Option<WindowShift> {
        let r = farthest as isize;
        let mut own = vec![0.0; SIDE * SIDE];
        let mut best = BestShift::default();
        best.offer([0, 0], self.correlation_at(picture, side, [0, 0], &mut own)?);
        // Hardly anything there, and not because it is elsewhere.
        if best.correlation < if r <= 6 { 0.6 * CORRELATION } else { 0.2 * CORRELATION } {
            return None;
        }
        // Every second place, then those about the best: what is seen from afar is smooth.
        for k in 0..(r + 1) * (r + 1) {
            let by = [2 * (k % (r + 1)) - r, 2 * (k / (r + 1)) - r];
            best.offer(by, self.correlation_at(picture, side, by, &mut own)?);
        }
        let [x, y] = best.by;
        for k in 0..9 {
            let by = [x + k % 3 - 1, y + k / 3 - 1];
            best.offer(by, self.correlation_at(picture, side, by, &mut own)?);
        }
        if best.correlation <= CORRELATION || best.by.iter().any(|d| d.abs() >= r) {
            return None;
        }
        self.closer(picture, side, DVec2::new(best.by[0] as f64, best.by[1] as f64))
    }

    /// Correlation at a shift; `None` where the picture does not show it.
    fn correlation_at(
        &self,
        picture: &SheetPicture,
        side: usize,
        by: [isize; 2],
        own: &mut [f32],
    ) -> Option<f32> {
        self.copy(picture, side, DVec2::new(by[0] as f64, by[1] as f64), own)?;
        let norm = centre(own);
        Some(if norm > 0.0 { dot(own, &self.values) / (norm * self.norm) } else { 0.0 })
    }

    /// Refines a shift to a fraction of a square.
    fn closer(&self, picture: &SheetPicture, side: usize, from: DVec2) -> Option<WindowShift> {
        let mut by = from;
        let mut own = vec![0.0; SIDE * SIDE];
        let mut fit = (0.0, 0.0);
        for _ in 0..8 {
            self.copy(picture, side, by, &mut own)?;
            let norm = centre(&mut own);
            let gain = dot(&own, &self.values) / (self.norm * self.norm);
            fit = (gain, gain * self.norm / norm);
            if !(gain > 0.0) {
                return None;
            }
            let mut g = DVec2::ZERO;
            for ((o, v), d) in own.iter().zip(&self.values).zip(&self.gradients) {
                let e = f64::from(o / gain - v);
                g += DVec2::new(f64::from(d[0]), f64::from(d[1])) * e;
            }
            let step = self.inverse * g;
            by -= step.clamp_length_max(1.0);
            if step.length() < 0.01 {
                break;
            }
        }
        let (gain, c) = (f64::from(fit.0), f64::from(fit.1));
        let kept = by.distance(from) < 1.5 && c > f64::from(CORRELATION);
        // Variance of what the window leaves, in units of the common picture.
        let left = f64::from(dot(&own, &own)) / gain.powi(2) * (1.0 - c * c).max(0.0) / own.len() as f64;
        let covariance = self.inverse * left;
        (kept && covariance.is_finite()).then_some(WindowShift { by, covariance })
    }

    /// The window as the picture has it at a shift; `None` where it is not all there.
    fn copy(&self, picture: &SheetPicture, side: usize, by: DVec2, out: &mut [f32]) -> Option<()> {
        let whole = by.floor();
        let (fx, fy) = ((by.x - whole.x) as f32, (by.y - whole.y) as f32);
        let left = (self.middle[0] as isize + whole.x as isize).checked_sub(HALF as isize)?;
        let top = (self.middle[1] as isize + whole.y as isize).checked_sub(HALF as isize)?;
        let (left, top) = (usize::try_from(left).ok()?, usize::try_from(top).ok()?);
        if left + SIDE + 1 > side || top + SIDE + 1 > side {
            return None;
        }
        let mut sum = 0.0;
        for (j, line) in out.chunks_exact_mut(SIDE).enumerate() {
            let above = &picture[(top + j) * side + left..][..SIDE + 1];
            let below = &picture[(top + j + 1) * side + left..][..SIDE + 1];
            for i in 0..SIDE {
                let a = above[i] + fx * (above[i + 1] - above[i]);
                let b = below[i] + fx * (below[i + 1] - below[i]);
                line[i] = a + fy * (b - a);
                sum += line[i];
            }
        }
        sum.is_finite().then_some(())
    }

    /// Whether all of it is there.
    pub(crate) fn shown_by(&self, picture: &SheetPicture, side: usize) -> bool {
        self.copy(picture, side, DVec2::ZERO, &mut [0.0; SIDE * SIDE]).is_some()
    }
}

/// The shift at which a window correlates best.
#[derive(Default)]
struct BestShift {
    correlation: f32,
    by: [isize; 2],
}

impl BestShift {
    fn offer(&mut self, by: [isize; 2], correlation: f32) {
        if correlation > self.correlation {
            *self = Self { correlation, by };
        }
    }
}

/// Takes the mean off; returns the root sum of squares.
fn centre(values: &mut [f32]) -> f32 {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|v| *v -= mean);
    dot(values, values).sqrt()
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
