//! NeRF and D-NeRF on an adapter against the processor.

use super::device::DrawnDepths;
use super::twin_tests::{field, rays, step};
use super::*;
use crate::gpu::parity_tests::{compare, compare_curves, kit_or_skip};
use crate::twin_tests::STEPS;

/// The depths of the twins.
fn drawn(field: &Nerf, rays: &[gradient::SightedRay]) -> DrawnDepths {
    let [coarse, fine] = field.shape.samples;
    let mut all = DrawnDepths::default();
    rays.iter().for_each(|r| r.reach.stratified(coarse, &mut || 0.5, &mut all.coarse));
    all.offsets = vec![0.5; rays.len() * fine];
    all
}

#[test]
fn shades_gradients_and_trainings_agree_with_the_processor() {
    let Some(kit) = kit_or_skip("NeRF on an adapter") else { return };
    for (name, deformed) in [("nerf", false), ("d-nerf", true)] {
        let mut host = field(deformed);
        let mut device = NerfOnDevice::new(host.clone(), &kit).unwrap();
        let first = rays(0);
        let depths = drawn(&host, &first);
        let truth = step(&host, &first);
        let [loss, _] = device.gradients(&first, first.len(), &depths).unwrap();
        assert!((loss / truth.loss - 1.0).abs() < 1e-4, "{name}: {loss} {}", truth.loss);
        for part in 0..2 {
            let what = format!("{name} gradient {part}");
            compare(&what, &device.gradient(part), &truth.gradients[part], 1e-3);
        }
        let mut device = NerfOnDevice::new(host.clone(), &kit).unwrap();
        let mut curves = [Vec::new(), Vec::new()];
        for number in 0..STEPS as u32 {
            let place = StepPlace { step: number, position: 1.0, seed: 0 };
            let rays = rays(u64::from(number));
            curves[0].push(device.gradients(&rays, rays.len(), &drawn(&host, &rays)).unwrap()[0]);
            device.descend(place).unwrap();
            let sums = step(&host, &rays);
            curves[1].push(sums.loss);
            host.descend(&[sums], place);
        }
        compare_curves(&format!("{name} curve"), &curves[0], &curves[1]);
        device.fetch().unwrap();
        let plain: Vec<NerfRay> = first.iter().map(|r| r.ray.clone()).collect();
        let ours = device.shade(1, &plain, &depths.coarse).unwrap();
        let truth = device.host().shade(1, &plain, &depths.coarse, &mut NerfLayers::default());
        let colours = |all: &[[f32; 4]]| all.iter().flat_map(|s| [s[0], s[1], s[2]]).collect::<Vec<_>>();
        compare(&format!("{name} forward colours"), &colours(&ours), &colours(&truth), 1e-4);
        let densities = |all: &[[f32; 4]]| all.iter().map(|s| s[3]).collect::<Vec<_>>();
        compare(&format!("{name} forward densities"), &densities(&ours), &densities(&truth), 1e-4);
    }
}
