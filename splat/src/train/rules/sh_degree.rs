//! How far colours depend on the direction they are seen from: all degrees of the spherical
//! harmonics are there from the first step, and the highest stay if the validation views are better
//! for it. Where they came in later, the two sides of a thin sheet were learnt as two layers by
//! then, and stayed (docs/decisions/13).

use crate::cpu::sh;
use crate::error::SplatError;
use crate::model::{MAX_SH_DEGREE, Model};
use crate::train::context::RuleContext;
use crate::train::evidence::LEAST_GAIN;
use crate::train::schedule::GROWTH_END;
use glam::Vec3;
use rayon::prelude::*;
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use scene::gaussians::SH_C0;
use scene::sh::SH_COUNT;
use serde::{Deserialize, Serialize};

/// When degrees are judged, and by how many views. Both were chosen by hand and never measured.
struct DegreePlan {
    /// Position in the schedule from which they are judged.
    judged_from: f64,
    /// Training views over whose directions a degree's mean is taken, at most.
    directions: usize,
}

/// See [`DegreePlan`].
const PLAN: DegreePlan = DegreePlan { judged_from: 0.5, directions: 32 };

/// Degrees are judged while there are views to judge them.
const _: () = assert!(PLAN.judged_from < GROWTH_END);

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ShDegreeRule {
    /// Degree above which the validation views gained nothing.
    limit: Option<u32>,
    /// Whether they were judged.
    pub(crate) judged: bool,
}

impl ShDegreeRule {
    /// Raises the degree to the highest one that is wanted.
    pub(super) fn before_step(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let wanted = step.setup.config.sh_degree.min(self.limit.unwrap_or(MAX_SH_DEGREE));
        if step.backend.sh_degree() < wanted { step.backend.set_sh_degree(wanted) } else { Ok(()) }
    }

    /// From the highest down to the first by which the validation views are better, degrees go.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let mut degree = step.backend.sh_degree();
        let is_time = (PLAN.judged_from..GROWTH_END).contains(&step.position());
        if self.judged || !is_time || degree == 0 || step.setup.validation.is_empty() {
            return Ok(());
        }
        self.judged = true;
        let (setup, level) = (step.setup, step.level());
        loop {
            let lower = degree - 1;
            let with = step.psnr(&setup.validation, level, Some(degree))?;
            let without = psnr_without(step, level, lower)?;
            let pays = with - without >= LEAST_GAIN;
            if !pays {
                self.limit = Some(lower);
                let cameras = some_cameras(step);
                step.backend.edit(&mut |model, _| {
                    fold_degree(model, degree, &cameras);
                    model.set_sh_degree(lower);
                })?;
            }
            if pays || lower == 0 {
                let [kept, other] = if pays { [degree, lower] } else { [lower, degree] };
                let [kept, other] = [kept, other].map(degree_choice);
                let (of_kept, of_other) = if pays { (with, without) } else { (without, with) };
                let decision = Decision::new(Subject::ShDegree, kept.clone(), Rule::Evidence)
                    .with(Measurement::count(Quantity::ValidationViews, setup.validation.len()))
                    .compared(kept, true, vec![Measurement::new(Quantity::Psnr, of_kept)])
                    .compared(other, false, vec![Measurement::new(Quantity::Psnr, of_other)]);
                step.state.decisions.push(decision);
                return Ok(());
            }
            degree = lower;
        }
    }
}

fn degree_choice(degree: u32) -> Choice {
    Measurement::new(Quantity::ShDegree, f64::from(degree)).into()
}

/// Where some of the training views were taken from.
fn some_cameras(step: &RuleContext) -> Vec<Vec3> {
    let setup = step.setup;
    let every = setup.views.len().div_ceil(PLAN.directions);
    let some = setup.views.iter().step_by(every);
    some.map(|&v| setup.dataset.views[v].view.position()).collect()
}

/// PSNR of the validation views with degrees up to `degree` alone. A degree that is in use carries
/// a part of the constant colour, so that leaving it out says too much for it: its mean over the
/// training views' directions takes the place of what it says.
fn psnr_without(step: &mut RuleContext, level: u32, degree: u32) -> Result<f64, SplatError> {
    let setup = step.setup;
    let cameras = some_cameras(step);
    let mut before = Vec::new();
    step.backend.edit(&mut |model, _| before = fold_degree(model, degree + 1, &cameras))?;
    let psnr = step.psnr(&setup.validation, level, Some(degree));
    step.backend.edit(&mut |model, _| {
        let stride = model.sh_stride();
        for (sh, constant) in model.sh.chunks_exact_mut(stride).zip(&before) {
            sh[..3].copy_from_slice(constant);
        }
    })?;
    psnr
}

/// Adds to the constant colour the mean of one degree's part over the directions from `cameras`;
/// returns the constants as they were.
fn fold_degree(model: &mut Model, degree: u32, cameras: &[Vec3]) -> Vec<[f32; 3]> {
    let stride = model.sh_stride();
    let means: Vec<Vec3> = (0..model.len).map(|i| model.mean(i)).collect();
    let all = model.sh.par_chunks_exact_mut(stride).zip(&means);
    all.map(|(sh, mean)| {
        let before = [sh[0], sh[1], sh[2]];
        let sum = sum_of_degree(sh, *mean, degree, cameras);
        let share = 1.0 / (SH_C0 * cameras.len().max(1) as f32);
        sh.iter_mut().zip(sum).for_each(|(v, s)| *v += s * share);
        before
    })
    .collect()
}

/// Sum over the cameras of one degree's part of the colour of a Gaussian at `mean`.
fn sum_of_degree(sh: &[f32], mean: Vec3, degree: u32, cameras: &[Vec3]) -> [f32; 3] {
    let band = (degree * degree) as usize..((degree + 1) * (degree + 1)) as usize;
    let mut sum = [0.0f32; 3];
    for camera in cameras {
        let mut basis = [0.0; SH_COUNT];
        sh::basis((mean - *camera).normalize_or_zero(), degree, &mut basis);
        for (k, y) in band.clone().zip(&basis[band.clone()]) {
            sum.iter_mut().zip(&sh[3 * k..]).for_each(|(s, v)| *s += y * v);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;
    use scene::Gaussians;

    #[test]
    fn the_constant_colour_takes_a_degrees_mean_over_the_directions() {
        let mut model = Model::from_gaussians(&Gaussians {
            means: vec![Vec3::ZERO],
            log_scales: vec![Vec3::ZERO],
            rotations: vec![Quat::IDENTITY],
            opacity_logits: vec![0.0],
            sh: vec![0.2, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, -0.5, 0.0],
            sh_degree: 1,
        });
        let colour = |model: &Model, eye: Vec3, degree: u32| {
            let mut basis = [0.0; SH_COUNT];
            sh::basis(-eye.normalize(), degree, &mut basis);
            crate::cpu::project::colour(&model.sh, &basis, degree)
        };
        let cameras = [Vec3::new(2.0, 0.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(3.0, 0.1, 1.0)];
        let mean: Vec<f32> =
            (0..3).map(|c| cameras.iter().map(|e| colour(&model, *e, 1)[c]).sum::<f32>() / 3.0).collect();
        assert_ne!(colour(&model, cameras[0], 0)[0], mean[0]);
        let before = fold_degree(&mut model, 1, &cameras);
        assert_eq!(before, vec![[0.2, 0.3, 0.4]]);
        for (c, mean) in mean.iter().enumerate() {
            assert!((colour(&model, cameras[0], 0)[c] - mean).abs() < 1e-6);
        }
    }
}
