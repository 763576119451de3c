//! Corners to a fraction of a pixel: lines through the steps from black to white, crossed.

use super::sampling::{Corners, sample};
use glam::DVec2;
use image::GrayImage;

/// Places along an edge at which the step is looked for. Source: derived; more than one a pixel of
/// tags that are not very near.
const PLACES: usize = 48;
/// Steps across the edge, a pixel. Source: derived; half of what bilinear values resolve.
const STEPS: i32 = 4;

/// The quadrilateral whose sides follow the steps from dark inside to light outside.
pub(super) fn refine(image: &GrayImage, mut quad: Corners) -> Option<Corners> {
    // The second round looks near the first one's lines only.
    for reach in [2.5, 1.5] {
        let lines: Option<Vec<(DVec2, DVec2)>> =
            (0..4).map(|i| line(image, quad[i], quad[(i + 1) % 4], reach)).collect();
        let lines = lines?;
        let mut crossed = quad;
        for i in 0..4 {
            let (before, after) = (lines[(i + 3) % 4], lines[i]);
            let corner = crossing(before, after)?;
            if corner.distance(quad[i]) > 3.0 * reach {
                return None;
            }
            crossed[i] = corner;
        }
        quad = crossed;
    }
    Some(quad)
}

/// Point and direction of the line nearest to the steps along an edge.
fn line(image: &GrayImage, from: DVec2, to: DVec2, reach: f64) -> Option<(DVec2, DVec2)> {
    let along = (to - from).try_normalize()?;
    // Clockwise as seen: outside is on the left of the way.
    let outward = DVec2::new(along.y, -along.x);
    let mut steps = Vec::with_capacity(PLACES);
    for i in 0..PLACES {
        // The ends are rounded by blur.
        let at = from.lerp(to, 0.08 + 0.84 * (i as f64 + 0.5) / PLACES as f64);
        steps.extend(step(image, at, outward, reach).map(|s| at + s * outward));
    }
    if steps.len() < PLACES / 2 {
        return None;
    }
    let fitted = fit(&steps)?;
    let mut distances: Vec<f64> = steps.iter().map(|p| distance(*p, fitted)).collect();
    distances.sort_by(f64::total_cmp);
    let most = (2.5 * distances[distances.len() / 2]).max(0.05);
    let kept: Vec<DVec2> = steps.into_iter().filter(|p| distance(*p, fitted) <= most).collect();
    fit(&kept)
}

/// Distance of a point from a line.
fn distance(point: DVec2, (on, along): (DVec2, DVec2)) -> f64 {
    (point - on).perp_dot(along).abs()
}

/// Where along the normal it becomes light: the mean of the places, weighted by the rise there.
fn step(image: &GrayImage, at: DVec2, outward: DVec2, reach: f64) -> Option<f64> {
    let count = (reach * f64::from(STEPS)) as i32;
    let (mut sum, mut weight) = (0.0, 0.0);
    for k in -count..count {
        let [before, after] =
            [k, k + 1].map(|k| sample(image, at + outward * (f64::from(k) / f64::from(STEPS))));
        let rise = (after? - before?).max(0.0);
        sum += rise * rise * (f64::from(k) + 0.5) / f64::from(STEPS);
        weight += rise * rise;
    }
    (weight > 1.0).then(|| sum / weight)
}

/// The line with the least squared distances: the mean and the main axis of the points.
fn fit(points: &[DVec2]) -> Option<(DVec2, DVec2)> {
    let n = points.len() as f64;
    let mean = points.iter().sum::<DVec2>() / n;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for d in points.iter().map(|p| *p - mean) {
        xx += d.x * d.x;
        xy += d.x * d.y;
        yy += d.y * d.y;
    }
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    (n > 2.0).then(|| (mean, DVec2::from_angle(angle)))
}

fn crossing(a: (DVec2, DVec2), b: (DVec2, DVec2)) -> Option<DVec2> {
    let sine = a.1.perp_dot(b.1);
    let along = (b.0 - a.0).perp_dot(b.1) / sine;
    (sine.abs() > 1e-3).then(|| a.0 + along * a.1)
}
