//! The noise of observations, and what one model gains over another in units of it.

use crate::bundle::{BundleObservation, BundleProblem};
use glam::DVec2;
use std::collections::HashMap;

/// Residuals beyond this take no part in estimates of the noise, and count as much where they are held out, standard deviations.
/// Source: Gaussian residuals are that large once in 3000; Hampel et al. 1986, hard rejection.
pub(crate) const TRUNCATION: f64 = 4.0;
/// Blocks of a track whose sums are compared; a track needs that many observations. Source: the least number of which a contrast,
/// + - - +, is orthogonal to a constant and a trend, which the point's position takes up.
const BLOCKS: usize = 4;
/// Cells along the longer image side within which residuals may be correlated. Source: chosen by hand, never measured.
const CELLS: f64 = 8.0;
/// Tracks that a variance inflation of 1 is worth beforehand. Source: a ratio of sums of squares of n tracks is known to
/// sqrt(1/n), a fifth here (two coordinates each).
const PRIOR_TRACKS: f64 = 25.0;

/// How much larger sums of residuals are than those of independent ones.
///
/// Observations of a point err together where a corner slides along an outline or a glint along a surface; those of an image do
/// where a shadow moves. The variance of what is estimated from n correlated observations is `κ σ²/n` (the design effect of
/// samples in clusters, Kish 1965), so n of them say as much as `n/κ` independent ones. With clusters of two kinds the
/// inflations add: `κ = κ_tracks + κ_images − 1` (Cameron, Gelbach & Miller, J. Business & Economic Statistics 2011, eq. 2.9).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Dependence {
    /// Inflation along tracks.
    pub along_tracks: f64,
    /// Inflation within parts of images.
    pub within_images: f64,
}

impl Dependence {
    /// Of the residuals of an adjusted problem in units of `sigma` times the observations' own standard deviations.
    pub fn of(problem: &BundleProblem, sigma: f64) -> Self {
        let mut tracks: Vec<Vec<DVec2>> = vec![Vec::new(); problem.points.len()];
        let mut cells: HashMap<[u32; 3], (DVec2, f64)> = HashMap::new();
        for o in &problem.observations {
            let Some(r) = residual(problem, o, sigma).filter(|r| r.length() < TRUNCATION) else { continue };
            tracks[o.point as usize].push(r);
            let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
            let cell = o.pixel * CELLS / f64::from(camera.width.max(camera.height));
            let sum = cells.entry([o.pose, cell.x as u32, cell.y as u32]).or_default();
            *sum = (sum.0 + r, sum.1 + r.length_squared());
        }
        let (mut contrasts, mut expected, mut used) = (0.0, 0.0, 0.0);
        let (mut squares, mut freedom) = (0.0, 0.0);
        for track in tracks.iter().filter(|t| t.len() >= BLOCKS) {
            let n = track.len() / BLOCKS;
            let sign = |i: usize| if (1..3).contains(&(i / n)) { -1.0 } else { 1.0 };
            let contrast: DVec2 = track[..BLOCKS * n].iter().enumerate().map(|(i, r)| sign(i) * *r).sum();
            contrasts += contrast.length_squared();
            expected += (2 * BLOCKS * n) as f64;
            squares += track.iter().map(|r| r.length_squared()).sum::<f64>();
            freedom += (2 * track.len()) as f64 - 3.0;
            used += 1.0;
        }
        let along = contrasts / expected * freedom / squares;
        let (sums, each) = cells.values().fold((0.0, 0.0), |(a, b), c| (a + c.0.length_squared(), b + c.1));
        Self {
            along_tracks: shrunk(along, used),
            within_images: shrunk(sums / each, cells.len() as f64),
        }
    }

    /// κ, at least 1.
    pub fn inflation(&self) -> f64 {
        (self.along_tracks + self.within_images - 1.0).max(1.0)
    }
}

/// An inflation that `count` clusters show, with what is thought of it beforehand.
fn shrunk(shown: f64, count: f64) -> f64 {
    if shown.is_finite() { (shown.max(1.0) * count + PRIOR_TRACKS) / (count + PRIOR_TRACKS) } else { 1.0 }
}

/// Projection less measured pixel, in units of `sigma` times the observation's standard deviation.
fn residual(problem: &BundleProblem, o: &BundleObservation, sigma: f64) -> Option<DVec2> {
    let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
    let projected = camera.project(problem.poses[o.pose as usize].transform(problem.points[o.point as usize]))?;
    Some((projected - o.pixel) / (sigma * o.sigma_px))
}

/// Squared reprojection error of an observation, pixels²; infinite behind the camera.
pub(crate) fn error_sq(problem: &BundleProblem, o: &BundleObservation) -> f64 {
    let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
    let projected =
        camera.project(problem.poses[o.pose as usize].transform(problem.points[o.point as usize]));
    projected.map_or(f64::INFINITY, |p| p.distance_squared(o.pixel))
}

/// Robust standard deviation of one residual coordinate, pixels: the median squared length of a two-dimensional
/// normal residual is 2 ln 2 σ².
pub fn noise(problem: &BundleProblem) -> f64 {
    median_noise(problem.observations.iter().map(|o| error_sq(problem, o)).collect())
}

/// [`noise`] in units of the observations' own standard deviations. Of short tracks it is too small, for a point takes up
/// 3 of the 2 n coordinates of its n observations; that keeps the robust loss tight where tracks are short and many wrong.
pub fn noise_in_units(problem: &BundleProblem) -> f64 {
    let error = |o: &BundleObservation| error_sq(problem, o) / o.sigma_px.powi(2);
    median_noise(problem.observations.iter().map(error).collect())
}

/// What [`noise_in_units`] is to be multiplied by to be the noise of the observations, not of the residuals: the root of
/// coordinates over redundancy.
pub fn redundancy(problem: &BundleProblem) -> f64 {
    let coordinates = 2 * problem.observations.len();
    let unknowns = 3 * problem.points.len() + 6 * problem.poses.len();
    (coordinates as f64 / coordinates.saturating_sub(unknowns).max(1) as f64).sqrt()
}

fn median_noise(mut errors: Vec<f64>) -> f64 {
    if errors.is_empty() {
        return 1.0;
    }
    let middle = errors.len() / 2;
    let median = *errors.select_nth_unstable_by(middle, f64::total_cmp).1;
    (median / (2.0 * std::f64::consts::LN_2)).sqrt().max(1e-3)
}
