//! Poses of the training views: kept, or moved to where the splat shows what their photos show, by evidence.
//!
//! Direct alignment (Lucas and Kanade 1981; Irani and Anandan 1999). A camera that moves by `x ← x + ω × x + v` (camera frame)
//! shows `I'(p) ≈ I(p) − ∇I · F ξ`, where F is the derivative of the pixel at depth z by ξ = (ω, v). Of a view's photo P the
//! motion is the least-squares solution of `∇I F ξ = I − P` over pixels and channels, with Huber's weights.

use super::Trainer;
use crate::backend::Target;
use crate::config::PoseRefinement;
use crate::view::PinholeView;
use crate::{RenderOptions, SplatError};
use glam::{DMat3, DQuat, DVec3, Mat3, Quat, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Positions of the schedule at which is asked whether poses are to be refined; both have to say so.
const LOOKS: [f64; 2] = [0.2, 0.3];
/// Part of the squared error that moving each view must explain, in pixels that had no part in moving it. Our own
/// poses left at most 0.02 to explain, poses 0.06° off 0.17 and more (docs/decisions/0024).
const EXPLAINED: f64 = 0.1;
/// Views that are asked: what a look costs must not grow with their number.
const SAMPLE: usize = 48;
/// Views are moved from the second look on (from the first place when told to), this often, until near the end.
const FROM: f64 = 0.1;
const EVERY: f64 = 0.05;
const UNTIL: f64 = 0.96;
/// Side of the blocks of pixels that take turns in moving and in judging.
const BLOCK: usize = 16;
/// Before anything is known a view is expected to be off by this, in radians and in normalised units.
const FIRST_SPREAD: f64 = 0.005;
/// What a splat shows wrong is wrong over many pixels: so many residuals say as much as one that is independent.
const PIXELS_AS_ONE: f64 = 1000.0;
/// Residuals above this multiple of their root mean square count by their size alone.
const HUBER: f64 = 2.0;
/// Where less than this is covered there is no surface to align.
const COVERED: f32 = 0.3;

/// What was found out about the poses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseFindings {
    /// Looks so far.
    pub looks: u32,
    /// What the looks that judge found explained.
    pub explained: Vec<f64>,
    /// Whether views are moved.
    pub refined: bool,
    /// Poses of the training views in their order: quaternion (x, y, z, w) and translation of `cam_from_world`, normalised.
    pub poses: Vec<[f32; 7]>,
    /// Root mean square of what views were moved by at first: rotation (radians) and translation (normalised), by coordinate.
    pub spread: Option<[f64; 2]>,
}

/// Which pixels are asked.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    All,
    /// The blocks of one colour of a chess board: 0 or 1.
    Blocks(usize),
}

impl Part {
    fn has(self, x: usize, y: usize) -> bool {
        match self {
            Self::All => true,
            Self::Blocks(colour) => (x / BLOCK + y / BLOCK) % 2 == colour,
        }
    }
}

/// Normal equations of a view's motion, and the squared error of the pixels that are not in them.
#[derive(Clone, Copy, Default)]
struct Sums {
    a: [[f64; 6]; 6],
    b: [f64; 6],
    /// Squared error of the pixels asked and of the others, and how many values the former are.
    inside: f64,
    outside: f64,
    count: f64,
}

impl Sums {
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

    /// The most likely motion, if `so_far` has been gone already and rotations and translations are as large as `spread`.
    fn motion(mut self, so_far: &[f64; 6], spread: [f64; 2]) -> [f64; 6] {
        let noise = (self.inside / self.count.max(1.0)).max(1e-9) * PIXELS_AS_ONE;
        for k in 0..6 {
            let weight = noise / spread[k / 3].max(1e-9).powi(2);
            self.a[k][k] += weight;
            self.b[k] -= weight * so_far[k];
        }
        super::align::solve(self.a, self.b).unwrap_or_default()
    }
}

/// The view after a motion (ω, v): `x ← exp(ω) x + v` in its frame.
pub(super) fn moved(view: &PinholeView, motion: &[f64; 6]) -> PinholeView {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from_slice(&motion[..3])));
    let translation = turn * view.translation.as_dvec3() + DVec3::from_slice(&motion[3..]);
    let rotation = (turn * view.rotation.as_dmat3()).as_mat3();
    PinholeView { rotation, translation: translation.as_vec3(), ..*view }
}

