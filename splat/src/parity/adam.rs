//! Kernel adam by itself: Adam on each Gaussian's own clock.

use super::scenes::{One, of, ordinary, view};
use super::steps::{Goal, RATES, parameter, reference_step};
use super::subject::subjects;
use crate::RenderOptions;
use crate::model::{MEAN, Model};
use crate::reference::Parameters;
use crate::reference::adam::Moments;
use crate::reference::constants::BETAS;
use glam::Vec3;
use rand::Rng;
use scene::Gaussians;

/// Gaussians in plain sight, and after them as many that no pixel shows: behind the camera, or
/// transparent.
fn seen_and_unseen(n: usize) -> Gaussians {
    let mut rng = scene::rng::rng(1, "seen and unseen", 0);
    let mut real = |low: f32, high: f32| rng.random_range(low..high);
    let mut all = Vec::new();
    for _ in 0..n {
        let mean = Vec3::new(real(-0.7, 0.7), real(-0.5, 0.5), real(-0.5, 0.5));
        let log_scale = Vec3::new(real(-4.0, -1.5), real(-4.0, -1.5), real(-4.0, -1.5));
        all.push(One { mean, log_scale, logit: real(-2.5, 1.0), ..One::default() });
    }
    for k in 0..n {
        let behind = One { mean: Vec3::new(0.1, 0.0, -4.0), ..One::default() };
        all.push(if k % 2 == 0 { behind } else { One { logit: -9.0, ..One::default() } });
    }
    of(&all)
}

#[test]
fn what_no_pixel_shows_keeps_its_parameters_moments_and_clock() {
    const N: usize = 30;
    let (g, v, o) = (seen_and_unseen(N), view(48, 40), RenderOptions::default());
    let goal = Goal::of(&ordinary(9, 30, 0), &v, &o);
    for mut subject in subjects() {
        let before = Model::from_gaussians(&g);
        let mut model = before.clone();
        let out = subject.step(&mut model, &goal.input(&v, o, RATES));
        assert_eq!((out.visible, out.non_finite), (N, 0), "{}", subject.name());
        for i in 0..2 * N {
            let moved = model.mean(i) != before.mean(i);
            assert_eq!(
                (moved, model.steps[i]),
                (i < N, f32::from(u8::from(i < N))),
                "{} {i}",
                subject.name()
            );
            let has_moment = model.geometry_m[MEAN][i] != 0.0;
            assert_eq!(has_moment, i < N, "{} {i}", subject.name());
        }
    }
}

/// The model that has the reference's parameters, moments and clocks.
fn model_of(g: &Gaussians, moments: &Moments) -> Model {
    let mut model = Model::from_gaussians(g);
    for i in 0..g.len() {
        for k in 0..11 {
            let (m, v) = (parameter(&moments.m, i, k).0 as f32, parameter(&moments.v, i, k).0 as f32);
            (model.geometry_m[k][i], model.geometry_v[k][i]) = (m, v);
        }
        for (c, plane) in model.sh_v.iter_mut().enumerate() {
            plane[i] = parameter(&moments.v, i, 11 + c).0 as f32;
        }
        model.steps[i] = moments.clock[i] as f32;
    }
    model
}

/// Clocks from none to long past the bias correction, each with moments such as gradients of a size
/// have left.
fn aged(g: &Gaussians, seed: u64) -> Moments {
    let p = Parameters::from_gaussians(g);
    let mut moments = Moments::new(&p);
    let mut rng = scene::rng::rng(seed, "aged moments", 0);
    let mut real = |low: f64, high: f64| f64::from(rng.random_range(low as f32..high as f32));
    for i in 0..g.len() {
        let clock = [0, 1, 2, 7, 60, 900, 30_000][i % 7];
        moments.clock[i] = clock;
        let grown = |beta: f64| 1.0 - beta.powi(clock as i32);
        let mut one = |m: &mut f64, v: &mut f64| {
            let size = 10f64.powf(real(-5.0, -2.0));
            *m = f64::from((real(-1.0, 1.0) * size * grown(BETAS[0])) as f32);
            *v = f64::from((real(1.0, 3.0) * size * size * grown(BETAS[1])) as f32);
        };
        let Moments { m, v, .. } = &mut moments;
        for k in 0..3 {
            one(&mut m.means[i][k], &mut v.means[i][k]);
            one(&mut m.log_scales[i][k], &mut v.log_scales[i][k]);
        }
        let (qm, qv) = (&mut m.rotations[i], &mut v.rotations[i]);
        one(&mut qm.w, &mut qv.w);
        one(&mut qm.x, &mut qv.x);
        one(&mut qm.y, &mut qv.y);
        one(&mut qm.z, &mut qv.z);
        one(&mut m.opacity_logits[i], &mut v.opacity_logits[i]);
        let stride = m.sh_stride();
        for c in i * stride..i * stride + 3 {
            // Colours have no first moments.
            one(&mut 0.0, &mut v.sh[c]);
        }
    }
    moments
}

/// Which parameter's second moment sizes the steps of parameter k: its own, or that of its
/// channel's constant harmonic.
fn sized_by(k: usize) -> usize {
    if k < 11 { k } else { 11 + (k - 11) % 3 }
}

/// Value, first (of colours 0) and second moment of parameter k of Gaussian i.
fn held(model: &Model, i: usize, k: usize) -> [f32; 3] {
    if k < 11 {
        return [&model.geometry, &model.geometry_m, &model.geometry_v].map(|planes| planes[k][i]);
    }
    let at = i * model.sh_stride() + k - 11;
    [model.sh[at], 0.0, model.sh_v[sized_by(k) - 11][i]]
}

