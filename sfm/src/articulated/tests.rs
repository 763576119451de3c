//! Exact tracks of a body with a part on a joint.

use super::*;
use glam::{DQuat, DVec3};
use rand::Rng as _;
use scene::{Camera, CameraModel, Pose};

/// Frames of a turn, and degrees between two.
const FRAMES: usize = 80;
const STEP_DEG: f64 = 4.0;

fn camera() -> Camera {
    Camera::centred(1, CameraModel::Pinhole, 640, 480, 600.0)
}

/// A camera that goes round the object.
fn poses() -> Vec<Pose> {
    let eye = |k: usize| {
        let (s, c) = (STEP_DEG.to_radians() * k as f64).sin_cos();
        DVec3::new(2.2 * c, 2.2 * s, 0.4)
    };
    (0..FRAMES).map(|k| Pose::look_at(eye(k), DVec3::ZERO, DVec3::Z)).collect()
}

/// Tracks of a point that moves: cut into lengths that a tracker reaches.
fn tracks_of(rng: &mut scene::rng::Rng, noise: f64, place: impl Fn(usize) -> DVec3) -> Vec<KltTrack> {
    let (camera, poses) = (camera(), poses());
    let mut first = rng.random_range(0..20_usize);
    let mut tracks = Vec::new();
    while first + 5 < FRAMES {
        let last = (first + rng.random_range(8..25_usize)).min(FRAMES);
        let mut noisy = |k: usize| {
            let exact = camera.project(poses[k].transform(place(k)))?;
            let error = || noise * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
            let mut error = error;
            Some(exact + glam::DVec2::new(error(), error()))
        };
        let positions: Option<Vec<glam::DVec2>> = (first..last).map(&mut noisy).collect();
        tracks.extend(positions.map(|positions| KltTrack { first, positions }));
        first = last + 3;
    }
    tracks
}

/// An axis with the angle in each frame.
struct True {
    axis: DVec3,
    place: DVec3,
    angle: fn(usize) -> f64,
}

impl True {
    fn at(&self, frame: usize, x: DVec3) -> DVec3 {
        self.place + DQuat::from_axis_angle(self.axis, (self.angle)(frame)) * (x - self.place)
    }
}

fn object(parts: &[True], noise: f64, seed: u64) -> Articulation {
    object_by(&camera(), parts, noise, seed).0
}

/// As `object`, for poses that were found with a camera of another focal length: as much farther
/// away.
fn object_by(assumed: &Camera, parts: &[True], noise: f64, seed: u64) -> (Articulation, Chain) {
    let (tracks, chain) = film(assumed, parts, noise, seed);
    in_unit(&tracks, chain, 0, &Progress::silent()).unwrap()
}

/// The tracks and poses of `object_by`.
fn film(assumed: &Camera, parts: &[True], noise: f64, seed: u64) -> (Vec<KltTrack>, Chain) {
    let mut rng = scene::rng::rng(seed, "articulated tests", 0);
    let mut tracks = Vec::new();
    let random = |rng: &mut scene::rng::Rng, half: DVec3| {
        half * DVec3::from([0; 3].map(|_| rng.random_range(-1.0..1.0)))
    };
    for _ in 0..80 {
        let x = random(&mut rng, DVec3::new(0.15, 0.15, 0.2));
        // The body hides its far side.
        let own = tracks_of(&mut rng, noise, |_| x);
        let poses = poses();
        tracks.extend(own.into_iter().filter(|t| {
            let eye = poses[t.first + t.positions.len() / 2].centre();
            x.dot(eye - x) > 0.0
        }));
    }
    for part in parts {
        // A flat array beside the axis.
        let across = part.axis.any_orthonormal_vector();
        for _ in 0..30 {
            let [u, v] = [rng.random_range(-0.16..0.16), rng.random_range(-0.12..0.12)];
            let x = part.place + part.axis * u + across * v;
            tracks.extend(tracks_of(&mut rng, noise, |k| part.at(k, x)));
        }
    }
    let farther = assumed.mean_focal() / camera().mean_focal();
    let pose =
        |p: Pose| Pose::new(p.rotation, p.translation + DVec3::Z * p.translation.length() * (farther - 1.0));
    let frames = poses().into_iter().map(|p| Some((0, pose(p)))).collect();
    let times = (0..FRAMES).map(|k| k as f64).collect();
    (tracks, Chain { cameras: vec![assumed.clone()], frames, joints: Vec::new(), ties: Vec::new(), times })
}

