//! Adding Gaussians where the picture pulls at them, removing those that do nothing.

use crate::PinholeView;
use crate::config::Selection;
use crate::cpu::adam::Statistics;
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, Model, OPACITY, ROTATION};
use glam::{Quat, Vec3};
use rand::Rng as _;
use rayon::prelude::*;

/// Mean screen gradient (units of half the image) above which a Gaussian is worth another (3DGS paper: 2e-4); only
/// without a plan of growth.
pub const GRADIENT: f32 = 2e-4;
/// Opacity below which a Gaussian is removed.
pub const MIN_OPACITY: f32 = 0.005;
/// Gaussians that fewer views than this have in their picture are removed where the background shows through.
const LEAST_VIEWS: usize = 5;

/// Splits up to `room` Gaussians, chosen by `selection` (gradients above `threshold`), and removes the transparent.
pub fn densify(
    model: &mut Model,
    statistics: &Statistics,
    room: usize,
    threshold: f32,
    selection: Selection,
    seed: u64,
    iteration: u32,
) {
    let rng = |i: u32| scene::rng::rng(seed, "densify", (u64::from(iteration) << 32) | u64::from(i));
    let opacity = |i: usize| 1.0 / (1.0 + (-model.geometry[OPACITY][i]).exp());
    let score = |i: usize| match selection {
        Selection::Gradient | Selection::AbsoluteGradient | Selection::Error => {
            statistics.gradient[i] / statistics.visible[i]
        }
        // Drawing without replacement in proportion to the weights: the greatest u^(1/w) (Efraimidis and Spirakis 2006).
        Selection::Opacity => {
            rng(i as u32).random_range(1e-6f32..1.0).powf(1.0 / opacity(i).max(1e-6)) + threshold
        }
    };
    let mut candidates: Vec<(f32, u32)> = (0..model.len)
        .filter(|&i| statistics.visible[i] > 0.0)
        .map(|i| (score(i), i as u32))
        .filter(|c| c.0 > threshold)
        .collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    candidates.truncate(room);
    let mut added = Vec::with_capacity(candidates.len());
    for &(_, i) in &candidates {
        let (mut rng, i) = (rng(i), i as usize);
        let other = if selection == Selection::Opacity {
            double(model, i, &mut rng)
        } else {
            split(model, i, &mut rng)
        };
        added.push((other, i));
    }
    model.append(&added);
    prune(model);
}

fn row(model: &Model, i: usize) -> [f32; GEOMETRY] {
    std::array::from_fn(|p| model.geometry[p][i])
}

/// Halves Gaussian `i` along its longest axis: one half stays, the other is returned.
fn split(model: &mut Model, i: usize, rng: &mut scene::rng::Rng) -> [f32; GEOMETRY] {
    let g = |p: usize| model.geometry[p][i];
    let q = orientation(model, i);
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

/// Makes two Gaussians that together look as one did (Kheradmand et al. 2024, equation 9), the second at a place drawn
/// from the first.
fn double(model: &mut Model, i: usize, rng: &mut scene::rng::Rng) -> [f32; GEOMETRY] {
    let old = (1.0 / (1.0 + (-model.geometry[OPACITY][i]).exp())).clamp(1e-4, 0.9999);
    let new = 1.0 - (1.0 - old).sqrt();
    let shrink = (old / (2.0 * new - new * new * std::f32::consts::FRAC_1_SQRT_2)).ln();
    model.geometry[OPACITY][i] = (new / (1.0 - new)).ln();
    let q = orientation(model, i);
    let mut offset = Vec3::ZERO;
    for k in 0..3 {
        model.geometry[LOG_SCALE + k][i] += shrink;
        // Sum of three uniform numbers: nearly normal, variance 1.
        let normal: f32 = (0..3).map(|_| rng.random_range(-1.0f32..1.0)).sum();
        offset[k] = model.geometry[LOG_SCALE + k][i].clamp(-20.0, 20.0).exp() * normal;
    }
    model.reset_moments(i);
    let (mut other, place) = (row(model, i), model.mean(i) + q * offset);
    other[MEAN..MEAN + 3].copy_from_slice(&place.to_array());
    other
}

fn orientation(model: &Model, i: usize) -> Quat {
    let g = |p: usize| model.geometry[p][i];
    let q = Quat::from_xyzw(g(ROTATION + 1), g(ROTATION + 2), g(ROTATION + 3), g(ROTATION));
    if q.length_squared() > 1e-20 { q.normalize() } else { Quat::IDENTITY }
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

/// How many of so many views must have a Gaussian in their picture.
pub fn least_views(views: usize) -> usize {
    LEAST_VIEWS.min(views / 8)
}

/// Removes Gaussians whose centre hardly any view has in its picture; returns how many. No other view contradicts them,
/// so that they settle just before a camera, explain its picture, and hang in the air in pictures from elsewhere.
pub fn prune_unseen(model: &mut Model, views: &[PinholeView]) -> usize {
    let least = least_views(views.len());
    let seen = |i: u32| {
        let x = model.mean(i as usize);
        let has = |v: &&PinholeView| {
            let c = v.rotation * x + v.translation;
            let [px, py] = [v.focal[0] * c.x + v.centre[0] * c.z, v.focal[1] * c.y + v.centre[1] * c.z];
            c.z > 0.0 && px >= 0.0 && py >= 0.0 && px < v.width as f32 * c.z && py < v.height as f32 * c.z
        };
        views.iter().filter(has).take(least).count() >= least
    };
    let keep: Vec<u32> = (0..model.len as u32).into_par_iter().filter(|&i| seen(i)).collect();
    let removed = model.len - keep.len();
    if removed > 0 && !keep.is_empty() {
        model.select(&keep);
        return removed;
    }
    0
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
