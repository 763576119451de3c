//! The first adapter of this machine, hardware or not, as a subject. A machine without any fails.

use super::subject::{Seen, Subject};
use crate::backend::{Backend, Target};
use crate::cpu::ModelGradient;
use crate::gpu::{GpuBackend, Opening};
use crate::model::Model;
use crate::statistics::Statistics;
use crate::{PinholeView, RenderOptions};
use glam::{Mat3, Vec3};
use scene::Gaussians;
use std::sync::{Mutex, MutexGuard, OnceLock};

/// One device for all tests, each call by itself.
pub(crate) struct Adapter;

fn device() -> MutexGuard<'static, GpuBackend> {
    static DEVICE: OnceLock<Mutex<GpuBackend>> = OnceLock::new();
    let open = || {
        Mutex::new(GpuBackend::open(&Opening::default()).expect("an adapter; mesa-vulkan-drivers brings one"))
    };
    DEVICE.get_or_init(open).lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().map(|v| (v * 255.0).round() as u8).collect()
}

impl Subject for Adapter {
    fn name(&self) -> String {
        device().adapter().to_string()
    }

    fn with(&mut self, run: &mut dyn FnMut(&mut dyn Backend)) {
        run(&mut *device());
    }

    fn affordable(&self, steps: usize) -> usize {
        if device().adapter().kind.is_hardware() { steps } else { steps.min(300) }
    }

    fn project(&mut self, g: &Gaussians, view: &PinholeView, options: &RenderOptions) -> Vec<Option<Seen>> {
        let mut gpu = device();
        gpu.upload(Model::from_gaussians(g), Statistics::default()).unwrap();
        gpu.projected(view, options).unwrap()
    }

    fn loss(
        &mut self,
        [width, height]: [usize; 2],
        rgb: &[f32],
        target: &[f32],
        weight: Option<&[f32]>,
        lambda: f32,
    ) -> (f32, f32, Vec<f32>) {
        let (target, mask) = (bytes(target), weight.map(bytes));
        let target = Target { rgb: &target, mask: mask.as_deref(), transparent: false, photo: None };
        let (rotation, translation) = (Mat3::IDENTITY, Vec3::ZERO);
        let view = PinholeView {
            rotation,
            translation,
            focal: [1.0; 2],
            centre: [0.0; 2],
            width,
            height,
            parts: crate::parts::PartPlaces::NONE,
        };
        let mut gpu = device();
        // Frames are run over pages of Gaussians, if only of none.
        gpu.upload(Model::default(), Statistics::default()).unwrap();
        gpu.loss(&view, rgb, &target, lambda).unwrap()
    }

    fn gradients(
        &mut self,
        g: &Gaussians,
        view: &PinholeView,
        options: &RenderOptions,
        d: &[f32],
    ) -> ModelGradient {
        let mut gpu = device();
        gpu.upload(Model::from_gaussians(g), Statistics::default()).unwrap();
        gpu.gradients(view, options, d).unwrap()
    }
}
