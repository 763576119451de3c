//! What densification chooses by, against the reference's sums over pixels.

use super::scenes::{ordinary, reference_options, reference_view, view};
use super::steps::{Goal, RATES};
use crate::backend::Backend;
use crate::cpu::CpuBackend;
use crate::cpu::dispatch::Isa;
use crate::model::Model;
use crate::reference::loss::loss;
use crate::reference::rasterise::{ImageGradient, rasterise_backward};
use crate::reference::{Parameters, render};
use crate::statistics::Statistics;
use crate::view::RenderOptions;
use glam::{DVec2, DVec3};

#[test]
fn statistics_are_the_norms_of_the_screen_gradients() {
    let (width, height) = (44, 37);
    let (g, v, o) = (ordinary(5, 90, 1), view(width, height), RenderOptions::default());
    let goal = Goal::of(&ordinary(905, 80, 0), &v, &o);
    let input = goal.input(&v, o, RATES);

    let (p, rv, ro) = (Parameters::from_gaussians(&g), reference_view(&v), reference_options(&o));
    let r = render(&p, &rv, &ro);
    let byte = |k: u8| f64::from(k) / 255.0;
    let target: Vec<DVec3> =
        goal.rgb.chunks(3).map(|c| DVec3::new(byte(c[0]), byte(c[1]), byte(c[2]))).collect();
    let d = ImageGradient::of_colour(loss(&r.picture.rgb, &target, None, width, 0.2).gradient);
    let truth = rasterise_backward(&r.projected, &r.colours, &r.order, &rv, ro.background, &d);
    let half = 0.5 * DVec2::new(width as f64, height as f64);
    let truth: Vec<f64> = truth.projected.iter().map(|g| (g.xy * half).length()).collect();
    let largest = truth.iter().copied().fold(0.0, f64::max);

    for isa in Isa::available() {
        let mut backend = CpuBackend::new(isa);
        backend.upload(Model::from_gaussians(&g), Statistics::default()).unwrap();
        backend.step(&input).unwrap();
        let (_, statistics) = backend.download().unwrap();
        let mut scored = 0;
        for (i, (&found, &expected)) in statistics.gradient.iter().zip(&truth).enumerate() {
            scored += usize::from(expected > 1e-3 * largest);
            assert!(
                (f64::from(found) - expected).abs() < 2e-3 * expected + 1e-4 * largest,
                "{:?} gaussian {i}: {found} {expected}",
                isa.kind()
            );
        }
        assert!(scored > 30, "{scored} Gaussians have a score");
    }
}
