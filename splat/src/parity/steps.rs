//! Whole training steps.

use super::scenes::{ordinary, reference_options, reference_view, rendered, view};
use super::subject::subjects;
use crate::backend::{LearningRates, StepInput, Target};
use crate::model::Model;
use crate::reference::adam::{self, Moments, Rates};
use crate::reference::loss::{ReferenceLoss, loss, over_background};
use crate::reference::rasterise::ImageGradient;
use crate::reference::{Parameters, backward, render};
use crate::{PinholeView, RenderOptions};
use glam::DVec3;
use rand::Rng;
use scene::Gaussians;

pub(crate) const RATES: LearningRates =
    LearningRates { mean: 2e-3, log_scale: 1e-2, rotation: 2e-3, opacity: 5e-2, sh0: 5e-3, sh_rest: 5e-4 };

/// 8-bit pixels and a mask.
pub(crate) struct Goal {
    pub(crate) rgb: Vec<u8>,
    pub(crate) mask: Option<Vec<u8>>,
    pub(crate) transparent: bool,
}

impl Goal {
    /// A picture of other Gaussians.
    pub(crate) fn of(g: &Gaussians, v: &PinholeView, o: &RenderOptions) -> Self {
        let picture = rendered(g, v, o).picture;
        let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        Self {
            rgb: picture.rgb.iter().flat_map(|c| c.to_array().map(byte)).collect(),
            mask: None,
            transparent: false,
        }
    }

    pub(crate) fn input<'a>(
        &'a self,
        view: &'a PinholeView,
        options: RenderOptions,
        rates: LearningRates,
    ) -> StepInput<'a> {
        StepInput {
            view,
            target: Target {
                rgb: &self.rgb,
                mask: self.mask.as_deref(),
                transparent: self.transparent,
                photo: None,
            },
            options,
            rates,
            lambda_dssim: 0.2,
        }
    }
}

/// One step as the reference takes it.
pub(crate) fn reference_step(p: &mut Parameters, moments: &mut Moments, input: &StepInput) -> ReferenceLoss {
    let (v, o) = (reference_view(input.view), reference_options(&input.options));
    let r = render(p, &v, &o);
    let byte = |v: u8| f64::from(v) / 255.0;
    let mask: Option<Vec<f64>> = input.target.mask.map(|m| m.iter().map(|&v| byte(v)).collect());
    let goal = |(i, c): (usize, &[u8])| {
        let c = DVec3::new(byte(c[0]), byte(c[1]), byte(c[2]));
        match &mask {
            Some(m) if input.target.transparent => over_background(c, m[i], o.background),
            _ => c,
        }
    };
    let target: Vec<DVec3> = input.target.rgb.chunks(3).enumerate().map(goal).collect();
    let weights = if input.target.transparent { None } else { mask.as_deref() };
    let l = loss(&r.picture.rgb, &target, weights, v.width, f64::from(input.lambda_dssim));
    let g = backward(p, &v, &o, &r, &ImageGradient::of_colour(l.gradient.clone()));
    let rate = |v: f32| f64::from(v);
    let rates = Rates {
        mean: rate(input.rates.mean),
        log_scale: rate(input.rates.log_scale),
        rotation: rate(input.rates.rotation),
        opacity: rate(input.rates.opacity),
        sh0: rate(input.rates.sh0),
        sh_rest: rate(input.rates.sh_rest),
    };
    adam::step(p, moments, &g, &rates);
    l
}

/// Value k of Gaussian i in the order of [`Model`], and its rate: 11 of geometry, then SH.
pub(crate) fn parameter(p: &Parameters, i: usize, k: usize) -> (f64, f32) {
    match k {
        0..3 => (p.means[i][k], RATES.mean),
        3..6 => (p.log_scales[i][k - 3], RATES.log_scale),
        6 => (p.rotations[i].w, RATES.rotation),
        7 => (p.rotations[i].x, RATES.rotation),
        8 => (p.rotations[i].y, RATES.rotation),
        9 => (p.rotations[i].z, RATES.rotation),
        10 => (p.opacity_logits[i], RATES.opacity),
        _ => (p.sh_of(i)[k - 11], if k < 14 { RATES.sh0 } else { RATES.sh_rest }),
    }
}