/// A first step has the size of the rate whatever the gradient, and one of 1e-9 may turn its sign;
/// all others are compared.
#[test]
fn a_step_on_any_clock_is_the_references_and_nothing_of_the_unseen_moves() {
    for mut subject in subjects() {
        for seed in 0..4 {
            let g = ordinary(seed, 140, (seed % 4) as u32);
            let (mut v, o) = (view(40, 34), RenderOptions::default());
            // Half of them lie beside the picture.
            v.translation.x += 1.0;
            let goal = Goal::of(&ordinary(seed + 900, 80, 0), &v, &o);
            let (mut p, mut moments) = (Parameters::from_gaussians(&g), aged(&g, seed));
            let mut model = model_of(&g, &moments);
            let (before, clocks) = (model.clone(), moments.clock.clone());
            let input = goal.input(&v, o, RATES);
            reference_step(&mut p, &mut moments, &input);
            subject.step(&mut model, &input);
            let unseen = (0..g.len()).filter(|&i| moments.clock[i] == clocks[i]).count();
            assert!(unseen > 40 && unseen < 100, "{unseen}");
            for (i, k) in (0..g.len()).flat_map(|i| (0..11 + p.sh_stride()).map(move |k| (i, k))) {
                let at = format!("{} seed {seed} gaussian {i} parameter {k}", subject.name());
                assert_eq!(model.steps[i], moments.clock[i] as f32, "{at}");
                let (old, new) = (held(&before, i, k), held(&model, i, k));
                if moments.clock[i] == clocks[i] {
                    assert_eq!(new, old, "{at}: nothing has seen it");
                    continue;
                }
                let (value, rate) = parameter(&p, i, k);
                let (m, v) = (parameter(&moments.m, i, k).0, parameter(&moments.v, i, sized_by(k)).0);
                let rounding = 1e-6 * value.abs();
                if clocks[i] == 0 {
                    // A harmonic of degree 3 is at most √7 times the constant one.
                    let largest = if k < 14 { 1.001 } else { 2.65 };
                    assert!(
                        (new[0] - old[0]).abs() <= largest * rate + rounding as f32,
                        "{at}: {old:?} {new:?}"
                    );
                    continue;
                }
                let [f, fm, fv] = new.map(f64::from);
                let good = (f - value).abs() < 2e-2 * f64::from(rate) + rounding
                    && (fm - m).abs() < 1e-2 * v.sqrt()
                    && (fv - v).abs() < 1e-2 * v;
                assert!(good, "{at}: {new:?} should be {value:e} {m:e} {v:e}, clock {}", clocks[i]);
            }
        }
    }
}

/// Views of the left, of the right and of both in turns: the clocks count apart, and a first look
/// moves a Gaussian by the whole rate, however late it comes.
#[test]
fn gaussians_seen_now_and_then_are_moved_by_their_own_clocks() {
    let (o, g) = (RenderOptions::default(), ordinary(40, 90, 0));
    let beside = |x: f32| {
        let mut v = view(40, 34);
        v.translation.x += x;
        v
    };
    let views = [beside(1.1), beside(-1.1), beside(0.0)];
    let goals = views.map(|v| Goal::of(&ordinary(41, 60, 0), &v, &o));
    for mut subject in subjects() {
        let (mut p, mut model) = (Parameters::from_gaussians(&g), Model::from_gaussians(&g));
        let (mut moments, mut late) = (Moments::new(&p), 0);
        for (step, which) in [0, 0, 0, 0, 1, 0, 2, 1, 1, 0, 2, 0].into_iter().enumerate() {
            let input = goals[which].input(&views[which], o, RATES);
            let before = model.clone();
            reference_step(&mut p, &mut moments, &input);
            subject.step(&mut model, &input);
            let at = format!("{} step {step}", subject.name());
            let differ = (0..g.len()).filter(|&i| model.steps[i] != moments.clock[i] as f32).count();
            assert!(differ <= 1, "{at}: {differ} clocks differ");
            for i in 0..g.len() {
                let moved = (model.geometry[MEAN][i] - before.geometry[MEAN][i]).abs();
                let (was, is) = (before.steps[i], model.steps[i]);
                assert!(
                    is == was + 1.0 || (is == was && moved == 0.0),
                    "{at} gaussian {i}: {was} {is} {moved}"
                );
                let first = step > 3 && was == 0.0 && is == 1.0;
                late += usize::from(first && (moved / RATES.mean - 1.0).abs() < 1e-2);
            }
        }
        assert!(late > 10, "{}: {late}", subject.name());
        let seen =
            |least: u32, most: u32| moments.clock.iter().filter(|c| (least..=most).contains(c)).count();
        assert!(seen(1, 5) > 10 && seen(6, 9) > 10, "{:?}", moments.clock);
        let value = |i: usize, k: usize| if k < 11 { model.geometry[k][i] } else { model.sh[i * 3 + k - 11] };
        let astray = (0..g.len()).flat_map(|i| (0..14).map(move |k| (i, k))).filter(|&(i, k)| {
            let (expected, rate) = parameter(&p, i, k);
            (f64::from(value(i, k)) - expected).abs() > 0.1 * f64::from(rate) + 1e-6 * expected.abs()
        });
        let astray = astray.count();
        assert!(astray * 50 < g.len() * 14, "{}: {astray} of {} parameters", subject.name(), g.len() * 14);
    }
}
