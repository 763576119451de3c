//! The noise of observations, and what one model gains over another in units of it.

use crate::bundle::{BundleObservation, BundleProblem};

/// Residuals beyond this take no part in estimates of the noise, and count as much where they are held out, standard deviations.
/// Source: Gaussian residuals are that large once in 3000; Hampel et al. 1986, hard rejection.
pub(crate) const TRUNCATION: f64 = 4.0;
/// Squared reprojection error of an observation, pixels²; infinite behind the camera.
pub(crate) fn error_sq(problem: &BundleProblem, o: &BundleObservation) -> f64 {
    let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
    let projected =
        camera.project(problem.poses[o.pose as usize].transform(problem.points[o.point as usize]));
    projected.map_or(f64::INFINITY, |p| p.distance_squared(o.pixel))
}

/// Robust standard deviation of one residual coordinate, pixels: the median squared length of a two-dimensional
/// normal residual is 2 ln 2 σ².
pub(crate) fn noise(problem: &BundleProblem) -> f64 {
    median_noise(problem.observations.iter().map(|o| error_sq(problem, o)).collect())
}

/// [`noise`] in units of the observations' own standard deviations. Of short tracks it is too small, for a point takes up
/// 3 of the 2 n coordinates of its n observations; that keeps the robust loss tight where tracks are short and many wrong.
pub(crate) fn noise_in_units(problem: &BundleProblem) -> f64 {
    let error = |o: &BundleObservation| error_sq(problem, o) / o.sigma_px.powi(2);
    median_noise(problem.observations.iter().map(error).collect())
}

/// What [`noise_in_units`] is to be multiplied by to be the noise of the observations, not of the residuals: the root of
/// coordinates over redundancy.
pub(crate) fn redundancy(problem: &BundleProblem) -> f64 {
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
