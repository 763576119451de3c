//! What no scene should hold and every scene may: results stay finite and, where f32 can hold them,
//! right.

use super::pictures::{compare_gradient, reference_gradient, weights};
use super::scenes::{One, of, ordinary, rendered, undecided, view};
use super::steps::Goal;
use super::subject::subjects;
use crate::backend::LearningRates;
use crate::model::Model;
use crate::train::schedule;
use crate::{RenderOptions, TrainConfig};
use glam::{Quat, Vec3};
use scene::Gaussians;

const TILT: Quat = Quat::from_xyzw(0.3, -0.5, 0.2, 0.7);

/// Cases in which the reference's picture and gradient can be followed in f32.
fn tame() -> Vec<(&'static str, Gaussians)> {
    let one = One::default();
    let ln = |s: [f32; 3]| Vec3::from_array(s.map(f32::ln));
    let scale = |s: [f32; 3]| One { log_scale: ln(s), rotation: TILT, ..one };
    let logit = |logit: f32| One { logit, ..one };
    let turned = |q: [f32; 4]| One { rotation: Quat::from_array(q), log_scale: ln([0.3, 0.1, 0.02]), ..one };
    let behind = One { mean: Vec3::new(0.3, 0.1, 0.4), sh0: Vec3::new(-1.0, 0.8, 0.1), ..one };
    vec![
        ("scale 1e-8", of(&[scale([1e-8; 3]), behind])),
        ("a needle of 1e6", of(&[scale([2e-7, 2e-7, 0.2]), behind])),
        ("a pancake of 1e6", of(&[scale([0.2, 0.2, 2e-7]), behind])),
        ("opacity 0", of(&[logit(-100.0), behind])),
        ("opacity 1", of(&[logit(100.0), behind])),
        ("opacity infinite", of(&[logit(f32::INFINITY), behind, logit(f32::NEG_INFINITY)])),
        ("a quaternion of zero norm", of(&[turned([0.0; 4]), behind])),
        (
            "quaternions tiny and huge",
            of(&[turned([1e-9, 2e-9, -1e-9, 3e-9]), behind, turned([1e9, 2e9, -1e9, 3e9])]),
        ),
        ("behind the camera", of(&[One { mean: Vec3::new(0.0, 0.0, -5.0), ..one }, behind])),
        ("on the camera", of(&[One { mean: camera_position(), ..one }, behind])),
        ("far outside the picture", of(&[One { mean: Vec3::new(1e4, 1e4, 1.0), ..one }, behind])),
        (
            "1e6 units away",
            of(&[One { mean: Vec3::new(0.0, 0.0, 1e6), log_scale: Vec3::splat(11.0), ..one }, behind]),
        ),
        ("NaN and infinity", of(&[broken(0), behind, broken(1), broken(2), broken(3), broken(4)])),
        ("no Gaussian", of(&[])),
    ]
}

/// Why f32 does not have the reference's picture or gradient of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lost {
    /// The determinant of its covariance on the screen, px⁴, is beyond 1e30: it is not drawn.
    Range,
    /// A needle longer on the screen than some thousand times its width there: it is drawn as it
    /// should, but its gradient, a difference of products, keeps no digit in f32.
    Cancelled,
}

/// Cases at the end of what f32 can hold, and the Gaussians for which it cannot. What is left must
/// be right; of all is asked that it is finite.
fn wild() -> Vec<(&'static str, Gaussians, Vec<(usize, Lost)>)> {
    use Lost::{Cancelled, Range};
    let one = One::default();
    let scale = |s: [f32; 3]| One { log_scale: Vec3::from_array(s.map(f32::ln)), rotation: TILT, ..one };
    let near =
        |dz: f32| One { mean: camera_position() + Vec3::Z * (crate::camera::DEFAULT_NEAR + dz), ..one };
    vec![
        ("scale 1e8", of(&[scale([1e8; 3]), one]), vec![(0, Range)]),
        (
            "scale 1e8 and 1e-8",
            of(&[scale([1e8, 1e-8, 1.0]), scale([1e8, 1e-8, 1e-8]), scale([1e8, 1e8, 1e-8]), one]),
            vec![(0, Cancelled), (1, Cancelled), (2, Range)],
        ),
        (
            "needles of 1e6",
            of(&[scale([1e-3, 1e-3, 1e3]), scale([1e6, 1.0, 1.0]), one]),
            vec![(0, Cancelled), (1, Cancelled)],
        ),
        ("pancakes of 1e6", of(&[scale([1e3, 1e3, 1e-3]), scale([1.0, 1e6, 1e6]), one]), Vec::new()),
        ("on the near plane", of(&[near(0.0), near(1e-6), near(-1e-6), one]), Vec::new()),
        (
            "log-scales 1e30",
            of(&[One { log_scale: Vec3::new(1e30, -1e30, 0.0), ..one }, one]),
            vec![(0, Cancelled)],
        ),
        ("colours 1e6", of(&[One { sh0: Vec3::new(1e6, -1e6, 3e6), ..one }, one]), Vec::new()),
        ("positions 1e30", of(&[One { mean: Vec3::new(1e30, -1e30, 1e30), ..one }, one]), Vec::new()),
    ]
}

