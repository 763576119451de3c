//! Direct alignment of a camera (Lucas and Kanade 1981; Irani and Anandan 1999).
//!
//! A camera that moves by ξ shows `I'(p) ≈ I(p) − ∇I · F ξ`, where F is the derivative of the pixel
//! at depth z by ξ. Of a view's photo P the motion is the least-squares solution of `∇I F ξ = I −
//! P` over pixels and channels, with Huber's weights.

use super::linear::solve;
use super::motion::Motion;
use crate::backend::Target;
use crate::error::SplatError;
use crate::train::context::RuleContext;
use crate::view::{PinholeView, RenderOutput};
use rayon::prelude::*;

/// What counts as evidence of a motion.
struct Alignment {
    /// Side of the blocks of pixels that take turns in moving and in judging, pixels. Source:
    /// chosen by hand, never measured; wider than the loss's window (11 pixels), so that most
    /// pixels are independent.
    block: usize,
    /// What a splat shows wrong is wrong over many pixels: so many residuals say as much as one
    /// that is independent, a count. Source: docs/decisions/14 (with 1 weak directions wandered by
    /// pixels, with 100 case 2 lost 3 dB).
    pixels_as_one: f64,
    /// Residuals above this multiple of their root mean square count by their size alone, a ratio.
    /// Source: Huber 1981 has 1.345 of a robust deviation; chosen by hand, never measured.
    huber: f64,
    /// Coverage below which there is no surface to align. Source: chosen by hand, never measured.
    covered: f32,
}

/// The values in force.
const ALIGNMENT: Alignment = Alignment { block: 16, pixels_as_one: 1000.0, huber: 2.0, covered: 0.3 };

/// Which pixels are asked.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum PixelSubset {
    All,
    /// The blocks of one colour of a chess board: 0 or 1.
    Blocks(usize),
}

impl PixelSubset {
    fn has(self, x: usize, y: usize) -> bool {
        match self {
            Self::All => true,
            Self::Blocks(colour) => (x / ALIGNMENT.block + y / ALIGNMENT.block) % 2 == colour,
        }
    }
}

/// Normal equations of a view's motion, and the squared error of the pixels that are not in them.
#[derive(Clone, Copy, Default)]
pub(super) struct MotionEquations {
    a: [[f64; 6]; 6],
    b: [f64; 6],
    /// Squared error of the pixels asked.
    inside: f64,
    /// Squared error of the others.
    pub(super) outside: f64,
    /// How many values are asked.
    count: f64,
}

impl MotionEquations {
    fn add(mut self, other: &Self) -> Self {
        for (row, more) in self.a.iter_mut().zip(&other.a) {
            row.iter_mut().zip(more).for_each(|(x, y)| *x += y);
        }
        self.b.iter_mut().zip(&other.b).for_each(|(x, y)| *x += y);
        self.inside += other.inside;
        self.outside += other.outside;
        self.count += other.count;
        self
    }

    /// The most likely motion, if `so_far` has been gone already and rotations and translations are
    /// as large as `spread`.
    pub(super) fn motion(mut self, so_far: &Motion, spread: [f64; 2]) -> Motion {
        let noise = (self.inside / self.count.max(1.0)).max(f64::EPSILON) * ALIGNMENT.pixels_as_one;
        for k in 0..6 {
            let weight = noise / spread[k / 3].max(f64::EPSILON).powi(2);
            self.a[k][k] += weight;
            self.b[k] -= weight * so_far[k];
        }
        solve(self.a, self.b).unwrap_or_default()
    }
}

/// What the photo of training view `v` says about the motion of `view`, at the resolution in use.
pub(super) fn motion_equations(
    step: &mut RuleContext,
    v: usize,
    view: &PinholeView,
    subset: PixelSubset,
) -> Result<MotionEquations, SplatError> {
    let (given, target) = step.photo(v, step.level());
    let view = PinholeView { rotation: view.rotation, translation: view.translation, ..given };
    let shown = step.backend.render(&view, &step.options())?;
    let gain = step.gain(v).unwrap_or([1.0; 3]);
    let photo = PhotoResidual { target, gain, view: &view, shown: &shown };
    let rows: Vec<f64> = (0..view.height).into_par_iter().map(|y| photo.row_error(y)).collect();
    let values = 3 * view.width * view.height;
    let limit = ALIGNMENT.huber * (rows.iter().sum::<f64>() / values.max(1) as f64).sqrt();
    let rows: Vec<MotionEquations> =
        (0..view.height).into_par_iter().map(|y| photo.row(y, subset, limit as f32)).collect();
    Ok(rows.iter().fold(MotionEquations::default(), MotionEquations::add))
}

