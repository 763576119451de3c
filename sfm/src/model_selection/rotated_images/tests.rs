use super::*;
use crate::bundle::{BundleObservation, SolveOptions, free_parameters};
use crate::solvers::essential_from_pose;
use glam::{DMat3, DVec2, DVec3};
use rand::Rng as _;
use scene::rng::rng;
use scene::{Camera, CameraModel, Pose, TwoViewGeometry};

const MODELS: [CameraModel; 3] = [CameraModel::SimplePinhole, CameraModel::Radial, CameraModel::Opencv];

fn camera(model: CameraModel) -> Camera {
    let mut camera = Camera::centred(1, model, 640, 480, 700.0);
    let n = model.num_focals();
    camera.params[n] += 9.0;
    camera.params[n + 1] -= 14.0;
    camera.params[n + 2..].iter_mut().zip([-0.1, 0.02, 0.001, -0.002]).for_each(|(p, k)| *p = k);
    camera
}

fn eye(i: usize, n: usize) -> DVec3 {
    let angle = std::f64::consts::TAU * i as f64 / n as f64;
    DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 0.8)
}

#[test]
fn a_turned_camera_sees_the_turned_image() {
    let pose = Pose::look_at(eye(1, 9), DVec3::ZERO, DVec3::Z);
    for model in MODELS {
        let camera = camera(model);
        for x in [DVec3::ZERO, DVec3::new(0.5, -0.3, 0.2), DVec3::new(-0.4, 0.6, -0.5)] {
            let pixel = camera.project(pose.transform(x)).unwrap();
            let rotated = rotate_camera(&camera).project(rotate_pose(&pose).transform(x)).unwrap();
            assert!(rotated.distance(rotate_pixel(&camera, pixel)) < 1e-9, "{model:?} {x}");
        }
        assert_eq!(rotate_camera(&rotate_camera(&camera)), camera);
    }
}

#[test]
fn the_geometry_of_a_turned_pair_holds_for_turned_pixels() {
    let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
    let poses = [0, 1].map(|i| Pose::look_at(eye(i, 9), DVec3::ZERO, DVec3::Z));
    let b_from_a = poses[1].compose(&poses[0].inverse());
    let e = essential_from_pose(&b_from_a);
    let k = DMat3::from_cols(DVec3::X * 700.0, DVec3::Y * 700.0, DVec3::new(320.0, 240.0, 1.0));
    let f = k.inverse().transpose() * e * k.inverse();
    for rotated in [[true, false], [false, true], [true, true]] {
        let mut geometry = TwoViewGeometry {
            a: 0,
            b: 1,
            kind: scene::TwoViewKind::Calibrated,
            inliers: Vec::new(),
            f: Some(f),
            e: Some(e),
            h: None,
            b_from_a: Some(b_from_a),
            median_angle: 0.1,
        };
        rotate_geometry(&mut geometry, [&camera, &camera], rotated);
        let side = |i: usize| if rotated[i] { rotate_pose(&poses[i]) } else { poses[i] };
        let expected = side(1).compose(&side(0).inverse());
        let found = geometry.b_from_a.unwrap();
        assert!(found.translation.distance(expected.translation) < 1e-12);
        assert!(found.rotation.dot(expected.rotation).abs() > 1.0 - 1e-12);
        let x = DVec3::new(0.3, 0.2, -0.4);
        let local = [0, 1].map(|i| side(i).transform(x));
        let rays = local.map(|c| c / c.z);
        assert!(rays[1].dot(geometry.e.unwrap() * rays[0]).abs() < 1e-12);
        let pixels = local.map(|c| camera.project(c).unwrap().extend(1.0));
        assert!(pixels[1].dot(geometry.f.unwrap() * pixels[0]).abs() < 1e-9);
    }
}

/// A ring of noisy views whose principal points lie off the centre by `offset(image)`, adjusted
/// with all of them at the centre.
fn adjusted_ring(n: usize, seed: u64, offset: impl Fn(usize) -> DVec2) -> BundleProblem {
    adjusted_views((n, 150), seed, |_, _| true, offset)
}

