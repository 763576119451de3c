//! What training decides by evidence: the spherical-harmonic degree and the number of Gaussians by a validation split
//! of the training views (never the views held out for evaluation), and which Gaussians the pictures do not miss.

use super::poses::PoseFindings;
use super::{Decision, Trainer};
use crate::backend::Target;
use crate::{RenderOptions, SplatError};
use serde::{Deserialize, Serialize};

/// One training view in this many judges while Gaussians and degrees are added, and is trained on afterwards.
const VALIDATION_EVERY: usize = 12;
/// With fewer training views than this all are needed: temple_ring (41) and fox (43) lose by sparing some.
pub const VALIDATION_FROM: usize = 60;
/// Looks at the growth of the number of Gaussians, evenly over the densification.
const LOOKS: f64 = 8.0;
/// What the validation views must gain from look to look, dB, for growth to go on.
const GROWTH_GAIN: f64 = 0.02;
/// Looks in a row without such a gain after which growth ends.
const PATIENCE: u32 = 2;

/// Steps of a schedule with a time limit from which on it pays to look for anything.
const LEAST_STEPS: f64 = 300.0;
/// Steps that must be left of it when redundant Gaussians are looked for, which costs as much as thirty steps.
const LEAST_STEPS_LEFT: f64 = 60.0;

/// Part of the schedule after which scales are held to what the views sample, again and again.
const SMOOTH_EVERY: f64 = 0.05;

/// What was found out on the way.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Findings {
    /// Degree above which the validation views gained nothing.
    pub sh_limit: Option<u32>,
    /// Degrees judged so far.
    pub degrees_judged: u32,
    /// Number of Gaussians at which growth stopped paying.
    pub gaussians_limit: Option<usize>,
    /// Looks at the growth so far.
    pub looks: u32,
    /// What the last look saw: PSNR (dB), Gaussians.
    pub last_look: Option<(f64, usize)>,
    /// The best look at the present resolution: level, PSNR (dB), Gaussians.
    pub best_look: Option<(u32, f64, usize)>,
    /// Looks since then.
    pub idle_looks: u32,
    /// Gaussians removed because hardly any view has them in its picture.
    pub unseen: usize,
    /// Gaussians removed because the mattes show background at their place.
    #[serde(default)]
    pub outside: usize,
    /// Whether that was looked for after growth.
    #[serde(default)]
    pub hull_applied: bool,
    /// Looks for gains so far.
    pub exposure_looks: u32,
    /// Gains of the training views that the first look found, until the second has judged them.
    #[serde(default)]
    pub suspected: Vec<[f32; 3]>,
    /// Gains of the training views, where exposure is modelled.
    pub gains: Vec<[f32; 3]>,
    /// Whether redundant Gaussians were looked for.
    pub pruned: bool,
    /// Gradients that were not finite: their Gaussians took no step.
    #[serde(default)]
    pub non_finite: usize,
    /// Of the poses of the training views.
    #[serde(default)]
    pub pose: PoseFindings,
    /// Times that scales were held to what the views sample.
    #[serde(default)]
    pub smoothed: u32,
}

/// The training views that judge: none where all are needed.
pub fn validation(views: &[usize]) -> Vec<usize> {
    if views.len() < VALIDATION_FROM {
        return Vec::new();
    }
    views.iter().skip(VALIDATION_EVERY / 2).step_by(VALIDATION_EVERY).copied().collect()
}

