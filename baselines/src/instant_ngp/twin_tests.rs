//! An Instant NeRF against its twin in torch.

use super::gradient::{Pass, RayBatch, Sums, TrainingRay};
use super::hash_grid::FEATURES;
use super::network::{LATENT, Layers, Weights, density, encode_direction};
use super::occupancy::Sample;
use super::*;
use crate::composite::{compose, seen};
use crate::dense::place;
use crate::domain::Domain;
use crate::mlp::{Mlp, logistic};
use crate::rays::Sighting;
use crate::twin_tests::{STEPS, Twin, directions, formula};
use glam::Vec3;

const RAYS: usize = 48;
const MOST: usize = 12;

/// The field of the script.
pub(super) fn field() -> InstantNgp {
    let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades: 1 };
    let shape = NgpShape { domain, levels: 4, log2_entries: 13, samples: 1 << 12 };
    let mut field = InstantNgp::new(shape, &[], 0);
    for (level, table) in (100..).zip(&mut field.grid.tables) {
        let count = table.values.len() * FEATURES;
        table.values.as_flattened_mut().copy_from_slice(&formula(level, count));
    }
    for (n, network) in [&field.network.density, &field.network.colour].into_iter().enumerate() {
        for (k, (inputs, outputs, begin)) in layers(network).into_iter().enumerate() {
            let bound = (6.0 / (inputs + outputs) as f32).sqrt();
            for (at, value) in formula((10 + 8 * n + k) as u64, inputs * outputs).into_iter().enumerate() {
                field.weights[n][begin + place(at / outputs, at % outputs, inputs)] = value * bound;
            }
        }
    }
    field
}

/// Inputs, outputs and first parameter of each layer.
fn layers(network: &Mlp) -> Vec<(usize, usize, usize)> {
    let mut begin = 0;
    let widths = network.widths().windows(2);
    widths
        .map(|w| {
            let layer = (w[0], w[1], begin);
            begin += w[0] * w[1];
            layer
        })
        .collect()
}

/// The rays of a step of the script.
pub(super) fn batch(field: &InstantNgp, step: u64) -> RayBatch {
    let mut batch = RayBatch::default();
    let backgrounds = formula(2000 + step, 3 * RAYS);
    let places = formula(3000 + step, 3 * RAYS * MOST);
    for (r, direction) in directions(1000 + step, RAYS).into_iter().enumerate() {
        let ray = Ray { origin: Vec3::ZERO, direction, time: 0.0 };
        let background = [0, 1, 2].map(|c| backgrounds[3 * r + c] * 0.5 + 0.5);
        let colour = direction.to_array().map(|d| 0.5 + 0.4 * (3.0 * d).sin());
        let (begin, count) = (batch.samples.len(), r % (MOST + 1));
        for k in 0..count {
            let at = &places[3 * (r * MOST + k)..];
            let position = [0, 1, 2].map(|a| ((at[a] * 0.5 + 0.5) * 1024.0).floor() / 1024.0);
            batch.points.push(field.grid_point(position));
            batch.samples.push(Sample { position, t: 0.1 * k as f32, dt: 0.1 });
        }
        batch.rays.push(TrainingRay { sighting: Sighting { ray, colour, background }, begin, count });
    }
    field.grid.encode(&batch.points, &mut batch.features);
    batch
}

pub(super) fn gradients(field: &InstantNgp, batch: &RayBatch) -> Sums {
    let transposed = [
        field.network.density.transposed(&field.weights[0]),
        field.network.colour.transposed(&field.weights[1]),
    ];
    let pass = Pass {
        network: &field.network,
        weights: field.weights(),
        transposed: Weights { density: &transposed[0], colour: &transposed[1] },
        weight: 1.0 / batch.rays.len() as f32,
        linear_from: field.settings.linear_from,
    };
    pass.stretch(batch, &batch.rays)
}

/// Colours of a batch's rays.
pub(super) fn colours(field: &InstantNgp, batch: &RayBatch) -> Vec<f32> {
    let mut all = Vec::new();
    let (mut layers, width) = (Layers::default(), field.network.colour.outputs());
    for ray in &batch.rays {
        let range = ray.begin..ray.begin + ray.count;
        let points = &batch.points[range.clone()];
        field.network.densities(&field.grid, &field.weights[0], points, &mut layers.density);
        let basis = vec![encode_direction(&ray.sighting.ray); ray.count];
        field.network.colours(&field.weights[1], &mut layers, basis.iter());
        let density = |i: usize| density(layers.density.layers[2][i * LATENT]);
        let steps = || batch.samples[range.clone()].iter().map(|s| s.dt);
        let count = seen((0..ray.count).map(density), steps());
        let samples = steps().take(count).enumerate().map(|(i, dt)| {
            let rgb = [0, 1, 2].map(|c| logistic(layers.colour.layers[3][i * width + c]));
            (density(i), dt, 0.0, rgb)
        });
        all.extend(compose(samples, ray.sighting.background).rgb);
    }
    all
}

#[test]
fn colours_gradients_and_a_training_agree_with_the_twin_in_torch() {
    let (mut field, twin) = (field(), Twin::of("instant-ngp"));
    let first = batch(&field, 0);
    let sums = gradients(&field, &first);
    twin.forward(&colours(&field, &first), sums.loss / RAYS as f64);
    let width = field.network.density.inputs();
    let mut tables = field.grid.tables.clone();
    for (level, table) in tables.iter_mut().enumerate() {
        let rows = sums.of_features.chunks_exact(width);
        table.scatter(
            sums.survivors.iter().zip(rows).map(|(&i, row)| {
                (first.points[i as usize], std::array::from_fn(|k| row[level * FEATURES + k]))
            }),
        );
    }
    twin.gradients(&|name, at| {
        let (kind, k) = name.split_at(name.len() - 1);
        let k: usize = k.parse().unwrap();
        if kind == "table" {
            return tables[k].gradient.as_flattened()[at];
        }
        let network = if kind == "density" { &field.network.density } else { &field.network.colour };
        let (inputs, outputs, begin) = layers(network)[k];
        let packed = if kind == "density" { &sums.density } else { &sums.colour };
        packed[begin + place(at / outputs, at % outputs, inputs)]
    });
    let mut curve = Vec::new();
    for step in 0..STEPS as u32 {
        let batch = batch(&field, u64::from(step));
        let sums = gradients(&field, &batch);
        curve.push(sums.loss / RAYS as f64);
        field.descend(&batch, &[sums], StepPlace { step, position: 0.85, seed: 0 });
    }
    twin.curve(&curve);
}
