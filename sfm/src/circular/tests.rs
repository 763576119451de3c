use super::evidence::MotionComparison;
use super::initialize::key_frames::{VideoTracks, drop_stationary};
use super::initialize::video_seed::VideoStart;
use super::job::{MotionInput, VideoJob};
use super::limits::FINAL_ROUNDS;
use super::model::AxisModel;
use super::motion::CircularMotion;
use super::motion::{pose_at, wrap_angle};
use super::problem::CircularProblem;
use super::solution::ChosenModel;
use super::video::STARTS;
use crate::bundle::{BundleObservation, BundleProblem, SolveOptions, free_parameters};
use crate::config::SfmConfig;
use crate::incremental::state::MappingInput;
use crate::klt::KltTrack;
use crate::knowledge::Knowledge;
use crate::solvers::testing::{normal, unit_vector};
use glam::{DQuat, DVec2, DVec3};
use rand::Rng as _;
use scene::decision::Decision;
use scene::rng::rng;
use scene::{Camera, CameraModel, Frame, FrameSet, Pose, Progress};

/// A sphere of points that turns before a camera that looks down on it.
pub(super) struct Turntable {
    pub camera: Camera,
    pub turn: CircularMotion,
    pub points: Vec<DVec3>,
    pub poses: Vec<Pose>,
}

impl Turntable {
    pub(crate) fn new(frames: usize, step_deg: f64, seed: u64) -> Self {
        let mut r = rng(seed, "turntable", 0);
        let mut camera = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 700.0);
        camera.params[3] = -0.05;
        let direction = DVec3::new(r.random_range(-0.1..0.1), -1.0, r.random_range(-0.5..-0.2));
        let angles: Vec<Option<f64>> =
            (0..frames).map(|i| Some((step_deg * i as f64).to_radians())).collect();
        let turn = CircularMotion::new(direction, DVec3::new(0.1, 0.0, 4.0), angles).unwrap();
        let points = (0..400).map(|_| unit_vector(&mut r) * r.random_range(0.8..1.0)).collect();
        let poses = (0..frames).map(|i| turn.pose(i).unwrap()).collect();
        Self { camera, turn, points, poses }
    }

    pub(crate) fn sees(&self, frame: usize, x: DVec3) -> Option<DVec2> {
        let pose = &self.poses[frame];
        let facing = x.normalize().dot((pose.centre() - x).normalize()) > 0.2;
        let pixel = self.camera.project(pose.transform(x)).filter(|_| facing)?;
        let size = DVec2::new(640.0, 480.0);
        (pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all()).then_some(pixel)
    }

    /// Runs of frames in which a point is seen.
    pub(crate) fn tracks(&self, noise_px: f64, seed: u64) -> Vec<KltTrack> {
        let mut r = rng(seed, "track noise", 0);
        let mut tracks = Vec::new();
        for x in &self.points {
            let mut run: Option<KltTrack> = None;
            for frame in 0..self.poses.len() {
                match self.sees(frame, *x) {
                    Some(p) => {
                        let p = p + DVec2::new(normal(&mut r), normal(&mut r)) * noise_px;
                        run.get_or_insert(KltTrack { first: frame, positions: vec![] }).positions.push(p);
                    }
                    None => tracks.extend(run.take()),
                }
            }
            tracks.extend(run);
        }
        tracks.retain(|t| t.positions.len() >= 3);
        tracks
    }

    /// Largest error of an angle against the truth, radians; all frames must have one.
    pub(crate) fn worst_angle(&self, model: &AxisModel) -> f64 {
        let found: Vec<f64> =
            model.turn.angles.iter().map(|a| a.expect("every frame has an angle")).collect();
        let sense = if model.turn.direction().dot(self.turn.direction()) < 0.0 { -1.0 } else { 1.0 };
        let off =
            found.iter().zip(&self.turn.angles).map(|(a, b)| wrap_angle(sense * (a - found[0]) - b.unwrap()));
        off.map(f64::abs).fold(0.0, f64::max)
    }

    /// Angle between the axis and the truth, radians.
    fn axis_error(&self, model: &AxisModel) -> f64 {
        model.turn.direction().dot(self.turn.direction()).abs().min(1.0).acos()
    }
}

