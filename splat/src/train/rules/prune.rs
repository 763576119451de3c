//! Near the end Gaussians go that the pictures do not miss.
//!
//! A picture is linear in each α, so that without Gaussian i a pixel changes by exactly `ΔC = −α_i
//! dC/dα_i`. The energy `Σ_pixels |ΔC|²` costs nothing new: where dL/dC is a random sign r for each
//! pixel and channel, `o dL/do = Σ r · α dC/dα` has the mean 0 and the variance `Σ |α dC/dα|²`
//! (Hutchinson 1990). One backward pass a view gives one draw for every Gaussian; the draws of the
//! views add up.

use crate::backend::Backend;
use crate::error::SplatError;
use crate::model::{Model, OPACITY};
use crate::statistics::Statistics;
use crate::train::context::RuleContext;
use crate::view::{PinholeView, RenderOptions};
use rand::Rng as _;
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use serde::{Deserialize, Serialize};

/// When redundant Gaussians are looked for, by what, and how closely.
struct PruneSearch {
    /// Position in the schedule at which Gaussians are removed; what follows lets the others close
    /// the gaps. Source: chosen by hand, never measured.
    at: f64,
    /// What removing them may cost the training views before that, dB.
    /// Source: chosen by hand: rows of docs/benchmarks.md below 0.2 dB are alike.
    loss: f64,
    /// Steps of a schedule with a time limit that must be left, which the search costs half of.
    /// Source: a search costs as much as thirty steps.
    least_steps_left: f64,
    /// Training views whose pictures judge the removal. Source: chosen by hand, never measured.
    judges: usize,
    /// Training views from which the energies are estimated: all of an ordinary capture. What only
    /// the others see would go without a trace. Source: docs/decisions/13.
    witnesses: usize,
    /// Pictures above this many pixels are halved for the energies: they only order the Gaussians.
    /// Source: chosen by hand, never measured.
    pixels: usize,
    /// Alpha is limited to 0.99, where its gradient vanishes; energies are taken at opacities
    /// below. Source: `reference::rasterise::MAX_ALPHA` less a hundredth.
    most_opaque: f32,
    /// At least one in this many Gaussians stays. Source: chosen by hand, never measured.
    least_kept: usize,
    /// The number that goes is found to one in this many Gaussians: six trials. Source: chosen by
    /// hand, never measured.
    resolution: usize,
}

/// The values in force.
const SEARCH: PruneSearch = PruneSearch {
    at: 0.9,
    loss: 0.05,
    least_steps_left: 60.0,
    judges: 8,
    witnesses: 100,
    pixels: 60_000,
    most_opaque: 0.98,
    least_kept: 4,
    resolution: 64,
};

/// Opacity (logit) of what is not drawn. Source: 1e-13, far below the least alpha that is drawn,
/// 1/255.
const HIDDEN: f32 = -30.0;

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PruneRule {
    /// Whether redundant Gaussians were looked for.
    pub(crate) done: bool,
}

impl PruneRule {
    /// Removes redundant Gaussians, once.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let left = step.expected_steps() - f64::from(step.state.place.iteration);
        let short = step.setup.config.time_limit.is_some() && left < SEARCH.least_steps_left;
        if self.done || step.position() < SEARCH.at || short {
            return Ok(());
        }
        self.done = true;
        prune_redundant(step)
    }
}

/// Removes as many of the Gaussians that the pictures miss least as may go at a loss of
/// [`PruneSearch::loss`].
fn prune_redundant(step: &mut RuleContext) -> Result<(), SplatError> {
    let judges = step.setup.some_views(SEARCH.judges);
    let before = step.psnr(&judges, 0, None)?;
    let (mut opacities, mut aside, mut seen) = (Vec::new(), Model::default(), Statistics::default());
    // Gradients may cost the moments.
    step.backend.edit(&mut |model, statistics| {
        opacities = model.geometry[OPACITY][..model.len].to_vec();
        aside = model.fresh_moments();
        model.swap_moments(&mut aside);
        seen = std::mem::take(statistics);
    })?;
    let n = opacities.len();
    let order = by_energy(step, &opacities)?;
    // The loss grows with what is removed: bisection. What is tried is hidden where it is: a copy
    // of the model would be the peak of a run's memory.
    let (mut good, mut bad) = (n, n / SEARCH.least_kept);
    while good > bad + n / SEARCH.resolution + 1 {
        let middle = (good + bad) / 2;
        let mut tried = opacities.clone();
        order[middle..].iter().for_each(|&i| tried[i as usize] = HIDDEN);
        set_opacities(step.backend, &tried)?;
        let loss = before - step.psnr(&judges, 0, None)?;
        if loss <= SEARCH.loss { good = middle } else { bad = middle }
    }
    step.backend.edit(&mut |model, statistics| {
        model.geometry[OPACITY][..n].copy_from_slice(&opacities);
        model.swap_moments(&mut aside);
        *statistics = std::mem::take(&mut seen);
        if model.keep(&first_sorted(&order, good)) > 0 {
            statistics.reset(good);
        }
    })?;
    let after = step.psnr(&judges, 0, None)?;
    let decision = Decision::new(Subject::RedundantGaussians, Choice::share(n - good, n), Rule::Evidence)
        .with(Measurement::count(Quantity::TrainingViews, judges.len()))
        .measured(Quantity::PsnrBefore, before)
        .measured(Quantity::PsnrAfter, after);
    step.state.decisions.push(decision);
    Ok(())
}

