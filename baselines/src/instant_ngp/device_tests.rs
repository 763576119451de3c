//! An Instant NeRF on an adapter against the processor.

use super::twin_tests::{batch, colours, field, gradients};
use super::*;
use crate::gpu::parity_tests::{compare, compare_curves, kit_or_skip};
use crate::instant_ngp::hash_grid::FEATURES;
use crate::twin_tests::STEPS;

#[test]
fn shades_gradients_and_a_training_agree_with_the_processor() {
    let Some(kit) = kit_or_skip("Instant NeRF on an adapter") else { return };
    let mut host = field();
    let mut device = NgpOnDevice::new(host.clone(), &kit).unwrap();
    let first = batch(&host, 0);
    let truth = gradients(&host, &first);
    let results = device.gradients(&first).unwrap();
    let loss: f64 = results.iter().map(|r| f64::from(r[0])).sum();
    assert!((loss / truth.loss - 1.0).abs() < 1e-4, "{loss} {}", truth.loss);
    compare(
        "instant-ngp gradient networks",
        &device.network_gradient(),
        &[&truth.density[..], &truth.colour].concat(),
        1e-3,
    );
    let mut tables = host.grid.tables.clone();
    let rows = || truth.of_features.chunks_exact(host.network.density.inputs());
    for (level, table) in tables.iter_mut().enumerate() {
        table.scatter(
            truth.survivors.iter().zip(rows()).map(|(&i, row)| {
                (first.points[i as usize], std::array::from_fn(|k| row[level * FEATURES + k]))
            }),
        );
    }
    let tables: Vec<f32> = tables.iter().flat_map(|t| t.gradient.as_flattened()).copied().collect();
    compare("instant-ngp gradient tables", &device.table_gradient(), &tables, 1e-3);
    let again = device.table_gradient();
    let mut second = NgpOnDevice::new(host.clone(), &kit).unwrap();
    second.gradients(&first).unwrap();
    assert!(again == second.table_gradient(), "the order of sums changes nothing");
    let mut device = NgpOnDevice::new(host.clone(), &kit).unwrap();
    let mut curves = [Vec::new(), Vec::new()];
    for step in 0..STEPS as u32 {
        let (place, batch) = (StepPlace { step, position: 0.85, seed: 0 }, batch(&host, u64::from(step)));
        let results = device.gradients(&batch).unwrap();
        device.descend(place).unwrap();
        curves[0].push(results.iter().map(|r| f64::from(r[0])).sum());
        let sums = gradients(&host, &batch);
        curves[1].push(sums.loss);
        host.descend(&batch, &[sums], place);
    }
    compare_curves("instant-ngp curve", &curves[0], &curves[1]);
    device.fetch().unwrap();
    let learnt = device.host();
    compare("instant-ngp forward", &colours(learnt, &first), &device.colours(&first), 1e-4);
}
