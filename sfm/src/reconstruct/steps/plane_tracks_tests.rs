use super::*;
use crate::Knowledge;
use crate::incremental::MapperConfig;
use crate::incremental::finish::converge;
use crate::model_selection::camera::before_the_choice;
use crate::plane_tracks::tests::{CAMERAS, Room, input};
use scene::Pose;

/// Keypoints are up to so far off, pixels.
const OFF: f64 = 2.0;

/// A room, the model that its few inexact points give, and what `try_plane_tracks` made of that.
struct PlaneTracksCase {
    room: Room,
    alone: MapState,
    found: Option<(PlaneTracks, MapState)>,
    decision: Option<Decision>,
    features: usize,
}

/// `spoil` changes the images before they are looked at.
fn outcome(name: &str, off: f64, spoil: impl Fn(&Room)) -> PlaneTracksCase {
    let room = Room::new(name, 1.0, 0.05);
    spoil(&room);
    let (state, keypoints, tracks) = room.model(&room.poses, off);
    let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
    let input = input(&keypoints, &tracks, &camera_of, &config);
    let (known, cameras, progress) = ([Knowledge::exact()], [room.camera.clone()], Progress::silent());
    let settle = |mut state: MapState, input: &MappingInput<'_>| -> Result<MapState, SfmError> {
        converge(&mut state, input, &known, &cameras, before_the_choice(None), &progress)?;
        Ok(state)
    };
    let alone = settle(state, &input).unwrap();
    let rotated = [false; CAMERAS];
    let (found, decision) =
        try_plane_tracks(Some(&room.frames), (&alone, &input), &rotated, settle, &progress).unwrap();
    let features = keypoints.iter().map(Vec::len).sum();
    PlaneTracksCase { room, alone, found, decision, features }
}

/// Root mean square error of the angles between neighbours' rotations, radians.
fn wrong(state: &MapState, true_poses: &[Pose]) -> f64 {
    let turn = |a: &Pose, b: &Pose| b.rotation * a.rotation.conjugate();
    let of = |k: usize| {
        let next = (k + 1) % CAMERAS;
        let found = turn(&state.poses[k].unwrap(), &state.poses[next].unwrap());
        found.angle_between(turn(&true_poses[k], &true_poses[next])).powi(2)
    };
    ((0..CAMERAS).map(of).sum::<f64>() / CAMERAS as f64).sqrt()
}

#[test]
fn a_floor_holds_cameras_that_few_inexact_points_hold_badly() {
    let PlaneTracksCase { room, alone, found, decision, features } = outcome("grounded", OFF, |_| ());
    let decision = decision.unwrap();
    assert!(decision.is_taken(), "{decision:?}");
    let (plane_tracks, model) = found.unwrap();
    let (before, after) = (wrong(&alone, &room.poses), wrong(&model, &room.poses));
    assert!(after < 0.5 * before, "{after} radians, {before} without the floor");
    let keypoints: usize = plane_tracks.keypoints.iter().map(Vec::len).sum();
    assert!(keypoints > features + 60, "{keypoints} of {features}");
    let same = |(k, sigmas): (&Vec<DVec2>, &Vec<f32>)| k.len() == sigmas.len();
    assert!(plane_tracks.keypoints.iter().zip(&plane_tracks.sigmas).all(same));
    assert!(plane_tracks.keypoints.iter().zip(&model.point_of).all(|(k, p)| k.len() == p.len()));
    assert_eq!(model.of_track.len(), plane_tracks.tracks.views.len());
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
    let PlaneTracksCase { found, decision, .. } = outcome("other", OFF, spoil);
    assert!(found.is_none());
    assert!(!decision.unwrap().is_taken());
}

#[test]
fn nothing_is_asked_where_images_may_not_be_read_or_have_masks() {
    let mut room = Room::new("unread", 1.0, 0.0);
    let (state, keypoints, tracks) = room.model(&room.poses, 0.0);
    let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
    let input = input(&keypoints, &tracks, &camera_of, &config);
    room.frames.frames[3].mask = Some("mask.png".into());
    for images in [None, Some(&room.frames)] {
        let settle =
            |_: MapState, _: &MappingInput<'_>| -> Result<MapState, SfmError> { panic!("nothing to settle") };
        let (found, decision) =
            try_plane_tracks(images, (&state, &input), &[false; CAMERAS], settle, &Progress::silent())
                .unwrap();
        assert!(found.is_none() && decision.is_none());
    }
}