/// The motion that takes a view to another.
fn apart(from: &PinholeView, to: &PinholeView) -> [f64; 6] {
    let turn = to.rotation.as_dmat3() * from.rotation.as_dmat3().transpose();
    let w = DQuat::from_mat3(&turn).to_scaled_axis();
    let v = to.translation.as_dvec3() - turn * from.translation.as_dvec3();
    [w.x, w.y, w.z, v.x, v.y, v.z]
}

impl Trainer<'_> {
    /// Camera and pose of a view as training sees it now.
    pub(super) fn camera(&self, view: usize) -> PinholeView {
        let given = self.dataset.views[view].view;
        let place = self.views.binary_search(&view).ok();
        place.and_then(|p| self.state.findings.pose.poses.get(p)).map_or(given, |p| PinholeView {
            rotation: Mat3::from_quat(Quat::from_xyzw(p[0], p[1], p[2], p[3])),
            translation: Vec3::new(p[4], p[5], p[6]),
            ..given
        })
    }

    /// Looks whether poses are to be refined, and refines them, at their places in the schedule.
    pub(super) fn judge_poses(&mut self) -> Result<(), SplatError> {
        let (pose, position) = (&self.state.findings.pose, self.state.position);
        if self.config.refine_poses == PoseRefinement::Off || self.views.len() < 3 {
            return Ok(());
        }
        if pose.refined || self.config.refine_poses == PoseRefinement::On {
            let due = FROM + EVERY * f64::from(pose.looks);
            return if position >= due && due <= UNTIL { self.refine() } else { Ok(()) };
        }
        let judged = pose.explained.len();
        if LOOKS.get(judged).is_none_or(|&at| position < at) {
            return Ok(());
        }
        if pose.explained.iter().any(|e| *e < EXPLAINED) {
            return Ok(());
        }
        let explained = self.explained_by_motions()?;
        let pose = &mut self.state.findings.pose;
        pose.explained.push(explained);
        let on = explained >= EXPLAINED;
        if on && judged + 1 < LOOKS.len() {
            return Ok(());
        }
        // Refining goes on at the places that are left from here.
        pose.refined = on;
        pose.looks = ((position - FROM) / EVERY).max(0.0) as u32;
        let evidence = format!(
            "moving each view would explain {:.1} % of the squared error of pixels without a part in moving it (needed: {:.0} %)",
            100.0 * explained,
            100.0 * EXPLAINED
        );
        let choice = if on { "refined by the photos" } else { "as given" };
        self.note("poses of the training views", choice.to_owned(), evidence);
        Ok(())
    }

    /// Part of the squared error that goes where views are moved by what the other half of their pixels says.
    fn explained_by_motions(&mut self) -> Result<f64, SplatError> {
        let (mut before, mut after) = (0.0, 0.0);
        let every = self.views.len().div_ceil(SAMPLE);
        let views: Vec<usize> = self.views.iter().step_by(every).copied().collect();
        for v in views {
            let view = self.camera(v);
            let sums = self.look(v, &view, Part::Blocks(0))?;
            let view = moved(&view, &sums.motion(&[0.0; 6], [FIRST_SPREAD; 2]));
            before += sums.outside;
            after += self.look(v, &view, Part::Blocks(0))?.outside;
        }
        Ok(if before > 0.0 { 1.0 - after / before } else { 0.0 })
    }

    /// Moves all training views once.
    fn refine(&mut self) -> Result<(), SplatError> {
        self.state.findings.pose.looks += 1;
        let known = self.state.findings.pose.spread;
        let (mut poses, mut squares) = (Vec::with_capacity(self.views.len()), [0.0f64; 2]);
        for v in self.views.clone() {
            let view = self.camera(v);
            let sums = self.look(v, &view, Part::All)?;
            let given = self.dataset.views[v].view;
            let spread = known.unwrap_or([FIRST_SPREAD; 2]);
            let view = moved(&view, &sums.motion(&apart(&given, &view), spread));
            for (k, x) in apart(&given, &view).iter().enumerate() {
                squares[k / 3] += x * x / 3.0;
            }
            let (q, t) = (Quat::from_mat3(&view.rotation), view.translation);
            poses.push([q.x, q.y, q.z, q.w, t.x, t.y, t.z]);
        }
        let n = self.views.len() as f64;
        let pose = &mut self.state.findings.pose;
        pose.refined = true;
        pose.poses = poses;
        pose.spread = known.or(Some(squares.map(|s| (s / n).sqrt())));
        Ok(())
    }

    /// What the photo of training view `v` says about the motion of `view`, at the resolution in use.
    fn look(&mut self, v: usize, view: &PinholeView, part: Part) -> Result<Sums, SplatError> {
        let own = &self.dataset.views[v];
        let level = self.level().min(own.levels.len() as u32 - 1);
        let (pixels, view) = (&own.levels[level as usize], view.at_level(level));
        let options = RenderOptions { antialias: self.config.antialias, ..RenderOptions::default() };
        let shown = self.backend.render(&view, &options)?;
        let target = Target {
            rgb: &pixels.rgb,
            mask: pixels.mask.as_deref(),
            transparent: self.dataset.is_transparent(),
            photo: None,
        };
        let photo = Photo { target, gain: self.gain(v).unwrap_or([1.0; 3]), view: &view, shown: &shown };
        let rows: Vec<f64> = (0..view.height).into_par_iter().map(|y| photo.row_error(y)).collect();
        let values = 3 * view.width * view.height;
        let limit = HUBER * (rows.iter().sum::<f64>() / values.max(1) as f64).sqrt();
        let rows: Vec<Sums> =
            (0..view.height).into_par_iter().map(|y| photo.row(y, part, limit as f32)).collect();
        Ok(rows.iter().fold(Sums::default(), Sums::add))
    }
}

