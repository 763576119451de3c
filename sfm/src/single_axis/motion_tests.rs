//! Which motion the evidence finds, on exact scenes.

use super::evidence::{Comparison, Tried};
use super::material::Material;
use super::tests::{Turntable, video};
use super::video::VideoJob;
use super::*;
use crate::SfmConfig;
use crate::solvers::testing::{normal, unit_vector};
use glam::{DQuat, DVec3};
use scene::Pose;
use scene::rng::rng;

/// What is found of true poses seen with 0.2 px of noise; the model that is compared, and that of an orbit.
fn found(table: &Turntable, seed: u64) -> (Comparison, State, Option<State>) {
    let frames = video(table.poses.len());
    let (config, progress) = (SfmConfig::default(), Progress::silent());
    let cameras = [table.camera.clone()];
    let known = [Knowledge { fixed: false, focal_sigma: None }];
    let camera_of = vec![0; frames.len()];
    let job = VideoJob {
        frames: &frames,
        config: &config,
        cameras: &cameras,
        camera_of: &camera_of,
        known: &known,
        progress: &progress,
    };
    let material = Material::of_klt(&table.tracks(0.2, seed), frames.len());
    let input = job.input(&material);
    let mut state = State::new(&input, cameras.to_vec());
    for (image, pose) in table.poses.iter().enumerate() {
        state.register(image, *pose);
    }
    state.grow_all(&input);
    let job = Job {
        input: &input,
        cameras: &cameras,
        known: &known,
        starts: &cameras,
        named: None,
        config: &config.motion,
        features: &[],
        progress: &progress,
    };
    let context = job.context(&[]);
    let intrinsics = Intrinsics { model: CameraModel::SimpleRadial, principal_point: false, held: None };
    let comparison = Comparison::of(None, &state, &context, intrinsics).unwrap().unwrap();
    let circled = orbit::adjusted(&state, &context, intrinsics, comparison.orbit_sigma).unwrap();
    (comparison, state, circled)
}

/// Gives every pose a motion of its own: rotation, and translation of the camera.
fn shaken(table: &mut Turntable, turn: f64, shift: f64, seed: u64) {
    let mut r = rng(seed, "shake", 0);
    for pose in &mut table.poses {
        let shake = DQuat::from_scaled_axis(unit_vector(&mut r) * (turn * normal(&mut r)));
        *pose = Pose::new(
            shake * pose.rotation,
            shake * pose.translation + unit_vector(&mut r) * (shift * normal(&mut r)),
        );
    }
}

#[test]
fn a_camera_that_goes_round_with_small_motions_is_an_orbit() {
    for seed in 0..2 {
        let mut table = Turntable::new(24, 15.0, seed);
        shaken(&mut table, 0.01, 0.04, seed);
        let (comparison, ..) = found(&table, seed);
        assert_eq!(comparison.choice(), Tried::Orbit, "seed {seed}: {}", comparison.describe());
        let [turn, shift] = comparison.orbit_sigma;
        // Of a random direction each coordinate has a third of the variance; the circle takes up a part.
        assert!((0.003..0.008).contains(&turn), "{turn}");
        assert!((0.002..0.008).contains(&shift), "{shift}");
    }
}

#[test]
fn poses_far_from_any_circle_are_free() {
    let mut table = Turntable::new(24, 15.0, 3);
    let mut r = rng(3, "far", 0);
    for pose in &mut table.poses {
        // Anywhere on a sphere of varying radius, looking at the middle.
        let turn = DQuat::from_scaled_axis(unit_vector(&mut r) * (1.0 + 0.5 * normal(&mut r)));
        let away = DVec3::Z * (4.0 + 0.8 * normal(&mut r));
        *pose = Pose::new(turn, away);
    }
    let (comparison, ..) = found(&table, 3);
    assert_eq!(comparison.choice(), Tried::Free, "{}", comparison.describe());
}

#[test]
fn an_orbit_of_small_motions_is_adjusted_to_the_same_shape() {
    let mut table = Turntable::new(24, 15.0, 4);
    shaken(&mut table, 0.002, 0.008, 4);
    let (comparison, _, circled) = found(&table, 4);
    assert_eq!(comparison.choice(), Tried::Orbit, "{}", comparison.describe());
    let circled = circled.expect("an orbit can be adjusted as one");
    let pair =
        |poses: &[Option<Pose>], i: usize, k: usize| poses[k].unwrap().compose(&poses[i].unwrap().inverse());
    let truth: Vec<Option<Pose>> = table.poses.iter().copied().map(Some).collect();
    for i in 1..table.poses.len() {
        let (a, b) = (pair(&circled.poses, 0, i), pair(&truth, 0, i));
        let off = (a.rotation * b.rotation.conjugate()).xyz().length() * 2.0;
        assert!(off < 2e-3, "frame {i}: {off}");
    }
}
