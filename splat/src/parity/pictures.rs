//! Whole pictures and whole gradients.

use super::scenes::{ordinary, reference_options, reference_view, rendered, undecided, view};
use super::subject::{Subject, subjects};
use crate::cpu::ModelGradient;
use crate::reference::rasterise::ImageGradient;
use crate::reference::{Parameters, backward};
use crate::{PinholeView, RenderOptions};
use glam::DVec3;
use rand::Rng;
use scene::Gaussians;

/// Compares a picture where no cut-off is at stake; at most a twentieth of the pixels may be left
/// out.
pub(crate) fn compare_picture(
    subject: &mut dyn Subject,
    g: &Gaussians,
    v: &PinholeView,
    o: &RenderOptions,
    what: &str,
) {
    let truth = rendered(g, v, o);
    let skip = undecided(&truth, v);
    assert!(
        skip.iter().filter(|&&s| s).count() * 20 <= skip.len().max(400),
        "{what}: too many pixels at cut-offs"
    );
    let out = subject.render(g, v, o);
    for i in (0..skip.len()).filter(|&i| !skip[i]) {
        let at = format!("{} {what} pixel {},{}", subject.name(), i % v.width, i / v.width);
        for c in 0..3 {
            let (found, expected) = (out.rgb.data[i * 3 + c], truth.picture.rgb[i][c]);
            assert!(
                (f64::from(found) - expected).abs() < 2e-4 * (1.0 + expected),
                "{at}: {found} should be {expected}"
            );
        }
        let (found, expected) = (out.alpha.data[i], truth.picture.alpha[i]);
        assert!((f64::from(found) - expected).abs() < 1e-4, "{at}: alpha {found} should be {expected}");
        let (found, expected) = (out.depth.data[i], truth.picture.depth[i]);
        assert!(
            (f64::from(found) - expected).abs() < 1e-3 * (1.0 + expected),
            "{at}: depth {found} should be {expected}"
        );
    }
}

/// The reference's gradient of L = Σ w · colour in the layout of a backend: 11 planes, then SH.
pub(crate) fn reference_gradient(
    g: &Gaussians,
    v: &PinholeView,
    o: &RenderOptions,
    d: &[f32],
) -> (Vec<Vec<f64>>, Vec<f64>) {
    let (p, rv, ro) = (Parameters::from_gaussians(g), reference_view(v), reference_options(o));
    let r = crate::reference::render(&p, &rv, &ro);
    let d = d.chunks(3).map(|c| DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]))).collect();
    let truth = backward(&p, &rv, &ro, &r, &ImageGradient::of_colour(d)).parameters;
    let plane = |k: usize| -> Vec<f64> {
        let of = |i: usize| match k {
            0..3 => truth.means[i][k],
            3..6 => truth.log_scales[i][k - 3],
            6 => truth.rotations[i].w,
            7 => truth.rotations[i].x,
            8 => truth.rotations[i].y,
            9 => truth.rotations[i].z,
            _ => truth.opacity_logits[i],
        };
        (0..p.len()).map(of).collect()
    };
    ((0..11).map(plane).collect(), truth.sh)
}

const PLANES: [&str; 11] =
    ["mean x", "mean y", "mean z", "scale x", "scale y", "scale z", "q w", "q x", "q y", "q z", "opacity"];

/// Relative to the value, with a floor of `floor` times the largest of its kind and of a few
/// roundings of f32: a gradient that vanishes (the rotation of a sphere) is a difference of terms
/// of the others' size.
pub(crate) fn compare_gradient(
    found: &ModelGradient,
    truth: &(Vec<Vec<f64>>, Vec<f64>),
    relative: f64,
    floor: f64,
    what: &str,
) {
    let groups = [0..3, 3..6, 6..10, 10..11];
    // Kinds whose gradient vanishes (rotations of spheres) are compared with the scale of the
    // others.
    let overall = truth.0.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    let rounding = 4.0 * f64::from(f32::EPSILON) * overall;
    let largest = |values: &mut dyn Iterator<Item = &f64>| values.fold(0.0f64, |m, v| m.max(v.abs()));
    for group in groups {
        let largest = largest(&mut truth.0[group.clone()].iter().flatten()).max(1e-4 * overall);
        for k in group {
            for (i, &expected) in truth.0[k].iter().enumerate() {
                let value = f64::from(found.geometry[k][i]);
                let good = (value - expected).abs() <= relative * expected.abs() + floor * largest + rounding;
                assert!(
                    good,
                    "{what}: {} of gaussian {i} is {value:e}, should be {expected:e} (largest {largest:e})",
                    PLANES[k]
                );
            }
        }
    }
    let largest = largest(&mut truth.1.iter());
    for (i, (&value, &expected)) in found.sh.iter().zip(&truth.1).enumerate() {
        let good = (f64::from(value) - expected).abs() <= relative * expected.abs() + floor * largest;
        assert!(good, "{what}: sh {i} is {value:e}, should be {expected:e}");
    }
}

/// Random dL/d(colour), zero where a cut-off is at stake.
pub(crate) fn weights(seed: u64, skip: &[bool]) -> Vec<f32> {
    let mut rng = scene::rng::rng(seed, "parity weights", 0);
    skip.iter()
        .flat_map(|&s| [(); 3].map(|()| if s { 0.0 } else { rng.random_range(-1.0f32..1.0) }))
        .collect()
}

#[test]
fn pictures_agree_for_every_degree_with_and_without_antialiasing() {
    for mut subject in subjects() {
        for seed in 0..8 {
            let (n, degree) = ([1, 10, 60, 200, 400, 200, 100, 50][seed as usize], (seed % 4) as u32);
            let g = ordinary(seed, n, degree);
            let [w, h] = [[40, 30], [64, 48], [75, 58], [33, 70], [80, 60], [17, 16], [7, 5], [128, 20]]
                [seed as usize];
            for antialias in [false, true] {
                let o = RenderOptions { antialias, background: [0.1, 0.6, 1.0], ..RenderOptions::default() };
                compare_picture(subject.as_mut(), &g, &view(w, h), &o, &format!("seed {seed}"));
            }
        }
    }
}

#[test]
fn gradients_agree_for_every_degree_with_and_without_antialiasing() {
    for mut subject in subjects() {
        for seed in 0..8 {
            let g = ordinary(seed + 50, 120, (seed % 4) as u32);
            let v = view(45, 38);
            for antialias in [false, true] {
                let o = RenderOptions { antialias, background: [0.1, 0.6, 1.0], ..RenderOptions::default() };
                let d = weights(seed, &undecided(&rendered(&g, &v, &o), &v));
                let found = subject.gradients(&g, &v, &o, &d);
                let truth = reference_gradient(&g, &v, &o, &d);
                let what = format!("{} seed {seed} antialias {antialias}", subject.name());
                compare_gradient(&found, &truth, 2e-3, 2e-4, &what);
            }
        }
    }
}

#[test]
fn a_lower_degree_in_use_and_another_near_plane_agree_too() {
    for mut subject in subjects() {
        let g = ordinary(3, 150, 3);
        let o = RenderOptions { sh_degree: Some(1), near: Some(1.9), ..RenderOptions::default() };
        compare_picture(subject.as_mut(), &g, &view(50, 40), &o, "degree 1");
        let d = weights(1, &undecided(&rendered(&g, &view(50, 40), &o), &view(50, 40)));
        let truth = reference_gradient(&g, &view(50, 40), &o, &d);
        compare_gradient(&subject.gradients(&g, &view(50, 40), &o, &d), &truth, 2e-3, 2e-4, &subject.name());
    }
}
