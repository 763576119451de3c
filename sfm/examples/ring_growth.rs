//! A simulated ring of images, keypoints synthesised: what each step costs, as JSON: `ring_growth
//! IMAGES [--points 5000]`.
//!
//! Every image shows about as many keypoints whatever the number of images, and every point is seen
//! over 40° of the ring, as with SIFT. Seven of ten such observations are detected, one of ten lies
//! elsewhere; the photos are shuffled.

use clap::Parser;
use glam::{DVec2, DVec3};
use rand::Rng as _;
use scene::rng::rng;
use scene::sim3::compare_poses;
use scene::synthetic::{default_camera, orbit_pose, posed_images};
use scene::{Camera, CameraModel, Features, Frame, FrameSet, Keypoint, Pose, Progress};
use sfm::{SfmConfig, reconstruct_features};

#[derive(Parser)]
struct Cli {
    /// Images on the ring.
    images: usize,
    /// Points on the object.
    #[arg(long, default_value_t = 5000)]
    points: usize,
    /// Seed of the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    sfm: SfmConfig,
}

/// Half of the azimuths from which a point is seen, radians.
const REACH: f64 = 0.35;
const DETECTED: f64 = 0.7;
const ELSEWHERE: f64 = 0.1;
const NOISE_PX: f64 = 0.4;

/// Place, azimuth and descriptor of each point, on a bumpy cylinder of about unit size.
fn points(n: usize, seed: u64) -> Vec<(DVec3, f64, Vec<u8>)> {
    let one = |i: usize| {
        let mut r = rng(seed, "ring point", i as u64);
        let azimuth = r.random_range(0.0..std::f64::consts::TAU);
        let radius = 0.8 + r.random_range(-0.15..0.15);
        let x = DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), r.random_range(-0.8..0.8));
        (x, azimuth, (0..Features::DIM).map(|_| r.random_range(0..100_u8)).collect())
    };
    (0..n).map(one).collect()
}

fn see(camera: &Camera, pose: &Pose, image: usize, points: &[(DVec3, f64, Vec<u8>)], seed: u64) -> Features {
    let mut r = rng(seed, "ring image", image as u64);
    let mut normal = || -> f64 { (0..12).map(|_| r.random_range(-0.5..0.5)).sum() };
    let own = pose.centre().y.atan2(pose.centre().x);
    let mut lots = rng(seed, "ring lots", image as u64);
    let mut features = Features::default();
    for (x, azimuth, descriptor) in points {
        let apart = (azimuth - own).sin().atan2((azimuth - own).cos()).abs();
        if apart > REACH || lots.random::<f64>() > DETECTED {
            continue;
        }
        let Some(exact) = camera.project(pose.transform(*x)) else { continue };
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let pixel = if lots.random::<f64>() < ELSEWHERE {
            DVec2::new(lots.random(), lots.random()) * size
        } else {
            exact + DVec2::new(normal(), normal()) * NOISE_PX
        };
        if pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all() {
            features.keypoints.push(Keypoint {
                x: pixel.x as f32,
                y: pixel.y as f32,
                scale: 2.0,
                angle: 0.0,
            });
            features.descriptors.extend(descriptor.iter().map(|d| d + lots.random_range(0..6_u8)));
        }
    }
    features
}

/// Peak resident memory of this process, MiB (0 where the platform does not tell).
fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let cli = Cli::parse();
    let camera = default_camera(CameraModel::SimplePinhole, 640, 480);
    let n = cli.images;
    // The order of the photos is not that of the ring.
    let mut order: Vec<usize> = (0..n).collect();
    let mut shuffle = rng(cli.seed, "ring order", 0);
    (1..n).rev().for_each(|i| order.swap(i, shuffle.random_range(0..=i)));
    let step = std::f64::consts::TAU / n as f64;
    let poses: Vec<Pose> = order.iter().map(|&i| orbit_pose(i as f64 * step, 0.35, 3.2)).collect();
    let truth = posed_images(&camera, &poses);
    let points = points(cli.points, cli.seed);
    let features: Vec<Features> =
        poses.iter().enumerate().map(|(i, pose)| see(&camera, pose, i, &points, cli.seed)).collect();
    let keypoints: usize = features.iter().map(Features::len).sum();
    let frame = |name: &String| Frame {
        name: name.clone(),
        width: camera.width,
        height: camera.height,
        ..Frame::default()
    };
    let names: Vec<String> = truth.images.values().map(|i| i.name.clone()).collect();
    let frames = FrameSet { frames: names.iter().map(frame).collect(), ..FrameSet::default() };
    let before = peak_mib();
    let result = reconstruct_features(&frames, features, &cli.sfm, &Progress::silent())?;
    let errors = result.reconstruction.as_ref().map(|model| compare_poses(model, &truth));
    let steps: Vec<String> =
        result.stats.steps.iter().map(|s| format!("\"{}\": {:.2}", s.step, s.cpu_s)).collect();
    println!(
        "{{\"images\": {n}, \"registered\": {}, \"keypoints\": {keypoints}, \"pairs_matched\": {}, \"pairs_verified\": {}, \
         \"points\": {}, \"observations\": {}, \"rotation_median_deg\": {:.4}, \"centre_max_pct\": {:.4}, \"start_mib\": \
         {before:.0}, \"peak_mib\": {:.0}, \"steps\": {{{}}}}}",
        result.stats.registered,
        result.stats.pairs_matched,
        result.stats.pairs_verified,
        result.stats.points,
        result.stats.observations,
        errors.as_ref().and_then(|e| e.rotation_deg).map_or(f64::NAN, |s| s.median),
        errors.as_ref().and_then(|e| e.centre_pct).map_or(f64::NAN, |s| s.max),
        peak_mib(),
        steps.join(", ")
    );
    Ok(())
}
