//! Views that stand elsewhere than they are said to.

use super::alignment::similarity;
use super::motion::{motion_between, moved};
use super::photometric::{PhotoResidual, PixelSubset, motion_equations};
use crate::backend::Target;
use crate::config::{PoseRefinement, TrainConfig};
use crate::dataset::Dataset;
use crate::model::Model;
use crate::statistics::Statistics;
use crate::train::session::Session;
use crate::train::tests::{config, dataset, decision, held_out_psnr, pictures_of, truth};
use crate::train::train;
use crate::view::{PinholeView, RenderOptions};
use glam::{DMat3, DQuat, DVec3, Vec3};
use rand::Rng as _;
use scene::Progress;
use scene::decision::Subject;
use scene::sim3::Sim3;

/// The training views off by about `size` radians, as solvers leave it: what they look at stays in
/// the middle.
fn with_wrong_poses(mut dataset: Dataset, size: f64) -> Dataset {
    for (k, view) in dataset.views.iter_mut().enumerate().filter(|(_, v)| !v.held_out) {
        let mut rng = scene::rng::rng(11, "wrong poses", k as u64);
        let mut off = || size * rng.random_range(-1.7..1.7);
        let (w, distance) = ([off(), off(), off()], f64::from(view.view.translation.z));
        let v = [0.3 * off() - w[1] * distance, 0.3 * off() + w[0] * distance, 0.3 * off()];
        view.view = moved(&view.view, &[w[0], w[1], w[2], v[0], v[1], v[2]]);
    }
    dataset
}

/// A training whose Gaussians are the true ones, at full resolution.
fn at_the_truth<'a>(dataset: &'a Dataset, config: &'a TrainConfig) -> Session<'a> {
    let mut session = Session::open(dataset, config, None).unwrap();
    session.backend.upload(Model::from_gaussians(&truth()), Statistics::default()).unwrap();
    session.state.place.position = 1.0;
    session
}

#[test]
fn a_view_finds_back_to_where_its_photo_was_taken() {
    let dataset = pictures_of(&truth(), 8, false, [144, 120]);
    let config = config(100);
    let mut session = at_the_truth(&dataset, &config);
    for (v, motion) in [(1, [0.01, -0.02, 0.01, 0.0, 0.0, 0.0]), (2, [0.0, 0.01, 0.0, 0.01, 0.015, -0.02])] {
        let given = dataset.views[v].view;
        let mut view = moved(&given, &motion);
        let error = |view: &PinholeView| {
            let off = motion_between(&given, view);
            off.iter().map(|x| x * x).sum::<f64>().sqrt()
        };
        let before = error(&view);
        for _ in 0..8 {
            let step = &mut session.context().0;
            let sums = motion_equations(step, v, &view, PixelSubset::All).unwrap();
            view = moved(&view, &sums.motion(&[0.0; 6], [1.0; 2]));
        }
        assert!(error(&view) < 0.05 * before, "{before} -> {}", error(&view));
    }
}

/// The derivative that the normal equations are made of is that of what the renderer shows: against
/// central differences of pictures.
#[test]
fn the_predicted_change_of_a_picture_is_that_of_the_renderer() {
    let dataset = pictures_of(&truth(), 8, false, [144, 120]);
    let config = config(100);
    let mut session = at_the_truth(&dataset, &config);
    let view = dataset.views[1].view;
    let options = RenderOptions::default();
    let shown = session.backend.render(&view, &options).unwrap();
    let rgb = &dataset.views[1].levels[0].rgb;
    let target = Target { rgb, mask: None, transparent: false, photo: None };
    let photo = PhotoResidual { target, gain: [1.0; 3], view: &view, shown: &shown };
    for k in 0..6 {
        let mut step = [0.0; 6];
        step[k] = 2e-3;
        let ahead = session.backend.render(&moved(&view, &step), &options).unwrap().rgb;
        let back = session.backend.render(&moved(&view, &step.map(|s| -s)), &options).unwrap().rgb;
        let (mut both, mut own, mut other) = (0.0, 0.0, 0.0);
        let (w, h) = (view.width, view.height);
        let inner = |i: &usize| (1..w - 1).contains(&(i % w)) && (1..h - 1).contains(&(i / w));
        for i in (0..h * w).filter(inner).filter(|i| shown.alpha.data[*i] > 0.9) {
            let (x, y) = (i % w, i / w);
            let flow = photo.flow(x, y, shown.depth.data[i]);
            let at = |j: usize| f64::from(shown.rgb.data[3 * j]);
            let predicted =
                -0.5 * ((at(i + 1) - at(i - 1)) * flow[0][k] + (at(i + w) - at(i - w)) * flow[1][k]);
            let found = f64::from(ahead.data[3 * i] - back.data[3 * i]) / 4e-3;
            both += predicted * found;
            own += predicted * predicted;
            other += found * found;
        }
        // The picture is made of blobs at many depths, so that a pixel has no one depth: alike, not
        // equal.
        let (alike, gain) = (both / (own * other).sqrt(), both / own);
        assert!(alike > 0.8 && (0.7..1.4).contains(&gain), "coordinate {k}: {alike:.3}, {gain:.3}");
    }
}

