use super::*;
use crate::config::SfmConfig;
use crate::knowledge::Knowledge;
use crate::plane_tracks::tests::{CAMERAS, Room};
use crate::reconstruct::context::FeatureOrigin;
use crate::reconstruct::setup::Setup;
use scene::{Pose, Progress};

/// Keypoints are up to so far off, pixels.
const OFF: f64 = 2.0;

/// The model that the few inexact points of a room give, by a camera that is known.
fn alone(room: &Room, context: &StepContext<'_>, off: f64) -> SfmModel {
    let mut model = SfmModel::new(&room.frames, context.config).unwrap();
    let (cameras, known, camera_of) = (vec![room.camera.clone()], vec![Knowledge::exact()], vec![0; CAMERAS]);
    model.starts.clone_from(&cameras);
    model.setup = Setup { cameras, known, camera_of };
    let (state, keypoints, tracks) = room.model(&room.poses, off);
    (model.keypoints, model.tracks) = (keypoints, tracks);
    model.state = model.settle(state, &model.input(context), model.intrinsics, context).unwrap();
    model
}

/// What the step makes of a room whose images `spoil` changes before they are looked at: the poses
/// before and after.
fn outcome(name: &str, spoil: impl Fn(&Room)) -> (Room, Vec<Option<Pose>>, SfmModel, Vec<Decision>) {
    let room = Room::new(name, 1.0, 0.05);
    spoil(&room);
    let (config, progress) = (SfmConfig::default(), Progress::silent());
    let source = FeatureOrigin::Images;
    let context = StepContext { frames: &room.frames, config: &config, source, progress: &progress };
    let model = alone(&room, &context, OFF);
    let before = model.state.poses.clone();
    let (model, decisions) = run(model, &context).unwrap();
    (room, before, model, decisions)
}

/// Root mean square error of the angles between neighbours' rotations, radians.
fn wrong(poses: &[Option<Pose>], true_poses: &[Pose]) -> f64 {
    let turn = |a: &Pose, b: &Pose| b.rotation * a.rotation.conjugate();
    let of = |k: usize| {
        let next = (k + 1) % CAMERAS;
        let found = turn(&poses[k].unwrap(), &poses[next].unwrap());
        found.angle_between(turn(&true_poses[k], &true_poses[next])).powi(2)
    };
    ((0..CAMERAS).map(of).sum::<f64>() / CAMERAS as f64).sqrt()
}

#[test]
fn a_floor_holds_cameras_that_few_inexact_points_hold_badly() {
    let (room, before, model, decisions) = outcome("grounded", |_| ());
    assert!(decisions[0].is_taken(), "{:?}", decisions[0]);
    let (before, after) = (wrong(&before, &room.poses), wrong(&model.state.poses, &room.poses));
    assert!(after < 0.5 * before, "{after} radians, {before} without the floor");
    let features: usize = room.model(&room.poses, OFF).1.iter().map(Vec::len).sum();
    let keypoints: usize = model.keypoints.iter().map(Vec::len).sum();
    assert!(keypoints > features + 60, "{keypoints} of {features}");
    assert!(model.keypoints.iter().zip(&model.sigmas).all(|(k, sigmas)| k.len() == sigmas.len()));
    assert!(model.keypoints.iter().zip(&model.state.point_of).all(|(k, p)| k.len() == p.len()));
    assert_eq!(model.state.of_track.len(), model.tracks.views.len());
}

#[test]
fn images_that_show_other_floors_are_not_used() {
    // Each image of another room's noise: what is seen has nothing in common.
    let spoil = |room: &Room| {
        let mut value = 9u32;
        for f in &room.frames.frames {
            let noise = image::GrayImage::from_fn(f.width, f.height, |_, _| {
                value = value.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                image::Luma([(value >> 24) as u8])
            });
            noise.save(&f.path).unwrap();
        }
    };
    let (_, before, model, decisions) = outcome("other", spoil);
    assert!(!decisions[0].is_taken());
    assert_eq!(model.state.poses, before);
}

#[test]
fn nothing_is_asked_where_images_may_not_be_read_or_have_masks() {
    let mut room = Room::new("unread", 1.0, 0.0);
    let (config, progress) = (SfmConfig::default(), Progress::silent());
    for source in [FeatureOrigin::Supplied, FeatureOrigin::Images] {
        let context = StepContext { frames: &room.frames, config: &config, source, progress: &progress };
        let model = alone(&room, &context, 0.0);
        let features: usize = model.keypoints.iter().map(Vec::len).sum();
        let (model, decisions) = run(model, &context).unwrap();
        assert!(decisions.is_empty());
        assert_eq!(model.keypoints.iter().map(Vec::len).sum::<usize>(), features);
        room.frames.frames[3].mask = Some("mask.png".into());
    }
}