#[test]
fn whole_steps_move_every_parameter_as_the_reference_does() {
    for mut subject in subjects() {
        for (seed, mode) in (0..6).map(|s| (s, s % 3)) {
            let (start, other) = (ordinary(seed, 80, (seed % 4) as u32), ordinary(seed + 900, 80, 0));
            let v = view(40, 34);
            let o = RenderOptions { background: [0.3, 0.2, 0.8], ..RenderOptions::default() };
            let mut goal = Goal::of(&other, &v, &o);
            if mode > 0 {
                let mut rng = scene::rng::rng(seed, "parity mask", 0);
                goal.mask =
                    Some((0..40 * 34).map(|_| if rng.random::<bool>() { rng.random() } else { 0 }).collect());
                goal.transparent = mode == 2;
            }
            let (mut p, mut model) = (Parameters::from_gaussians(&start), Model::from_gaussians(&start));
            let mut moments = Moments::new(&p);
            let input = goal.input(&v, o, RATES);
            for step in 1..=3 {
                let (truth, out) =
                    (reference_step(&mut p, &mut moments, &input), subject.step(&mut model, &input));
                let at = format!("{} seed {seed} mask {mode} step {step}", subject.name());
                assert!(
                    (f64::from(out.loss) - truth.loss).abs() < 1e-4 * truth.loss + 1e-6,
                    "{at}: {} {}",
                    out.loss,
                    truth.loss
                );
                assert_eq!(out.non_finite, 0, "{at}");
                let (mut total, mut astray) = (0, 0);
                let stride = p.sh_stride();
                for (i, k) in (0..p.len()).flat_map(|i| (0..11 + stride).map(move |k| (i, k))) {
                    let found = if k < 11 { model.geometry[k][i] } else { model.sh[i * stride + k - 11] };
                    let (expected, rate) = parameter(&p, i, k);
                    let error = (f64::from(found) - expected).abs();
                    total += 1;
                    // The first steps have the size of the rate whatever the gradient: one of 1e-9
                    // may turn sign.
                    astray += usize::from(error > 0.03 * f64::from(rate) + 1e-6 * expected.abs());
                    assert!(
                        error < 2.1 * f64::from(step) * f64::from(rate),
                        "{at} gaussian {i} {k}: {found} {expected}"
                    );
                }
                assert!(astray * 100 < total, "{at}: {astray} of {total} parameters moved differently");
                let clocks =
                    moments.clock.iter().zip(&model.steps).filter(|(a, b)| **a as f32 != **b).count();
                assert!(clocks <= 1, "{at}: {clocks} clocks differ");
            }
        }
    }
}

#[test]
fn two_hundred_steps_end_where_the_references_do() {
    for mut subject in subjects() {
        let (start, other) = (ordinary(21, 60, 1), ordinary(22, 60, 0));
        let v = view(40, 30);
        let o = RenderOptions::default();
        let goal = Goal::of(&other, &v, &o);
        let input = goal.input(&v, o, RATES);
        let (mut p, mut model) = (Parameters::from_gaussians(&start), Model::from_gaussians(&start));
        let mut moments = Moments::new(&p);
        let mut ends = [0.0; 2];
        let mut first = 0.0;
        for step in 0..200 {
            let truth = reference_step(&mut p, &mut moments, &input);
            ends = [truth.mse, f64::from(subject.step(&mut model, &input).mse)];
            if step == 0 {
                first = truth.mse;
            }
        }
        let db = |mse: f64| -10.0 * mse.log10();
        assert!(db(ends[0]) > db(first) + 5.0, "it learns: {} to {} dB", db(first), db(ends[0]));
        assert!(
            (db(ends[0]) - db(ends[1])).abs() < 0.1,
            "{}: {} and {} dB",
            subject.name(),
            db(ends[0]),
            db(ends[1])
        );
    }
}

#[test]
fn the_same_steps_give_the_same_bytes_on_one_and_two_threads() {
    let run = |threads: usize, which: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut subject = subjects().swap_remove(which);
            let mut model = Model::from_gaussians(&ordinary(31, 1500, 2));
            let v = view(90, 70);
            let goal = Goal::of(&ordinary(32, 50, 0), &v, &RenderOptions::default());
            for _ in 0..5 {
                subject.step(&mut model, &goal.input(&v, RenderOptions::default(), RATES));
            }
            model
        })
    };
    for which in 0..subjects().len() {
        assert_eq!(run(1, which), run(2, which), "{}", subjects()[which].name());
    }
}
