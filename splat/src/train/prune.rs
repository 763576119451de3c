//! Which Gaussians the pictures do not miss.
//!
//! A picture is linear in each α, so that without Gaussian i a pixel changes by exactly `ΔC = −α_i dC/dα_i`. The energy
//! `Σ_pixels |ΔC|²` costs nothing new: where dL/dC is a random sign r for each pixel and channel, `o dL/do = Σ r · α dC/dα`
//! has the mean 0 and the variance `Σ |α dC/dα|²` (Hutchinson 1990). One backward pass a view gives one draw for every
//! Gaussian; the draws of the views add up.

use super::Trainer;
use crate::backend::Backend;
use crate::cpu::CpuBackend;
use crate::model::{Model, OPACITY};
use crate::statistics::Statistics;
use crate::{PinholeView, RenderOptions, SplatError};
use rand::Rng as _;

/// Training views whose pictures judge the removal.
const JUDGES: usize = 8;
/// Training views from which the energies are estimated: all of an ordinary capture. What only the others see would go
/// without a trace.
const WITNESSES: usize = 100;
/// Pictures above this many pixels are halved for the energies: they only order the Gaussians.
const PIXELS: usize = 60_000;
/// Alpha is limited to 0.99, where its gradient vanishes; energies are taken at opacities below.
const MOST_OPAQUE: f32 = 0.98;

/// `count` of the views, evenly: the middle one of each share.
fn some(views: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(views.len());
    (0..count).map(|k| views[(2 * k + 1) * views.len() / (2 * count)]).collect()
}

/// For each Gaussian the energy `Σ |ΔC|²` that the pictures of the views would lose without it, estimated by one draw a
/// view (relative deviation √(2 / views)).
fn energies(
    whole: &Model,
    views: &[PinholeView],
    antialias: bool,
    seed: u64,
) -> Result<Vec<f32>, SplatError> {
    let limit = (MOST_OPAQUE / (1.0 - MOST_OPAQUE)).ln();
    let all: Vec<u32> = (0..whole.len as u32).collect();
    let mut model = whole.drawn(&all);
    model.geometry[OPACITY].iter_mut().for_each(|logit| *logit = logit.min(limit));
    // o dL/do = dL/dlogit / (1 − o)
    let slopes: Vec<f32> = model.geometry[OPACITY].iter().map(|l| 1.0 / (1.0 + l.exp())).collect();
    let mut backend = CpuBackend::default();
    backend.upload(model, Statistics::default())?;
    let mut energies = vec![0.0f32; whole.len];
    let options = RenderOptions { antialias, ..RenderOptions::default() };
    for (index, view) in views.iter().enumerate() {
        let mut rng = scene::rng::rng(seed, "energies", index as u64);
        let mut sign = || if rng.random::<bool>() { 1.0 } else { -1.0 };
        let signs: Vec<f32> = (0..view.width * view.height * 3).map(|_| sign()).collect();
        let found = backend.gradients(view, &options, &signs);
        for ((e, g), slope) in energies.iter_mut().zip(&found.geometry[OPACITY]).zip(&slopes) {
            *e += (g / slope).powi(2);
        }
    }
    Ok(energies)
}

impl Trainer<'_> {
    /// Removes as many of the Gaussians that the pictures miss least as may go at a loss of `Recipe::prune_loss`.
    pub(super) fn prune_redundant(&mut self) -> Result<(), SplatError> {
        let judges = some(&self.views, JUDGES);
        let before = self.psnr(&judges, 0, None)?;
        let (whole, mut statistics) = self.backend.release()?;
        let witnesses: Vec<PinholeView> = some(&self.views, WITNESSES)
            .iter()
            .map(|&v| self.dataset.views[v].view)
            .map(|view| view.at_level(u32::from(view.width * view.height > PIXELS)))
            .collect();
        let energies = energies(&whole, &witnesses, self.config.antialias, self.config.seed)?;
        let mut order: Vec<u32> = (0..whole.len as u32).collect();
        order.sort_by(|&a, &b| energies[b as usize].total_cmp(&energies[a as usize]).then(a.cmp(&b)));
        let keep = |count: usize| {
            let mut kept = order[..count].to_vec();
            kept.sort_unstable();
            kept
        };
        // The loss grows with what is removed: bisection.
        let (mut good, mut bad) = (whole.len, whole.len / 4);
        while good > bad + whole.len / 64 + 1 {
            let middle = (good + bad) / 2;
            self.backend.upload(whole.drawn(&keep(middle)), Statistics::default())?;
            let loss = before - self.psnr(&judges, 0, None)?;
            if loss <= self.config.recipe.prune_loss { good = middle } else { bad = middle }
        }
        let kept = keep(good);
        let (n, mut model) = (whole.len, whole);
        if good < n {
            model.select(&kept);
            statistics.reset(good);
        }
        self.backend.upload(model, statistics)?;
        let after = self.psnr(&judges, 0, None)?;
        self.note(
            "redundant Gaussians",
            format!("{} of {n} removed", n - good),
            format!(
                "{} training views: {before:.2} dB before, {after:.2} dB after, then trained on",
                judges.len()
            ),
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat3, Quat, Vec3};
    use scene::Gaussians;

    #[test]
    fn all_views_bear_witness_up_to_their_number_and_are_spread_beyond() {
        let views: Vec<usize> = (0..41).map(|k| 3 * k).collect();
        assert_eq!(some(&views, WITNESSES), views);
        assert_eq!(some(&views, 4), [15, 45, 75, 105]);
        assert!(some(&[], 4).is_empty());
    }

    #[test]
    fn energies_are_what_the_picture_loses_without_the_gaussian() {
        let mut rng = scene::rng::rng(2, "blobs", 0);
        let n = 12;
        let mut unit = || Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0f32..1.0)));
        let means: Vec<Vec3> = (0..n).map(|_| unit() * 0.4).collect();
        let model = Model::from_gaussians(&Gaussians {
            log_scales: vec![Vec3::splat(-2.0); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: (0..n).map(|i| [-2.0, 0.0, 3.0][i % 3]).collect(),
            sh: (0..n).flat_map(|_| unit().to_array()).collect(),
            sh_degree: 0,
            means,
        });
        let view = PinholeView {
            rotation: Mat3::IDENTITY,
            translation: Vec3::Z * 2.0,
            focal: [60.0; 2],
            centre: [24.0, 20.0],
            width: 48,
            height: 40,
        };
        // The same view again and again: the mean of the draws is the energy itself.
        const DRAWS: usize = 400;
        let estimated = energies(&model, &[view; DRAWS], false, 1).unwrap();
        let mut backend = CpuBackend::default();
        let mut picture = |kept: &[u32]| {
            backend.upload(model.drawn(kept), Statistics::default()).unwrap();
            backend.render(&view, &RenderOptions::default()).unwrap().rgb.data
        };
        let all: Vec<u32> = (0..n as u32).collect();
        let whole = picture(&all);
        for (i, &energy) in estimated.iter().enumerate() {
            let others: Vec<u32> = all.iter().copied().filter(|&k| k as usize != i).collect();
            let exact: f32 = picture(&others).iter().zip(&whole).map(|(a, b)| (a - b).powi(2)).sum();
            let found = energy / DRAWS as f32;
            assert!((found / exact - 1.0).abs() < 0.3, "gaussian {i}: {found} for {exact}");
        }
    }
}
