//! Exact turns at the ends of what is filmed: other senses, axes, rates and lengths.

use super::motion::CircularMotion;
use super::tests::{Turntable, favours_single, problem, solve, solve_from};
use crate::bundle::{SolveOptions, free_parameters};
use glam::DVec3;

/// A table that turns about another axis, at other angles (degrees).
fn table(direction: DVec3, place: DVec3, angles_deg: impl Iterator<Item = f64>, seed: u64) -> Turntable {
    let angles: Vec<Option<f64>> = angles_deg.map(|a| Some(a.to_radians())).collect();
    let mut table = Turntable::new(angles.len(), 1.0, seed);
    table.turn = CircularMotion::new(direction, place, angles).unwrap();
    table.poses = (0..table.poses.len()).map(|i| table.turn.pose(i).unwrap()).collect();
    table
}

fn steady(frames: usize, step: f64) -> impl Iterator<Item = f64> {
    (0..frames).map(move |i| step * i as f64)
}

const DOWN: DVec3 = DVec3::new(0.05, -1.0, -0.3);
const MIDDLE: DVec3 = DVec3::new(0.1, 0.0, 4.0);

#[test]
fn the_sense_of_the_turn_does_not_matter() {
    let table = table(DOWN, MIDDLE, steady(36, -10.0), 1);
    let (model, comparison) = solve(&table, table.tracks(0.0, 1)).unwrap();
    assert!(table.worst_angle(&model) < 1e-6, "{}", table.worst_angle(&model));
    favours_single(comparison);
}

#[test]
fn an_axis_may_lie_across_the_image() {
    for (seed, direction) in [(2, DVec3::new(-1.0, 0.05, -0.3)), (3, DVec3::new(1.0, 0.1, -0.25))] {
        let table = table(direction, DVec3::new(0.0, 0.1, 4.0), steady(36, 10.0), seed);
        let (model, comparison) = solve(&table, table.tracks(0.0, seed)).unwrap();
        assert!(table.worst_angle(&model) < 1e-6, "seed {seed}: {}", table.worst_angle(&model));
        favours_single(comparison);
    }
}

#[test]
fn an_axis_beside_the_image_centre_is_found_with_the_principal_point() {
    let mut table = table(DOWN, DVec3::new(0.9, 0.1, 4.0), steady(36, 10.0), 4);
    table.camera.params[1] += 7.0;
    table.camera.params[2] -= 6.0;
    let (model, _) = solve(&table, table.tracks(0.0, 4)).unwrap();
    assert!(table.worst_angle(&model) < 1e-5, "{}", table.worst_angle(&model));
    let off = model.state.cameras[0].principal_point() - table.camera.principal_point();
    assert!(off.length() < 0.1, "{off}");
    let tilt = model.turn.direction().cross(table.turn.direction()).length();
    assert!(tilt < 1e-4, "{tilt}");
}

#[test]
fn a_rate_that_varies_by_half_is_followed() {
    let mut angle = 0.0;
    let angles = (0..48).map(move |i| {
        angle += 7.5 * (1.0 + 0.5 * (0.4 * f64::from(i)).sin());
        angle
    });
    let table = table(DOWN, MIDDLE, angles, 5);
    let (model, comparison) = solve(&table, table.tracks(0.0, 5)).unwrap();
    assert!(table.worst_angle(&model) < 1e-5, "{}", table.worst_angle(&model));
    favours_single(comparison);
}

#[test]
fn a_few_frames_are_enough_where_they_are_exact() {
    let table = table(DOWN, MIDDLE, steady(6, 8.0), 6);
    let (model, _) = solve(&table, table.tracks(0.0, 6)).unwrap();
    assert!(table.worst_angle(&model) < 1e-3, "{}", table.worst_angle(&model));
}

#[test]
fn the_unit_of_the_scene_does_not_matter() {
    for unit in [1e-4, 1e4] {
        let mut table = table(DOWN, MIDDLE * unit, steady(36, 10.0), 7);
        table.points.iter_mut().for_each(|x| *x *= unit);
        let (model, _) = solve(&table, table.tracks(0.0, 7)).unwrap();
        assert!(table.worst_angle(&model) < 1e-6, "unit {unit}: {}", table.worst_angle(&model));
    }
}

/// Standard deviation of the principal point along an axis that is vertical in the image, for noise
/// of one pixel, with all intrinsics free and lens distortion `k`; infinite where it is not
/// determined.
fn deviation_along(k: f64, sideways: f64) -> f64 {
    let mut table = table(DVec3::new(0.0, -1.0, -0.3), DVec3::new(sideways, 0.0, 4.0), steady(36, 10.0), 9);
    table.camera.params[3] = k;
    let mut problem = problem(&table, 1.0, 0.0, 0);
    problem.bundle.camera_free = vec![free_parameters(&table.camera, true, true, true)];
    let covariance = problem.covariance(&SolveOptions::default(), 1.0).unwrap();
    covariance.map_or(f64::INFINITY, |c| c.cameras[0][2 * 4 + 2].sqrt())
}

#[test]
fn the_principal_point_along_a_centred_axis_is_seen_by_distortion_alone() {
    let (pinhole, weak, strong) =
        (deviation_along(0.0, 0.0), deviation_along(-0.05, 0.0), deviation_along(-0.2, 0.0));
    assert!(!(pinhole < 1e3), "without distortion it is not determined: {pinhole}");
    assert!(strong < 0.5 * weak && weak < 1e3, "{weak} px, {strong} px");
    // An axis beside the image centre is not in the plane of symmetry.
    let beside = deviation_along(0.0, 1.0);
    assert!(beside < 50.0, "{beside} px");
}

#[test]
fn known_intrinsics_leave_no_tilt() {
    let table = table(DOWN, MIDDLE, steady(72, 5.0), 10);
    let (model, _) = solve_from(&table, table.tracks(0.15, 10), table.camera.clone(), true).unwrap();
    let direction = model.turn.direction();
    let tilt = direction.cross(table.turn.direction()).length().to_degrees();
    assert!(tilt < 0.1, "{tilt}°");
    assert_eq!(model.state.cameras[0].params, table.camera.params);
    assert!(table.worst_angle(&model) < 0.01, "{}", table.worst_angle(&model));
}
