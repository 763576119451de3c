//! A joint from a few tracks over a few frames: axes and rates are tried, and for each the place of
//! the axis and of the points is a linear problem.

use super::joint::JointPath;
use super::limits::{BENDS, DIRECTIONS, KEPT, TURNS_DEG};
use super::posed::PosedTrack;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// An axis and how far the part turns in a frame's time, radians.
#[derive(Clone, Copy, Debug)]
struct Turning {
    axis: DVec3,
    rate: f64,
}

/// What one track saw: frame from the first, camera, `(I − d dᵀ)` of its ray times the weight.
struct SeenRay {
    frame: usize,
    centre: DVec3,
    across: DMat3,
}

/// The joints that explain a group of tracks in some frames best, best first; the object's middle
/// is the origin and its size 1. `pixel`: standard deviation of an observation.
pub(super) fn joints(
    group: &[&PosedTrack<'_>],
    frames: Range<usize>,
    times: &Arc<[f64]>,
    pixel: f64,
) -> Vec<JointPath> {
    let rays: Vec<Vec<SeenRay>> = group.iter().map(|t| rays(t, &frames, pixel)).collect();
    // From the first of them on.
    let since: Vec<f64> = frames.clone().map(|k| times[k] - times[frames.start]).collect();
    let whole = since.last().copied().unwrap_or(1.0);
    let directions = (0..DIRECTIONS).into_par_iter().flat_map_iter(|k| {
        let axis = on_sphere(k);
        TURNS_DEG.into_iter().map(move |turn| Turning { axis, rate: turn.to_radians() / whole })
    });
    let tried = directions.filter_map(|t| Some((solve(&rays, t, &since)?.0, t)));
    let mut tried: Vec<(f64, Turning)> = tried.collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    tried.truncate(KEPT);
    let mut best: Vec<(f64, JointPath)> = tried
        .into_par_iter()
        .filter_map(|start| {
            let (cost, turning) = improved(&rays, start, &since);
            let place = solve(&rays, turning, &since)?.1;
            let (axis, first, times) = (turning.axis, frames.start, times.clone());
            let angles = since.iter().map(|t| turning.rate * t).collect();
            let bend = BENDS[BENDS.len() - 1];
            Some((cost, JointPath { axis, place, first, angles, bend, times }))
        })
        .collect();
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    best.into_iter().map(|(_, joint)| joint).collect()
}

/// Points spread evenly over the sphere.
fn on_sphere(k: usize) -> DVec3 {
    let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
    let (s, c) = (PI * (3.0 - 5f64.sqrt()) * k as f64).sin_cos();
    DVec3::new(c, s, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
}

/// What a track saw in these frames.
fn rays(track: &PosedTrack<'_>, frames: &Range<usize>, pixel: f64) -> Vec<SeenRay> {
    let seen = track.views.iter().filter(|(k, _)| frames.contains(k));
    seen.map(|(k, view)| {
        let d = view.ray;
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        // Pixels that a place at the middle of the object is off, in standard deviations.
        let weight = view.camera.mean_focal() / (view.centre.length() * pixel);
        SeenRay { frame: k - frames.start, centre: view.centre, across: across * (weight * weight) }
    })
    .collect()
}

/// Steps to and fro along each of three unknowns while that helps, then steps of half the size.
fn improved(rays: &[Vec<SeenRay>], (mut cost, mut best): (f64, Turning), since: &[f64]) -> (f64, Turning) {
    for degrees in [12.0_f64, 6.0, 3.0, 1.5, 0.75, 0.375] {
        let size = degrees.to_radians();
        // A search that goes round in circles ends.
        for _ in 0..20 {
            let u = best.axis.any_orthonormal_vector();
            let v = best.axis.cross(u);
            let tilts = [u, -u, v, -v].map(|w| Turning { axis: (best.axis + w * size).normalize(), ..best });
            let rates = [1.0 + size, 1.0 / (1.0 + size)].map(|f| Turning { rate: best.rate * f, ..best });
            let trials = tilts.into_iter().chain(rates).filter_map(|t| Some((solve(rays, t, since)?.0, t)));
            match trials.min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some(better) if better.0 < cost => (cost, best) = better,
                _ => break,
            }
        }
    }
    (cost, best)
}

/// Least squared distance of the rays from the points (weighted), and the place of the axis: for
/// each ray `P (R x + (I − R) c − o) = 0`. Place and points are about the object's size from its
/// middle, beforehand, which decides where nothing else does (along the axis).
fn solve(rays: &[Vec<SeenRay>], turning: Turning, since: &[f64]) -> Option<(f64, DVec3)> {
    let rotations: Vec<DMat3> = since
        .iter()
        .map(|t| DMat3::from_quat(DQuat::from_axis_angle(turning.axis, turning.rate * t)))
        .collect();
    let (mut place, mut place_right, mut constant) = (DMat3::IDENTITY, DVec3::ZERO, 0.0);
    let mut gained = 0.0;
    for track in rays {
        let (mut point, mut mixed) = (DMat3::IDENTITY, DMat3::ZERO);
        let mut right = DVec3::ZERO;
        for ray in track {
            let turned = rotations[ray.frame];
            let stays = DMat3::IDENTITY - turned;
            let (back, seen) = (turned.transpose() * ray.across, ray.across * ray.centre);
            point += back * turned;
            mixed += back * stays;
            right += turned.transpose() * seen;
            place += stays.transpose() * ray.across * stays;
            place_right += stays.transpose() * seen;
            constant += ray.centre.dot(seen);
        }
        let eliminated = point.inverse();
        place -= mixed.transpose() * eliminated * mixed;
        place_right -= mixed.transpose() * (eliminated * right);
        gained += right.dot(eliminated * right);
    }
    let found = place.inverse() * place_right;
    let cost = constant - gained - found.dot(place_right);
    (cost.is_finite() && found.is_finite()).then_some((cost, found))
}
