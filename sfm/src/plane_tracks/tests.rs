//! A floor whose texture is known everywhere, with an object's points above it, seen from a ring of
//! cameras.

use super::plane::{ScenePlane, widest};
use super::*;
use crate::incremental::MapperConfig;
use crate::statistics::median;
use crate::tracks::{NONE, Tracks};
use glam::DQuat;
use rand::Rng as _;
use scene::rng::rng;
use scene::{Camera, CameraModel, Frame, Pose};

const SIZE: (u32, u32) = (240, 180);
const FOCAL: f64 = 260.0;
pub(crate) const CAMERAS: usize = 12;

/// Brightness of a place of the floor, of which a hundredth of the radius is a pixel or so.
fn texture(x: f64, y: f64) -> f64 {
    let waves =
        [(41.0, 12.0, 0.3), (-29.0, 37.0, 1.1), (14.0, -43.0, 2.0), (51.0, 33.0, 0.7), (9.0, 27.0, 4.0)];
    0.5 + 0.08 * waves.iter().map(|(a, b, c)| (a * x + b * y + c).sin()).sum::<f64>()
}

/// The floor is z = −0.6 radii.
pub(crate) struct Room {
    folder: std::path::PathBuf,
    unit: f64,
    pub camera: Camera,
    pub poses: Vec<Pose>,
    pub frames: FrameSet,
}

impl Drop for Room {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.folder).ok();
    }
}

impl Room {
    /// `unit`: the radius of the ring. Images have noise of this standard deviation.
    pub(crate) fn new(name: &str, unit: f64, noise: f64) -> Self {
        let folder = std::env::temp_dir().join(format!("sat-recon-ground-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let camera = Camera::centred(1, CameraModel::SimplePinhole, SIZE.0, SIZE.1, FOCAL);
        let eye = |k: usize| {
            let (s, c) = (std::f64::consts::TAU * k as f64 / CAMERAS as f64).sin_cos();
            Pose::look_at(DVec3::new(s, -c, 0.3) * unit, DVec3::new(0.0, 0.0, -0.4) * unit, -DVec3::Z)
        };
        let mut room = Self {
            folder,
            unit,
            camera,
            poses: (0..CAMERAS).map(eye).collect(),
            frames: FrameSet::default(),
        };
        let mut random = rng(8, "grain", 0);
        for k in 0..CAMERAS {
            let path = room.folder.join(format!("{k}.png"));
            let image = image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                let value = room.shown(k, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                let grain = noise * (0..6).map(|_| random.random::<f64>() - 0.5).sum::<f64>() * 2f64.sqrt();
                image::Luma([(255.0 * (value + grain)).clamp(0.0, 255.0).round() as u8])
            });
            image.save(&path).unwrap();
            let (width, height) = SIZE;
            room.frames.frames.push(Frame {
                name: format!("{k}.png"),
                path,
                width,
                height,
                ..Frame::default()
            });
        }
        room
    }

    /// What a pixel shows of the floor; black above its horizon.
    fn shown(&self, camera: usize, pixel: DVec2) -> f64 {
        let pose = &self.poses[camera];
        let (centre, ray) = (pose.centre(), pose.rotation.conjugate() * self.camera.ray(pixel));
        if ray.z >= -0.05 {
            return 0.0;
        }
        let x = centre - ray * ((centre.z + 0.6 * self.unit) / ray.z);
        texture(x.x / self.unit, x.y / self.unit)
    }

    /// Points of the floor and of an object above it, which cameras see to `off` pixels
    /// (uniformly); poses as they are given.
    pub(crate) fn model(&self, poses: &[Pose], off: f64) -> (MapState, Vec<Vec<DVec2>>, Tracks) {
        let mut random = rng(5, "points", 0);
        let mut within = |r: f64| r * (2.0 * random.random::<f64>() - 1.0);
        let mut points: Vec<DVec3> = (0..60).map(|_| DVec3::new(within(0.5), within(0.5), -0.6)).collect();
        points.extend((0..100).map(|_| DVec3::new(within(0.1), within(0.1), within(0.1) - 0.3)));
        let mut keypoints = vec![Vec::new(); CAMERAS];
        let mut tracks = Tracks { of: vec![Vec::new(); CAMERAS], views: Vec::new() };
        for x in &mut points {
            *x *= self.unit;
            let track = tracks.views.len() as u32;
            let mut views = Vec::new();
            for (k, pose) in self.poses.iter().enumerate() {
                let Some(p) = self.camera.project(pose.transform(*x)) else { continue };
                views.push([k as u32, keypoints[k].len() as u32]);
                keypoints[k].push(p + DVec2::new(within(off), within(off)));
                tracks.of[k].push(track);
            }
            tracks.views.push(views);
        }
        let config = MapperConfig::default();
        let camera_of = vec![0; CAMERAS];
        let input = input(&keypoints, &tracks, &camera_of, &config);
        let mut state = MapState::new(&input, vec![self.camera.clone()]);
        poses.iter().enumerate().for_each(|(k, pose)| state.register(k, *pose));
        (0u32..).zip(&points).for_each(|(t, x)| state.place(&input, t, *x));
        (state, keypoints, tracks)
    }

    fn floor(&self) -> ScenePlane {
        let origin = DVec3::new(0.0, 0.0, -0.6 * self.unit);
        ScenePlane { origin, axes: [DVec3::X, DVec3::Y], reach: 0.5 * self.unit }
    }

    fn observations(&self, poses: &[Pose], farthest: usize) -> Vec<PlanePoint> {
        let (state, keypoints, tracks) = self.model(poses, 0.0);
        let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
        let input = input(&keypoints, &tracks, &camera_of, &config);
        let frames = (&self.frames, &[false; CAMERAS][..]);
        find_plane_tracks(self.floor(), (&state, &input), frames, farthest, &Progress::silent()).unwrap()
    }

    /// Where the true camera has a place, from a pixel.
    fn off(&self, place: &PlanePoint, s: &PlaneObservation) -> DVec2 {
        s.pixel - self.camera.project(self.poses[s.image].transform(place.position)).unwrap()
    }
}

pub(crate) fn input<'a>(
    keypoints: &'a [Vec<DVec2>],
    tracks: &'a Tracks,
    camera_of: &'a [usize],
    config: &'a MapperConfig,
) -> MappingInput<'a> {
    let (sigmas, geometries) = (&[], &[]);
    MappingInput {
        keypoints,
        sigmas,
        tracks,
        camera_of,
        geometries,
        config,
        is_video: false,
        skip: &[],
        seed: 0,
    }
}

