//! What the tests of all methods on adapters share.

use super::FieldKit;
use crate::tests::{FIELDS, StopAt, ball, bytes, config, dataset, folder, times, train};
use crate::{Accelerator, FieldConfig, FieldError, TrainedField};
use scene::Progress;
use splat::{BackendChoice, DeviceConfig};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Any adapter, an emulated one too.
pub(crate) fn any_adapter() -> DeviceConfig {
    DeviceConfig { backend: BackendChoice::Gpu, ..DeviceConfig::default() }
}

/// Kernels on an adapter; without one the test says so, and fails where tests run unattended.
pub(crate) fn kit_or_skip(test: &str) -> Option<Arc<FieldKit>> {
    match FieldKit::open(&any_adapter()) {
        Ok(kit) => kit,
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "{test}: {error}");
            println!("SKIPPED {test}: {error}");
            None
        }
    }
}

/// Says how far two arrays are from each other, in shares of the largest value, and asks for
/// `most` at most.
pub(crate) fn compare(what: &str, ours: &[f32], truth: &[f32], most: f32) {
    assert_eq!(ours.len(), truth.len(), "{what}");
    let largest = truth.iter().fold(0.0f32, |a, v| a.max(v.abs()));
    assert!(largest > 0.0, "{what}: nothing to compare");
    let off = ours.iter().zip(truth).map(|(a, b)| (a - b).abs() / largest);
    let worst = off.fold(0.0f32, |a, v| if v <= a { a } else { v });
    println!("parity {what} {worst:.2e}");
    assert!(worst < most, "{what}: {worst}");
}

/// The same for curves of losses, in means of 50 steps.
pub(crate) fn compare_curves(what: &str, ours: &[f64], truth: &[f64]) {
    let means = |curve: &[f64]| curve.chunks(50).map(|c| c.iter().sum::<f64>() as f32).collect::<Vec<_>>();
    let (ours, truth) = (means(ours), means(truth));
    let worst = ours.iter().zip(&truth).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0f32, f32::max);
    println!("parity {what} {worst:.2e}");
    assert!(worst < 1e-2, "{what}: {worst}");
}

#[test]
fn a_training_on_an_adapter_follows_the_processor_and_resumes_to_the_same_bytes() {
    if kit_or_skip("training on an adapter").is_none() {
        return;
    }
    let data = dataset(5, 1.0, ball);
    for method in FIELDS {
        let (folder, here) = (folder(&format!("adapter-{}", method.name())), config(method, 12));
        let there = FieldConfig { device: any_adapter(), ..here.clone() };
        let [file, resumed] = ["once.bin", "resumed.bin"].map(|name| folder.join(name));
        let [here, once] = [&here, &there].map(|c| train(&data, c, None, &Progress::silent()).unwrap());
        let [ours, truth] = [&once, &here].map(|r| r.curve[0].loss);
        assert!((ours / truth - 1.0).abs() < 1e-2, "{method:?}: {ours} {truth}");
        once.field.write(&file).unwrap();
        static STOP: AtomicBool = AtomicBool::new(false);
        STOP.store(false, Ordering::Relaxed);
        let progress = Progress::new(Box::new(StopAt { steps: 5, flag: &STOP }), &STOP);
        let stopped = train(&data, &there, Some(&folder), &progress);
        assert!(matches!(stopped, Err(FieldError::Cancelled(_))), "{method:?}");
        let again = bytes(&data, &there, Some(&folder), &resumed);
        assert!(again == std::fs::read(&file).unwrap(), "{method:?}: stopped and resumed");
        // The file shows the same on both.
        let (view, time) = (&data.views[1], times(method, &data)[1]);
        let pictures = [any_adapter(), DeviceConfig { backend: BackendChoice::Cpu, ..any_adapter() }]
            .map(|device| TrainedField::read(&file, &Accelerator::open(&device).unwrap()).unwrap())
            .map(|field| field.render(&view.camera, &view.pose, time, [0.5; 3]).unwrap());
        compare(&format!("{} picture", method.name()), &pictures[0].rgb.data, &pictures[1].rgb.data, 1e-3);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
