//! The noise of observations, and how far they err together.

use crate::bundle::{BundleObservation, BundleProblem};
use crate::limits::OUTLIER_SIGMAS;
use glam::DVec2;
use std::collections::BTreeMap;

/// An image is divided into so many cells each way to see whether its observations err together:
/// coarse enough for several in a cell, fine enough that its pose does not take up what they share.
/// Source: derived; 16 cells leave 26 of their 32 coordinates to what a pose does not fit.
const CELLS: f64 = 4.0;

/// Squared reprojection error of an observation, pixels²; infinite behind the camera.
pub(crate) fn error_sq(problem: &BundleProblem, o: &BundleObservation) -> f64 {
    residual(problem, o).map_or(f64::INFINITY, DVec2::length_squared)
}

/// Reprojection error, pixels; `None` behind the camera.
fn residual(problem: &BundleProblem, o: &BundleObservation) -> Option<DVec2> {
    let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
    let in_camera = problem.poses[o.pose as usize].transform(problem.points[o.point as usize]);
    Some(o.pixel - camera.project(in_camera)?)
}

/// By what factor standard deviations are too small that take observations for independent.
///
/// Sums of n independent residuals have n times the variance of one; here they are taken over the
/// cells of each image, and over tracks with the sign changed half-way in the order of the images
/// (the sum of all is what the point is fitted to). The larger ratio counts, and no less than 1.
pub(crate) fn inflation(problem: &BundleProblem) -> f64 {
    let sigma = noise_in_units(problem);
    let mut length = vec![0usize; problem.points.len()];
    problem.observations.iter().for_each(|o| length[o.point as usize] += 1);
    let mut seen = vec![0usize; problem.points.len()];
    let mut ordered: Vec<&BundleObservation> = problem.observations.iter().collect();
    ordered.sort_by_key(|o| (o.point, o.pose));
    let mut cells: BTreeMap<(u32, i32, i32), SumOfResiduals> = BTreeMap::new();
    let mut tracks = vec![SumOfResiduals::default(); problem.points.len()];
    for o in ordered {
        let point = o.point as usize;
        let sign = if 2 * seen[point] < length[point] { 1.0 } else { -1.0 };
        seen[point] += 1;
        let Some(residual) = residual(problem, o) else { continue };
        let residual = residual / (o.sigma_px * sigma);
        if residual.length() > OUTLIER_SIGMAS {
            continue;
        }
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        let cell = (o.pixel / f64::from(camera.width.max(camera.height)) * CELLS).floor();
        cells.entry((o.pose, cell.x as i32, cell.y as i32)).or_default().add(residual);
        tracks[point].add(residual * sign);
    }
    ratio(cells.values()).max(ratio(tracks.iter())).max(1.0).sqrt()
}

/// A sum of residuals in units of the noise, and the sum of their squared lengths.
#[derive(Clone, Copy, Default)]
struct SumOfResiduals {
    sum: DVec2,
    squares: f64,
}

impl SumOfResiduals {
    fn add(&mut self, residual: DVec2) {
        self.sum += residual;
        self.squares += residual.length_squared();
    }
}

/// What sums vary by, over what they would vary by if their terms were independent.
fn ratio<'a>(sums: impl Iterator<Item = &'a SumOfResiduals> + Clone) -> f64 {
    let squares: f64 = sums.clone().map(|s| s.squares).sum();
    sums.map(|s| s.sum.length_squared()).sum::<f64>() / squares.max(f64::MIN_POSITIVE)
}

/// Robust standard deviation of one residual coordinate, pixels: the median squared length of a
/// two-dimensional normal residual is 2 ln 2 σ².
pub(crate) fn noise(problem: &BundleProblem) -> f64 {
    median_noise(problem.observations.iter().map(|o| error_sq(problem, o)).collect())
}

/// [`noise`] in units of the observations' own standard deviations. Of short tracks it is too
/// small, for a point takes up 3 of the 2 n coordinates of its n observations; that keeps the
/// robust loss tight where tracks are short and many wrong.
pub(crate) fn noise_in_units(problem: &BundleProblem) -> f64 {
    median_noise(problem.observations.iter().map(|o| error_sq(problem, o) / o.sigma_px.powi(2)).collect())
}

/// What [`noise_in_units`] is to be multiplied by to be the noise of the observations, not of the
/// residuals: the root of coordinates over redundancy.
pub(crate) fn redundancy(problem: &BundleProblem) -> f64 {
    let coordinates = 2 * problem.observations.len();
    let unknowns = 3 * problem.points.len() + 6 * problem.poses.len();
    (coordinates as f64 / coordinates.saturating_sub(unknowns).max(1) as f64).sqrt()
}

/// [`noise`] of squared lengths of errors; 1 of none.
pub(crate) fn median_noise(mut errors: Vec<f64>) -> f64 {
    if errors.is_empty() {
        return 1.0;
    }
    let middle = errors.len() / 2;
    let median = *errors.select_nth_unstable_by(middle, f64::total_cmp).1;
    (median / (2.0 * std::f64::consts::LN_2)).sqrt().max(1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{Camera, CameraModel, Pose};

    /// 12 images of 40 points each seen with errors `error(image, point, coordinate)`, pixels.
    fn seen_with(error: impl Fn(usize, usize, usize) -> f64) -> BundleProblem {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 500.0);
        let at = |k: usize| glam::DVec3::new(k as f64 % 8.0 - 3.5, (k / 8) as f64 - 2.0, 8.0);
        let mut problem = BundleProblem {
            poses: vec![Pose::IDENTITY; 12],
            pose_camera: vec![0; 12],
            points: (0..40).map(at).collect(),
            cameras: vec![camera],
            ..BundleProblem::default()
        };
        for pose in 0..12 {
            for point in 0..40 {
                let pixel = problem.cameras[0].project(problem.points[point]).unwrap()
                    + DVec2::new(error(pose, point, 0), error(pose, point, 1));
                let (pose, point) = (pose as u32, point as u32);
                problem.observations.push(BundleObservation { pose, point, pixel, sigma_px: 1.0 });
            }
        }
        problem
    }

    /// A number in -1..1 that looks random.
    fn scattered(k: usize) -> f64 {
        (k as f64 * 12.9898).sin() * 43758.5453 % 1.0
    }

    #[test]
    fn what_errs_by_itself_is_not_inflated_and_what_errs_together_is() {
        let alone = inflation(&seen_with(|i, p, c| scattered(1000 * i + 10 * p + c + 1)));
        assert!((1.0..1.2).contains(&alone), "{alone}");
        // A track that drifts: its halves err in opposite directions, all twelve as one.
        let drift = |i: usize, p: usize, c: usize| scattered(10 * p + c + 1) * if i < 6 { 1.0 } else { -1.0 };
        assert!(inflation(&seen_with(drift)) > 3.0);
        assert!(inflation(&seen_with(|i, p, c| scattered(1000 * i + 100 * (p % 8 / 2) + c + 1))) > 1.5);
    }
}