/// A photo beside what the splat shows of it.
struct Photo<'a> {
    target: Target<'a>,
    gain: [f32; 3],
    view: &'a PinholeView,
    shown: &'a crate::RenderOutput,
}

impl Photo<'_> {
    fn weight(&self, i: usize) -> f32 {
        self.target.mask.filter(|_| !self.target.transparent).map_or(1.0, |m| f32::from(m[i]) / 255.0)
    }

    /// Photo minus rendering; the background is black in both.
    fn residual(&self, i: usize, c: usize) -> f32 {
        let cover = self.target.mask.filter(|_| self.target.transparent);
        let cover = cover.map_or(1.0, |m| f32::from(m[i]) / 255.0);
        cover * f32::from(self.target.rgb[3 * i + c]) / 255.0 / self.gain[c] - self.shown.rgb.data[3 * i + c]
    }

    fn row_error(&self, y: usize) -> f64 {
        let row = y * self.view.width..(y + 1) * self.view.width;
        let at = |i: usize| (0..3).map(|c| self.residual(i, c).powi(2)).sum::<f32>() * self.weight(i);
        row.map(|i| f64::from(at(i))).sum()
    }

    fn row(&self, y: usize, part: Part, limit: f32) -> Sums {
        let (w, h) = (self.view.width, self.view.height);
        let mut sums = Sums::default();
        for x in 0..w {
            let i = y * w + x;
            let e: [f32; 3] = std::array::from_fn(|c| self.residual(i, c));
            let weight = self.weight(i);
            let square = f64::from(weight * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]));
            if !part.has(x, y) {
                sums.outside += square;
                continue;
            }
            sums.inside += square;
            sums.count += 3.0;
            let z = self.shown.depth.data[i];
            let inner = x > 0 && y > 0 && x + 1 < w && y + 1 < h;
            if inner && weight > 0.0 && self.shown.alpha.data[i] >= COVERED && z > 0.0 {
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
    fn flow(&self, x: usize, y: usize, z: f32) -> [[f64; 6]; 2] {
        let ([fx, fy], [cx, cy]) = (self.view.focal.map(f64::from), self.view.centre.map(f64::from));
        let (u, v, z) = ((x as f64 + 0.5 - cx) / fx, (y as f64 + 0.5 - cy) / fy, f64::from(z));
        [
            [-fx * u * v, fx * (1.0 + u * u), -fx * v, fx / z, 0.0, -fx * u / z],
            [-fy * (1.0 + v * v), fy * u * v, fy * u, 0.0, fy / z, -fy * v / z],
        ]
    }
}

impl Sums {
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

#[cfg(test)]
#[path = "poses_tests.rs"]
mod tests;
