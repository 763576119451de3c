//! How far colours depend on the direction they are seen from.

use super::Trainer;
use crate::SplatError;
use crate::cpu::sh;
use crate::model::Model;
use crate::schedule::{self, SH_FROM};
use glam::Vec3;
use rayon::prelude::*;
use scene::gaussians::SH_C0;

/// Part of the schedule between a degree's beginning and its judgement.
const DEGREE_TRIAL: f64 = 0.1;
/// What a degree must gain, dB: it costs time in every step and memory for ever.
const DEGREE_GAIN: f64 = 0.02;
/// Training views over whose directions a degree's mean is taken, at most.
const DIRECTIONS: usize = 32;

impl Trainer<'_> {
    /// A degree that was in use for a while stays if the validation views are better for it.
    pub(super) fn judge_degree(&mut self) -> Result<(), SplatError> {
        let judged = self.state.findings.degrees_judged;
        let Some(from) = SH_FROM.get(judged as usize).filter(|_| judged < self.config.sh_degree) else {
            return Ok(());
        };
        if self.state.findings.sh_limit.is_some() || self.state.position < from + DEGREE_TRIAL {
            return Ok(());
        }
        let (views, level, degree) = (self.validation.clone(), self.level(), judged + 1);
        let with = self.psnr(&views, level, Some(degree))?;
        let without = self.psnr_without(&views, level, judged)?;
        self.state.findings.degrees_judged = degree;
        let evidence = format!(
            "{} validation views: {with:.2} dB with degree {degree}, {without:.2} dB without, its mean over the views' directions in the constant term",
            views.len()
        );
        if with - without < DEGREE_GAIN {
            self.state.findings.sh_limit = Some(judged);
            self.backend.set_sh_degree(judged)?;
            self.note("spherical-harmonic degree", judged.to_string(), evidence);
        } else if degree == self.config.sh_degree {
            self.note("spherical-harmonic degree", degree.to_string(), evidence);
        }
        Ok(())
    }

    /// PSNR of views with degrees up to `degree` alone. A degree that is in use carries a part of the constant colour, so that
    /// leaving it out says too much for it: its mean over the training views' directions takes the place of what it says.
    fn psnr_without(&mut self, views: &[usize], level: u32, degree: u32) -> Result<f64, SplatError> {
        let every = self.views.len().div_ceil(DIRECTIONS);
        let cameras: Vec<Vec3> =
            self.views.iter().step_by(every).map(|&v| self.dataset.views[v].view.position()).collect();
        let mut before = Vec::new();
        self.backend.edit(&mut |model, _| before = fold_degree(model, degree + 1, &cameras))?;
        let psnr = self.psnr(views, level, Some(degree));
        self.backend.edit(&mut |model, _| {
            let stride = model.sh_stride();
            for (sh, constant) in model.sh.chunks_exact_mut(stride).zip(&before) {
                sh[..3].copy_from_slice(constant);
            }
        })?;
        psnr
    }
}

/// Adds to the constant colour the mean of one degree's part over the directions from `cameras`; returns the constants as they were.
fn fold_degree(model: &mut Model, degree: u32, cameras: &[Vec3]) -> Vec<[f32; 3]> {
    let (stride, band) =
        (model.sh_stride(), (degree * degree) as usize..((degree + 1) * (degree + 1)) as usize);
    let means: Vec<Vec3> = (0..model.len).map(|i| model.mean(i)).collect();
    let fold = |(sh, mean): (&mut [f32], &Vec3)| {
        let before = [sh[0], sh[1], sh[2]];
        let mut sum = [0.0f32; 3];
        for camera in cameras {
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            sh::basis((*mean - *camera).normalize_or_zero(), degree, &mut basis);
            for (k, y) in band.clone().zip(&basis[band.clone()]) {
                sum.iter_mut().zip(&sh[3 * k..]).for_each(|(s, v)| *s += y * v);
            }
        }
        let share = 1.0 / (SH_C0 * cameras.len().max(1) as f32);
        sh.iter_mut().zip(sum).for_each(|(v, s)| *v += s * share);
        before
    };
    model.sh.par_chunks_exact_mut(stride).zip(&means).map(fold).collect()
}

/// The schedule's constants fit together: degrees are judged while there are views to judge them.
const _: () = assert!(SH_FROM[2] + DEGREE_TRIAL < 0.7 && schedule::SH_FROM.len() == 3);

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
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
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
