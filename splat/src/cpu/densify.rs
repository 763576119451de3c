//! densify: Gaussians are split where the picture pulls at them, and removed where they do nothing.
//! Twin of `densify.wgsl`.

use crate::backend::{Backend, Round};
use crate::error::SplatError;
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, Model, OPACITY, ROTATION};
use crate::reference::constants::MAX_LOG_SCALE;
use crate::statistics::Statistics;
use crate::view::PinholeView;
use glam::{Quat, Vec3};
use rand::Rng as _;
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Opacity below which a Gaussian is removed. Source: chosen by hand, never measured (Kerbl et al.
/// 2023, section 5.2, have the rule).
pub(crate) const MIN_OPACITY: f32 = 0.005;
/// Gaussians that fewer views than this have in their picture are removed where the background
/// shows through. Source: chosen by hand; that they go is worth 1.0 to 1.5 dB (docs/benchmarks.md,
/// ablations).
const LEAST_VIEWS: usize = 5;
/// How far the halves lie from the old centre, in standard deviations of the longest axis.
/// Source: chosen by hand, never measured.
const OFFSETS: std::ops::Range<f32> = 0.4..0.6;
/// What halves lose of the logarithms of their shorter axes. Source: chosen by hand, never
/// measured.
const SHRINK: f32 = 0.16;

/// A round of densification by the host; how many were removed because hardly any view has them.
pub(crate) fn densify_by_edit<B: Backend + ?Sized>(
    backend: &mut B,
    round: &Round,
) -> Result<usize, SplatError> {
    let mut unseen = 0;
    backend.edit(&mut |model, statistics| {
        split_candidates(model, statistics, round);
        prune_transparent(model);
        if let Some(views) = round.remove_unseen {
            unseen = prune_unseen(model, views);
        }
        statistics.reset(model.len);
    })?;
    Ok(unseen)
}

/// Splits those at which the picture pulls most, as many as there is room for.
fn split_candidates(model: &mut Model, statistics: &Statistics, round: &Round) {
    let mut candidates: Vec<(f32, u32)> = (0..model.len)
        .filter(|&i| statistics.visible[i] > 0.0)
        .map(|i| (statistics.gradient[i] / statistics.visible[i], i as u32))
        .filter(|c| c.0 > 0.0)
        .collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    candidates.truncate(round.room);
    let mut added = Vec::with_capacity(candidates.len());
    for &(_, i) in &candidates {
        let draw = (u64::from(round.iteration) << 32) | u64::from(i);
        let mut rng = scene::rng::rng(round.seed, "densify", draw);
        added.push((split(model, i as usize, &mut rng), i as usize));
    }
    model.append(&added);
}

/// Halves Gaussian `i` along its longest axis: one half stays, the other is returned.
fn split(model: &mut Model, i: usize, rng: &mut scene::rng::Rng) -> [f32; GEOMETRY] {
    let q = orientation(model, i);
    let logs: [f32; 3] = std::array::from_fn(|k| model.geometry[LOG_SCALE + k][i]);
    let longest = (0..3).max_by(|&a, &b| logs[a].total_cmp(&logs[b])).unwrap_or(0);
    let (limit, mut axis) = (MAX_LOG_SCALE as f32, Vec3::ZERO);
    axis[longest] = logs[longest].clamp(-limit, limit).exp() * rng.random_range(OFFSETS);
    let offset = q * axis;
    let mean = model.mean(i);
    for k in 0..3 {
        model.geometry[MEAN + k][i] = (mean + offset)[k];
        model.geometry[LOG_SCALE + k][i] -= if k == longest { LN_2 } else { SHRINK };
    }
    model.reset_moments(i);
    let mut other: [f32; GEOMETRY] = std::array::from_fn(|p| model.geometry[p][i]);
    for k in 0..3 {
        other[MEAN + k] = (mean - offset)[k];
    }
    other
}

/// The rotation of Gaussian `i`; none where its quaternion has no direction.
fn orientation(model: &Model, i: usize) -> Quat {
    let [w, x, y, z] = std::array::from_fn(|k| model.geometry[ROTATION + k][i]);
    let q = Quat::from_xyzw(x, y, z, w);
    if q.length_squared() > 1e-20 { q.normalize() } else { Quat::IDENTITY }
}

/// Removes Gaussians that are transparent or not finite.
fn prune_transparent(model: &mut Model) {
    let floor = (MIN_OPACITY / (1.0 - MIN_OPACITY)).ln();
    let kept = (0..model.len as u32).filter(|&i| {
        let opaque = model.geometry[OPACITY][i as usize] > floor;
        opaque && model.geometry.iter().all(|plane| plane[i as usize].is_finite())
    });
    let kept: Vec<u32> = kept.collect();
    model.keep(&kept);
}

/// How many of so many views must have a Gaussian in their picture.
pub(crate) fn least_views(views: usize) -> usize {
    LEAST_VIEWS.min(views / 8)
}

/// Removes Gaussians whose centre hardly any view has in its picture; returns how many. No other
/// view contradicts them, so that they settle just before a camera, explain its picture, and hang
/// in the air in pictures from elsewhere.
fn prune_unseen(model: &mut Model, views: &[PinholeView]) -> usize {
    let least = least_views(views.len());
    let parts = views.first().map_or(0, |v| v.parts.len()) as u8;
    let of_parts: Vec<Vec<PinholeView>> =
        (0..=parts).map(|part| views.iter().map(|v| v.of_part(part)).collect()).collect();
    let kept = (0..model.len as u32).into_par_iter().filter(|&i| {
        let x = model.mean(i as usize);
        let views = of_parts.get(usize::from(model.part_of(i as usize))).unwrap_or(&of_parts[0]);
        views.iter().filter(|v| v.sees(v.camera_point(x))).take(least).count() >= least
    });
    let kept: Vec<u32> = kept.collect();
    model.keep(&kept)
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
                parts: crate::parts::PartPlaces::NONE,
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
