//! A plane with texture that is known everywhere, seen from several sides.

use super::*;
use crate::incremental::MapperConfig;
use crate::tracks::Tracks;
use glam::DQuat;
use rand::Rng as _;
use scene::CameraModel;
use scene::rng::rng;

const SIZE: (u32, u32) = (200, 160);
const FOCAL: f64 = 220.0;
/// Keypoints are so far off, pixels.
const OFF: f64 = 0.4;

/// Brightness of a place of the plane, of which one unit is a pixel or so.
fn texture(x: f64, y: f64) -> f64 {
    let waves =
        [(0.61, 0.22, 0.3), (-0.41, 0.57, 1.1), (0.21, -0.65, 2.0), (0.71, 0.48, 0.7), (0.15, 0.42, 4.0)];
    0.5 + 0.08 * waves.iter().map(|(a, b, c)| (a * x + b * y + c).sin()).sum::<f64>()
}

/// What the tests refer to. The plane is z = 0 and `unit` of it a pixel of the first camera.
struct RefinementScene {
    folder: std::path::PathBuf,
    unit: f64,
    camera: Camera,
    poses: Vec<Pose>,
    places: Vec<DVec3>,
    keypoints: Vec<Vec<DVec2>>,
}

impl Drop for RefinementScene {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.folder).ok();
    }
}

