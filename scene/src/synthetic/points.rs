//! Points on a convex surface, seen by cameras around it.

use super::{default_camera, direction, normal, orbit_pose, posed_images};
use crate::rng::rng;
use crate::{
    Camera, CameraModel, Features, Keypoint, Observation, Pose, Reconstruction, ScenePoint, TrackElement,
};
use glam::{DVec2, DVec3};
use rand::Rng as _;
use std::collections::BTreeMap;

/// The surface the points lie on (about 1 unit in radius).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneShape {
    /// Unit sphere.
    Sphere,
    /// Cube of side 1.2.
    Box,
    /// Square of side 2 in the plane z = 0, seen from above.
    Plane,
}

/// Where the cameras stand; all look at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraPath {
    /// Evenly on a closed circle.
    Ring,
    /// Evenly on a part of the circle, this many degrees from first to last.
    Arc(f64),
    /// Anywhere on the sphere (for [`SceneShape::Plane`]: its upper part), distances varying by 30
    /// %.
    Random,
}

/// What [`synthetic_scene`] makes.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticOptions {
    /// Surface.
    pub shape: SceneShape,
    /// Path of the cameras.
    pub path: CameraPath,
    /// Points.
    pub num_points: usize,
    /// Cameras.
    pub num_cameras: usize,
    /// Intrinsics of all cameras; its id is kept.
    pub camera: Camera,
    /// Distance of the cameras from the origin, units.
    pub distance: f64,
    /// Height of ring and arc over the equator, degrees.
    pub elevation_deg: f64,
    /// Standard deviation of the keypoints, pixels.
    pub noise_px: f64,
    /// Share of the keypoints that lie anywhere in the image instead, in [0, 1].
    pub outliers: f64,
    /// Keypoints of no point, a image.
    pub clutter: usize,
    /// Scene units a unit of the above: 1e-6 to 1e6 to test for hidden absolute thresholds.
    pub unit: f64,
}

impl Default for SyntheticOptions {
    fn default() -> Self {
        Self {
            shape: SceneShape::Sphere,
            path: CameraPath::Ring,
            num_points: 500,
            num_cameras: 12,
            camera: default_camera(CameraModel::SimplePinhole, 640, 480),
            distance: 4.0,
            elevation_deg: 20.0,
            noise_px: 0.0,
            outliers: 0.0,
            clutter: 0,
            unit: 1.0,
        }
    }
}

/// A scene of which everything is known.
#[derive(Clone, Debug)]
pub struct SyntheticScene {
    /// True cameras, poses and points (those with two true observations or more). Observations are
    /// the keypoints of `features`, unrounded, in the same order; outliers and clutter observe no
    /// point.
    pub truth: Reconstruction,
    /// By image, in the order of `truth.images`. Descriptors are random a point and vary a little
    /// an observation.
    pub features: Vec<Features>,
    /// For every image and keypoint: the point it claims to see (outliers claim wrongly).
    pub claims: Vec<Vec<Option<u64>>>,
    /// For every image and keypoint: whether it is an outlier.
    pub outliers: Vec<Vec<bool>>,
}

impl SyntheticScene {
    /// Matches of images `a` and `b` (indices): pairs of keypoints that claim the same point.
    pub fn matches(&self, a: usize, b: usize) -> Vec<[u32; 2]> {
        let numbered =
            |i: usize| self.claims[i].iter().enumerate().filter_map(|(k, c)| Some(((*c)?, k as u32)));
        let of_b: BTreeMap<u64, u32> = numbered(b).collect();
        numbered(a).filter_map(|(id, k)| Some([k, *of_b.get(&id)?])).collect()
    }

    /// Whether a match consists of two true observations.
    pub fn is_true_match(&self, a: usize, b: usize, [i, j]: [u32; 2]) -> bool {
        !self.outliers[a][i as usize] && !self.outliers[b][j as usize]
    }
}

/// A point of the surface and its outward normal.
fn surface_point(shape: SceneShape, r: &mut crate::rng::Rng) -> (DVec3, DVec3) {
    match shape {
        SceneShape::Sphere => {
            let n = direction(r);
            (n, n)
        }
        SceneShape::Box => {
            let (axis, sign) = (r.random_range(0..3), if r.random::<bool>() { 1.0 } else { -1.0 });
            let mut x =
                DVec3::new(r.random_range(-0.6..0.6), r.random_range(-0.6..0.6), r.random_range(-0.6..0.6));
            let mut n = DVec3::ZERO;
            (x[axis], n[axis]) = (0.6 * sign, sign);
            (x, n)
        }
        SceneShape::Plane => {
            (DVec3::new(r.random_range(-1.0..1.0), r.random_range(-1.0..1.0), 0.0), DVec3::Z)
        }
    }
}

