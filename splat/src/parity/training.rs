//! A small training with densification, on an adapter and on the processor.

use super::scenes::ordinary;
use crate::backend::Target;
use crate::dataset::{NormalisedFrame, Pixels, pyramid};
use crate::model::Model;
use crate::statistics::Statistics;
use crate::{
    AlphaMode, BackendChoice, Dataset, DeviceConfig, RenderOptions, Renderer, TrainConfig, TrainResult, View,
    train,
};
use glam::{DVec3, Vec3};
use rand::Rng;
use scene::decision::{Choice, Subject};
use scene::{Camera, CameraModel, Gaussians, Pose, Progress};

/// Views of a scene from a ring of radius 3; every 4th held out.
fn dataset(truth: &Gaussians, count: usize) -> Dataset {
    let mut renderer = Renderer::new(truth).unwrap();
    let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 60.0);
    let normalisation = NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 / 3.0 };
    let view = |k: usize| {
        let angle = k as f64 / count as f64 * std::f64::consts::TAU;
        let eye = 3.0 * DVec3::new(angle.cos(), angle.sin(), 0.3 * (3.0 * angle).sin()).normalize();
        let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
        let picture = renderer.render(&camera, &pose, &RenderOptions::default()).unwrap();
        // Noise, as photos have it: what is left when the scene is learnt does not hang on single
        // gaussians.
        let mut rng = scene::rng::rng(9, "parity noise", k as u64);
        let mut byte = |v: &f32| (v * 255.0 + rng.random_range(-16.0..16.0)).round().clamp(0.0, 255.0) as u8;
        let rgb = picture.rgb.data.iter().map(&mut byte).collect();
        View {
            name: format!("{k:03}.png"),
            camera: camera.clone(),
            pose,
            view: normalisation.view(&camera, &pose),
            levels: pyramid(Pixels { width: 64, height: 48, rgb, mask: None }),
            held_out: k.is_multiple_of(4),
        }
    };
    let near = |m: &Vec3| (*m * (1.02 / 3.0), [128; 3]);
    Dataset {
        views: (0..count).map(view).collect(),
        points: truth.means.iter().map(near).collect(),
        normalisation,
        alpha: AlphaMode::Transparent,
        articulation: None,
    }
}

fn trained(dataset: &Dataset, backend: BackendChoice, seed: u64) -> TrainResult {
    let device = DeviceConfig { backend, ..DeviceConfig::default() };
    let (iterations, sh_degree) = (200, 1);
    let config =
        TrainConfig { iterations, sh_degree, seed, max_gaussians: 600, device, ..TrainConfig::default() };
    train(dataset, &config, None, &Progress::silent()).unwrap()
}

/// Gaussians before the redundant ones went.
fn grown(result: &TrainResult) -> usize {
    let judged = result.decisions.iter().find(|d| d.subject == Subject::RedundantGaussians).unwrap();
    let Choice::Count { count: removed, total: Some(before) } = judged.choice else { panic!("{judged:?}") };
    assert_eq!(before - removed, result.gaussians.len());
    before
}

/// Mean squared error over the held-out views, as PSNR in dB; both rendered by the processor.
fn held_out_psnr(dataset: &Dataset, result: &TrainResult) -> f64 {
    let mut renderer = Renderer::new(&result.gaussians).unwrap();
    let (mut sum, mut count) = (0.0, 0.0);
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let image = renderer.render(&view.camera, &view.pose, &result.render).unwrap().rgb;
        for (v, &expected) in image.data.iter().zip(&view.levels[0].rgb) {
            sum += f64::from(v - f32::from(expected) / 255.0).powi(2);
            count += 1.0;
        }
    }
    -10.0 * f64::log10(sum / count)
}

#[test]
fn a_limit_on_the_adapters_memory_means_fewer_gaussians_and_says_so() {
    let dataset = dataset(&ordinary(41, 30, 0), 4);
    let run = |vram_limit, max_gaussians| {
        let device = DeviceConfig { backend: BackendChoice::Gpu, vram_limit: Some(vram_limit), gpu: None };
        let config = TrainConfig { iterations: 3, max_gaussians, device, ..TrainConfig::default() };
        train(&dataset, &config, None, &Progress::silent())
    };
    let said = |r: &TrainResult| {
        r.decisions
            .iter()
            .any(|d| d.subject == Subject::GaussianLimit && d.message.as_deref() == Some("--vram-limit 16"))
    };
    assert!(said(&run(16, 150_000).unwrap()));
    assert!(!said(&run(16, 1000).unwrap()));
    let error = run(0, 1000).unwrap_err().to_string();
    assert!(error.contains("--vram-limit"), "{error}");
}