fn video(frames: usize) -> FrameSet {
    let frame = |i: usize| Frame {
        name: format!("{i:03}.png"),
        width: 640,
        height: 480,
        time_s: Some(0.1 * i as f64),
        ..Frame::default()
    };
    FrameSet { frames: (0..frames).map(frame).collect(), is_video: true, ..FrameSet::default() }
}

/// Frames of one camera and the settings that go with them: what the jobs of tests refer to.
pub(super) struct Filmed {
    frames: FrameSet,
    pub config: SfmConfig,
    progress: Progress,
    pub cameras: [Camera; 1],
    pub known: [Knowledge; 1],
    camera_of: Vec<usize>,
}

impl Filmed {
    /// `fixed`: the intrinsics are known.
    pub(crate) fn new(frames: usize, camera: Camera, fixed: bool) -> Self {
        Self {
            frames: video(frames),
            config: SfmConfig::default(),
            progress: Progress::silent(),
            cameras: [camera],
            known: [Knowledge { fixed, ..Knowledge::default() }],
            camera_of: vec![0; frames],
        }
    }

    pub(crate) fn video(&self) -> VideoJob<'_> {
        let Self { frames, config, progress, cameras, known, camera_of } = self;
        VideoJob { frames, config, cameras, camera_of, known, progress }
    }

    pub(crate) fn job<'a>(&'a self, input: &'a MappingInput<'a>, starts: &'a [Camera]) -> MotionInput<'a> {
        let Self { config, progress, cameras, known, .. } = self;
        MotionInput {
            input,
            cameras,
            known,
            starts,
            named: None,
            config: &config.motion,
            features: &[],
            room: None,
            progress,
        }
    }
}

/// Follows the whole path from tracks to the adjusted model.
pub(super) fn solve(
    table: &Turntable,
    tracks: Vec<KltTrack>,
) -> Result<(AxisModel, Option<MotionComparison>), String> {
    solve_from(table, tracks, Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 768.0), false)
}

/// The model that grows from the first start.
pub(super) fn grown(
    job: &VideoJob<'_>,
    input: &MappingInput<'_>,
    tracks: &[KltTrack],
) -> Result<AxisModel, Box<Decision>> {
    let start = VideoStart::find(job, tracks, &[])?;
    job.grow(input, &start).unwrap().map_err(Box::new)
}

/// The same from some intrinsics, which may be known.
pub(super) fn solve_from(
    table: &Turntable,
    mut tracks: Vec<KltTrack>,
    camera: Camera,
    fixed: bool,
) -> Result<(AxisModel, Option<MotionComparison>), String> {
    let filmed = Filmed::new(table.poses.len(), camera, fixed);
    drop_stationary(&mut tracks);
    let job = filmed.video();
    let material = VideoTracks::of_klt(&tracks, table.poses.len());
    let input = job.input(&material);
    let grown = grown(&job, &input, &tracks).map_err(|why| format!("{why:?}"))?;
    let starts = grown.state.cameras.clone();
    let job = filmed.job(&input, &starts);
    let context = job.context(&[]);
    let solved = ChosenModel::adjust(&context, &job, &starts, grown.turn, FINAL_ROUNDS).unwrap();
    let ChosenModel { model, intrinsics, .. } = solved.ok_or("no model")?;
    let comparison = MotionComparison::of(Some(&model), &model.state, &context, intrinsics).unwrap();
    Ok((model, comparison))
}

pub(super) fn favours_single(comparison: Option<MotionComparison>) {
    let comparison = comparison.unwrap();
    assert!(comparison.favours_single(), "{:?}", comparison.describe());
}

#[test]
fn an_exact_turn_is_recovered_from_its_tracks_alone() {
    for seed in 0..3 {
        let table = Turntable::new(36, 10.0, seed);
        let (model, comparison) = solve(&table, table.tracks(0.0, seed)).unwrap();
        assert!(table.worst_angle(&model) < 1e-6, "seed {seed}: {}", table.worst_angle(&model));
        let direction = model.turn.direction().cross(table.turn.direction()).length();
        assert!(direction < 1e-6, "seed {seed}: axis off by {direction}");
        let camera = &model.state.cameras[0];
        assert!((camera.params[0] - 700.0).abs() < 1e-3, "seed {seed}: {:?}", camera.params);
        favours_single(comparison);
    }
}

