//! Training as a whole: resumed, cancelled, on any number of threads, on odd data.

use crate::instant_ngp::NgpShape;
use crate::method::FieldShape;
use crate::moving::MovingShape;
use crate::nerf::NerfShape;
use crate::train::{FieldResult, train_shape};
use crate::{FieldConfig, FieldError, Method, TrainedField};
use glam::{DVec2, DVec3};
use scene::progress::ProgressSink;
use scene::{Camera, CameraModel, Pose, PosedImage, Progress, Reconstruction};
use splat::{AlphaMode, BackendChoice, Dataset, DeviceConfig, NormalisedFrame, Pixels, View, pyramid};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Side of the pictures, pixels.
const SIZE: u32 = 24;

/// What the views of a test show: a colour and a coverage along each ray of the unit scene.
pub(crate) type Shown = fn(DVec3, DVec3) -> ([u8; 3], u8);

/// A ball of radius ½, redder to one side.
pub(crate) fn ball(origin: DVec3, direction: DVec3) -> ([u8; 3], u8) {
    let along = -origin.dot(direction);
    let depth = 0.25 - origin.length_squared() + along * along;
    if depth < 0.0 {
        return ([0; 3], 0);
    }
    let normal = (origin + direction * (along - depth.sqrt())) * 2.0;
    ([(127.0 + 120.0 * normal.x) as u8, 60, 90], 255)
}

/// `count` views from a sphere of radius 3 around the origin, in scenes `unit` large.
pub(crate) fn dataset(count: usize, unit: f64, shown: Shown) -> Dataset {
    let camera = Camera::centred(1, CameraModel::Pinhole, SIZE, SIZE, f64::from(SIZE) * 1.5);
    let mut model = Reconstruction::default();
    model.cameras.insert(1, camera.clone());
    for i in 0..count {
        let (height, turn) = (0.6 * (i as f64 * 1.7).sin(), i as f64 * 2.4);
        let out = DVec3::new(turn.cos(), height, turn.sin()).normalize() * 3.0;
        let pose = Pose::look_at(out * unit, DVec3::ZERO, -DVec3::Y);
        let (id, name) = (i as u32 + 1, format!("{i:03}.png"));
        model.images.insert(id, PosedImage { id, name, camera: 1, pose, observations: vec![] });
    }
    let normalisation = NormalisedFrame::of(&model);
    let view = |image: &PosedImage| {
        let to_world = image.pose.inverse();
        let origin = image.pose.centre() / unit;
        let (mut rgb, mut mask) = (Vec::new(), Vec::new());
        for at in 0..SIZE * SIZE {
            let pixel = DVec2::new(f64::from(at % SIZE) + 0.5, f64::from(at / SIZE) + 0.5);
            let towards = to_world.rotation * camera.unproject(pixel).extend(1.0).normalize();
            let (colour, cover) = shown(origin, towards);
            rgb.extend(colour);
            mask.push(cover);
        }
        let mask = mask.iter().any(|&m| m < 255).then_some(mask);
        let pixels = Pixels { width: SIZE as usize, height: SIZE as usize, rgb, mask };
        View {
            name: image.name.clone(),
            camera: camera.clone(),
            pose: image.pose,
            view: normalisation.view(&camera, &image.pose),
            levels: pyramid(pixels),
            held_out: false,
        }
    };
    let views = model.images.values().map(view).collect();
    Dataset { views, points: vec![], normalisation, alpha: AlphaMode::Transparent, articulation: None }
}

pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("baselines-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

pub(crate) const FIELDS: [Method; 4] =
    [Method::InstantNgp, Method::Nerf, Method::DNerf, Method::MovingGaussians];

/// So many steps on the processor.
pub(crate) fn config(method: Method, iterations: u32) -> FieldConfig {
    let device = DeviceConfig { backend: BackendChoice::Cpu, ..DeviceConfig::default() };
    FieldConfig { device, ..FieldConfig::new(method, iterations) }
}

/// A small field of a method.
fn small(method: Method, data: &Dataset, times: &[f32]) -> FieldShape {
    match FieldShape::of(method, data, times, true).unwrap() {
        FieldShape::InstantNgp(shape) => {
            FieldShape::InstantNgp(NgpShape { levels: 4, log2_entries: 13, samples: 1 << 12, ..shape })
        }
        FieldShape::Nerf(shape) => {
            FieldShape::Nerf(NerfShape { width: 32, samples: [16, 8], rays: 64, ..shape })
        }
        FieldShape::Moving(shape) => FieldShape::Moving(MovingShape { space: 8, gaussians: 800, ..shape }),
    }
}

/// Times of the views, in no order; 0 for methods whose scene stands still.
pub(crate) fn times(method: Method, data: &Dataset) -> Vec<f32> {
    let count = data.views.len();
    if matches!(method, Method::InstantNgp | Method::Nerf) {
        return vec![0.0; count];
    }
    (0..count).map(|i| (i * 3 % count) as f32 / (count - 1).max(1) as f32).collect()
}

/// Trains a small field; views have times from 0 to 1.
pub(crate) fn train(
    data: &Dataset,
    config: &FieldConfig,
    checkpoints: Option<&Path>,
    progress: &Progress,
) -> Result<FieldResult, FieldError> {
    let times = times(config.method, data);
    train_shape(small(config.method, data, &times), (data, &times), config, checkpoints, progress)
}

/// The bytes of a field after training.
pub(crate) fn bytes(
    data: &Dataset,
    config: &FieldConfig,
    checkpoints: Option<&Path>,
    file: &Path,
) -> Vec<u8> {
    train(data, config, checkpoints, &Progress::silent()).unwrap().field.write(file).unwrap();
    std::fs::read(file).unwrap()
}

/// Mean squared error of the field's picture of a view over black.
pub(crate) fn square_error(field: &TrainedField, view: &View, time: f32) -> f64 {
    let render = field.render(&view.camera, &view.pose, time, [0.0; 3]).unwrap();
    let pixels = &view.levels[0];
    let truth = |i: usize| {
        let cover = pixels.mask.as_ref().map_or(255, |m| m[i / 3]);
        f64::from(pixels.rgb[i]) * f64::from(cover) / 255.0 / 255.0
    };
    let errors = render.rgb.data.iter().enumerate().map(|(i, &v)| (f64::from(v) - truth(i)).powi(2));
    errors.sum::<f64>() / render.rgb.data.len() as f64
}

pub(crate) struct StopAt {
    pub(crate) steps: u64,
    pub(crate) flag: &'static AtomicBool,
}

impl ProgressSink for StopAt {
    fn begin(&self, _: &str, _: u64) {}
    fn update(&self, done: u64, _: &str) {
        if done >= self.steps {
            self.flag.store(true, Ordering::Relaxed);
        }
    }
    fn note(&self, _: &str) {}
}

#[test]
fn one_thread_two_threads_and_a_resumed_training_give_the_same_bytes() {
    let data = dataset(5, 1.0, ball);
    for method in FIELDS {
        let (folder, config) = (folder(&format!("bytes-{}", method.name())), config(method, 12));
        let once = bytes(&data, &config, None, &folder.join("once.bin"));
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let again = pool.install(|| bytes(&data, &config, None, &folder.join("again.bin")));
            assert!(again == once, "{method:?}: {threads} threads");
        }
        static STOP: AtomicBool = AtomicBool::new(false);
        STOP.store(false, Ordering::Relaxed);
        let progress = Progress::new(Box::new(StopAt { steps: 5, flag: &STOP }), &STOP);
        let stopped = train(&data, &config, Some(&folder), &progress);
        assert!(matches!(stopped, Err(FieldError::Cancelled(_))), "{method:?}");
        let resumed = bytes(&data, &config, Some(&folder), &folder.join("resumed.bin"));
        assert!(resumed == once, "{method:?}: stopped and resumed");
        let other = FieldConfig { seed: 1, ..config };
        let other = bytes(&data, &other, Some(&folder), &folder.join("other.bin"));
        assert!(other != once, "{method:?}: another seed");
        std::fs::remove_dir_all(folder).unwrap();
    }
}

#[test]
fn photos_seen_often_enough_end_a_training_before_its_time() {
    let data = dataset(2, 1.0, ball);
    let config = FieldConfig { time_limit: Some(1e6), ..config(Method::MovingGaussians, 1) };
    let result = train(&data, &config, None, &Progress::silent()).unwrap();
    assert_eq!(result.iterations, 300, "150 times two photos");
    assert!(result.curve.last().unwrap().seconds < 1e6);
    let error = square_error(&result.field, &data.views[0], times(config.method, &data)[0]);
    assert!(error < 0.03, "the schedule ended: {error}");
}

#[test]
fn a_damaged_checkpoint_is_refused_with_its_name() {
    for method in FIELDS {
        refuse_damaged_checkpoints(&config(method, 9));
    }
}