/// The same of so many images and points, each seen from where `sees(eye, point)`.
fn adjusted_views(
    (n, of_points): (usize, usize),
    seed: u64,
    sees: impl Fn(DVec3, DVec3) -> bool,
    offset: impl Fn(usize) -> DVec2,
) -> BundleProblem {
    let mut random = rng(seed, "turned", 0);
    let mut coordinate = || random.random_range(-0.9..0.9);
    let points: Vec<DVec3> =
        (0..of_points).map(|_| DVec3::new(coordinate(), coordinate(), coordinate())).collect();
    let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
    let mut problem = BundleProblem {
        camera_free: vec![free_parameters(&camera, true, false, true)],
        poses: (0..n).map(|i| Pose::look_at(eye(i, n), DVec3::ZERO, DVec3::Z)).collect(),
        pose_camera: vec![0; n],
        pose_constant: vec![false; n],
        point_constant: vec![false; points.len()],
        cameras: vec![camera],
        points,
        ..BundleProblem::default()
    };
    let mut noise = rng(seed, "turned noise", 0);
    // A sum of three uniform numbers of variance 1/12 each: standard deviation 0.3 px.
    let mut normal = || (0..3).map(|_| noise.random_range(-0.5..0.5)).sum::<f64>() * 0.6;
    for (pose, cam_from_world) in problem.poses.iter().enumerate() {
        for (point, x) in problem.points.iter().enumerate() {
            if !sees(cam_from_world.centre(), *x) {
                continue;
            }
            let pixel = problem.cameras[0].project(cam_from_world.transform(*x)).unwrap()
                + offset(pose)
                + DVec2::new(normal(), normal());
            let (pose, point) = (pose as u32, point as u32);
            problem.observations.push(BundleObservation { pose, point, pixel, sigma_px: 1.0 });
        }
    }
    let options = SolveOptions { max_iterations: 100, ..SolveOptions::default() };
    assert!(problem.solve(&options, &Progress::silent()).unwrap().usable);
    problem
}

#[test]
fn images_that_were_turned_are_found_whatever_their_order() {
    for seed in 0..5 {
        let n = 12 + 4 * seed as usize;
        let truth: Vec<bool> = (0..n).map(|i| (i * 7 + seed as usize).is_multiple_of(3)).collect();
        let offset = DVec2::new(6.0, 18.0);
        let problem = adjusted_ring(n, seed, |i| if truth[i] { -offset } else { offset });
        let found = suspects(&problem, &[Knowledge::default()], &Progress::silent()).unwrap();
        assert_eq!(found.first(), Some(&truth), "seed {seed}");
        let known = suspects(&problem, &[Knowledge::exact()], &Progress::silent()).unwrap();
        assert!(known.is_empty(), "what is known is not doubted");
    }
}

#[test]
fn one_principal_point_or_a_different_one_for_every_image_is_not_taken_for_turned_images() {
    for seed in 0..5 {
        let shared = adjusted_ring(16, seed, |_| DVec2::new(8.0, -15.0));
        assert!(
            suspects(&shared, &[Knowledge::default()], &Progress::silent()).unwrap().is_empty(),
            "seed {seed}"
        );
        let each = |i: usize| {
            let mut random = rng(seed, "stabiliser", i as u64);
            DVec2::new(random.random_range(-12.0..12.0), random.random_range(-12.0..12.0))
        };
        let stabilised = adjusted_ring(16, seed, each);
        assert!(
            suspects(&stabilised, &[Knowledge::default()], &Progress::silent()).unwrap().is_empty(),
            "seed {seed}"
        );
    }
}

#[test]
fn many_images_are_asked_in_windows_that_agree_with_each_other() {
    let n = JOINT_IMAGES + 70;
    let ahead = |eye: DVec3, x: DVec3| eye.truncate().angle_to(x.truncate()).abs() < 1.0;
    let truth: Vec<bool> = (0..n).map(|i| (i * 7).is_multiple_of(3) || (40..60).contains(&i)).collect();
    let offset = DVec2::new(6.0, 18.0);
    let rotated = adjusted_views((n, 400), 1, ahead, |i| if truth[i] { -offset } else { offset });
    let found = suspects(&rotated, &[Knowledge::default()], &Progress::silent()).unwrap();
    assert_eq!(found, [truth]);
    let none = adjusted_views((n, 400), 2, ahead, |_| offset);
    assert!(suspects(&none, &[Knowledge::default()], &Progress::silent()).unwrap().is_empty());
    // Where every image sees the same, the windows get on all the same.
    let same = adjusted_views((n, 40), 3, |_, _| true, |_| offset);
    let all: Vec<usize> = (0..n).collect();
    assert!(windows::count(&same, &all) <= n / 30 + 1);
}
