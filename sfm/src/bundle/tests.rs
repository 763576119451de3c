use super::*;
use rand::Rng as _;
use scene::CameraModel;
use scene::rng::rng;

fn ring(model: CameraModel, unit: f64, shift: DVec3) -> BundleProblem {
    ring_of(8, model, unit, shift)
}

/// A ring of cameras round 120 points in the unit ball, measured exactly; `unit` scales and `shift`
/// moves it.
fn ring_of(cameras: u32, model: CameraModel, unit: f64, shift: DVec3) -> BundleProblem {
    let mut random = rng(1, "ring", 0);
    let mut camera = Camera::centred(1, model, 640, 480, 600.0);
    let n = model.num_focals() + 2;
    camera.params[n..].iter_mut().zip([-0.1, 0.02, 0.001, -0.002]).for_each(|(p, k)| *p = k);
    let poses: Vec<Pose> = (0..cameras)
        .map(|i| {
            let angle = f64::from(i) * 0.7;
            let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 0.5 + 0.3 * angle.sin());
            Pose::look_at(eye * unit + shift, shift, DVec3::Z)
        })
        .collect();
    let mut coordinate = || random.random_range(-0.7..0.7);
    let points: Vec<DVec3> =
        (0..120).map(|_| DVec3::new(coordinate(), coordinate(), coordinate()) * unit + shift).collect();
    let mut problem = BundleProblem {
        camera_free: vec![free_parameters(&camera, true, false, true)],
        pose_camera: vec![0; poses.len()],
        pose_constant: vec![false; poses.len()],
        point_constant: vec![false; 120],
        poses,
        points,
        cameras: vec![camera],
        ..BundleProblem::default()
    };
    for (pose, cam_from_world) in problem.poses.iter().enumerate() {
        for (point, x) in problem.points.iter().enumerate() {
            let pixel = problem.cameras[0].project(cam_from_world.transform(*x)).unwrap();
            let (pose, point) = (pose as u32, point as u32);
            problem.observations.push(BundleObservation { pose, point, pixel, sigma_px: 1.0 });
        }
    }
    problem
}

/// Moves everything but the first pose by about a hundredth of the scene and the focal length by 5
/// %.
fn disturb(problem: &mut BundleProblem, unit: f64) {
    let mut random = rng(2, "disturb", 0);
    let mut small = || DVec3::from_array(std::array::from_fn(|_| random.random_range(-0.02..0.02)));
    for pose in problem.poses.iter_mut().skip(1) {
        let centre = pose.centre() + small() * unit;
        *pose = Pose::from_centre(DQuat::from_scaled_axis(small()) * pose.rotation, centre);
    }
    for x in &mut problem.points {
        *x += small() * unit;
    }
    for camera in &mut problem.cameras {
        let n = camera.model.num_focals();
        camera.params[..n].iter_mut().for_each(|f| *f *= 1.05);
        camera.params[n + 2..].iter_mut().for_each(|k| *k = 0.0);
    }
}

fn solve(problem: &mut BundleProblem) -> BundleSummary {
    let options = SolveOptions { function_tolerance: 1e-14, ..SolveOptions::default() };
    problem.solve(&options, &Progress::silent()).unwrap()
}

fn worst_residual(problem: &BundleProblem) -> f64 {
    let residual = |o: &BundleObservation| {
        let x = problem.poses[o.pose as usize].transform(problem.points[o.point as usize]);
        (problem.cameras[0].project(x).unwrap() - o.pixel).length()
    };
    problem.observations.iter().map(residual).fold(0.0, f64::max)
}

#[test]
fn recovers_poses_and_intrinsics_of_every_model_in_few_iterations() {
    for model in CameraModel::ALL {
        let truth = ring(model, 1.0, DVec3::ZERO);
        let mut problem = truth.clone();
        disturb(&mut problem, 1.0);
        let summary = solve(&mut problem);
        assert!(worst_residual(&problem) < 1e-6, "{model:?} {summary:?}");
        assert!(summary.iterations < 15, "wrong Jacobians converge slowly: {model:?} {summary:?}");
        for (p, t) in problem.cameras[0].params.iter().zip(&truth.cameras[0].params) {
            assert!((p - t).abs() < 1e-5 * (1.0 + t.abs()), "{model:?} {:?}", problem.cameras[0]);
        }
    }
}

/// More than `kManyPoses`: the cameras are solved for by conjugate gradients.
#[test]
fn many_poses_are_recovered_too() {
    let mut problem = ring_of(240, CameraModel::SimplePinhole, 1.0, DVec3::ZERO);
    disturb(&mut problem, 1.0);
    assert!(worst_residual(&problem) > 5.0);
    solve(&mut problem);
    assert!(worst_residual(&problem) < 1e-2, "{}", worst_residual(&problem));
    let focal = problem.cameras[0].params[0];
    assert!((focal - 600.0).abs() < 0.01, "{focal}");
}

