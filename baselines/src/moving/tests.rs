//! The deformation against the same written in f64, and against its finite differences.

use super::deformation::Deformation;
use super::hexplane::{FEATURES, HexPlanes, LEVELS, Smoothness};
use super::shape::{MOVES, Moved, OUTPUTS};
use super::*;
use crate::domain::Domain;
use glam::Vec3;
use rand::Rng as _;
use scene::rng::rng;
use splat::model::Planes;

const COUNT: usize = 30;
const TIME: f32 = 0.37;

fn shape() -> MovingShape {
    let domain = Domain { centre: Vec3::new(0.1, -0.2, 0.3), half: 0.5, cascades: 1 };
    MovingShape { domain, space: 5, times: 7, gaussians: 100, pixel: 0.01 }
}

/// A deformation that moves, and Gaussians at rest.
fn moving() -> (Deformation, Planes) {
    let mut rng = rng(3, "moving", 0);
    let mut deformation = Deformation::new(shape(), &MovingSettings::default(), 3);
    deformation.weights.iter_mut().for_each(|w| *w = rng.random_range(-0.3..0.3));
    let values = deformation.planes.values.iter_mut().flatten();
    values.for_each(|v| *v = rng.random_range(0.2..1.2));
    let rest =
        Planes::from(std::array::from_fn(|_| (0..COUNT).map(|_| rng.random_range(-0.4..0.4)).collect()));
    (deformation, rest)
}

/// Parameters in f64.
#[derive(Clone)]
struct ReferenceDeformation {
    shape: MovingShape,
    planes: Vec<Vec<f64>>,
    /// Weights [output][input] and biases of each layer.
    layers: Vec<(Vec<Vec<f64>>, Vec<f64>)>,
}

const WIDTHS: [usize; 4] = [FEATURES * LEVELS, 64, 192, OUTPUTS];

impl ReferenceDeformation {
    fn new(of: &Deformation) -> Self {
        let layer = |l: usize| {
            let (place, bias) = of.stack.places(l);
            let at = |i, o| f64::from(of.weights[place(i, o)]);
            let row = |o| (0..WIDTHS[l]).map(|i| at(i, o)).collect();
            let bias = bias.take(WIDTHS[l + 1]).map(|b| f64::from(of.weights[b])).collect();
            ((0..WIDTHS[l + 1]).map(row).collect(), bias)
        };
        let planes = of.planes.values.iter().map(|p| p.iter().map(|&v| f64::from(v)).collect()).collect();
        Self { shape: shape(), planes, layers: (0..3).map(layer).collect() }
    }

    /// What moves a Gaussian at `mean`.
    fn moves(&self, mean: [f64; 3]) -> Vec<f64> {
        let MovingShape { domain, space, times, .. } = self.shape;
        let mut place = [0.0; 4];
        for a in 0..3 {
            place[a] = (mean[a] - f64::from(domain.centre[a])) / (2.0 * f64::from(domain.half)) + 0.5;
        }
        place[3] = f64::from(TIME);
        let mut x = Vec::new();
        for level in 0..LEVELS {
            let mut product = [1.0; FEATURES];
            for (k, [a, b]) in [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3]].into_iter().enumerate() {
                let side = |axis| if axis == 3 { times } else { space << level };
                let (na, nb) = (side(a), side(b));
                let at = |axis: usize, n: usize| place[axis].clamp(0.0, 1.0) * (n - 1) as f64;
                let (u, v) = (at(a, na), at(b, nb));
                let (i, j) = ((u as usize).min(na - 2), (v as usize).min(nb - 2));
                let (fu, fv) = (u - i as f64, v - j as f64);
                for (f, product) in product.iter_mut().enumerate() {
                    let value = |i: usize, j: usize| self.planes[level * 6 + k][(j * na + i) * FEATURES + f];
                    *product *= (1.0 - fv) * ((1.0 - fu) * value(i, j) + fu * value(i + 1, j))
                        + fv * ((1.0 - fu) * value(i, j + 1) + fu * value(i + 1, j + 1));
                }
            }
            x.extend(product);
        }
        for (l, (weights, bias)) in self.layers.iter().enumerate() {
            let sum = |(row, b): (&Vec<f64>, &f64)| row.iter().zip(&x).map(|(w, x)| w * x).sum::<f64>() + b;
            x = weights.iter().zip(bias).map(sum).map(|v| if l < 2 { v.max(0.0) } else { v }).collect();
        }
        (0..3).for_each(|a| x[a] *= f64::from(domain.half));
        x
    }

    /// Sum of the moves, each times a factor.
    fn loss(&self, rest: &Planes, factors: &Moved) -> f64 {
        let one = |i: usize| {
            let moves = self.moves([0, 1, 2].map(|a| f64::from(rest[a][i])));
            moves.iter().enumerate().map(|(p, m)| m * f64::from(factors.value(p, i))).sum::<f64>()
        };
        (0..COUNT).map(one).sum()
    }
}

