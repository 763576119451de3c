//! Vertical lines of the room in which an object turns (docs/decisions/11).
//!
//! A camera that stands still sees the room as it is, and a turn says nothing of that. But where
//! the axis is plumb, what is vertical in the room (edges of furniture, door frames, stands) is
//! parallel to it, and the images of parallel lines meet in one point (Hartley & Zisserman 2004,
//! section 8.6): so each of them says which way the axis leans towards the camera, the one thing
//! that the turn leaves open (`intrinsics`). Which lines are vertical is not known. Those that are
//! agree on one lean, the others on none: the lean is the one that makes all lines likeliest as a
//! mixture of both.

mod edges;
#[cfg(test)]
mod tests;

pub(crate) use edges::{Segment, edges_along};

use super::axis::Elevation;
use super::motion::CircularMotion;
use crate::error::SfmError;
use crate::model_selection::camera::{DISTORTION_SIGMA, PRINCIPAL_POINT_SIGMA, convert_camera};
use crate::solvers::linalg::{moments, symmetric_eigen};
use crate::statistics::{MEDIAN_DEVIATION, median};
use glam::DVec3;
use scene::decision::{Measurement, Quantity, Remark};
use scene::{Camera, CameraModel, FrameSet};
use std::f64::consts::PI;

/// How exactly what is vertical is so, and edges are seen, whatever their residuals say, radians.
/// Source: chosen by hand, never measured.
const VERTICAL_SIGMA: f64 = 0.12 * PI / 180.0;
/// Residuals along an edge err together over so many pixels.
/// Source: chosen by hand, never measured.
const TOGETHER_PX: f64 = 8.0;
/// Rays farther from their plane than so many standard deviations are left out.
/// Source: chosen by hand, never measured.
const FAR: f64 = 2.5;
/// Share of lines that are vertical, before they are looked at.
/// Source: docs/decisions/11; leaving it unknown gained nothing.
const SHARE: f64 = 0.3;
/// Of the others most lean by little, for things are set up askew, radians.
/// Source: chosen by hand, never measured.
const ASKEW: f64 = 2.0 * PI / 180.0;
/// Lines that lean by more are not looked at, radians.
/// Source: chosen by hand, never measured.
const MOST_LEAN: f64 = 7.0 * PI / 180.0;
/// Steps between the leans that are tried, radians, a thousand to each side.
/// Source: chosen by hand, a tenth of the accuracy of docs/decisions/11.
const STEP: f64 = 0.01 * PI / 180.0;
/// Log of the odds, against lines of which none is vertical, at which it is believed.
/// Source: docs/decisions/11, e² let two rooms in that e⁴ left out.
const CLEAR: f64 = 2.0;

/// What one line says: by how much the axis leans towards the camera from where it is thought to
/// be.
#[derive(Clone, Copy, Debug)]
struct Vote {
    /// Radians.
    lean: f64,
    /// What an error of the line's direction (radians) is to that: leans are known to `sigma /
    /// lever`. Its sign says on which side of the plane through the axis and the optical axis the
    /// line is.
    lever: f64,
    /// Standard deviation of the line's direction, radians.
    sigma: f64,
}

/// Edges of what stands still, along the image of the axis.
pub(crate) fn room_edges(frames: &FrameSet, turn: &CircularMotion) -> Result<Vec<Segment>, SfmError> {
    let z = turn.direction();
    edges::segments(frames, z.x.abs() > z.y.abs())
}

/// The camera's elevation over the plane of the turn that vertical lines show; `None` where they do
/// not agree on one.
pub(crate) fn elevation(segments: &[Segment], camera: &Camera, turn: &CircularMotion) -> Option<Elevation> {
    let up = turn.direction() * turn.upward();
    // Turning about `side` takes the axis in the plane of itself and the optical axis.
    let side = up.cross(DVec3::Z).try_normalize()?;
    let mut bends: Vec<(f64, Vec<Vote>)> = Vec::new();
    for (log_prior, camera) in with_distortions(camera) {
        bends.push((log_prior, segments.iter().filter_map(|s| vote(s, &camera, up, side)).collect()));
    }
    let prior = PRINCIPAL_POINT_SIGMA * f64::from(camera.width.max(camera.height)) / camera.mean_focal();
    let found = likeliest(&bends, prior)?;
    let votes = &bends[found.bend].1;
    let both =
        [1.0, -1.0].map(|side| votes.iter().filter(|v| v.lever * side > 0.0 && v.agrees(found.lean)).count());
    if found.log_odds < CLEAR || found.sigma > 5.0 * VERTICAL_SIGMA || both.contains(&0) {
        return None;
    }
    let leaning = up * found.lean.cos() + side.cross(up) * found.lean.sin();
    Some(Elevation {
        angle: -leaning.z.clamp(-1.0, 1.0).asin(),
        sigma: found.sigma,
        source: Remark::VerticalLines,
        doubt: Remark::DoubtfulLines,
        figures: vec![
            Measurement::count(Quantity::AgreeingLines, both[0] + both[1]),
            Measurement::count(Quantity::Lines, votes.len()),
            Measurement::new(Quantity::LogOdds, found.log_odds),
        ],
    })
}

impl Vote {
    /// Whether it is within two standard deviations of a lean.
    fn agrees(&self, lean: f64) -> bool {
        ((lean - self.lean) * self.lever).abs() < 2.0 * self.sigma
    }
}

