//! The production code against the reference and finite differences.

use super::gradient::{Pass, RayBatch, Sums, TrainingRay};
use super::hash_grid::FEATURES;
use super::network::{Weights, density};
use super::occupancy::Sample;
use super::reference::{ReferenceField, matrices};
use super::*;
use crate::composite::compose;
use crate::domain::Domain;
use crate::rays::Sighting;
use glam::Vec3;
use rand::Rng as _;

const SMALL: u32 = 12;

fn small_field() -> InstantNgp {
    let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades: 1 };
    let shape = NgpShape { domain, levels: 4, log2_entries: SMALL, samples: 1 << 12 };
    let mut field = InstantNgp::new(shape, &[], 5);
    let mut rng = scene::rng::rng(5, "test", 0);
    for table in &mut field.grid.tables {
        table.values.as_flattened_mut().iter_mut().for_each(|v| *v = rng.random_range(-1.0..1.0));
    }
    field
}

fn batch(field: &InstantNgp, rays: usize, most: usize) -> RayBatch {
    let mut rng = scene::rng::rng(5, "batch", 1);
    let mut batch = RayBatch::default();
    for r in 0..rays {
        let direction = Vec3::from(rng.random::<[f32; 3]>().map(|v| v - 0.5)).normalize();
        let ray = Ray { origin: Vec3::ZERO, direction, time: 0.0 };
        let sighting = Sighting { ray, colour: rng.random(), background: rng.random() };
        let (begin, count) = (batch.samples.len(), r % (most + 1));
        for k in 0..count {
            // Exact in f32 at every level's scale: what is compared is not the rounding of places.
            let position = rng.random::<[f32; 3]>().map(|v| (v * 1024.0).floor() / 1024.0);
            batch.points.push(field.grid_point(position));
            batch.samples.push(Sample { position, t: k as f32 * 0.1, dt: 0.1 });
        }
        batch.rays.push(TrainingRay { sighting, begin, count });
    }
    field.grid.encode(&batch.points, &mut batch.features);
    batch
}

fn reference(field: &InstantNgp) -> ReferenceField {
    let corner = |c: &hash_grid::Corner| c.map(f64::from);
    ReferenceField {
        density: matrices(field.network.density.widths(), &field.weights[0]),
        colour: matrices(field.network.colour.widths(), &field.weights[1]),
        tables: field.grid.tables.iter().map(|t| t.values.iter().map(corner).collect()).collect(),
        most_entries: 1 << SMALL,
    }
}