#[test]
fn units_and_origin_do_not_matter() {
    for (unit, shift) in [(1e-6, DVec3::ZERO), (1e6, DVec3::ZERO), (1.0, DVec3::new(1e7, -1e7, 1e7))] {
        let mut problem = ring(CameraModel::SimpleRadial, unit, shift);
        disturb(&mut problem, unit);
        solve(&mut problem);
        assert!(worst_residual(&problem) < 1e-4, "unit {unit} shift {shift}: {}", worst_residual(&problem));
        assert!((problem.cameras[0].params[0] - 600.0).abs() < 1e-2, "unit {unit} shift {shift}");
    }
}

#[test]
fn numbers_that_are_not_finite_are_an_error_and_change_nothing() {
    for bad in [f64::NAN, f64::INFINITY] {
        let mut problem = ring(CameraModel::Pinhole, 1.0, DVec3::ZERO);
        problem.observations[7].pixel.x = bad;
        assert!(problem.solve(&SolveOptions::default(), &Progress::silent()).is_err());
        let mut problem = ring(CameraModel::Pinhole, 1.0, DVec3::ZERO);
        problem.cameras[0].params[0] = bad;
        assert!(problem.solve(&SolveOptions::default(), &Progress::silent()).is_err());
    }
    let mut empty = BundleProblem::default();
    assert!(!empty.solve(&SolveOptions::default(), &Progress::silent()).unwrap().usable);
}

#[test]
fn a_robust_loss_shrugs_off_wrong_matches() {
    let mut problem = ring(CameraModel::SimplePinhole, 1.0, DVec3::ZERO);
    problem.observations.iter_mut().step_by(20).for_each(|o| o.pixel += DVec2::new(40.0, -25.0));
    disturb(&mut problem, 1.0);
    let options =
        SolveOptions { loss: RobustLoss::Cauchy(1.0), max_iterations: 100, ..SolveOptions::default() };
    problem.solve(&options, &Progress::silent()).unwrap();
    assert!((problem.cameras[0].params[0] - 600.0).abs() < 0.5, "{:?}", problem.cameras[0]);
}

#[test]
fn what_is_held_stays_to_the_bit() {
    let mut problem = ring(CameraModel::Opencv, 1.0, DVec3::ZERO);
    disturb(&mut problem, 1.0);
    problem.pose_constant[3] = true;
    problem.point_constant[5] = true;
    problem.camera_free[0] = vec![true, true, false, false, true, false, false, false];
    let before = problem.clone();
    solve(&mut problem);
    assert_eq!(problem.poses[3], before.poses[3]);
    assert_eq!(problem.points[5], before.points[5]);
    assert_eq!(problem.cameras[0].params[2..4], before.cameras[0].params[2..4]);
    assert_eq!(problem.cameras[0].params[5..], before.cameras[0].params[5..]);
    assert_ne!(problem.cameras[0].params[0], before.cameras[0].params[0]);
}

#[test]
fn a_prior_pulls_as_its_sigma_says() {
    let solved = |sigma| {
        let mut problem = ring(CameraModel::SimplePinhole, 1.0, DVec3::ZERO);
        problem.priors.push(IntrinsicsPrior { camera: 0, parameter: 0, mean: 660.0, sigma });
        solve(&mut problem);
        problem.cameras[0].params[0]
    };
    assert!((solved(1e6) - 600.0).abs() < 1e-3);
    assert!((solved(1e-4) - 660.0).abs() < 1e-3);
}