impl RefinementScene {
    /// Five cameras, up to 40° from the first; each keypoint off its place by a random [`OFF`].
    fn new(name: &str, unit: f64) -> Self {
        let folder = std::env::temp_dir().join(format!("sat-recon-refinement-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let camera = Camera::centred(1, CameraModel::SimplePinhole, SIZE.0, SIZE.1, FOCAL);
        let eye = |degrees: f64| {
            let (s, c) = degrees.to_radians().sin_cos();
            Pose::look_at(DVec3::new(s, 0.2 * s, -c) * FOCAL * unit, DVec3::ZERO, DVec3::Y)
        };
        let poses: Vec<Pose> = [0.0, -20.0, -10.0, 12.0, 20.0].map(eye).to_vec();
        let grid = |i: i32| DVec3::new(f64::from(i % 9 - 4) * 12.0, f64::from(i / 9 - 3) * 12.0, 0.0) * unit;
        let places: Vec<DVec3> = (0..63).map(grid).collect();
        let mut rng = rng(3, "keypoints", 0);
        let mut seen = |pose: &Pose, x: DVec3| {
            let angle = std::f64::consts::TAU * rng.random::<f64>();
            camera.project(pose.transform(x)).unwrap() + OFF * DVec2::from_angle(angle)
        };
        let keypoints = poses.iter().map(|p| places.iter().map(|x| seen(p, *x)).collect()).collect();
        Self { folder, unit, camera, poses, places, keypoints }
    }

    /// Where the ray of a pixel meets the plane.
    fn on_plane(&self, pose: &Pose, pixel: DVec2) -> DVec3 {
        let ray = pose.rotation.conjugate() * self.camera.ray(pixel);
        let centre = pose.centre();
        centre - ray * (centre.z / ray.z)
    }

    /// Files of the images as `shown` has their brightness; those that `rotated` marks are rotated
    /// by 180°.
    fn frames(&self, rotated: &[bool], shown: impl Fn(usize, f64) -> f64) -> FrameSet {
        let frame = |k: usize| {
            let path = self.folder.join(format!("{k}.png"));
            let mut image = image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                let p = self.on_plane(&self.poses[k], DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                let value = shown(k, texture(p.x / self.unit, p.y / self.unit));
                image::Luma([(255.0 * value).round() as u8])
            });
            if rotated[k] {
                image = image::imageops::rotate180(&image);
            }
            image.save(&path).unwrap();
            Frame { name: format!("{k}.png"), path, width: SIZE.0, height: SIZE.1, ..Frame::default() }
        };
        FrameSet { frames: (0..self.poses.len()).map(frame).collect(), ..FrameSet::default() }
    }

    fn refine(&self, frames: &FrameSet, rotated: &[bool]) -> Result<RefinedKeypoints, SfmError> {
        let (images, points) = (self.poses.len(), self.places.len());
        let numbers: Vec<u32> = (0..points as u32).collect();
        let of_point = |p: &u32| -> Vec<[u32; 2]> { (0..images as u32).map(|i| [i, *p]).collect() };
        let tracks =
            Tracks { of: vec![numbers.clone(); images], views: numbers.iter().map(of_point).collect() };
        let sigmas = vec![vec![1.5; points]; images];
        let config = MapperConfig::default();
        let input = MappingInput {
            keypoints: &self.keypoints,
            sigmas: &sigmas,
            tracks: &tracks,
            camera_of: &vec![0; images],
            geometries: &[],
            config: &config,
            is_video: false,
            skip: &[],
            seed: 0,
        };
        let mut state = MapState::new(&input, vec![self.camera.clone()]);
        self.poses.iter().enumerate().for_each(|(i, pose)| state.register(i, *pose));
        for (k, x) in self.places.iter().enumerate() {
            state.points.push(Some(MapPoint {
                position: *x,
                track: k as u32,
                views: tracks.views[k].clone(),
            }));
        }
        refine(&state, &input, frames, rotated, &Progress::silent())
    }

    /// Largest and median distance of the moved keypoints from the spot that the first image's
    /// keypoint shows.
    fn off(&self, refined: &RefinedKeypoints) -> (f64, f64) {
        let distance = |[image, feature]: &[u32; 2]| {
            let (image, feature) = (*image as usize, *feature as usize);
            let spot = self.on_plane(&self.poses[0], self.keypoints[0][feature]);
            let truth = self.camera.project(self.poses[image].transform(spot)).unwrap();
            truth.distance(refined.keypoints[image][feature])
        };
        let all: Vec<f64> = refined.moved.iter().map(distance).collect();
        (all.iter().copied().fold(0.0, f64::max), median(all))
    }
}

#[test]
fn keypoints_move_to_the_spot_the_middle_one_shows() {
    for (name, unit) in [("small", 1e-6), ("one", 1.0), ("large", 1e6)] {
        let scene = RefinementScene::new(name, unit);
        let light = [1.0, 0.8, 0.6, 0.9, 0.5];
        let rotated = [false, true, false, false, true];
        let frames = scene.frames(&rotated, |k, v| light[k] * v + 0.05 * k as f64);
        let refined = scene.refine(&frames, &rotated).unwrap();
        // All but those whose windows leave an image.
        assert!(refined.moved.len() > 150, "{} moved", refined.moved.len());
        assert!(refined.moved.iter().all(|v| v[0] != 0), "the middle camera's keypoints stay");
        assert_eq!(refined.keypoints[0], scene.keypoints[0]);
        let (most, half) = scene.off(&refined);
        assert!(most < 0.2 && half < 0.04, "unit {unit}: at most {most}, half below {half} px of {OFF}");
        let of_moved: Vec<f64> =
            refined.moved.iter().map(|v| f64::from(refined.sigmas[v[0] as usize][v[1] as usize])).collect();
        assert!((median(of_moved) - 1.0).abs() < 1e-6);
    }
}

#[test]
fn what_shows_nothing_or_something_else_stays() {
    let scene = RefinementScene::new("nothing", 1.0);
    let rotated = [false; 5];
    for (what, frames) in [
        ("black", scene.frames(&rotated, |_, _| 0.0)),
        ("saturated", scene.frames(&rotated, |_, v| (v * 100.0).min(1.0))),
    ] {
        let refined = scene.refine(&frames, &rotated).unwrap();
        assert!(refined.moved.is_empty() && refined.unsure.is_empty(), "{what}");
        assert_eq!(refined.keypoints, scene.keypoints, "{what}");
        assert!(refined.sigmas.iter().flatten().all(|s| s.is_finite() && *s > 0.0), "{what}");
    }
    // One image is the negative of what it should be.
    let frames = scene.frames(&rotated, |k, v| if k == 3 { 1.0 - v } else { v });
    let refined = scene.refine(&frames, &rotated).unwrap();
    assert!(refined.moved.iter().all(|v| v[0] != 3) && !refined.moved.is_empty());
    assert!(refined.unsure.iter().filter(|v| v[0] == 3).count() > 40);
    assert_eq!(refined.keypoints[3], scene.keypoints[3]);
}

#[test]
fn windows_are_warped_as_the_model_says() {
    // Steeper than what a window finds by itself, and rolled.
    let mut scene = RefinementScene::new("steep", 1.0);
    let roll = DQuat::from_rotation_z(1.2);
    scene.poses[2] =
        Pose { rotation: roll * scene.poses[2].rotation, translation: roll * scene.poses[2].translation };
    scene.keypoints[2] =
        scene.places.iter().map(|x| scene.camera.project(scene.poses[2].transform(*x)).unwrap()).collect();
    let rotated = [false; 5];
    let refined = scene.refine(&scene.frames(&rotated, |_, v| v), &rotated).unwrap();
    assert!(refined.moved.iter().filter(|v| v[0] == 2).count() > 40);
    assert!(scene.off(&refined).1 < 0.04);
    assert!(image_of_tangents(&scene.camera, &scene.poses[0], DVec3::ZERO, [DVec3::X, DVec3::Z]).is_none());
}

#[test]
fn images_that_cannot_be_read_are_named() {
    let scene = RefinementScene::new("unreadable", 1.0);
    let rotated = [false; 5];
    let mut frames = scene.frames(&rotated, |_, v| v);
    frames.frames[2].width += 1;
    let error = scene.refine(&frames, &rotated).err().unwrap();
    assert!(matches!(&error, SfmError::SizeMismatch { path, .. } if path.ends_with("2.png")), "{error}");
    // Frames are read in no order of their own: the one that is asked for must be the only bad one.
    frames.frames[2].width -= 1;
    std::fs::remove_file(&frames.frames[1].path).unwrap();
    let error = scene.refine(&frames, &rotated).err().unwrap().to_string();
    assert!(error.contains("1.png"), "{error}");
}