fn gradients(field: &InstantNgp, batch: &RayBatch) -> Sums {
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

#[test]
fn densities_and_colours_agree_with_the_reference() {
    let field = small_field();
    let truth = reference(&field);
    let batch = batch(&field, 60, 12);
    let (colours, loss) = truth.loss(&batch);
    let sums = gradients(&field, &batch);
    let mean = sums.loss / batch.rays.len() as f64;
    assert!((mean - loss).abs() < 1e-5 * loss, "{mean} {loss}");
    // The picture's own way through the same samples.
    let mut layers = network::Layers::default();
    for (ray, colour) in batch.rays.iter().zip(colours) {
        let range = ray.begin..ray.begin + ray.count;
        field.network.densities(
            &field.grid,
            &field.weights[0],
            &batch.points[range.clone()],
            &mut layers.density,
        );
        let direction = network::encode_direction(&ray.sighting.ray);
        let directions = vec![direction; ray.count];
        field.network.colours(&field.weights[1], &mut layers, directions.iter());
        let width = field.network.colour.outputs();
        let samples = batch.samples[range].iter().enumerate().map(|(i, s)| {
            let latent = layers.density.layers[2][i * network::LATENT];
            let rgb = [0, 1, 2].map(|c| crate::mlp::logistic(layers.colour.layers[3][i * width + c]));
            (density(latent), s.dt, s.t, rgb)
        });
        let shown = compose(samples, ray.sighting.background);
        for c in 0..3 {
            assert!((f64::from(shown.rgb[c]) - colour[c]).abs() < 1e-5, "{shown:?} {colour:?}");
        }
    }
}

#[test]
fn gradients_agree_with_finite_differences_of_the_reference() {
    let mut field = small_field();
    let batch = batch(&field, 40, 9);
    let sums = gradients(&field, &batch);
    let width = field.network.density.inputs();
    for (level, table) in field.grid.tables.iter_mut().enumerate() {
        let rows = sums.of_features.chunks_exact(width);
        table.scatter(
            sums.survivors.iter().zip(rows).map(|(&i, row)| {
                (batch.points[i as usize], std::array::from_fn(|k| row[level * FEATURES + k]))
            }),
        );
    }
    let truth = reference(&field);
    // Short enough that hardly any rectifier switches on the way.
    let h = 1e-7;
    let slope = |change: &dyn Fn(&mut ReferenceField, f64)| {
        let at = |by: f64| {
            let mut moved = truth.clone();
            change(&mut moved, by);
            moved.loss(&batch).1
        };
        (at(h) - at(-h)) / (2.0 * h)
    };
    let mut rng = scene::rng::rng(5, "places", 2);
    let compare = |what: &str, places: Vec<(f64, f64)>| {
        let size = places.iter().map(|p| p.1.abs()).fold(0.0, f64::max);
        assert!(size > 0.0, "{what}: no gradient");
        for (ours, truth) in places {
            assert!((ours - truth).abs() < 1e-4 * size, "{what}: {ours} is not {truth} (largest {size})");
        }
    };
    for (network, packed) in [(0, &sums.density), (1, &sums.colour)] {
        let shape = if network == 0 { &field.network.density } else { &field.network.colour };
        let mut begin = 0;
        for (layer, w) in shape.widths().windows(2).enumerate() {
            let outputs = if network == 1 && layer == 2 { 3 } else { w[1] };
            let places = (0..25)
                .map(|_| {
                    let (i, o) = (rng.random_range(0..w[0]), rng.random_range(0..outputs));
                    let ours = packed[begin + crate::dense::place(i, o, w[0])];
                    let truth = slope(&|field, by| {
                        let layers = if network == 0 { &mut field.density } else { &mut field.colour };
                        layers[layer][i][o] += by;
                    });
                    (f64::from(ours), truth)
                })
                .collect();
            compare(&format!("network {network}, layer {layer}"), places);
            begin += w[0] * w[1];
        }
    }
    for (level, table) in field.grid.tables.iter().enumerate() {
        let size = |i: &usize| table.gradient[*i].iter().map(|g| g.abs()).sum::<f32>();
        let mut largest: Vec<usize> = (0..table.values.len()).collect();
        largest.sort_by(|a, b| size(b).total_cmp(&size(a)));
        let places = (0..25)
            .map(|n| {
                let (i, k) = (largest[n], n % FEATURES);
                let truth = slope(&|field, by| field.tables[level][i][k] += by);
                (f64::from(table.gradient[i][k]), truth)
            })
            .collect();
        compare(&format!("level {level}"), places);
    }
}

#[test]
fn steps_through_all_of_space_add_up_to_one_however_many_cubes_there_are() {
    for cascades in [1, 3, 5] {
        let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades };
        let shape = NgpShape { domain, levels: 4, log2_entries: SMALL, samples: 1 << 12 };
        let mut field = InstantNgp::new(shape, &[], 5);
        // All cells count as occupied but one, which is below the mean.
        let mut density = vec![2.0; cascades as usize * occupancy::CELLS];
        density[0] = 0.0;
        field.occupancy.set_density(density);
        let origin = Vec3::new(-40.0, 0.1, 0.2);
        let mut march =
            field.occupancy.march(field.local(&Ray { origin, direction: Vec3::X, time: 0.0 }), 0.5);
        let sum: f32 = std::iter::from_fn(|| field.occupancy.next(&mut march)).map(|s| s.dt).sum();
        assert!((sum - 1.0).abs() < 0.05, "{cascades} cubes: {sum}");
    }
}