fn poses(options: &SyntheticOptions, seed: u64) -> Vec<Pose> {
    let n = options.num_cameras;
    let elevation = options.elevation_deg.to_radians();
    let poses = (0..n).map(|i| {
        let share = |parts: usize| i as f64 / parts.max(1) as f64;
        match options.path {
            CameraPath::Ring => orbit_pose(share(n) * std::f64::consts::TAU, elevation, options.distance),
            CameraPath::Arc(degrees) => {
                orbit_pose(share(n.saturating_sub(1)) * degrees.to_radians(), elevation, options.distance)
            }
            CameraPath::Random => {
                let mut r = rng(seed, "synthetic camera", i as u64);
                let distance = options.distance * r.random_range(0.85..1.15);
                let mut from = direction(&mut r);
                if options.shape == SceneShape::Plane {
                    from.z = from.z.abs().max(0.3);
                }
                let up = direction(&mut r);
                Pose::look_at(from.normalize() * distance, DVec3::ZERO, up)
            }
        }
    });
    poses.collect()
}

/// Makes a scene; the same seed gives the same scene, whatever the unit.
pub fn synthetic_scene(options: &SyntheticOptions, seed: u64) -> SyntheticScene {
    let mut r = rng(seed, "synthetic points", 0);
    let points: Vec<(DVec3, DVec3)> =
        (0..options.num_points).map(|_| surface_point(options.shape, &mut r)).collect();
    let poses = poses(options, seed);
    let mut truth = posed_images(&options.camera, &poses);
    let mut tracks: Vec<Vec<TrackElement>> = vec![Vec::new(); points.len()];
    let mut scene = SyntheticScene {
        truth: Reconstruction::default(),
        features: Vec::new(),
        claims: Vec::new(),
        outliers: Vec::new(),
    };
    for ((&id, image), pose) in truth.images.iter_mut().zip(&poses) {
        let mut observations = see(options, seed, id, pose, &points);
        observations.truncate(u32::MAX as usize);
        for (k, s) in observations.iter().enumerate() {
            if let (Some(point), false) = (s.claim, s.outlier) {
                tracks[point as usize].push(TrackElement { image: id, observation: k as u32 });
            }
        }
        image.observations =
            observations.iter().map(|s| Observation { pixel: s.pixel, point: None }).collect();
        scene.features.push(features_of(&observations, seed, id));
        scene.claims.push(observations.iter().map(|s| s.claim.map(|p| p + 1)).collect());
        scene.outliers.push(observations.iter().map(|s| s.outlier).collect());
        image.pose.translation *= options.unit;
    }
    for (i, track) in tracks.into_iter().enumerate().filter(|(_, t)| t.len() >= 2) {
        let id = i as u64 + 1;
        for element in &track {
            if let Some(image) = truth.images.get_mut(&element.image) {
                image.observations[element.observation as usize].point = Some(id);
            }
        }
        let position = points[i].0 * options.unit;
        let rgb = [0, 1, 2].map(|c| ((points[i].0[c] * 0.5 + 0.5) * 255.0) as u8);
        truth.points.insert(id, ScenePoint { position, rgb, error_px: options.noise_px, track });
    }
    scene.truth = truth;
    scene
}

struct SyntheticObservation {
    pixel: DVec2,
    /// Index of the point.
    claim: Option<u64>,
    outlier: bool,
}

/// What one camera sees: points that face it and fall into the image, then clutter.
fn see(
    options: &SyntheticOptions,
    seed: u64,
    id: u32,
    pose: &Pose,
    points: &[(DVec3, DVec3)],
) -> Vec<SyntheticObservation> {
    let mut r = rng(seed, "synthetic sightings", u64::from(id));
    let size = DVec2::new(f64::from(options.camera.width), f64::from(options.camera.height));
    let inside = |p: DVec2| p.cmpge(DVec2::ZERO).all() && p.cmplt(size).all();
    let centre = pose.centre();
    let mut observations = Vec::new();
    for (i, (x, n)) in points.iter().enumerate() {
        let (noise, lot) = (DVec2::new(normal(&mut r), normal(&mut r)), r.random::<f64>());
        let anywhere = DVec2::new(r.random::<f64>(), r.random::<f64>()) * size;
        let facing = n.dot((centre - *x).normalize()) > 0.15;
        let Some(exact) = options.camera.project(pose.transform(*x)).filter(|p| facing && inside(*p)) else {
            continue;
        };
        let outlier = lot < options.outliers;
        let pixel = if outlier { anywhere } else { exact + noise * options.noise_px };
        observations.push(SyntheticObservation { pixel, claim: Some(i as u64), outlier });
    }
    for _ in 0..options.clutter {
        let pixel = DVec2::new(r.random::<f64>(), r.random::<f64>()) * size;
        observations.push(SyntheticObservation { pixel, claim: None, outlier: false });
    }
    observations
}