/// Degrees between the axes, distance of the true place from the line, degrees RMS of the angles.
fn errors(found: &MovingPart, truth: &True) -> [f64; 3] {
    let axis = DVec3::from(found.axis);
    let sign = axis.dot(truth.axis).signum();
    let off = (DVec3::from(found.place) - truth.place).reject_from_normalized(truth.axis);
    let zero = (truth.angle)(0).to_degrees();
    let squares = found.angles_deg.iter().enumerate().map(|(k, a)| {
        let wrong = sign * a - ((truth.angle)(k).to_degrees() - zero);
        wrong * wrong
    });
    let rms = (squares.sum::<f64>() / FRAMES as f64).sqrt();
    [axis.cross(truth.axis).length().asin().to_degrees(), off.length(), rms]
}

/// Two arrays on one axis that turn against each other.
fn arrays() -> [True; 2] {
    [1.0, -1.0].map(|side| True {
        axis: DVec3::X * side,
        place: DVec3::new(0.35 * side, 0.0, 0.03),
        angle: |k| 0.026 * k as f64,
    })
}

#[test]
fn the_parts_correct_a_focal_length() {
    let wrong = Camera::centred(1, CameraModel::Pinhole, 640, 480, 650.0);
    let (found, chain) = object_by(&wrong, &arrays(), 0.2, 1);
    assert_eq!(found.parts.len(), 2);
    let focal = chain.cameras[0].mean_focal();
    assert!((focal - 600.0).abs() < 12.0, "{focal}");
}

#[test]
fn two_arrays_and_their_joints_are_found() {
    let arrays = arrays();
    let found = object(&arrays, 0.2, 1);
    assert_eq!(
        found.parts.len(),
        2,
        "{:?}",
        found.parts.iter().map(|p| (p.tracks, p.axis)).collect::<Vec<_>>()
    );
    for part in &found.parts {
        let truth = arrays.iter().find(|a| a.place.x * part.place[0] > 0.0).unwrap();
        let [axis, place, angle] = errors(part, truth);
        assert!(axis < 0.5 && place < 0.005 && angle < 0.5, "{axis}° {place} {angle}°");
        assert!(
            part.axis_sigma_deg < 0.5 && part.place_sigma < 0.005,
            "{} {}",
            part.axis_sigma_deg,
            part.place_sigma
        );
    }
}

/// The joint of a part that turns as `angle` says.
fn joint(part: &True, chain: &Chain, angle: impl Fn(usize) -> f64) -> JointPath {
    let angles = (0..FRAMES).map(angle).collect();
    let (axis, place, times) = (part.axis, part.place, chain.times.clone());
    JointPath { axis, place, first: 0, angles, bend: 8.1e-4, times }
}

#[test]
fn a_part_whose_tracks_were_lost_turns_as_the_other_does() {
    let arrays = arrays();
    let (tracks, chain) = film(&camera(), &arrays, 0.2, 1);
    let lost = |k: usize| (arrays[0].angle)(k.min(30));
    for order in [[0, 1], [1, 0]] {
        let own = arrays
            .iter()
            .enumerate()
            .map(|(i, part)| joint(part, &chain, |k| if order[i] == 0 { lost(k) } else { (part.angle)(k) }));
        let joints: Vec<JointPath> = own.collect();
        let mut contest = Contest::new(&tracks, &chain);
        contest.enter(&Chain { joints, ties: vec![Tie::default(); 2], ..chain.clone() });
        let found = contest.settled();
        assert_eq!(found.ties[1].axis_of, Some(0));
        for path in &found.joints {
            let wrong = path.angles[FRAMES - 1].abs() - (arrays[0].angle)(FRAMES - 1);
            assert!(wrong.abs() < 0.02, "{order:?}: {wrong}");
        }
    }
}