fn lengths(room: &Room, places: &[PlanePoint]) -> Vec<f64> {
    places.iter().flat_map(|p| p.observations.iter().map(|s| room.off(p, s).length())).collect()
}

#[test]
fn the_floor_is_found_below_an_object_with_more_points_in_any_unit() {
    for (name, unit) in [("small", 1e-6), ("one", 1.0), ("large", 1e6)] {
        let room = Room::new(&format!("plane-{name}"), unit, 0.0);
        let (state, keypoints, tracks) = room.model(&room.poses, 0.0);
        let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
        let plane = widest(&state, &input(&keypoints, &tracks, &camera_of, &config)).unwrap();
        assert!(plane.normal().z.abs() > 1.0 - 1e-9, "{plane:?}");
        assert!((plane.origin.z / unit + 0.6).abs() < 1e-5, "{plane:?}");
        assert!(plane.reach > 0.2 * unit && plane.reach < 2.0 * unit, "{plane:?}");
    }
}

#[test]
fn a_cloud_without_a_floor_and_an_empty_model_have_none() {
    let room = Room::new("none", 1.0, 0.0);
    let (mut state, keypoints, tracks) = room.model(&room.poses, 0.0);
    let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
    let input = input(&keypoints, &tracks, &camera_of, &config);
    (0..60).for_each(|id| state.drop_point(id));
    assert_eq!(widest(&state, &input).filter(|p| (p.origin.z + 0.6).abs() < 0.1), None);
    (60..160).for_each(|id| state.drop_point(id));
    assert!(state.point_of.iter().flatten().all(|p| *p == NONE));
    assert_eq!(widest(&state, &input), None);
}