/// A photo beside what the splat shows of it.
pub(super) struct PhotoResidual<'a> {
    pub(super) target: Target<'a>,
    pub(super) gain: [f32; 3],
    pub(super) view: &'a PinholeView,
    pub(super) shown: &'a RenderOutput,
}

impl PhotoResidual<'_> {
    fn weight(&self, i: usize) -> f32 {
        self.target.mask.filter(|_| !self.target.transparent).map_or(1.0, |m| f32::from(m[i]) / 255.0)
    }

    /// PhotoResidual minus rendering; the background is black in both.
    fn residual(&self, i: usize, c: usize) -> f32 {
        let cover = self.target.mask.filter(|_| self.target.transparent);
        let cover = cover.map_or(1.0, |m| f32::from(m[i]) / 255.0);
        cover * f32::from(self.target.rgb[3 * i + c]) / 255.0 / self.gain[c] - self.shown.rgb.data[3 * i + c]
    }

    fn row_error(&self, y: usize) -> f64 {
        let row = y * self.view.width..(y + 1) * self.view.width;
        row.map(|i| {
            let square: f32 = (0..3).map(|c| self.residual(i, c).powi(2)).sum();
            f64::from(square * self.weight(i))
        })
        .sum()
    }

    fn row(&self, y: usize, subset: PixelSubset, limit: f32) -> MotionEquations {
        let (w, h) = (self.view.width, self.view.height);
        let mut sums = MotionEquations::default();
        for x in 0..w {
            let i = y * w + x;
            let e: [f32; 3] = std::array::from_fn(|c| self.residual(i, c));
            let weight = self.weight(i);
            let square = f64::from(weight * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]));
            if !subset.has(x, y) {
                sums.outside += square;
                continue;
            }
            sums.inside += square;
            sums.count += 3.0;
            let z = self.shown.depth.data[i];
            let inner = x > 0 && y > 0 && x + 1 < w && y + 1 < h;
            if inner && weight > 0.0 && self.shown.alpha.data[i] >= ALIGNMENT.covered && z > 0.0 {
                let (matrix, side) = self.gradients(i, &e, weight, limit);
                sums.note(&self.flow(x, y, z), matrix, side);
            }
        }
        sums
    }

    /// Σ w ∇I ∇Iᵀ (xx, xy, yy) and Σ w ∇I (I − P) over the channels of a pixel.
    fn gradients(&self, i: usize, e: &[f32; 3], weight: f32, limit: f32) -> ([f32; 3], [f32; 2]) {
        let (rgb, w) = (&self.shown.rgb.data, self.view.width);
        let (mut matrix, mut side) = ([0.0; 3], [0.0; 2]);
        for (c, e) in e.iter().enumerate() {
            let gx = 0.5 * (rgb[3 * (i + 1) + c] - rgb[3 * (i - 1) + c]);
            let gy = 0.5 * (rgb[3 * (i + w) + c] - rgb[3 * (i - w) + c]);
            let wt = if e.abs() > limit { weight * limit / e.abs() } else { weight };
            for (m, g) in matrix.iter_mut().zip([gx * gx, gx * gy, gy * gy]) {
                *m += wt * g;
            }
            side[0] -= wt * gx * e;
            side[1] -= wt * gy * e;
        }
        (matrix, side)
    }

    /// Derivative of a pixel at depth z by ξ = (ω, v).
    pub(super) fn flow(&self, x: usize, y: usize, z: f32) -> [[f64; 6]; 2] {
        let ([fx, fy], [cx, cy]) = (self.view.focal.map(f64::from), self.view.centre.map(f64::from));
        let (u, v, z) = ((x as f64 + 0.5 - cx) / fx, (y as f64 + 0.5 - cy) / fy, f64::from(z));
        [
            [-fx * u * v, fx * (1.0 + u * u), -fx * v, fx / z, 0.0, -fx * u / z],
            [-fy * (1.0 + v * v), fy * u * v, fy * u, 0.0, fy / z, -fy * v / z],
        ]
    }
}

impl MotionEquations {
    fn note(&mut self, flow: &[[f64; 6]; 2], matrix: [f32; 3], side: [f32; 2]) {
        let [xx, xy, yy] = matrix.map(f64::from);
        let [sx, sy] = side.map(f64::from);
        for r in 0..6 {
            let (p, q) = (xx * flow[0][r] + xy * flow[1][r], xy * flow[0][r] + yy * flow[1][r]);
            self.b[r] += sx * flow[0][r] + sy * flow[1][r];
            for (a, (f, g)) in self.a[r].iter_mut().zip(flow[0].iter().zip(&flow[1])) {
                *a += p * f + q * g;
            }
        }
    }
}