fn refuse_damaged_checkpoints(config: &FieldConfig) {
    let (data, folder) = (dataset(3, 1.0, ball), folder(&format!("damaged-{}", config.method.name())));
    static STOP: AtomicBool = AtomicBool::new(false);
    STOP.store(false, Ordering::Relaxed);
    let progress = Progress::new(Box::new(StopAt { steps: 2, flag: &STOP }), &STOP);
    assert!(train(&data, config, Some(&folder), &progress).is_err());
    let path = folder.join("field.checkpoint");
    let whole = std::fs::read(&path).unwrap();
    // NaN in the last array, with a checksum that fits.
    let mut with_nan = whole[..whole.len() - 4].to_vec();
    let at = with_nan.len() - 400;
    with_nan[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    with_nan.extend(crc32fast::hash(&with_nan).to_le_bytes());
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for (what, bytes) in [
        ("cut short", &whole[..whole.len() - 9]),
        ("empty", &[][..]),
        ("a bit is wrong", &flipped),
        ("NaN", &with_nan),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let error = train(&data, config, Some(&folder), &Progress::silent());
        let error = error.err().unwrap_or_else(|| panic!("{what} was taken")).to_string();
        assert!(error.contains("field.checkpoint") && error.contains("delete it"), "{what}: {error}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn scenes_of_any_unit_are_learnt_alike() {
    for (method, steps) in [(Method::InstantNgp, 300), (Method::Nerf, 300), (Method::MovingGaussians, 200)] {
        learn_in_any_unit(&config(method, steps));
    }
}

fn learn_in_any_unit(config: &FieldConfig) {
    let method = config.method;
    let errors = [1e-3, 1.0, 1e3].map(|unit| {
        let data = dataset(8, unit, ball);
        let field = train(&data, config, None, &Progress::silent()).unwrap().field;
        let depth = field.render(&data.views[0].camera, &data.views[0].pose, 0.0, [0.0; 3]).unwrap().depth;
        let centre = f64::from(depth.data[(SIZE * SIZE / 2 + SIZE / 2) as usize]);
        assert!(
            (centre / unit - 2.5).abs() < 0.4,
            "{method:?}, unit {unit}: the ball's front is {centre} away"
        );
        let times = times(method, &data);
        data.views.iter().zip(times).map(|(v, t)| square_error(&field, v, t)).sum::<f64>() / 8.0
    });
    for error in errors {
        // A black picture has 0.07; so few steps leave holes at the outline.
        assert!(error < 0.03, "{method:?}: {errors:?}");
        assert!((error / errors[1] - 1.0).abs() < 0.3, "{method:?}: {errors:?}");
    }
}

/// A white ball.
fn white_ball(origin: DVec3, direction: DVec3) -> ([u8; 3], u8) {
    ([255; 3], ball(origin, direction).1)
}

#[test]
fn white_objects_stay_whatever_the_order_of_the_views() {
    for first in 0..3 {
        let mut data = dataset(4, 1.0, white_ball);
        data.views.rotate_left(first);
        let config = FieldConfig { seed: first as u64, ..config(Method::InstantNgp, 100) };
        let field = train(&data, &config, None, &Progress::silent()).unwrap().field;
        for view in &data.views {
            // A black picture has 0.21.
            let error = square_error(&field, view, 0.0);
            assert!(error < 0.02, "from view {first}, {}: {error}", view.name);
        }
    }
}

#[test]
fn black_white_empty_and_single_views_are_learnt_without_a_fuss() {
    let cases: [(&str, usize, Shown); 4] = [
        ("black", 4, |_, _| ([0; 3], 255)),
        ("white", 4, |_, _| ([255; 3], 255)),
        ("nothing", 4, |_, _| ([0; 3], 0)),
        ("one view", 1, ball),
    ];
    for ((what, views, shown), method) in cases.into_iter().flat_map(|c| FIELDS.map(|m| (c, m))) {
        let data = dataset(views, 1.0, shown);
        let field = train(&data, &config(method, 200), None, &Progress::silent()).unwrap().field;
        let time = times(method, &data)[0];
        let error = square_error(&field, &data.views[0], time);
        assert!(error < 0.03, "{what}, {method:?}: {error}");
        let outside = [-3.0, 4.0, f32::NAN].map(|t| square_error(&field, &data.views[0], t));
        assert!(outside.iter().all(|e| e.is_finite()), "{what}, {method:?}: {outside:?}");
    }
}
