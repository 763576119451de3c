//! Which motion the evidence finds, on exact scenes.

use super::evidence::MotionComparison;
use super::initialize::key_frames::VideoTracks;
use super::orbit;
use super::tests::{Filmed, Turntable};
use crate::incremental::adjust::Adjustment;
use crate::incremental::adjust::adjust;
use crate::incremental::state::MapState;
use crate::model_selection::camera::FreeIntrinsics;
use crate::solvers::testing::{normal, unit_vector};
use glam::{DQuat, DVec3};
use scene::decision::MotionModel;
use scene::rng::rng;
use scene::{CameraModel, Pose, Progress};

/// What is found of true poses seen with 0.2 px of noise; the model of free poses, and that of an
/// orbit.
fn found(table: &Turntable, seed: u64) -> (MotionComparison, MapState, Option<MapState>) {
    let filmed = Filmed::new(table.poses.len(), table.camera.clone(), false);
    let material = VideoTracks::of_klt(&table.tracks(0.2, seed), table.poses.len());
    let video = filmed.video();
    let input = video.input(&material);
    let Filmed { cameras, known, .. } = &filmed;
    let mut state = MapState::new(&input, cameras.to_vec());
    for (image, pose) in table.poses.iter().enumerate() {
        state.register(image, *pose);
    }
    state.grow_all(&input);
    let job = filmed.job(&input, cameras);
    let context = job.context(&[]);
    let intrinsics = FreeIntrinsics { model: CameraModel::SimpleRadial, principal_point: false, held: None };
    let comparison = MotionComparison::of(None, &state, &context, intrinsics).unwrap().unwrap();
    let (free, priors) = crate::incremental::growth::freedom(cameras, known, cameras, usize::MAX);
    adjust(&mut state, &input, &Adjustment::growing(free, priors), &Progress::silent()).unwrap();
    let circled = orbit::adjust(&state, &context, intrinsics, comparison.orbit_sigma).unwrap();
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
        assert_eq!(comparison.choice(), MotionModel::Orbit, "seed {seed}: {:?}", comparison.describe());
        let [turn, shift] = comparison.orbit_sigma;
        // Of a random direction each coordinate has a third of the variance; the circle takes up a
        // part.
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
    assert_eq!(comparison.choice(), MotionModel::Free, "{:?}", comparison.describe());
}

/// Median error of the cameras' places in the shape that they form (scale taken out), radii:
/// distances between every two.
fn median_error(found: &MapState, table: &Turntable) -> f64 {
    let centres: Vec<DVec3> = found.poses.iter().flatten().map(Pose::centre).collect();
    let truth: Vec<DVec3> = table.poses.iter().map(Pose::centre).collect();
    let pairs = || (0..truth.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let ratio = |(a, b): (usize, usize)| centres[a].distance(centres[b]) / truth[a].distance(truth[b]);
    let scale = crate::statistics::median(pairs().map(ratio).collect());
    crate::statistics::median(pairs().map(|pair| (ratio(pair) / scale - 1.0).abs()).collect())
}

#[test]
fn a_circle_makes_the_poses_of_an_orbit_more_exact() {
    for seed in 4..7 {
        let mut table = Turntable::new(24, 15.0, seed);
        shaken(&mut table, 0.0005, 0.002, seed);
        let (comparison, free, circled) = found(&table, seed);
        assert_eq!(comparison.choice(), MotionModel::Orbit, "{:?}", comparison.describe());
        let circled = circled.expect("an orbit can be adjusted as one");
        let (with, without) = (median_error(&circled, &table), median_error(&free, &table));
        assert!(with < without, "seed {seed}: {with} with the circle, {without} without");
    }
}