#[test]
fn points_that_hardly_move_and_do_not_last_do_not_hide_the_turn() {
    // A panel on the axis: key frames as far apart as its points need to move share none of them.
    let mut table = Turntable::new(72, 5.0, 10);
    for x in table.points.iter_mut().skip(60) {
        *x *= DVec3::new(0.12, 0.12, 1.0);
    }
    let short = |t: &KltTrack| -> Vec<KltTrack> {
        let part = |(k, p): (usize, &[DVec2])| KltTrack { first: t.first + 4 * k, positions: p.to_vec() };
        t.positions.chunks(4).enumerate().map(part).filter(|t| t.positions.len() > 2).collect()
    };
    let tracks: Vec<KltTrack> = table.tracks(0.02, 10).iter().flat_map(short).collect();
    let (model, _) = solve(&table, tracks).unwrap();
    assert!(table.worst_angle(&model) < 0.02, "{}", table.worst_angle(&model));
}

#[test]
fn a_later_start_avoids_what_moves_by_itself_in_the_first() {
    // For a third of the video, most tracks are of a part that turns about another axis as well.
    let table = Turntable::new(72, 5.0, 11);
    let mut part = Turntable::new(72, 5.0, 12);
    for (k, pose) in part.poses.iter_mut().enumerate() {
        pose.rotation *= DQuat::from_rotation_x(0.08 * k as f64);
    }
    part.points.extend(Turntable::new(72, 5.0, 13).points);
    let mut tracks = part.tracks(0.0, 12);
    tracks.retain_mut(|t| {
        t.positions.truncate(24usize.saturating_sub(t.first));
        t.positions.len() >= 3
    });
    tracks.extend(table.tracks(0.0, 11));
    let filmed = Filmed::new(72, table.camera.clone(), false);
    let job = filmed.video();
    let material = VideoTracks::of_klt(&tracks, 72);
    let input = job.input(&material);

    let mut starts = Vec::new();
    let mut is_right = Vec::new();
    for _ in 0..STARTS {
        let start = VideoStart::find(&job, &tracks, &starts).unwrap();
        let grown = job.grow(&input, &start).unwrap();
        is_right.push(grown.is_ok_and(|model| table.axis_error(&model) < 0.02));
        starts.push(start);
    }

    assert_eq!([is_right[0], is_right[STARTS - 1]], [false, true], "{is_right:?}");
}

#[test]
fn a_part_of_a_turn_is_enough() {
    let table = Turntable::new(31, 2.0, 4);
    let (model, _) = solve(&table, table.tracks(0.0, 4)).unwrap();
    assert!(table.worst_angle(&model) < 1e-5, "{}", table.worst_angle(&model));
    let (model, _) = solve(&table, table.tracks(0.2, 5)).unwrap();
    assert!(table.worst_angle(&model) < 0.01, "{}", table.worst_angle(&model));
}

#[test]
fn noise_and_things_that_stand_still_do_little_harm() {
    let table = Turntable::new(72, 5.0, 6);
    let mut tracks = table.tracks(0.2, 6);
    let mut r = rng(6, "still", 0);
    for _ in 0..600 {
        let p = DVec2::new(r.random_range(0.0..640.0), r.random_range(0.0..480.0));
        let shiver = || p + DVec2::new(normal(&mut r), normal(&mut r)) * 0.1;
        let positions = std::iter::repeat_with(shiver).take(72).collect();
        tracks.push(KltTrack { first: 0, positions });
    }
    let (model, comparison) = solve(&table, tracks).unwrap();
    let drift = table.worst_angle(&model);
    assert!(drift < 0.01, "an open chain of angles drifts by {drift}");
    assert!((model.state.cameras[0].params[0] / 700.0 - 1.0).abs() < 0.02);
    favours_single(comparison);
}

