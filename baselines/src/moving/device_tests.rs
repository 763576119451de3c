//! The perceptron of moving Gaussians on an adapter against the processor.

use super::device::HeadsOnDevice;
use super::settings::MovingSettings;
use super::twin_tests::{COUNT, gradient, moving};
use crate::gpu::parity_tests::{compare, compare_curves, kit_or_skip};
use crate::twin_tests::{STEPS, formula};
use std::sync::Arc;

#[test]
fn moves_gradients_and_a_training_agree_with_the_processor() {
    let Some(kit) = kit_or_skip("4DGS on an adapter") else { return };
    let (mut host, rest) = moving();
    let mut device = host.clone();
    device.heads = Some(Arc::new(HeadsOnDevice::new(&host.stack, &kit).unwrap()));
    let (_, truth, moved) = gradient(&host, &rest, 0.375);
    let (_, ours, moved_there) = gradient(&device, &rest, 0.375);
    compare("4dgs forward", &moved_there.concat(), &moved.concat(), 1e-4);
    compare("4dgs gradient weights", &ours.weights, &truth.weights, 1e-3);
    compare("4dgs gradient planes", &ours.planes.concat(), &truth.planes.concat(), 1e-3);
    assert!(host.moved(&rest, COUNT, 0.5).unwrap().geometry != moved, "another time");
    let settings = MovingSettings::default();
    let mut curves = [Vec::new(), Vec::new()];
    for (step, time) in formula(700, STEPS).into_iter().enumerate() {
        let [planes, weights] = [1.6e-3, 1.6e-4].map(|rate| settings.adam.rates(rate, step as u32 + 1));
        for (deformation, curve) in [&mut device, &mut host].into_iter().zip(&mut curves) {
            let (loss, gradient, _) = gradient(deformation, &rest, time * 0.5 + 0.5);
            curve.push(loss);
            deformation.step(gradient, &planes, &weights);
        }
    }
    compare_curves("4dgs curve", &curves[0], &curves[1]);
}
