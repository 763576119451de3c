//! A measured elevation of the camera, believed and doubted.

use super::axis::elevation;
use super::axis_report::decisions;
use super::config::MotionConfig;
use super::initialize::key_frames::VideoTracks;
use super::limits::FINAL_ROUNDS;
use super::solution::ChosenModel;
use super::tests::{Filmed, Turntable, grown};
use scene::decision::{Decision, Quantity, Remark, Rule};
use scene::{Camera, CameraModel};

/// Pixels by which the principal point of the films is off the centre, along the axis: half a
/// degree.
const OFF_PX: f64 = 7.0;

/// A film of a turn whose camera has its principal point off the centre, with lens distortion `k`.
fn film(k: f64, seed: u64) -> Turntable {
    let mut table = Turntable::new(36, 10.0, seed);
    table.camera.params[2] += OFF_PX;
    table.camera.params[3] = k;
    table
}

/// How the camera of the table looks down, degrees.
fn true_elevation(table: &Turntable) -> f64 {
    elevation(&table.turn).to_degrees()
}

/// Error of the axis' direction, degrees, and what was said of axis and elevation.
fn solved_with(table: &Turntable, given: Option<f64>, noise_px: f64) -> (f64, Vec<Decision>) {
    let camera = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 768.0);
    let mut filmed = Filmed::new(table.poses.len(), camera, false);
    filmed.config.motion.known_elevation = given;
    let tracks = table.tracks(noise_px, 3);
    let material = VideoTracks::of_klt(&tracks, table.poses.len());
    let video = filmed.video();
    let input = video.input(&material);
    let grown = grown(&video, &input, &tracks).unwrap();
    let starts = grown.state.cameras.clone();
    let job = filmed.job(&input, &starts);
    let context = job.context(&[]);
    let solved = ChosenModel::adjust(&context, &job, &starts, grown.turn, FINAL_ROUNDS);
    let ChosenModel { model, intrinsics, .. } = solved.unwrap().unwrap();
    let (.., covariance) = model.covariance(&context, intrinsics, 1.0).unwrap().unwrap();
    let said = decisions(&model, &context, intrinsics, &covariance, 1.0).unwrap();
    let tilt = model.turn.direction().cross(table.turn.direction()).length().asin();
    (tilt.to_degrees(), said.0)
}

/// The standard deviation towards the camera that is said of the axis, degrees.
fn said_towards(said: &[Decision]) -> f64 {
    said[0].value(Quantity::AxisTiltTowards).unwrap()
}

/// Whether the elevation was used without a doubt.
fn is_believed(decision: &Decision) -> bool {
    decision.rule == Rule::Evidence && decision.remarks == [Remark::MeasuredElevation]
}

#[test]
fn a_measured_elevation_says_where_the_principal_point_is() {
    for seed in [1, 2] {
        let table = film(0.0, seed);
        let (without, said) = solved_with(&table, None, 0.1);
        assert!(without > 0.3, "seed {seed}: {without}° off without it");
        assert!(said_towards(&said) > 0.5 * without && said.len() == 1, "{said:?}");
        let (with, said) = solved_with(&table, Some(true_elevation(&table)), 0.1);
        assert!(with < 0.05, "seed {seed}: {with}° off with it");
        assert!(is_believed(&said[1]) && said_towards(&said) >= 0.0999, "{said:?}");
    }
}

#[test]
fn an_elevation_that_cannot_be_is_doubted_or_not_used() {
    // Without distortion nothing but what is usual speaks against it.
    let table = film(0.0, 1);
    let (_, said) = solved_with(&table, Some(true_elevation(&table) + 15.0), 0.1);
    assert!(!is_believed(&said[1]), "{said:?}");
    // Distortion, whose centre is the principal point, does.
    let table = film(-0.15, 1);
    let (without, _) = solved_with(&table, None, 0.1);
    let (with, said) = solved_with(&table, Some(true_elevation(&table) + 15.0), 0.1);
    assert!(said[1].rule == Rule::Contradicted, "{said:?}");
    assert!((with - without).abs() < 0.05, "{with}° off with it, {without}° without");
}

#[test]
fn an_elevation_is_not_used_where_the_camera_is_known() {
    let table = film(0.0, 1);
    let mut filmed = Filmed::new(table.poses.len(), table.camera.clone(), true);
    filmed.config.motion.known_elevation = Some(true_elevation(&table) + 2.0);
    let tracks = table.tracks(0.1, 3);
    let material = VideoTracks::of_klt(&tracks, table.poses.len());
    let video = filmed.video();
    let input = video.input(&material);
    let job = filmed.job(&input, &filmed.cameras);
    let turn = table.turn.clone();
    let solved = ChosenModel::adjust(&job.context(&[]), &job, &filmed.cameras, turn, FINAL_ROUNDS);
    let model = solved.unwrap().unwrap().model;
    assert!(model.elevation.is_none());
    let tilt = model.turn.direction().cross(table.turn.direction()).length().to_degrees();
    assert!(tilt < 0.05, "{tilt}°");
}

#[test]
fn elevations_beyond_the_zenith_are_refused() {
    for value in [90.0, -120.0, f64::NAN, f64::INFINITY] {
        let config = MotionConfig { known_elevation: Some(value), ..MotionConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("--known-elevation"));
    }
    assert!(MotionConfig { known_elevation: Some(-12.5), ..MotionConfig::default() }.validate().is_ok());
}
