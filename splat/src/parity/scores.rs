//! What densification chooses by, against the reference's sums over pixels.

use super::scenes::{ordinary, reference_options, reference_view, view};
use super::steps::{Goal, RATES};
use glam::{DVec2, DVec3};
use crate::RenderOptions;
use crate::backend::{Backend, Scores};
use crate::cpu::CpuBackend;
use crate::cpu::adam::Statistics;
use crate::cpu::simd::Isa;
use crate::model::Model;
use crate::reference::loss::loss;
use crate::reference::rasterise::rasterise_backward;
use crate::reference::{ImageGradient, Parameters, render};

#[test]
fn scores_are_sums_over_the_pixels_that_a_gaussian_is_drawn_in() {
    let (width, height) = (44, 37);
    let (g, v, o) = (ordinary(5, 90, 1), view(width, height), RenderOptions::default());
    let goal = Goal::of(&ordinary(905, 80, 0), &v, &o);
    let input = goal.input(&v, o, RATES);

    let (p, rv, ro) = (Parameters::from_gaussians(&g), reference_view(&v), reference_options(&o));
    let r = render(&p, &rv, &ro);
    let byte = |k: u8| f64::from(k) / 255.0;
    let target: Vec<DVec3> =
        goal.rgb.chunks(3).map(|c| DVec3::new(byte(c[0]), byte(c[1]), byte(c[2]))).collect();
    let back = |d: Vec<DVec3>| {
        let d = ImageGradient::of_colour(d);
        rasterise_backward(&r.projected, &r.colours, &r.order, &rv, ro.background, &d)
    };
    let by_loss = back(loss(&r.picture.rgb, &target, None, width, 0.2).gradient);
    // Σ T α e is the derivative by a Gaussian's colour where dL/dC is e.
    let error = |(c, t): (&DVec3, &DVec3)| DVec3::splat((*c - *t).abs().element_sum());
    let by_error = back(r.picture.rgb.iter().zip(&target).map(error).collect());
    let half = 0.5 * DVec2::new(width as f64, height as f64);
    let truth = |scores: Scores, i: usize| match scores {
        Scores::Gradient => (by_loss.projected[i].xy * half).length(),
        Scores::Magnitudes => (by_loss.xy_abs[i] * half).length(),
        Scores::Error => by_error.colours[i].x,
    };

    for isa in Isa::available() {
        for scores in [Scores::Gradient, Scores::Magnitudes, Scores::Error] {
            let mut backend = CpuBackend::new(isa);
            backend.set_scores(scores);
            let mut none = Statistics::default();
            none.reset(g.len());
            Backend::upload(&mut backend, Model::from_gaussians(&g), none).unwrap();
            Backend::step(&mut backend, &input).unwrap();
            let largest = (0..g.len()).map(|i| truth(scores, i)).fold(0.0, f64::max);
            let mut scored = 0;
            for (i, &found) in backend.statistics.gradient.iter().enumerate().take(g.len()) {
                let expected = truth(scores, i);
                scored += usize::from(expected > 1e-3 * largest);
                assert!(
                    (f64::from(found) - expected).abs() < 2e-3 * expected + 1e-4 * largest,
                    "{:?} {scores:?} gaussian {i}: {found} {expected}",
                    isa.kind()
                );
            }
            assert!(scored > 30, "{scores:?}: {scored} Gaussians have a score");
        }
    }
}