/// Gives the Gaussians of the backend's model these opacities (logits).
fn set_opacities(backend: &mut dyn Backend, logits: &[f32]) -> Result<(), SplatError> {
    backend.edit(&mut |model, _| model.geometry[OPACITY][..logits.len()].copy_from_slice(logits))
}

/// The Gaussians, whose opacities are `opacities` (logits), by falling energy.
fn by_energy(step: &mut RuleContext, opacities: &[f32]) -> Result<Vec<u32>, SplatError> {
    let (setup, witnesses) = (step.setup, step.setup.some_views(SEARCH.witnesses));
    let views = witnesses.iter().map(|&v| setup.dataset.views[v].view);
    let views: Vec<PinholeView> =
        views.map(|view| view.at_level(u32::from(view.width * view.height > SEARCH.pixels))).collect();
    let options = step.options();
    let energies = energies(step.backend, opacities, &views, options, setup.config.seed)?;
    let mut order: Vec<u32> = (0..opacities.len() as u32).collect();
    order.sort_by(|&a, &b| energies[b as usize].total_cmp(&energies[a as usize]).then(a.cmp(&b)));
    Ok(order)
}

/// The first of an order, ascending.
fn first_sorted(order: &[u32], count: usize) -> Vec<u32> {
    let mut kept = order[..count].to_vec();
    kept.sort_unstable();
    kept
}

/// For each Gaussian the energy `Σ |ΔC|²` that the pictures of the views would lose without it,
/// estimated by one draw a view (relative deviation √(2 / views)). Leaves the opacities limited.
fn energies(
    backend: &mut dyn Backend,
    opacities: &[f32],
    views: &[PinholeView],
    options: RenderOptions,
    seed: u64,
) -> Result<Vec<f32>, SplatError> {
    let limit = (SEARCH.most_opaque / (1.0 - SEARCH.most_opaque)).ln();
    let limited: Vec<f32> = opacities.iter().map(|logit| logit.min(limit)).collect();
    // o dL/do = dL/dlogit / (1 − o)
    let slopes: Vec<f32> = limited.iter().map(|l| 1.0 / (1.0 + l.exp())).collect();
    set_opacities(backend, &limited)?;
    let mut energies = vec![0.0f32; opacities.len()];
    for (index, view) in views.iter().enumerate() {
        let mut rng = scene::rng::rng(seed, "energies", index as u64);
        let values = view.width * view.height * 3;
        let signs: Vec<f32> = (0..values).map(|_| if rng.random::<bool>() { 1.0 } else { -1.0 }).collect();
        let found = backend.opacity_gradients(view, &options, &signs)?;
        for ((e, g), slope) in energies.iter_mut().zip(&found).zip(&slopes) {
            *e += (g / slope).powi(2);
        }
    }
    Ok(energies)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuBackend;
    use glam::{Mat3, Quat, Vec3};
    use scene::Gaussians;

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
            parts: crate::parts::PartPlaces::NONE,
        };
        // The same view again and again: the mean of the draws is the energy itself.
        const DRAWS: usize = 400;
        let mut backend = CpuBackend::default();
        let opacities = model.geometry[OPACITY][..n].to_vec();
        backend.upload(model, Statistics::default()).unwrap();
        let views = vec![view; DRAWS];
        let estimated = energies(&mut backend, &opacities, &views, RenderOptions::default(), 1).unwrap();
        let mut picture = |left_out: Option<usize>| {
            let mut kept = opacities.clone();
            left_out.into_iter().for_each(|i| kept[i] = HIDDEN);
            set_opacities(&mut backend, &kept).unwrap();
            backend.render(&view, &RenderOptions::default()).unwrap().rgb.data
        };
        let whole = picture(None);
        for (i, &energy) in estimated.iter().enumerate() {
            let exact: f32 = picture(Some(i)).iter().zip(&whole).map(|(a, b)| (a - b).powi(2)).sum();
            let found = energy / DRAWS as f32;
            assert!((found / exact - 1.0).abs() < 0.3, "gaussian {i}: {found} for {exact}");
        }
    }
}