/// Those that are not in the list.
fn without(g: &Gaussians, gone: &[usize]) -> Gaussians {
    let kept: Vec<usize> = (0..g.len()).filter(|i| !gone.contains(i)).collect();
    Gaussians {
        means: kept.iter().map(|&i| g.means[i]).collect(),
        log_scales: kept.iter().map(|&i| g.log_scales[i]).collect(),
        rotations: kept.iter().map(|&i| g.rotations[i]).collect(),
        opacity_logits: kept.iter().map(|&i| g.opacity_logits[i]).collect(),
        sh: kept.iter().flat_map(|&i| g.sh[3 * i..3 * i + 3].to_vec()).collect(),
        sh_degree: g.sh_degree,
    }
}

fn camera_position() -> Vec3 {
    view(32, 24).position()
}

fn broken(kind: usize) -> One {
    let one = One::default();
    match kind {
        0 => One { mean: Vec3::new(f32::NAN, 0.0, 0.0), ..one },
        1 => One { log_scale: Vec3::new(0.0, f32::NAN, 0.0), ..one },
        2 => One { rotation: Quat::from_xyzw(0.0, f32::NAN, 0.0, 1.0), ..one },
        3 => One { logit: f32::NAN, ..one },
        _ => One { mean: Vec3::new(0.0, f32::INFINITY, 0.0), ..one },
    }
}

fn finite(values: &[f32]) -> bool {
    values.iter().all(|v| v.is_finite())
}

#[test]
fn extreme_gaussians_are_drawn_as_the_reference_draws_them() {
    for mut subject in subjects() {
        for (what, g) in tame() {
            for antialias in [false, true] {
                let v = view(32, 24);
                let o = RenderOptions { antialias, background: [0.2, 0.4, 0.6], ..RenderOptions::default() };
                super::pictures::compare_picture(
                    subject.as_mut(),
                    &g,
                    &v,
                    &o,
                    &format!("{what}, antialias {antialias}"),
                );
            }
        }
    }
}

#[test]
fn extreme_gaussians_have_the_references_gradients() {
    for mut subject in subjects() {
        for (what, g) in tame() {
            let v = view(32, 24);
            let o = RenderOptions { background: [0.2, 0.4, 0.6], ..RenderOptions::default() };
            let d = weights(5, &undecided(&rendered(&g, &v, &o), &v));
            let found = subject.gradients(&g, &v, &o, &d);
            let at = format!("{} {what}", subject.name());
            assert!(found.geometry.iter().all(|p| finite(p)) && finite(&found.sh), "{at}");
            compare_gradient(&found, &reference_gradient(&g, &v, &o, &d), 1e-2, 1e-3, &at);
        }
    }
}

/// The tolerances are those of the cases above. Gaussians beyond the range stay in the scene that
/// is drawn: there the picture is the reference's without them.
#[test]
fn what_f32_can_hold_of_wild_scenes_has_the_references_picture_and_gradient() {
    for mut subject in subjects() {
        for (what, g, lost) in wild() {
            let of =
                |kind: Lost| -> Vec<usize> { lost.iter().filter(|l| l.1 == kind).map(|l| l.0).collect() };
            for antialias in [false, true] {
                let v = view(32, 24);
                let o = RenderOptions { antialias, background: [0.2, 0.4, 0.6], ..RenderOptions::default() };
                let at = format!("{} {what}, antialias {antialias}", subject.name());
                let all: Vec<usize> = lost.iter().map(|l| l.0).collect();
                let (drawn, left) = (without(&g, &of(Lost::Range)), without(&g, &all));
                super::pictures::compare_picture(subject.as_mut(), &drawn, &v, &o, &at);
                assert_eq!(subject.render(&g, &v, &o), subject.render(&drawn, &v, &o), "{at}");
                let d = weights(5, &undecided(&rendered(&left, &v, &o), &v));
                let found = subject.gradients(&left, &v, &o, &d);
                compare_gradient(&found, &reference_gradient(&left, &v, &o, &d), 1e-2, 1e-3, &at);
            }
        }
    }
}

