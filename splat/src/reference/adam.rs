//! adam: gradient → step.
//!
//! ```text
//! m ← β1 m + (1 − β1) g        v ← β2 v + (1 − β2) g²
//! p ← p − rate · m̂ / (√v̂ + ε)   m̂ = m / (1 − β1ᵗ)   v̂ = v / (1 − β2ᵗ)
//! ```
//! Kingma & Ba 2015, algorithm 1. Colours, four fifths of the parameters, have no first moment, and
//! of second ones a single one by channel, that of the constant harmonic's gradient g₀ (one for
//! a block of parameters: Zhang et al., Adam-mini, 2025):
//!
//! ```text
//! v ← β2 v + (1 − β2) g₀²
//! p ← p − rate · g / (√v̂ + ε)
//! ```
//! The clock t belongs to a Gaussian and counts only the steps in
//! which it is composited into a pixel; in the others nothing of it changes, so that unseen
//! Gaussians do not drift on old momentum.

use super::constants::{BETAS, EPSILON};
use super::parameters::Parameters;
use super::render::ReferenceGradient;
use glam::DVec3;

/// Step sizes by kind of parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rates {
    /// Means, scene units.
    pub(crate) mean: f64,
    /// Log-scales.
    pub(crate) log_scale: f64,
    /// Quaternions.
    pub(crate) rotation: f64,
    /// Opacity logits.
    pub(crate) opacity: f64,
    /// Spherical harmonics of degree 0.
    pub(crate) sh0: f64,
    /// Higher spherical harmonics.
    pub(crate) sh_rest: f64,
}

/// Mean and mean square of all gradients, and the clocks.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Moments {
    /// Decaying mean of the gradient.
    pub(crate) m: Parameters,
    /// Decaying mean of its square; of colours that of the constant harmonic alone.
    pub(crate) v: Parameters,
    /// \[N\] steps in which the Gaussian was seen.
    pub(crate) clock: Vec<u32>,
}

impl Moments {
    /// All zero.
    pub(crate) fn new(p: &Parameters) -> Self {
        Self { m: Parameters::zeros_like(p), v: Parameters::zeros_like(p), clock: vec![0; p.len()] }
    }
}

/// One parameter's step: the new (p, m, v). `t` counts from 1.
pub(crate) fn adam(p: f64, g: f64, m: f64, v: f64, t: u32, rate: f64) -> (f64, f64, f64) {
    let m = BETAS[0] * m + (1.0 - BETAS[0]) * g;
    let v = BETAS[1] * v + (1.0 - BETAS[1]) * g * g;
    (p - rate * unbiased(m, BETAS[0], t) / (unbiased(v, BETAS[1], t).sqrt() + EPSILON), m, v)
}

/// A moment that began at zero `t` steps ago, as if it had not.
fn unbiased(value: f64, beta: f64, t: u32) -> f64 {
    value / (1.0 - beta.powi(t as i32))
}

/// A step of every Gaussian that was composited into a pixel that counts: where all of its gradient
/// is exactly zero, as of one that is seen only where weights are zero, it stays as it is.
pub(crate) fn step(p: &mut Parameters, moments: &mut Moments, g: &ReferenceGradient, rates: &Rates) {
    let stride = p.sh_stride();
    for i in (0..p.len()).filter(|&i| g.pixels[i] > 0 && !is_zero(&g.parameters, i)) {
        moments.clock[i] += 1;
        let t = moments.clock[i];
        let Moments { m, v, .. } = moments;
        let one = |p: &mut f64, g: f64, m: &mut f64, v: &mut f64, rate: f64| {
            (*p, *m, *v) = adam(*p, g, *m, *v, t, rate)
        };
        let d = &g.parameters;
        for k in 0..3 {
            one(&mut p.means[i][k], d.means[i][k], &mut m.means[i][k], &mut v.means[i][k], rates.mean);
            let (pm, pv) = (&mut m.log_scales[i][k], &mut v.log_scales[i][k]);
            one(&mut p.log_scales[i][k], d.log_scales[i][k], pm, pv, rates.log_scale);
        }
        let (q, dq, qm, qv) = (&mut p.rotations[i], d.rotations[i], &mut m.rotations[i], &mut v.rotations[i]);
        one(&mut q.w, dq.w, &mut qm.w, &mut qv.w, rates.rotation);
        one(&mut q.x, dq.x, &mut qm.x, &mut qv.x, rates.rotation);
        one(&mut q.y, dq.y, &mut qm.y, &mut qv.y, rates.rotation);
        one(&mut q.z, dq.z, &mut qm.z, &mut qv.z, rates.rotation);
        let (om, ov) = (&mut m.opacity_logits[i], &mut v.opacity_logits[i]);
        one(&mut p.opacity_logits[i], d.opacity_logits[i], om, ov, rates.opacity);
        for c in i * stride..i * stride + 3 {
            v.sh[c] = BETAS[1] * v.sh[c] + (1.0 - BETAS[1]) * d.sh[c] * d.sh[c];
            let size = unbiased(v.sh[c], BETAS[1], t).sqrt() + EPSILON;
            for k in (c..(i + 1) * stride).step_by(3) {
                p.sh[k] -= if k == c { rates.sh0 } else { rates.sh_rest } * d.sh[k] / size;
            }
        }
    }
}

/// Whether Gaussian `i` has no gradient at all.
fn is_zero(d: &Parameters, i: usize) -> bool {
    let shape = d.means[i] == DVec3::ZERO && d.log_scales[i] == DVec3::ZERO;
    let turn = d.rotations[i].to_array().iter().all(|v| *v == 0.0);
    shape && turn && d.opacity_logits[i] == 0.0 && d.sh_of(i).iter().all(|v| *v == 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate_whatever_the_gradient() {
        for g in [1e-9, -3.0, 1e9] {
            let (p, _, _) = adam(0.0, g, 0.0, 0.0, 1, 0.01);
            assert!((p + 0.01 * f64::signum(g)).abs() < 1e-7, "{g} {p}");
        }
    }

    #[test]
    fn a_parabola_is_descended_to_its_lowest_point() {
        let (mut p, mut m, mut v) = (3.0, 0.0, 0.0);
        for t in 1..=4000 {
            let rate = 0.1 * 0.998f64.powi(t as i32);
            (p, m, v) = adam(p, 2.0 * (p - 1.0), m, v, t, rate);
        }
        assert!((p - 1.0).abs() < 1e-3, "{p}");
    }

    #[test]
    fn unseen_gaussians_stay_as_they_are() {
        let (mut p, view) = crate::reference::finite_differences::random_scene(3, 30, 1);
        p.opacity_logits[4] = -20.0;
        let options = crate::reference::Options::default();
        let r = crate::reference::render(&p, &view, &options);
        let w = crate::reference::finite_differences::random_loss(3, view.pixels());
        let g = crate::reference::backward(&p, &view, &options, &r, &w);
        let (before, mut moments) = (p.clone(), Moments::new(&p));
        let rates =
            Rates { mean: 1e-3, log_scale: 1e-3, rotation: 1e-3, opacity: 1e-2, sh0: 1e-3, sh_rest: 1e-4 };
        step(&mut p, &mut moments, &g, &rates);
        assert_eq!((p.means[4], p.sh_of(4), moments.clock[4]), (before.means[4], before.sh_of(4), 0));
        let seen = (0..30).filter(|&i| g.pixels[i] > 0).collect::<Vec<_>>();
        assert!(
            seen.len() > 15 && seen.iter().all(|&i| moments.clock[i] == 1 && p.means[i] != before.means[i])
        );
    }
}
