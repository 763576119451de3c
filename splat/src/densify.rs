//! A round of densification by the host: Gaussians are added where the picture pulls at them, and those that do nothing go.

use crate::model::{GEOMETRY, LOG_SCALE, MEAN, Model, OPACITY};
use crate::statistics::Statistics;
use crate::view::PinholeView;
use glam::{Quat, Vec3};
use rand::Rng as _;
use rayon::prelude::*;

/// Opacity below which a Gaussian is removed. Source: Kerbl et al. 2023, section 5.2 (its implementation has 0.005).
pub(crate) const MIN_OPACITY: f32 = 0.005;
/// Gaussians that fewer views than this have in their picture are removed where the background shows through.
/// Source: chosen by hand; that they go is worth 1.0 to 1.5 dB (docs/benchmarks.md, ablations).
const LEAST_VIEWS: usize = 5;
/// The same as a share of the views, one in so many, where there are few. Source: see [`LEAST_VIEWS`].
const LEAST_VIEWS_SHARE: usize = 8;
/// Logarithms of scales are limited to this and its negative. Source: `exp` of it squared is finite in f32.
const MAX_LOG_SCALE: f32 = 20.0;
/// How far the halves lie from the whole's centre, standard deviations along its longest axis, drawn evenly.
/// Source: chosen by hand, never measured.
const OFFSETS: std::ops::Range<f32> = 0.4..0.6;
/// The halves' scales: a half along the longest axis, `exp(−0.16)` across it. Source: chosen by hand, never measured.
const SHRINK_ACROSS: f32 = 0.16;
/// Squared norm below which a quaternion says nothing. Source: the square of what f32 keeps beside 1, far below.
const LEAST_NORM_SQUARED: f32 = 1e-20;

/// Splits up to `room` Gaussians, those of the largest mean screen gradient (Kerbl et al. 2023), and removes the transparent.
pub(crate) fn densify(model: &mut Model, statistics: &Statistics, room: usize, seed: u64, iteration: u32) {
    let mut candidates: Vec<(f32, u32)> = (0..model.len)
        .filter(|&i| statistics.visible[i] > 0.0)
        .map(|i| (statistics.gradient[i] / statistics.visible[i], i as u32))
        .filter(|c| c.0 > 0.0)
        .collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    candidates.truncate(room);
    let mut added = Vec::with_capacity(candidates.len());
    for &(_, i) in &candidates {
        let mut rng = scene::rng::rng(seed, "densify", (u64::from(iteration) << 32) | u64::from(i));
        added.push((split(model, i as usize, &mut rng), i as usize));
    }
    model.append(&added);
    prune(model);
}

fn row(model: &Model, i: usize) -> [f32; GEOMETRY] {
    std::array::from_fn(|p| model.geometry[p][i])
}

/// Halves Gaussian `i` along its longest axis: one half stays, the other is returned.
fn split(model: &mut Model, i: usize, rng: &mut scene::rng::Rng) -> [f32; GEOMETRY] {
    let logs = [0, 1, 2].map(|k| model.geometry[LOG_SCALE + k][i]);
    let longest = (0..3).max_by(|&a, &b| logs[a].total_cmp(&logs[b])).unwrap_or(0);
    let mut axis = Vec3::ZERO;
    axis[longest] = logs[longest].clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp() * rng.random_range(OFFSETS);
    let (mean, offset) = (model.mean(i), unit(model.rotation(i)) * axis);
    for k in 0..3 {
        model.geometry[MEAN + k][i] = (mean + offset)[k];
        model.geometry[LOG_SCALE + k][i] -= if k == longest { 0.5f32.ln().abs() } else { SHRINK_ACROSS };
    }
    model.reset_moments(i);
    let mut other = row(model, i);
    other[MEAN..MEAN + 3].copy_from_slice(&(mean - offset).to_array());
    other
}

fn unit(q: Quat) -> Quat {
    if q.length_squared() > LEAST_NORM_SQUARED { q.normalize() } else { Quat::IDENTITY }
}

/// Removes Gaussians that are transparent or not finite.
fn prune(model: &mut Model) {
    let floor = (MIN_OPACITY / (1.0 - MIN_OPACITY)).ln();
    let stays = |i: &u32| {
        let g = row(model, *i as usize);
        g[OPACITY] > floor && g.iter().all(|v| v.is_finite())
    };
    let keep = (0..model.len as u32).filter(stays).collect();
    keep_some(model, keep);
}

/// Keeps the Gaussians of the list, all of them where it is empty; returns how many went.
pub(crate) fn keep_some(model: &mut Model, keep: Vec<u32>) -> usize {
    let removed = model.len - keep.len();
    if removed == 0 || keep.is_empty() {
        return 0;
    }
    model.select(&keep);
    removed
}

/// How many of so many views must have a Gaussian in their picture.
pub(crate) fn least_views(views: usize) -> usize {
    LEAST_VIEWS.min(views / LEAST_VIEWS_SHARE)
}

/// Removes Gaussians whose centre hardly any view has in its picture; returns how many. No other view contradicts them,
/// so that they settle just before a camera, explain its picture, and hang in the air in pictures from elsewhere.
pub(crate) fn prune_unseen(model: &mut Model, views: &[PinholeView]) -> usize {
    let least = least_views(views.len());
    let is_seen = |i: &u32| {
        let x = model.mean(*i as usize);
        views.iter().filter(|v| v.sees(v.to_camera(x))).take(least).count() >= least
    };
    let keep = (0..model.len as u32).into_par_iter().filter(is_seen).collect();
    keep_some(model, keep)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Mat3;
    use scene::Gaussians;

    #[test]
    fn what_hangs_before_one_camera_is_removed_and_what_all_see_stays() {
        // Cameras on a ring look down on the origin from distance 1.
        let view = |k: usize| {
            let (s, c) = (k as f32 / 40.0 * std::f32::consts::TAU).sin_cos();
            let eye = Vec3::new(c, s, 1.0).normalize();
            let (z, x) = (-eye, Vec3::new(-s, c, 0.0));
            let rotation = Mat3::from_cols(x, z.cross(x), z).transpose();
            let translation = -(rotation * eye);
            PinholeView {
                rotation,
                translation,
                focal: [60.0; 2],
                centre: [24.0, 20.0],
                width: 48,
                height: 40,
            }
        };
        let views: Vec<_> = (0..40).map(view).collect();
        let means = vec![Vec3::ZERO, views[3].position() * 0.97, Vec3::new(0.1, -0.1, 0.05)];
        let n = means.len();
        let mut model = Model::from_gaussians(&Gaussians {
            means,
            log_scales: vec![Vec3::splat(-4.0); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![0.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        });
        assert_eq!(prune_unseen(&mut model, &views), 1);
        assert_eq!((model.len, model.mean(0), model.mean(1)), (2, Vec3::ZERO, Vec3::new(0.1, -0.1, 0.05)));
        assert_eq!(prune_unseen(&mut model, &views[..3]), 0, "too few views to tell");
    }
}
