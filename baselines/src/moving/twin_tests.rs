//! HexPlanes and heads against their twin in torch.

use super::deformation::{Deformation, DeformationGradient};
use super::settings::MovingSettings;
use super::shape::{MOVES, Moved, MovingShape};
use crate::domain::Domain;
use crate::twin_tests::{STEPS, Twin, formula};
use glam::Vec3;
use splat::model::Planes;

pub(super) const COUNT: usize = 30;
const WIDTHS: [usize; 4] = [32, 64, 192, MOVES];

/// The deformation of the script, and its Gaussians at rest.
pub(super) fn moving() -> (Deformation, Planes) {
    let domain = Domain { centre: Vec3::new(0.1, -0.2, 0.3), half: 0.5, cascades: 1 };
    let shape = MovingShape { domain, space: 5, times: 7, gaussians: 100, pixel: 0.01 };
    let mut deformation = Deformation::new(shape, &MovingSettings::default(), 0);
    for (seed, plane) in (400..).zip(&mut deformation.planes.values) {
        *plane = formula(seed, plane.len()).into_iter().map(|v| 0.7 + 0.5 * v).collect();
    }
    for k in 0..3 {
        let (place, bias) = deformation.stack.places(k);
        let seed = 500 + 2 * k as u64;
        let mut all = deformation.weights.clone();
        for (at, value) in formula(seed, WIDTHS[k] * WIDTHS[k + 1]).into_iter().enumerate() {
            all[place(at / WIDTHS[k + 1], at % WIDTHS[k + 1])] = value * 0.3;
        }
        bias.zip(formula(seed + 1, WIDTHS[k + 1])).for_each(|(b, value)| all[b] = value * 0.3);
        deformation.weights = all;
    }
    let numbers = formula(600, MOVES * COUNT);
    let mut rest = Planes::default();
    for (plane, numbers) in rest.iter_mut().zip(numbers.chunks_exact(COUNT)) {
        *plane = numbers.iter().map(|v| v * 0.4).collect();
    }
    rest.iter_mut().skip(MOVES).for_each(|plane| *plane = vec![0.0; COUNT]);
    (deformation, rest)
}

/// The loss at a time, and its gradient. The twin moves no colours.
fn loss(rest: &Planes, moved: &Planes, time: f32) -> (f64, Moved) {
    let (mut loss, mut of_moved) = (0.0, Moved::rest(rest, COUNT));
    for plane in 0..MOVES {
        for i in 0..COUNT {
            let target = rest[plane][i] + 0.3 * (5.0 * time + plane as f32).sin();
            let e = moved[plane][i] - target;
            loss += f64::from(e * e) / (COUNT * MOVES) as f64;
            of_moved.geometry[plane][i] = 2.0 * e / (COUNT * MOVES) as f32;
        }
    }
    (loss, of_moved)
}

pub(super) fn gradient(
    deformation: &Deformation,
    rest: &Planes,
    time: f32,
) -> (f64, DeformationGradient, Planes) {
    let moved = deformation.moved(rest, COUNT, time).unwrap().geometry;
    let (loss, of_moved) = loss(rest, &moved, time);
    (loss, deformation.gradient(rest, COUNT, time, &of_moved).unwrap(), moved)
}

#[test]
fn moves_gradients_and_a_training_agree_with_the_twin_in_torch() {
    let ((mut deformation, rest), twin) = (moving(), Twin::of("4dgs"));
    let (first, gradients, moved) = gradient(&deformation, &rest, 0.375);
    let ours: Vec<f32> =
        (0..COUNT).flat_map(|i| (0..MOVES).map(move |p| (i, p))).map(|(i, p)| moved[p][i]).collect();
    twin.forward(&ours, first);
    twin.gradients(&|name, at| {
        if let Some(plane) = name.strip_prefix("plane") {
            return gradients.planes[plane.parse::<usize>().unwrap()][at];
        }
        let (kind, k) = name.split_at(1);
        let k: usize = k.parse().unwrap();
        let (place, bias) = deformation.stack.places(k);
        let outputs = WIDTHS[k + 1];
        let at = if kind == "w" { place(at / outputs, at % outputs) } else { bias.start + at };
        gradients.weights[at]
    });
    let settings = MovingSettings::default();
    let mut curve = Vec::new();
    for (step, time) in formula(700, STEPS).into_iter().enumerate() {
        let (loss, gradient, _) = gradient(&deformation, &rest, time * 0.5 + 0.5);
        curve.push(loss);
        let [planes, weights] = [1.6e-3, 1.6e-4].map(|rate| settings.adam.rates(rate, step as u32 + 1));
        deformation.step(gradient, &planes, &weights);
    }
    twin.curve(&curve);
}