#[test]
fn an_object_that_looks_alike_from_two_sides_turns_once_and_not_twice() {
    let mut table = Turntable::new(36, 10.0, 7);
    let half = DQuat::from_rotation_z(std::f64::consts::PI);
    table.points.truncate(200);
    let twins: Vec<DVec3> = table.points.iter().map(|x| half * *x).collect();
    table.points.extend(twins);
    let (model, _) = solve(&table, table.tracks(0.05, 7)).unwrap();
    assert!(table.worst_angle(&model) < 0.01, "{}", table.worst_angle(&model));
}

#[test]
fn a_camera_that_wobbles_is_not_a_turn() {
    let mut table = Turntable::new(36, 10.0, 8);
    let mut r = rng(8, "wobble", 0);
    for pose in &mut table.poses {
        let shake = DQuat::from_scaled_axis(unit_vector(&mut r) * 0.001);
        *pose = Pose::new(shake * pose.rotation, shake * pose.translation + unit_vector(&mut r) * 0.005);
    }
    let (_, comparison) = solve(&table, table.tracks(0.2, 8)).unwrap();
    let comparison = comparison.unwrap();
    assert!(!comparison.favours_single(), "{:?}", comparison.describe());
}

#[test]
fn what_does_not_turn_is_no_model() {
    let table = Turntable::new(20, 5.0, 9);
    assert!(solve(&table, Vec::new()).is_err());
    let p = |i: usize| DVec2::new(30.0 + 25.0 * (i % 20) as f64, 30.0 + 20.0 * (i / 20) as f64);
    let still = |i: usize| KltTrack { first: 0, positions: vec![p(i); 20] };
    assert!(solve(&table, (0..300).map(still).collect()).is_err());
    let mut r = rng(9, "walk", 0);
    let mut wander = |i: usize| {
        let mut at = p(i);
        let mut step = || {
            at += DVec2::new(normal(&mut r), normal(&mut r)) * 12.0;
            at
        };
        KltTrack { first: 0, positions: std::iter::repeat_with(&mut step).take(20).collect() }
    };
    let random: Vec<KltTrack> = (0..300).map(&mut wander).collect();
    let result = solve(&table, random);
    assert!(result.is_err() || result.is_ok_and(|(_, c)| c.is_none_or(|c| !c.favours_single())));
}

/// All points of the table in all frames in which they are seen, in scenes of any unit.
pub(super) fn problem(table: &Turntable, unit: f64, noise_px: f64, seed: u64) -> CircularProblem {
    let mut r = rng(seed, "pixels", 0);
    let n = table.poses.len();
    let mut bundle = BundleProblem {
        camera_free: vec![free_parameters(&table.camera, true, false, true)],
        cameras: vec![table.camera.clone()],
        pose_camera: vec![0; n],
        pose_constant: vec![false; n],
        points: table.points.iter().map(|x| *x * unit).collect(),
        point_constant: vec![false; table.points.len()],
        poses: vec![Pose::IDENTITY; n],
        ..BundleProblem::default()
    };
    for frame in 0..n {
        for (i, x) in table.points.iter().enumerate() {
            let Some(pixel) = table.sees(frame, *x) else { continue };
            let pixel = pixel + DVec2::new(normal(&mut r), normal(&mut r)) * noise_px;
            bundle.observations.push(BundleObservation {
                pose: frame as u32,
                point: i as u32,
                pixel,
                sigma_px: 1.0,
            });
        }
    }
    let axis = Pose { translation: table.turn.axis.translation * unit, ..table.turn.axis };
    CircularProblem::new(bundle, axis, table.turn.angles.iter().flatten().copied().collect())
}

#[test]
fn the_adjustment_returns_to_the_truth_in_any_unit() {
    let table = Turntable::new(12, 30.0, 1);
    for unit in [1e-6, 1.0, 1e6] {
        let mut problem = problem(&table, unit, 0.0, 0);
        let mut r = rng(2, "disturb", 0);
        problem.axis.rotation =
            (DQuat::from_scaled_axis(unit_vector(&mut r) * 0.02) * problem.axis.rotation).normalize();
        problem.axis.translation += DVec3::new(0.03, 0.01, 0.0) * unit;
        problem.angles[1..].iter_mut().for_each(|a| *a += r.random_range(-0.03..0.03));
        problem.bundle.points.iter_mut().for_each(|x| *x += unit_vector(&mut r) * 0.02 * unit);
        problem.bundle.cameras[0].params[0] *= 1.04;
        let options = SolveOptions { function_tolerance: 1e-16, ..SolveOptions::default() };
        let summary = problem.solve(&options, &Progress::silent()).unwrap();
        assert!(summary.final_rms < 1e-6 && summary.iterations < 20, "unit {unit}: {summary:?}");
        assert!((problem.bundle.cameras[0].params[0] - 700.0).abs() < 1e-4);
        for (i, a) in problem.angles.iter().enumerate() {
            let truth = table.turn.angles[i].unwrap();
            assert!(wrap_angle(a - problem.angles[0] - truth).abs() < 1e-8, "unit {unit} frame {i}");
        }
    }
}

