//! How an object turns about one axis, in numbers.

use super::deviations::AxisDeviation;
use super::model::AxisModel;
use super::problem::CircularCovariance;
use glam::DVec3;
use scene::decision::MotionModel;
use scene::motion_report::{Estimate, MotionReport, MotionSample};

/// The report of a turn; `None` of fewer than three frames. `times`: by frame, seconds. `images`:
/// those whose angles the covariance is of.
pub(super) fn report(
    model: &AxisModel,
    covariance: &CircularCovariance,
    axis_deviation: AxisDeviation,
    images: &[usize],
    times: &[f64],
) -> Option<MotionReport> {
    let angles: Option<Vec<f64>> = images.iter().map(|&i| model.turn.angles[i]).collect();
    let angles = angles.filter(|a| a.len() >= 3)?;
    let times: Vec<f64> = images.iter().map(|&i| times[i]).collect();
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    let square: f64 = times.iter().map(|t| (t - mean).powi(2)).sum();
    // The slope of the angles over time is a sum of them with these weights.
    let weights: Vec<f64> = times.iter().map(|t| (t - mean) / square).collect();
    let slope: f64 = weights.iter().zip(&angles).map(|(w, a)| w * a).sum();
    let rows = covariance.joint.chunks_exact(images.len());
    let variance: f64 = rows
        .zip(&weights)
        .map(|(row, w)| w * row.iter().zip(&weights).map(|(c, v)| c * v).sum::<f64>())
        .sum();
    let sign = if slope < 0.0 { -1.0 } else { 1.0 };
    let axis = model.turn.direction() * sign;
    let sample = |i: usize| {
        let (from, to) = (i.saturating_sub(1), (i + 1).min(angles.len() - 1));
        let rate = (angles[to] - angles[from]) / (times[to] - times[from]);
        MotionSample { time_s: times[i], rate_deg_s: (axis * (sign * rate.to_degrees())).to_array() }
    };
    Some(MotionReport {
        motion: MotionModel::SingleAxis,
        axis_camera: axis.to_array(),
        axis_camera_deviation_deg: axis_deviation.length().to_degrees(),
        axis_body: (DVec3::Z * sign).to_array(),
        axis_body_deviation_deg: 0.0,
        rate_deg_s: Estimate::new(slope.abs(), variance.max(0.0).sqrt()).in_degrees(),
        tumble: None,
        samples: (0..angles.len()).map(sample).collect(),
    })
}