#[test]
fn moves_agree_with_the_reference_and_gradients_with_its_finite_differences() {
    let (deformation, rest) = moving();
    let truth = ReferenceDeformation::new(&deformation);
    let (moved, still) = (deformation.moved(&rest, COUNT, TIME).unwrap(), Moved::rest(&rest, COUNT));
    assert_eq!(moved.geometry[MOVES], rest[MOVES], "opacities stay");
    (0..COUNT).for_each(|i| {
        let moves = truth.moves([0, 1, 2].map(|a| f64::from(rest[a][i])));
        for (p, m) in moves.iter().enumerate() {
            let ours = f64::from(moved.value(p, i) - still.value(p, i));
            assert!((ours - m).abs() < 1e-5 * m.abs().max(1.0), "{i}, {p}: {ours} {m}");
        }
    });
    let mut rng = rng(3, "factors", 1);
    let mut some = |n: usize| (0..n).map(|_| rng.random_range(-1.0..1.0)).collect::<Vec<f32>>();
    let factors = Moved { geometry: std::array::from_fn(|_| some(COUNT)), tint: some(3 * COUNT) };
    let gradient = deformation.gradient(&rest, COUNT, TIME, &factors).unwrap();
    let slope = |change: &dyn Fn(&mut ReferenceDeformation, f64)| {
        let at = |by: f64| {
            let mut changed = truth.clone();
            change(&mut changed, by);
            changed.loss(&rest, &factors)
        };
        (at(1e-6) - at(-1e-6)) / 2e-6
    };
    for (p, ours) in gradient.planes.iter().enumerate() {
        let mut largest: Vec<usize> = (0..ours.len()).collect();
        largest.sort_by(|&a, &b| ours[b].abs().total_cmp(&ours[a].abs()));
        let size = f64::from(ours[largest[0]].abs());
        assert!(size > 0.0);
        for &i in &largest[..20] {
            let truth = slope(&|r, by| r.planes[p][i] += by);
            assert!((f64::from(ours[i]) - truth).abs() < 1e-4 * size, "plane {p}: {} {truth}", ours[i]);
        }
    }
    for l in 0..3 {
        let (place, bias) = deformation.stack.places(l);
        let mut found = Vec::new();
        for _ in 0..20 {
            let (i, o) = (rng.random_range(0..WIDTHS[l]), rng.random_range(0..WIDTHS[l + 1]));
            let truth = slope(&|r, by| r.layers[l].0[o][i] += by);
            found.push((gradient.weights[place(i, o)], truth));
            found.push((gradient.weights[bias.start + o], slope(&|r, by| r.layers[l].1[o] += by)));
        }
        let size = found.iter().map(|f| f.1.abs()).fold(0.0, f64::max);
        for (ours, truth) in found {
            assert!((f64::from(ours) - truth).abs() < 1e-4 * size, "layer {l}: {ours} {truth} ({size})");
        }
    }
}

#[test]
fn smoothness_has_the_gradient_of_what_it_says() {
    let planes = HexPlanes::new(4, 6, 9);
    let mut rng = rng(3, "smooth", 2);
    let mut planes = planes;
    planes.values.iter_mut().flatten().for_each(|v| *v = rng.random_range(0.1..2.0));
    let weights = Smoothness { space: 2.0, time: 3.0, still: 0.5 };
    let mut gradients: Vec<Vec<f32>> = planes.values.iter().map(|v| vec![0.0; v.len()]).collect();
    planes.add_smoothness(&weights, &mut gradients);
    let penalty = |plane: usize, values: &[f64]| {
        let (across, along) = if plane < 3 { (4, 4) } else { (4, 6) };
        let at = |i: usize, j: usize, f: usize| values[(j * across + i) * FEATURES + f];
        let mut sum = 0.0;
        for f in 0..FEATURES {
            for j in 0..along {
                for i in 0..across {
                    if plane < 3 {
                        sum += if i > 0 { 2.0 * (at(i, j, f) - at(i - 1, j, f)).powi(2) } else { 0.0 };
                        sum += if j > 0 { 2.0 * (at(i, j, f) - at(i, j - 1, f)).powi(2) } else { 0.0 };
                    } else {
                        sum += 0.5 * (at(i, j, f) - 1.0).abs();
                        if (1..along - 1).contains(&j) {
                            let bend = at(i, j - 1, f) - 2.0 * at(i, j, f) + at(i, j + 1, f);
                            sum += 3.0 * bend.powi(2);
                        }
                    }
                }
            }
        }
        sum / values.len() as f64
    };
    for (plane, gradients) in gradients.iter().enumerate().take(6) {
        let values: Vec<f64> = planes.values[plane].iter().map(|&v| f64::from(v)).collect();
        for i in (0..values.len()).step_by(7) {
            let at = |by: f64| {
                let mut changed = values.clone();
                changed[i] += by;
                penalty(plane, &changed)
            };
            let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
            let ours = f64::from(gradients[i]);
            assert!((ours - slope).abs() < 1e-6, "plane {plane}, {i}: {ours} {slope}");
        }
    }
}

#[test]
fn a_new_deformation_moves_nothing_and_times_outside_the_video_are_its_ends() {
    let rest = moving().1;
    assert_eq!(
        Deformation::new(shape(), &MovingSettings::default(), 1).moved(&rest, COUNT, 0.5).unwrap(),
        Moved::rest(&rest, COUNT)
    );
    let (deformation, _) = moving();
    let at = |time| deformation.moved(&rest, COUNT, time).unwrap();
    assert_eq!((at(-0.5), at(1.5)), (at(0.0), at(1.0)));
    assert_eq!(at(f32::NAN), at(0.0));
}