#[test]
fn small_motions_beside_the_axis_are_found_where_they_are_allowed() {
    let table = Turntable::new(12, 30.0, 2);
    let mut problem = problem(&table, 1.0, 0.0, 0);
    let shift = Pose::new(DQuat::from_rotation_x(0.002), DVec3::new(0.003, 0.0, 0.001));
    for o in problem.bundle.observations.iter_mut().filter(|o| o.pose == 5) {
        let x = shift
            .compose(&pose_at(&table.turn.axis, table.turn.angles[5].unwrap()))
            .transform(table.points[o.point as usize]);
        o.pixel = table.camera.project(x).unwrap();
    }
    let mut pure = problem.clone();
    let rigid = pure.solve(&SolveOptions::default(), &Progress::silent()).unwrap();
    problem.offset_sigma = Some([0.1, 0.1]);
    let loose = problem.solve(&SolveOptions::default(), &Progress::silent()).unwrap();
    assert!(rigid.final_rms > 20.0 * loose.final_rms, "{rigid:?} {loose:?}");
}

#[test]
fn standard_deviations_match_the_scatter_of_repeated_measurements() {
    let mut table = Turntable::new(10, 36.0, 3);
    table.points.truncate(150);
    let truth = problem(&table, 1.0, 0.0, 0);
    let covariance = truth.covariance(&SolveOptions::default(), 1.0).unwrap().unwrap();
    let n = truth.bundle.cameras[0].params.len();
    let predicted =
        [covariance.angles[5], covariance.axis[0], covariance.axis[1], covariance.cameras[0][0].sqrt()];
    let mut scatter = [0.0; 4];
    let runs = 60;
    for run in 0..runs {
        let mut noisy = problem(&table, 1.0, 1.0, run + 1);
        noisy.solve(&SolveOptions::default(), &Progress::silent()).unwrap();
        let (z, true_z) = (noisy.axis.rotation * DVec3::Z, truth.axis.rotation * DVec3::Z);
        let out = -(truth.axis.rotation * DVec3::X);
        scatter[0] += wrap_angle(noisy.angles[5] - truth.angles[5]).powi(2);
        scatter[1] += (z - true_z).dot(true_z.cross(out)).powi(2);
        scatter[2] += (z - true_z).dot(out).powi(2);
        scatter[3] += (noisy.bundle.cameras[0].params[0] - 700.0).powi(2);
    }
    assert_eq!(covariance.cameras[0].len(), n * n);
    for (s, p) in scatter.iter().zip(predicted) {
        let measured = (s / runs as f64).sqrt();
        assert!((0.7..1.4).contains(&(measured / p)), "measured {measured}, predicted {p} of {predicted:?}");
    }
}

#[test]
fn numbers_that_are_not_finite_are_an_error() {
    let table = Turntable::new(6, 60.0, 5);
    let mut bad = problem(&table, 1.0, 0.0, 0);
    bad.angles[2] = f64::NAN;
    assert!(bad.solve(&SolveOptions::default(), &Progress::silent()).is_err());
    let mut bad = problem(&table, 1.0, 0.0, 0);
    bad.bundle.observations[3].pixel.x = f64::INFINITY;
    assert!(bad.solve(&SolveOptions::default(), &Progress::silent()).is_err());
    let mut empty = problem(&table, 1.0, 0.0, 0);
    empty.bundle.observations.clear();
    assert!(!empty.solve(&SolveOptions::default(), &Progress::silent()).unwrap().usable);
}
