//! Plane or space: the choice between a homography and an epipolar geometry.

use crate::statistics::{MEDIAN_DEVIATION, median};

/// Robust score of a model (smaller is better): GRIC of Torr, "An Assessment of Information
/// Criteria for Motion Model Selection", CVPR 1997, over all matches. `squared`: squared distances
/// to the model's manifold, `sigma`: noise, both in pixels; `dimension` of the manifold in the
/// four-dimensional space of matches (homography 2, epipolar geometry 3) and number of `parameters`
/// of the model.
pub(crate) fn gric(squared: impl Iterator<Item = f64>, sigma: f64, dimension: f64, parameters: f64) -> f64 {
    let largest = 2.0 * (4.0 - dimension);
    let mut sum = 0.0;
    let mut count = 0.0;
    for e in squared {
        sum += (e / (sigma * sigma)).min(largest);
        count += 1.0;
    }
    sum + 4.0_f64.ln() * dimension * count + (4.0 * count).ln() * parameters
}

/// Standard deviation of one-dimensional residuals from their median absolute value (and half as
/// much again because the model was fitted to them), kept between a quarter of a pixel and half of
/// the `limit`. `squared`: squared residuals of the inliers, pixels.
pub(crate) fn noise(squared: Vec<f64>, limit: f64) -> f64 {
    let highest = (0.5 * limit).max(0.25);
    if squared.is_empty() {
        return highest;
    }
    (1.5 * median(squared).sqrt() / MEDIAN_DEVIATION).clamp(0.25, highest)
}