#[test]
fn a_joint_that_explains_nothing_alone_goes() {
    let arrays = arrays();
    let (tracks, chain) = film(&camera(), &arrays, 0.2, 1);
    let mut joints: Vec<JointPath> = arrays.iter().map(|a| joint(a, &chain, a.angle)).collect();
    let fragment = JointPath { axis: DVec3::new(0.9, 0.4, 0.1).normalize(), ..joints[0].clone() };
    joints.push(fragment);
    let mut contest = Contest::new(&tracks, &chain);
    contest.enter(&Chain { joints, ties: vec![Tie::default(); 3], ..chain.clone() });
    let found = contest.settled();
    assert_eq!(found.joints.len(), 2);
    assert!(found.joints.iter().all(|j| j.axis.cross(DVec3::X).length() < 0.02));
}

#[test]
fn a_swing_is_followed_there_and_back() {
    let dish = True {
        axis: DVec3::new(0.8, 0.6, 0.1).normalize(),
        place: DVec3::new(0.0, 0.1, 0.45),
        angle: |k| 0.35 * (0.12 * k as f64).sin(),
    };
    let found = object(std::slice::from_ref(&dish), 0.2, 2);
    assert_eq!(found.parts.len(), 1);
    let [axis, place, angle] = errors(&found.parts[0], &dish);
    assert!(axis < 1.0 && place < 0.01 && angle < 1.0, "{axis}° {place} {angle}°");
}

#[test]
fn a_rigid_object_has_no_parts() {
    for noise in [0.0, 0.2, 1.0] {
        let found = object(&[], noise, 3);
        assert!(found.parts.is_empty() && found.tracks > 100, "{noise} px");
    }
}

#[test]
fn what_goes_round_with_the_camera_is_a_reflection() {
    let turning = |share: fn(usize) -> f64| {
        let rim = True { axis: DVec3::Z, place: DVec3::new(0.3, 0.1, 0.0), angle: share };
        object(&[rim], 0.2, 4).parts.len()
    };
    assert_eq!(turning(|k| -0.4 * STEP_DEG.to_radians() * k as f64), 1);
    assert_eq!(turning(|k| 0.9 * STEP_DEG.to_radians() * k as f64), 0);
}

#[test]
fn parts_that_move_as_one_are_one() {
    let path = |bend: f64| JointPath {
        axis: DVec3::X,
        place: DVec3::ZERO,
        first: 0,
        angles: vec![0.0, 0.1],
        bend,
        times: Arc::new([0.0, 1.0]),
    };
    // The third turns as the second does, the fourth on the same axis with an angle of its own.
    let tied = [(None, None), (Some(0), Some(-1.0)), (Some(1), Some(1.0)), (Some(2), None)];
    let ties = tied.map(|(axis_of, ratio)| Tie { axis_of, ratio }).to_vec();
    let joints = [1.0, 2.0, 3.0, 4.0].map(path).to_vec();
    let chain = Chain { cameras: Vec::new(), frames: Vec::new(), joints, ties, times: Arc::new([0.0, 1.0]) };
    let found = chain.without_repeats();
    assert_eq!(found.joints.iter().map(|j| j.bend).collect::<Vec<_>>(), [1.0, 2.0, 4.0]);
    assert_eq!(found.ties[2], Tie { axis_of: Some(1), ratio: None });
    assert_eq!(found.ties[..2], chain.ties[..2]);
}

#[test]
fn nothing_to_follow_gives_nothing() {
    let found = in_unit(
        &[],
        Chain {
            cameras: Vec::new(),
            frames: Vec::new(),
            joints: Vec::new(),
            ties: Vec::new(),
            times: Arc::new([]),
        },
        0,
        &Progress::silent(),
    )
    .unwrap()
    .0;
    assert!(found.parts.is_empty() && found.tracks == 0);
}
