//! A dish that swings on a body without any tracks on it.

use super::*;
use glam::{DQuat, DVec3, Quat, Vec3};
use rand::Rng as _;
use scene::{Camera, CameraModel, Frame, Gaussians, Pose};
use splat::{AlphaMode, NormalisedFrame, Pixels, RenderOptions, Renderer, TrainConfig, View};

const VIEWS: usize = 72;
/// Blobs of the body.
const BODY: usize = 500;
const AXIS: DVec3 = DVec3::new(0.6, 0.8, 0.0);
const PLACE: DVec3 = DVec3::new(0.9, 0.0, 0.5);

/// Angle of the dish, radians.
fn angle(view: usize) -> f64 {
    0.35 * (view as f64 / 9.0).sin()
}

/// A body of coloured blobs and a grey dish, which is part 1.
fn object() -> (Gaussians, Vec<u8>) {
    let mut rng = scene::rng::rng(4, "dish", 0);
    let mut g = Gaussians { sh_degree: 0, ..Gaussians::default() };
    let mut add = |mean: Vec3, colour: [f32; 3]| {
        g.means.push(mean);
        g.log_scales.push(Vec3::splat(-2.3));
        g.rotations.push(Quat::IDENTITY);
        g.opacity_logits.push(3.0);
        g.sh.extend(colour);
    };
    for i in 0..BODY {
        let mut place = Vec3::from(rng.random::<[f32; 3]>()) * 2.0 - 1.0;
        // On a face of the box.
        place[i % 3] = if i % 2 == 0 { 1.0 } else { -1.0 };
        add(place * Vec3::new(0.7, 0.7, 0.4), (place * 2.0).to_array().map(|c| 0.6 * c.sin()));
    }
    let across = [AXIS.cross(DVec3::Z), AXIS].map(|v| v.as_vec3());
    for _ in 0..150 {
        let [r, turn] = rng.random::<[f32; 2]>();
        let (sin, cos) = (6.3 * turn).sin_cos();
        let place = 0.4 * r.sqrt() * (cos * across[0] + sin * across[1]);
        add(PLACE.as_vec3() + place + Vec3::Z * 0.1, [0.9; 3]);
    }
    let parts = (0..g.len()).map(|i| u8::from(i >= BODY)).collect();
    (g, parts)
}

/// Photos of it, all round; `swings`: whether the dish does.
fn captured(swings: bool) -> Dataset {
    let (gaussians, parts) = object();
    let (mut renderer, _) = Renderer::on(&splat::DeviceConfig::default(), &gaussians, parts).unwrap();
    let normalisation = NormalisedFrame { centre: DVec3::ZERO, scale: 0.25 };
    let camera = Camera::centred(1, CameraModel::Pinhole, 160, 120, 183.0);
    let mut view = |k: usize| {
        let (turn, up) = (k as f64 * 0.21, 0.8 * (k as f64 * 0.13).sin());
        let eye = 4.0 * DVec3::new(turn.cos() * up.cos(), up.sin(), turn.sin() * up.cos());
        let pose = Pose::look_at(eye, DVec3::ZERO, -DVec3::Y);
        let turn = DQuat::from_axis_angle(AXIS, if swings { angle(k) } else { 0.0 });
        renderer.part_poses = vec![Pose::new(turn, PLACE - turn * PLACE)];
        let picture = renderer.render(&camera, &pose, &RenderOptions::default()).unwrap();
        let rgb = picture.rgb.data.iter().map(|v| (255.0 * v).clamp(0.0, 255.0).round() as u8).collect();
        View {
            name: format!("{k:03}.png"),
            view: normalisation.view(&camera, &pose),
            levels: splat::pyramid(Pixels { width: 160, height: 120, rgb, mask: None }),
            held_out: false,
            camera: camera.clone(),
            pose,
        }
    };
    Dataset {
        views: (0..VIEWS).map(&mut view).collect(),
        points: Vec::new(),
        normalisation,
        alpha: AlphaMode::Transparent,
        articulation: None,
    }
}

#[test]
fn pieces_of_a_dish_that_swings_come_first() {
    let dataset = captured(true);
    let pieces = Pieces::of(&dataset.normalisation.normalise(object().0), 0);
    let (times, views) = (taken(), (0..VIEWS).collect::<Vec<_>>());
    let seen = Seen { dataset: &dataset, pieces: &pieces, times: &times, views: &views, seed: 0 };
    let scale = dataset.normalisation.scale;
    let mean = (0..VIEWS).map(angle).sum::<f64>() / VIEWS as f64;
    let truth: Vec<f64> = (0..VIEWS).map(|k| angle(k) - mean).collect();
    let alike = |candidate: refined::PhotoCandidate| {
        let middle = candidate.points.iter().sum::<DVec3>() / candidate.points.len() as f64 / scale;
        assert!(middle.distance(PLACE) < 0.5, "{middle}");
        let joint = candidate.joint;
        let sign = joint.axis.dot(AXIS).signum();
        sign * product(&joint.angles, &truth)
            / (product(&joint.angles, &joint.angles) * product(&truth, &truth)).sqrt()
    };
    let found: Vec<f64> = candidates(seen, &Progress::silent()).unwrap().into_iter().map(alike).collect();
    assert!(found.iter().any(|&c| c > 0.8), "{found:?}");
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn taken() -> Vec<f64> {
    (0..VIEWS).map(|k| k as f64).collect()
}

#[test]
fn photos_speak_for_the_true_joint_and_for_no_other_place() {
    let dataset = captured(true);
    let NormalisedFrame { scale, .. } = dataset.normalisation;
    let gaussians = dataset.normalisation.normalise(object().0);
    let pieces = Pieces::of(&gaussians, 0);
    let times = taken();
    let [judges, views] = judge::split(&dataset.training_views());
    let seen = Seen { dataset: &dataset, pieces: &pieces, times: &times, views: &views, seed: 0 };
    let gain = |place: DVec3, points: &[Vec3]| {
        let angles = (0..VIEWS).map(angle).collect();
        let place = place * scale;
        let joint = LooseJoint { axis: AXIS, place, angles, sigmas: [0.0; 2], explained: 1.0 };
        let points: Vec<DVec3> = points.iter().map(|p| p.as_dvec3()).collect();
        judge::gain_db(seen, &judges, &joint, &points, &Progress::silent()).unwrap()
    };
    let (right, wrong) = (gain(PLACE, &gaussians.means[BODY..]), gain(DVec3::ZERO, &gaussians.means[..150]));
    assert!(right.is_some_and(|db| db > 1.0) && wrong.is_none(), "{right:?} {wrong:?}");
}

#[test]
fn nothing_is_found_where_nothing_moves() {
    let dataset = captured(false);
    let gaussians = dataset.normalisation.normalise(object().0);
    let frames = FrameSet {
        frames: dataset.views.iter().map(|v| Frame { name: v.name.clone(), ..Frame::default() }).collect(),
        ..FrameSet::default()
    };
    let run = TrainConfig { iterations: 300, max_gaussians: 2000, ..TrainConfig::default() };
    assert!(search(dataset, &gaussians, &frames, &run, &Progress::silent()).unwrap().is_none());
}