#[test]
fn the_similarity_between_poses_is_found() {
    let dataset = dataset(9, false);
    let given: Vec<PinholeView> = dataset.views.iter().map(|v| v.view).collect();
    let true_one = Sim3 {
        scale: 1.01,
        rotation: DQuat::from_scaled_axis(DVec3::new(0.01, -0.02, 0.015)),
        translation: DVec3::new(0.01, 0.02, -0.01),
    };
    // R' x + t' is R (s Q x + d) + t, up to the scale that no picture shows.
    let seen: Vec<PinholeView> = given
        .iter()
        .map(|v| {
            let r = v.rotation.as_dmat3();
            let t = (r * true_one.translation + v.translation.as_dvec3()) / true_one.scale;
            PinholeView {
                rotation: (r * DMat3::from_quat(true_one.rotation)).as_mat3(),
                translation: t.as_vec3(),
                ..*v
            }
        })
        .collect();
    let points: Vec<DVec3> = truth().means.iter().map(|m| m.as_dvec3()).collect();
    let (found, rms) = similarity(&points, &given, &seen);
    assert!((found.scale - 1.01).abs() < 1e-5 && rms < 1e-3, "{found:?} {rms}");
    assert!((found.translation - true_one.translation).length() < 1e-5 && rms < 1e-3, "{found:?}");
    assert_eq!(similarity(&[], &given, &seen).0, Sim3::IDENTITY);
}

#[test]
fn wrong_poses_are_refined_and_right_ones_are_left_alone() {
    let mut fine = truth();
    fine.log_scales.iter_mut().for_each(|s| *s -= 1.2);
    let right = pictures_of(&fine, 24, false, [384, 320]);
    let wrong = with_wrong_poses(right.clone(), 0.014);
    let run = |dataset: &Dataset, refine_poses| {
        let config = TrainConfig { refine_poses, ..config(400) };
        let result = train(dataset, &config, None, &Progress::silent()).unwrap();
        // Held-out views stand where they are said to.
        (held_out_psnr(&right, &result), result)
    };
    let (left, _) = run(&wrong, PoseRefinement::Off);
    let (refined, result) = run(&wrong, PoseRefinement::Auto);
    assert!(decision(&result, Subject::TrainingPoses).is_taken(), "{:?}", result.decisions);
    assert!(refined > left + 2.0, "{left:.2} dB -> {refined:.2} dB");
    // What the poses turn the scene by, in common, is nobody's error; the splat tells it from what
    // they look at.
    let off = |pose: &dyn Fn(usize) -> scene::Pose| {
        let training = right.training_views();
        let angle = |v: &usize| scene::pose::rotation_angle(pose(*v).rotation, right.views[*v].pose.rotation);
        training.iter().map(angle).sum::<f64>() / training.len() as f64
    };
    let given = |v: usize| {
        let view = &wrong.views[v].view;
        scene::Pose::from_matrix(view.rotation.as_dmat3(), view.translation.as_dvec3())
    };
    let found = |v: usize| result.poses.iter().find(|(name, _)| *name == right.views[v].name).unwrap().1;
    assert!(off(&found) < 0.75 * off(&given), "{} -> {}", off(&given), off(&found));
    assert!(run(&wrong, PoseRefinement::On).0 > left + 1.0);
    let (_, result) = run(&right, PoseRefinement::Auto);
    assert!(!decision(&result, Subject::TrainingPoses).is_taken(), "{:?}", result.decisions);
    assert_eq!(result.gaussians, run(&right, PoseRefinement::Off).1.gaussians);
}

/// Views without anything to align, black, saturated, or fewer than three: nothing happens, and
/// nothing is lost.
#[test]
fn views_that_say_nothing_stay() {
    for (views, level) in [(12, 0u8), (12, 255), (2, 90)] {
        let mut blank = dataset(views, false);
        for view in &mut blank.views {
            view.levels.iter_mut().for_each(|l| l.rgb.fill(level));
        }
        let config = TrainConfig { refine_poses: PoseRefinement::On, ..config(60) };
        let result = train(&blank, &config, None, &Progress::silent()).unwrap();
        let finite = |v: &Vec3| v.is_finite();
        assert!(result.gaussians.means.iter().all(finite), "{views} views of {level}");
    }
}