/// Keypoints with descriptors: 128 bytes a point, a few units of noise an observation; clutter has
/// its own.
fn features_of(observations: &[SyntheticObservation], seed: u64, image: u32) -> Features {
    let mut features = Features::default();
    for (k, s) in observations.iter().enumerate() {
        let place = u64::from(image) << 32 | k as u64;
        features.keypoints.push(Keypoint {
            x: s.pixel.x as f32,
            y: s.pixel.y as f32,
            scale: 2.0,
            angle: 0.0,
        });
        let mut own = match s.claim {
            Some(point) => rng(seed, "synthetic descriptor", point),
            None => rng(seed, "synthetic clutter", place),
        };
        let mut noise = rng(seed, "synthetic descriptor noise", place);
        features.descriptors.extend((0..Features::DIM).map(|_| {
            let clean: u8 = own.random_range(0..100);
            clean + noise.random_range(0..6_u8)
        }));
    }
    features
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_scenes_of_every_shape_path_and_unit_have_no_residual() {
        for shape in [SceneShape::Sphere, SceneShape::Box, SceneShape::Plane] {
            for path in [CameraPath::Ring, CameraPath::Arc(60.0), CameraPath::Random] {
                for unit in [1e-6, 1.0, 1e6] {
                    let scene =
                        synthetic_scene(&SyntheticOptions { shape, path, unit, ..Default::default() }, 3);
                    scene.truth.validate().unwrap();
                    assert!(
                        scene.truth.points.len() > 150,
                        "{shape:?} {path:?}: {}",
                        scene.truth.points.len()
                    );
                    let errors = scene.truth.reprojection_errors();
                    assert!(
                        errors.len() > 600 && errors.iter().all(|&e| e < 1e-9),
                        "{shape:?} {path:?} {unit}"
                    );
                    assert!(path == CameraPath::Random || scene.matches(0, 1).len() > 50);
                }
            }
        }
    }

    #[test]
    fn noise_and_outliers_have_the_asked_for_size() {
        let options = SyntheticOptions {
            noise_px: 0.5,
            outliers: 0.3,
            clutter: 40,
            num_points: 2000,
            ..Default::default()
        };
        let scene = synthetic_scene(&options, 5);
        scene.truth.validate().unwrap();
        let errors = scene.truth.reprojection_errors();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((rms - 0.5 * 2f64.sqrt()).abs() < 0.03, "{rms}");
        let wrong: usize = scene.outliers.iter().flatten().filter(|&&o| o).count();
        let claims: usize = scene.claims.iter().flatten().flatten().count();
        assert!((wrong as f64 / claims as f64 - 0.3).abs() < 0.02);
        let matches = scene.matches(2, 3);
        let right = matches.iter().filter(|&&m| scene.is_true_match(2, 3, m)).count();
        assert!((right as f64 / matches.len() as f64 - 0.49).abs() < 0.08, "0.7 squared");
        assert!(
            scene
                .features
                .iter()
                .zip(&scene.claims)
                .all(|(f, c)| f.len() == c.len() && f.descriptors.len() == 128 * f.len())
        );
    }

    #[test]
    fn the_same_seed_gives_the_same_scene_and_descriptors_match_their_points() {
        let options = SyntheticOptions::default();
        let (a, b) = (synthetic_scene(&options, 1), synthetic_scene(&options, 1));
        assert_eq!(a.features, b.features);
        assert_ne!(a.features, synthetic_scene(&options, 2).features);
        let distance = |i: usize, j: usize| -> u32 {
            let pairs = a.features[0].descriptor(i).iter().zip(a.features[1].descriptor(j));
            pairs.map(|(p, q)| u32::from(p.abs_diff(*q)).pow(2)).sum()
        };
        for [i, j] in a.matches(0, 1) {
            let best = (0..a.features[1].len()).min_by_key(|&k| distance(i as usize, k)).unwrap();
            assert_eq!(best, j as usize);
        }
    }
}