#[test]
fn standard_deviations_match_the_scatter_of_repeated_measurements() {
    let truth = ring(CameraModel::SimplePinhole, 1e3, DVec3::splat(1e4));
    let covariance = truth.covariance(&SolveOptions::default()).unwrap().unwrap();
    let (focal_sd, pose_sd) = (covariance.cameras[0][0].sqrt(), covariance.poses[4]);
    let mut scatter = [0.0; 3];
    let runs = 60;
    for run in 0..runs {
        let mut random = rng(3, "noise", run);
        let mut noise = || (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
        let mut problem = truth.clone();
        problem.observations.iter_mut().for_each(|o| o.pixel += DVec2::new(noise(), noise()));
        solve(&mut problem);
        let turned = problem.poses[4].rotation * truth.poses[4].rotation.conjugate();
        scatter[0] += (problem.cameras[0].params[0] - 600.0).powi(2);
        scatter[1] += turned.to_scaled_axis().x.powi(2);
        scatter[2] += (problem.poses[4].centre() - truth.poses[4].centre()).y.powi(2);
    }
    let measured = scatter.map(|s: f64| (s / runs as f64).sqrt());
    for (m, predicted) in measured.iter().zip([focal_sd, pose_sd[0], pose_sd[4]]) {
        assert!(
            (0.75..1.33).contains(&(m / predicted)),
            "measured {measured:?}, predicted {focal_sd} {pose_sd:?}"
        );
    }
}

#[test]
fn standard_deviations_do_not_depend_on_the_order_of_elimination() {
    // Each point is seen from three places in a row, so the poses lie in several levels.
    let mut chain = ring(CameraModel::Radial, 1.0, DVec3::ZERO);
    let near = |o: &BundleObservation| (o.pose + 8 - o.point % 8) % 8 < 3;
    chain.observations.retain(near);
    // A point that all see, all but without weight: one level.
    let mut knot = chain.clone();
    for pose in 3..8 {
        let pixel = knot.cameras[0].project(knot.poses[pose].transform(knot.points[0])).unwrap();
        let observation = BundleObservation { pose: pose as u32, point: 0, pixel, sigma_px: 1e6 };
        knot.observations.push(observation);
    }
    let of = |p: &BundleProblem| p.covariance(&SolveOptions::default()).unwrap().unwrap();
    let (chain, knot) = (of(&chain), of(&knot));
    let all =
        |c: &BundleCovariance| c.poses.iter().flatten().chain(&c.cameras[0]).copied().collect::<Vec<f64>>();
    for (a, b) in all(&chain).iter().zip(&all(&knot)) {
        assert!((a - b).abs() <= 1e-6 * b.abs(), "{a} {b}");
    }
}

#[test]
fn the_same_problem_gives_the_same_bytes() {
    let run = || {
        let mut problem = ring(CameraModel::Radial, 1.0, DVec3::ZERO);
        disturb(&mut problem, 1.0);
        solve(&mut problem);
        problem.poses.iter().flat_map(|p| p.translation.to_array()).map(f64::to_bits).collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn points_alone_settle_where_their_robust_cost_is_least() {
    let exact = ring(CameraModel::Radial, 1.0, DVec3::ZERO);
    let mut problem = exact.clone();
    // One observation of eight is wrong: far from what the others say the loss bends the other way.
    problem.observations.iter_mut().filter(|o| o.pose == 2).for_each(|o| o.pixel += DVec2::new(30.0, -20.0));
    let mut random = rng(5, "settle", 0);
    for x in &mut problem.points {
        *x += DVec3::from_array(std::array::from_fn(|_| random.random_range(-0.02..0.02)));
    }
    let loss = RobustLoss::Cauchy(0.5);
    let settled = problem.settle_points(loss);
    let slope = |point: usize, x: DVec3| -> f64 {
        let views = problem.observations.iter().filter(|o| o.point as usize == point);
        let at = |x: DVec3| -> f64 {
            let error = |o: &BundleObservation| {
                let p = problem.cameras[0].project(problem.poses[o.pose as usize].transform(x)).unwrap();
                crate::solvers::levenberg::cauchy(p.distance_squared(o.pixel), 0.5).0
            };
            views.clone().map(error).sum()
        };
        let steps = [DVec3::X, DVec3::Y, DVec3::Z].map(|d| (at(x + d * 1e-6) - at(x - d * 1e-6)) / 2e-6);
        DVec3::from_array(steps).length()
    };
    for (i, (x, was)) in settled.iter().zip(&problem.points).enumerate() {
        assert!(slope(i, *x) < 0.01 * slope(i, *was), "{i}: {} of {}", slope(i, *x), slope(i, *was));
        assert!((*x - exact.points[i]).length() < 2e-4, "{i}: {x} should be near {}", exact.points[i]);
    }
}

#[test]
fn points_that_nothing_can_settle_stay() {
    let mut problem = ring(CameraModel::SimplePinhole, 1.0, DVec3::ZERO);
    disturb(&mut problem, 1.0);
    problem.point_constant[5] = true;
    problem.points[6] = problem.poses[0].centre() * 2.0; // behind a camera
    problem.points[7] = DVec3::NAN;
    problem.observations.retain(|o| o.point != 8);
    problem.observations.iter_mut().filter(|o| o.point == 9).for_each(|o| o.pixel = DVec2::NAN);
    let settled = problem.settle_points(RobustLoss::Cauchy(1.0));
    for i in [5, 6, 8, 9] {
        assert_eq!(settled[i], problem.points[i], "{i}");
    }
    assert!(settled[7].is_nan());
    assert_ne!(settled[4], problem.points[4]);
    assert_eq!(problem.settle_points(RobustLoss::Squared)[..7], problem.points[..7]);
}