impl Trainer<'_> {
    /// Looks whether something is to be decided at this place of the schedule. Nothing is where the steps that a time
    /// limit leaves are too few to pay for it, and nothing at the schedule's end.
    pub(super) fn decide(&mut self) -> Result<(), SplatError> {
        let steps = self.state.pace.steps(&self.state, self.config);
        let limited = self.config.time_limit.is_some();
        self.prune_outside()?;
        self.smooth()?;
        if self.state.position >= 1.0 || (limited && steps < LEAST_STEPS) {
            return Ok(());
        }
        if !self.validation.is_empty() && self.state.position < self.config.recipe.densify_until {
            self.judge_degree()?;
            self.judge_growth()?;
        }
        if self.config.recipe.exposure {
            self.judge_exposure()?;
        }
        self.judge_poses()?;
        if self.config.recipe.prune_redundant
            && !self.state.findings.pruned
            && self.state.position >= self.config.recipe.prune_at
            && (!limited || steps - f64::from(self.state.iteration) >= LEAST_STEPS_LEFT)
        {
            self.state.findings.pruned = true;
            self.prune_redundant()?;
        }
        Ok(())
    }

    /// Once growth has ended: removes what the mattes exclude. By the host, so not in every round.
    fn prune_outside(&mut self) -> Result<(), SplatError> {
        let due = self.state.position >= self.config.recipe.densify_until;
        let Some(hull) = self.hull.as_ref().filter(|_| due && !self.state.findings.hull_applied) else {
            return Ok(());
        };
        let mut outside = 0;
        self.backend.edit(&mut |model, statistics| {
            outside = hull.prune(model);
            statistics.reset(model.len);
        })?;
        self.state.findings.outside += outside;
        self.state.findings.hull_applied = true;
        Ok(())
    }

    /// At its places in the schedule: no Gaussian is finer than what the views sample.
    fn smooth(&mut self) -> Result<(), SplatError> {
        let due = f64::from(self.state.findings.smoothed + 1) * SMOOTH_EVERY;
        if !self.config.smoothing || self.state.position < due.min(1.0) {
            return Ok(());
        }
        self.state.findings.smoothed = (self.state.position / SMOOTH_EVERY) as u32;
        let views: Vec<_> = self.views.iter().map(|&v| self.camera(v)).collect();
        self.backend.edit(&mut |model, _| {
            crate::smoothing::raise_scales(model, &views);
        })
    }

    pub(super) fn note(&mut self, subject: &str, choice: String, evidence: String) {
        self.state.decisions.push(Decision { subject: subject.to_owned(), choice, evidence });
    }

    /// PSNR of views at a level with spherical harmonics up to a degree, dB.
    pub(super) fn psnr(
        &mut self,
        views: &[usize],
        level: u32,
        sh_degree: Option<u32>,
    ) -> Result<f64, SplatError> {
        let mut sum = 0.0;
        for &v in views {
            let view = &self.dataset.views[v];
            let level = level.min(view.levels.len() as u32 - 1);
            let pixels = &view.levels[level as usize];
            let target = Target {
                rgb: &pixels.rgb,
                mask: pixels.mask.as_deref(),
                transparent: self.dataset.is_transparent(),
                photo: Some(v as u32),
            };
            let options =
                RenderOptions { antialias: self.config.antialias, sh_degree, ..RenderOptions::default() };
            self.backend.set_gain(self.gain(v));
            let camera = self.camera(v).at_level(level);
            sum += self.backend.mean_square_error(&camera, &target, &options)?;
        }
        Ok(-10.0 * (sum / views.len().max(1) as f64).max(1e-12).log10())
    }

    /// Growth ends where the validation views stop gaining by it.
    fn judge_growth(&mut self) -> Result<(), SplatError> {
        let step = self.config.recipe.densify_until / LOOKS;
        if self.state.findings.gaussians_limit.is_some()
            || self.state.position < step * f64::from(self.state.findings.looks + 1)
        {
            return Ok(());
        }
        let (views, level, now) = (self.validation.clone(), self.level(), self.backend.gaussians());
        let psnr = self.psnr(&views, level, None)?;
        self.state.findings.looks += 1;
        // Validation of a moving target is noisy: growth ends when two looks in a row are no better than the best.
        let best = match self.state.findings.best_look {
            Some(best) if best.0 == level => best,
            _ => (level, f64::NEG_INFINITY, now),
        };
        if psnr >= best.1 + GROWTH_GAIN {
            self.state.findings.best_look = Some((level, psnr, now));
            self.state.findings.idle_looks = 0;
        } else {
            self.state.findings.idle_looks += 1;
        }
        if self.state.findings.idle_looks >= PATIENCE && now > best.2 {
            self.state.findings.gaussians_limit = Some(now);
            let evidence = format!(
                "validation views had {:.2} dB with {} Gaussians and have {psnr:.2} dB with {now}",
                best.1, best.2
            );
            self.note("number of Gaussians", format!("growth ended at {now}"), evidence);
        }
        self.state.findings.last_look = Some((psnr, now));
        Ok(())
    }

    /// All decisions, with what is only known at the end, when there are `n` Gaussians and poses that were refined show them
    /// `apart` pixels from where those as given do.
    pub(super) fn decisions(&mut self, n: usize, apart: Option<f64>) -> Vec<Decision> {
        let findings = self.state.findings.clone();
        if let (None, Some((psnr, then))) = (findings.gaussians_limit, findings.last_look) {
            let evidence =
                format!("validation views did not stop gaining ({psnr:.2} dB with {then} Gaussians)");
            self.note("number of Gaussians", format!("{n}, as planned"), evidence);
        }
        if findings.unseen > 0 {
            let evidence =
                "hardly any view has them in its picture, so that none contradicts them".to_owned();
            self.note("Gaussians in the air", format!("{} removed", findings.unseen), evidence);
        }
        if findings.outside > 0 {
            let evidence =
                "more than 2 and more than a twentieth of the training views that have their centre in the \
                            picture show background there"
                    .to_owned();
            self.note("Gaussians outside the silhouettes", format!("{} removed", findings.outside), evidence);
        }
        if let Some(pixels) = apart {
            let evidence = format!(
                "they show the scene {pixels:.2} px (root mean square) from where the poses as given do, in whose frame the splat lies"
            );
            self.note("refined poses", "training views only".to_owned(), evidence);
        }
        if findings.non_finite > 0 {
            let choice = format!("{} left out", findings.non_finite);
            let evidence = "they were not finite; each Gaussian stayed as it was in that step".to_owned();
            self.note("gradients", choice, evidence);
        }
        let (steps, seconds) = (f64::from(self.state.iteration), self.state.seconds);
        let full = steps > 0.95 * self.most_steps();
        if let Some(limit) = self.config.time_limit.filter(|limit| full && seconds < 0.95 * limit) {
            let choice = format!("ended after {seconds:.0} of {limit:.0} s");
            let passes = steps / self.views.len() as f64;
            let evidence = format!(
                "{steps} steps, {passes:.0} for each training view: more would learn the photos by heart"
            );
            self.note("training time", choice, evidence);
        }
        if let Some(evidence) = super::watch::stuck(&self.state.curve) {
            self.note("convergence", "none".to_owned(), evidence);
        }
        self.state.decisions.extend(self.backend.remarks());
        std::mem::take(&mut self.state.decisions)
    }
}