#[test]
fn what_no_number_can_hold_still_gives_finite_pictures_gradients_and_steps() {
    for mut subject in subjects() {
        let wild = wild().into_iter().map(|(what, g, _)| (what, g));
        for (what, g) in wild.chain(tame()) {
            for antialias in [false, true] {
                let v = view(32, 24);
                let o = RenderOptions { antialias, ..RenderOptions::default() };
                let at = format!("{} {what}, antialias {antialias}", subject.name());
                let out = subject.render(&g, &v, &o);
                assert!(finite(&out.alpha.data) && finite(&out.depth.data), "{at}");
                assert!(finite(&out.rgb.data), "{at}");
                let found = subject.gradients(&g, &v, &o, &vec![1.0; 32 * 24 * 3]);
                assert!(found.geometry.iter().all(|p| finite(p)) && finite(&found.sh), "{at}");
                let mut model = Model::from_gaussians(&g);
                let goal = Goal { rgb: vec![255; 32 * 24 * 3], mask: None, transparent: false };
                let before = model.clone();
                for _ in 0..3 {
                    let out = subject.step(&mut model, &goal.input(&v, o, rates(1.0)));
                    assert!(out.loss.is_finite() && out.mse.is_finite(), "{at}");
                }
                for (now, then) in model.geometry.iter().flatten().zip(before.geometry.iter().flatten()) {
                    assert!(now.is_finite() || !then.is_finite(), "{at}: {then} became {now}");
                }
                assert!(finite(&model.sh), "{at}");
            }
        }
    }
}

#[test]
// Mesa leaves a shader's loops after 65,535 rounds (LP_MAX_TGSI_LOOP_ITERATIONS).
fn forty_thousand_gaussians_at_one_point_are_one_picture() {
    let mut all = vec![One { logit: -4.0, ..One::default() }; 40_000];
    all[0].logit = 0.0;
    let (g, v, o) = (of(&all), view(16, 12), RenderOptions::default());
    for mut subject in subjects() {
        super::pictures::compare_picture(subject.as_mut(), &g, &v, &o, "40,000 at a point");
        let d = weights(5, &undecided(&rendered(&g, &v, &o), &v));
        let truth = reference_gradient(&g, &v, &o, &d);
        compare_gradient(&subject.gradients(&g, &v, &o, &d), &truth, 1e-2, 1e-3, &subject.name());
    }
}

fn rates(factor: f32) -> LearningRates {
    LearningRates {
        mean: 1.6e-4 * factor,
        log_scale: 5e-3 * factor,
        rotation: 1e-3 * factor,
        opacity: 0.05 * factor,
        sh0: 2.5e-3 * factor,
        sh_rest: 1.25e-4 * factor,
    }
}

#[test]
fn saturated_and_single_colour_targets_are_learnt_without_a_nan() {
    for mut subject in subjects() {
        for value in [0u8, 255, 128] {
            let (v, o) = (view(32, 24), RenderOptions::default());
            let mut model = Model::from_gaussians(&ordinary(6, 40, 1));
            let goal = Goal { rgb: vec![value; 32 * 24 * 3], mask: None, transparent: false };
            let mut losses = Vec::new();
            for _ in 0..60 {
                losses.push(subject.step(&mut model, &goal.input(&v, o, rates(2.0))).loss);
            }
            assert!(finite(&losses) && losses[59] < losses[0], "{} {value}: {losses:?}", subject.name());
        }
    }
}

#[test]
fn a_view_with_an_empty_mask_changes_nothing() {
    for mut subject in subjects() {
        let (v, o) = (view(32, 24), RenderOptions::default());
        let mut model = Model::from_gaussians(&ordinary(6, 40, 1));
        let before = model.clone();
        let goal = Goal { rgb: vec![255; 32 * 24 * 3], mask: Some(vec![0; 32 * 24]), transparent: false };
        let out = subject.step(&mut model, &goal.input(&v, o, rates(1.0)));
        assert_eq!((out.loss, out.mse), (0.0, 0.0), "{}", subject.name());
        assert_eq!((&model.geometry, &model.sh), (&before.geometry, &before.sh), "{}", subject.name());
    }
}

/// The trainer's own rates at a step of its schedule, ten times as large.
fn ten_times_the_trainers(step: usize, steps: usize) -> LearningRates {
    let config = TrainConfig { learning_rate: 10.0, ..TrainConfig::default() };
    schedule::rates(step as f64 / steps as f64, steps as f64, 2e-3, &config)
}

/// Judged by its end: a run that is thrown off by such rates must find back once they are low.
#[test]
fn ten_thousand_steps_at_ten_times_the_trainers_rates_stay_finite_and_learn() {
    for mut subject in subjects() {
        let (v, o) = (view(16, 12), RenderOptions::default());
        let mut model = Model::from_gaussians(&ordinary(8, 12, 0));
        let goal = Goal::of(&ordinary(9, 12, 0), &v, &o);
        let steps = subject.affordable(10_000);
        let mut losses = Vec::with_capacity(steps);
        for step in 0..steps {
            let rates = ten_times_the_trainers(step, steps);
            let out = subject.step(&mut model, &goal.input(&v, o, rates));
            assert!(out.loss.is_finite() && out.mse.is_finite(), "{} step {step}", subject.name());
            losses.push(out.loss);
        }
        assert!(model.geometry.iter().all(|p| finite(p)) && finite(&model.sh), "{}", subject.name());
        let (first, last) = (losses[0], losses[steps - 20..].iter().copied().fold(0.0, f32::max));
        assert!(last < 0.3 * first, "{}: {first} to {last}", subject.name());
    }
}