/// What a line says if it is parallel to an axis that leans: `n · (cos δ up + sin δ side × up) =
/// 0`, n the normal of the plane of its rays.
fn vote(segment: &Segment, camera: &Camera, up: DVec3, side: DVec3) -> Option<Vote> {
    let (normal, seen) = plane_of(segment.points.iter().map(|p| camera.ray(*p)).collect())?;
    let (across, lever) = (normal.dot(up), normal.dot(side.cross(up)));
    let sigma = seen.hypot(VERTICAL_SIGMA);
    let usable = across.abs() < MOST_LEAN.sin() && sigma < ASKEW * lever.abs() && sigma.is_finite();
    // The normal points to one side: levers of lines left and right of the axis differ in sign.
    let right = if normal.dot(side) < 0.0 { -1.0 } else { 1.0 };
    usable.then(|| Vote { lean: (-across / lever).atan(), lever: lever * right, sigma })
}

/// Normal of the plane in which rays are, and its standard deviation about the middle one; rays far
/// out of it (where an edge meets another) are left out. `None` where few are left.
pub(crate) fn plane_of(mut rays: Vec<DVec3>) -> Option<(DVec3, f64)> {
    let all = rays.len();
    for rounds_left in (0..=4).rev() {
        let (values, axes) = symmetric_eigen(&moments(rays.iter().map(|r| (1.0, *r))));
        let normal = DVec3::from_array(axes[0]);
        let count = rays.len() as f64;
        // Along the line the rays spread by the second moment.
        let (residual, spread) = ((values[0].max(0.0) / count).sqrt(), (values[1] / count).sqrt());
        let typical = median(rays.iter().map(|r| r.dot(normal).abs()).collect()) / MEDIAN_DEVIATION;
        let before = rays.len();
        // Nothing is seen more exactly than a millionth.
        rays.retain(|r| r.dot(normal).abs() <= FAR * typical.max(1e-6));
        if rays.len() == before || rounds_left == 0 {
            return Some((normal, residual / spread * (TOGETHER_PX / count).sqrt().min(1.0)));
        }
        if rays.len() * 2 < all {
            return None;
        }
    }
    None
}

/// The camera with other distortions, each with the logarithm of its probability but for a
/// constant. What turns in the middle of the picture says little of the distortion at its borders,
/// where the room is.
fn with_distortions(camera: &Camera) -> impl Iterator<Item = (f64, Camera)> + use<> {
    let distorted = match camera.distortion().len() {
        0 => convert_camera(camera, CameraModel::SimpleRadial),
        _ => camera.clone(),
    };
    let first = distorted.model.num_focals() + 2;
    let side = f64::from(camera.width.max(camera.height));
    let shrink = (2.0 * camera.mean_focal() / side).powi(2);
    (-5..=5).map(move |k| {
        let share = 0.5 * f64::from(k) * DISTORTION_SIGMA;
        let mut other = distorted.clone();
        other.params[first] += share * shrink;
        (-0.5 * (share / DISTORTION_SIGMA).powi(2), other)
    })
}

/// A lean, how well it is known, with which distortion most likely, and the log of the odds that
/// some lines are vertical.
struct Likeliest {
    lean: f64,
    sigma: f64,
    bend: usize,
    log_odds: f64,
}

/// Mean and deviation of the lean given all lines, whatever the distortion. Each is vertical with
/// the probability [`SHARE`]; else it leans by itself, whatever the axis does. `prior`: standard
/// deviation of the lean beforehand.
fn likeliest(bends: &[(f64, Vec<Vote>)], prior: f64) -> Option<Likeliest> {
    let leans: Vec<f64> = (-1000..=1000).map(|k| f64::from(k) * STEP).collect();
    let norm = bends.iter().map(|b| b.0.exp()).sum::<f64>().ln();
    let mut logs: Vec<Vec<f64>> = Vec::new();
    for (log_prior, votes) in bends {
        let odds = leans.iter().map(|l| log_prior - norm + log_odds(votes, *l) - 0.5 * (l / prior).powi(2));
        logs.push(odds.collect());
    }
    let most = logs.iter().flatten().copied().fold(f64::MIN, f64::max);
    let weights: Vec<Vec<f64>> = logs.iter().map(|l| l.iter().map(|l| (l - most).exp()).collect()).collect();
    let masses: Vec<f64> = weights.iter().map(|w| w.iter().sum()).collect();
    let bend = (0..masses.len()).max_by(|a, b| masses[*a].total_cmp(&masses[*b]))?;
    let sum: f64 = masses.iter().sum();
    let lean = weighted_sum(&weights, leans.iter().copied()) / sum;
    let sigma = (weighted_sum(&weights, leans.iter().map(|l| (l - lean).powi(2))) / sum).sqrt();
    let log_odds = most + (sum * STEP / (prior * (2.0 * PI).sqrt())).ln();
    (log_odds.is_finite() && sigma > 0.0).then_some(Likeliest { lean, sigma, bend, log_odds })
}

/// Values by lean, weighed with the weights of all distortions.
fn weighted_sum(weights: &[Vec<f64>], values: impl Iterator<Item = f64> + Clone) -> f64 {
    weights.iter().map(|w| values.clone().zip(w).map(|(v, w)| w * v).sum::<f64>()).sum::<f64>()
}

/// Density of a normal variable.
fn gauss(x: f64, sigma: f64) -> f64 {
    (-0.5 * (x / sigma).powi(2)).exp() / (sigma * (2.0 * PI).sqrt())
}

/// Log of the odds that some lines are vertical and the axis leans by `lean`, against none being
/// so.
fn log_odds(votes: &[Vote], lean: f64) -> f64 {
    let mut sum = 0.0;
    for v in votes {
        let askew = (1.0 - SHARE) * gauss(v.lean * v.lever, ASKEW.hypot(v.sigma));
        let others = askew + SHARE / (2.0 * MOST_LEAN);
        let vertical = gauss((lean - v.lean) * v.lever, v.sigma);
        sum += (SHARE * vertical / others + 1.0 - SHARE).ln();
    }
    sum
}