#[test]
fn two_hundred_steps_with_densification_end_where_the_processors_do() {
    let truth = ordinary(41, 150, 0);
    let dataset = dataset(&truth, 16);
    // What is rounded differently drifts apart: held-out views by tenths of a decibel, the steps of
    // the last quarter hardly.
    let mut ends = [0.0; 2];
    for seed in [0, 1] {
        let both = [BackendChoice::Cpu, BackendChoice::Gpu].map(|b| trained(&dataset, b, seed));
        let [a, b] = both.each_ref().map(|r| held_out_psnr(&dataset, r));
        assert!(a > 24.0 && (a - b).abs() < 0.7, "held out, seed {seed}: {a:.3} dB and {b:.3} dB");
        // What is removed at the end is as many as a loss of 0.05 dB allows: a steep function of
        // what is rounded differently, so that what has grown is compared, and the pictures of what
        // is left.
        let [n, m] = both.each_ref().map(grown);
        assert!(n > 160 && n.abs_diff(m) * 20 < n, "seed {seed}: {n} and {m} gaussians");
        println!("seed {seed}: held out {a:.3} {b:.3} dB, {n} and {m} gaussians");
        for (end, result) in ends.iter_mut().zip(&both) {
            *end += f64::from(result.curve.last().unwrap().psnr) / 2.0;
        }
    }
    let [cpu, gpu] = ends;
    println!("trained {cpu:.3} {gpu:.3} dB");
    assert!((cpu - gpu).abs() < 0.1, "processor {cpu:.3} dB, adapter {gpu:.3} dB");
}

#[test]
fn gains_and_what_they_are_found_by_agree_with_the_processors() {
    let truth = ordinary(43, 120, 1);
    let dataset = dataset(&ordinary(44, 60, 0), 3);
    let view = &dataset.views[1];
    let all = [BackendChoice::Cpu, BackendChoice::Gpu].map(|backend| {
        let device = DeviceConfig { backend, ..DeviceConfig::default() };
        let (mut backend, _) = crate::device::open(&device).unwrap();
        backend.upload(Model::from_gaussians(&truth), Statistics::default()).unwrap();
        let mask: Vec<u8> = (0..64 * 48).map(|i| (i * 7 % 256) as u8).collect();
        let options = RenderOptions { background: [0.2, 0.5, 0.9], ..RenderOptions::default() };
        let mut found = Vec::new();
        for (mask, transparent) in [(None, false), (Some(&mask[..]), false), (Some(&mask[..]), true)] {
            let target = Target { rgb: &view.levels[0].rgb, mask, transparent, photo: None };
            found.extend(backend.products(&view.view, &target, &options).unwrap().into_iter().flatten());
            for gain in [None, Some([0.8, 1.1, 1.3])] {
                backend.set_gain(gain);
                found.push(backend.mean_square_error(&view.view, &target, &options).unwrap());
            }
            backend.set_gain(None);
        }
        // In other signs at every pixel and channel, as redundant Gaussians are looked for.
        let signs: Vec<f32> = (0..3 * 64 * 48).map(|i| if i * i % 7 < 3 { 1.0 } else { -1.0 }).collect();
        let slopes = backend.opacity_gradients(&view.view, &options, &signs).unwrap();
        assert_eq!(slopes.len(), 120);
        found.extend(slopes.into_iter().map(f64::from));
        found
    });
    for (k, (a, b)) in all[0].iter().zip(&all[1]).enumerate() {
        assert!((a - b).abs() < 1e-4 * a.abs() + if k < 33 { 1e-7 } else { 1e-3 }, "figure {k}: {a} and {b}");
    }
    // A gain changes what is compared.
    assert!((all[0][9] - all[0][10]).abs() > 1e-4, "{:?}", &all[0][9..11]);
}