#[test]
fn windows_of_true_cameras_are_where_they_are_meant_to_be() {
    for (name, unit) in [("true-small", 1e-6), ("true-large", 1e6)] {
        let room = Room::new(name, unit, 0.0);
        let places = room.observations(&room.poses, 3);
        let off = lengths(&room, &places);
        assert!(off.len() > 60, "{} observations", off.len());
        assert!(median(off) < 0.05);
    }
}

#[test]
fn a_camera_that_is_off_is_told_so_against_noise() {
    // The texture's standard deviation is 0.13.
    for (name, noise, allowed) in [("clean", 0.0, 0.15), ("noisy", 0.13, 0.4)] {
        let room = Room::new(name, 1.0, noise);
        let mut poses = room.poses.clone();
        poses[4].rotation = DQuat::from_rotation_y(0.012) * DQuat::from_rotation_z(0.01) * poses[4].rotation;
        let places = room.observations(&poses, 8);
        let own = |p: &PlanePoint| {
            p.observations.iter().filter(|s| s.image == 4).map(|s| (s.off, room.off(p, s))).collect()
        };
        let of_four: Vec<(f64, DVec2)> =
            places.iter().flat_map(|p| -> Vec<(f64, DVec2)> { own(p) }).collect();
        assert!(of_four.len() >= 5, "{name}: {} observations", of_four.len());
        let moved = median(of_four.iter().map(|s| s.0).collect());
        let left = median(of_four.iter().map(|s| s.1.length()).collect());
        assert!(moved > 1.5, "{name}: the model has them {moved} px off");
        assert!(left < allowed, "{name}: found to {left} px");
        let said: Vec<f64> = places.iter().flat_map(|p| &p.observations).map(|s| s.deviation).collect();
        let truly = median(lengths(&room, &places)) / 1.1774;
        let ratio = median(said) / truly;
        // Neighbouring squares err together: what is said counts them as independent.
        assert!((0.1..5.0).contains(&ratio), "{name}: deviations are said {ratio} times too large");
    }
}

#[test]
fn black_and_saturated_frames_and_one_camera_show_nothing() {
    let room = Room::new("flat", 1.0, 0.0);
    for level in [0u8, 255] {
        for f in &room.frames.frames {
            image::GrayImage::from_pixel(SIZE.0, SIZE.1, image::Luma([level])).save(&f.path).unwrap();
        }
        assert!(room.observations(&room.poses, 8).is_empty());
    }
    let (mut state, keypoints, tracks) = room.model(&room.poses, 0.0);
    (1..CAMERAS).for_each(|k| state.unregister(k));
    let (config, camera_of) = (MapperConfig::default(), vec![0; CAMERAS]);
    let input = input(&keypoints, &tracks, &camera_of, &config);
    let frames = (&room.frames, &[false; CAMERAS][..]);
    assert!(
        find_plane_tracks(room.floor(), (&state, &input), frames, 8, &Progress::silent()).unwrap().is_empty()
    );
}

#[test]
fn places_known_better_move_the_plane_and_a_few_wrong_ones_do_not() {
    let plane = ScenePlane { origin: DVec3::ZERO, axes: [DVec3::X, DVec3::Y], reach: 2.0 };
    let tilt = DQuat::from_rotation_x(0.01);
    let mut places: Vec<DVec3> = (0..49)
        .map(|i| tilt * DVec3::new(f64::from(i % 7 - 3), f64::from(i / 7 - 3), 0.0) * 0.1 + DVec3::Z * 0.02)
        .collect();
    places.push(DVec3::new(0.1, 0.1, 0.5));
    let closer = plane.closer(&places).unwrap();
    assert!(closer.normal().angle_between(tilt * DVec3::Z) < 1e-3, "{closer:?}");
    assert!((closer.origin.z - 0.02).abs() < 1e-3, "{closer:?}");
    let about = closer.about(&places, 0.1);
    assert!((about.reach - 0.4).abs() < 0.01, "{about:?}");
    assert_eq!(plane.closer(&places[..2]), None);
    assert!(plane.closer(&[DVec3::NAN; 5]).is_none_or(|p| p.origin.is_nan() || p.normal().is_finite()));
}
