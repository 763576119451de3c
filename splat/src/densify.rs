//! Adding Gaussians where the picture pulls at them, removing those that do nothing.

use crate::cpu::optimise::Statistics;
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, Model, OPACITY, ROTATION};
use glam::{Quat, Vec3};
use rand::Rng as _;

/// Steps between rounds.
pub const EVERY: u32 = 100;
/// Mean screen gradient (units of half the image) above which a Gaussian is worth another (3DGS paper: 2e-4).
pub const GRADIENT: f32 = 2e-4;
/// Opacity below which a Gaussian is removed.
const MIN_OPACITY: f32 = 0.005;
/// Gaussians larger than this on the screen (fraction of the larger side, 3 σ) are always split, never cloned.
const SPLIT_RADIUS: f32 = 0.008;

/// What a round of densification did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Copied in place.
    pub cloned: usize,
    /// Replaced by two smaller ones.
    pub split: usize,
    /// Removed.
    pub pruned: usize,
}

/// Adds up to `room` Gaussians, those with the greatest mean screen gradient first, and removes the transparent.
pub fn densify(
    model: &mut Model,
    statistics: &Statistics,
    room: usize,
    threshold: f32,
    seed: u64,
    iteration: u32,
) -> Densified {
    let mut done = Densified::default();
    let mut candidates: Vec<(f32, u32)> = (0..model.len)
        .filter(|&i| statistics.visible[i] > 0.0)
        .map(|i| (statistics.gradient[i] / statistics.visible[i], i as u32))
        .filter(|c| c.0 > threshold)
        .collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    candidates.truncate(room);
    let mut added = Vec::with_capacity(candidates.len());
    for &(_, i) in &candidates {
        let i = i as usize;
        let mut rng = scene::rng::rng(seed, "densify", (u64::from(iteration) << 32) | i as u64);
        if statistics.radius[i] > SPLIT_RADIUS {
            added.push((split(model, i, &mut rng), i));
            done.split += 1;
        } else {
            added.push((row(model, i), i));
            done.cloned += 1;
        }
    }
    model.append(&added);
    done.pruned = prune(model);
    done
}

fn row(model: &Model, i: usize) -> [f32; GEOMETRY] {
    std::array::from_fn(|p| model.geometry[p][i])
}

/// Halves Gaussian `i` along its longest axis: one half stays, the other is returned.
fn split(model: &mut Model, i: usize, rng: &mut scene::rng::Rng) -> [f32; GEOMETRY] {
    let g = |p: usize| model.geometry[p][i];
    let q = Quat::from_xyzw(g(ROTATION + 1), g(ROTATION + 2), g(ROTATION + 3), g(ROTATION));
    let q = if q.length_squared() > 1e-20 { q.normalize() } else { Quat::IDENTITY };
    let logs = [g(LOG_SCALE), g(LOG_SCALE + 1), g(LOG_SCALE + 2)];
    let longest = (0..3).max_by(|&a, &b| logs[a].total_cmp(&logs[b])).unwrap_or(0);
    let mut axis = Vec3::ZERO;
    axis[longest] = logs[longest].clamp(-20.0, 20.0).exp() * rng.random_range(0.4f32..0.6);
    let offset = q * axis;
    let mean = model.mean(i);
    for k in 0..3 {
        model.geometry[MEAN + k][i] = (mean + offset)[k];
        model.geometry[LOG_SCALE + k][i] -= if k == longest { 0.5f32.ln().abs() } else { 0.16 };
    }
    model.reset_moments(i);
    let mut other = row(model, i);
    for k in 0..3 {
        other[MEAN + k] = (mean - offset)[k];
    }
    other
}

/// Removes Gaussians that are transparent, too large or not finite; returns how many.
pub fn prune(model: &mut Model) -> usize {
    let floor = (MIN_OPACITY / (1.0 - MIN_OPACITY)).ln();
    let keep: Vec<u32> = (0..model.len)
        .filter(|&i| {
            let g = |p: usize| model.geometry[p][i];
            g(OPACITY) > floor && (0..GEOMETRY).all(|p| g(p).is_finite())
        })
        .map(|i| i as u32)
        .collect();
    let removed = model.len - keep.len();
    if removed > 0 && !keep.is_empty() {
        model.select(&keep);
        return removed;
    }
    0
}
