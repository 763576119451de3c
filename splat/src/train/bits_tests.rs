//! What must not change a bit of the result: the number of threads, stopping and going on.

use super::*;
use scene::progress::ProgressSink;
use std::sync::atomic::{AtomicBool, Ordering};

/// Cancels at a step.
struct CancelAt(u64, &'static AtomicBool);

impl ProgressSink for CancelAt {
    fn begin(&self, _: &str, _: u64) {}
    fn update(&self, done: u64, _: &str) {
        self.1.store(done >= self.0, Ordering::Relaxed);
    }
    fn note(&self, _: &str) {}
}

/// Everything but what a clock measured.
fn assert_same(found: &TrainResult, whole: &TrainResult, what: &str) {
    let curve = |r: &TrainResult| -> Vec<_> {
        r.curve.iter().map(|p| (p.iteration, p.loss.to_bits(), p.psnr.to_bits(), p.gaussians)).collect()
    };
    assert_eq!(found.gaussians, whole.gaussians, "{what}");
    assert_eq!(found.decisions, whole.decisions, "{what}");
    assert_eq!(curve(found), curve(whole), "{what}");
    assert_eq!((found.iterations, found.render), (whole.iterations, whole.render), "{what}");
}

/// Trains without a stop, and with one after each of the `stops` steps; the results must be the
/// same. Returns the first.
fn stopped_and_resumed(what: &str, data: &Dataset, config: &TrainConfig, stops: &[u64]) -> TrainResult {
    let whole = train(data, config, None, &Progress::silent()).unwrap();
    for &stop in stops {
        let at = format!("{what}, stop at {stop}");
        let folder = folder(&format!("resume-{}-{stop}", what.replace(' ', "-")));
        let flag: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
        let progress = Progress::new(Box::new(CancelAt(stop, flag)), flag);
        let stopped = train(data, config, Some(&folder), &progress);
        assert!(matches!(stopped, Err(SplatError::Cancelled(_))), "{at}");
        let resumed = train(data, config, Some(&folder), &Progress::silent()).unwrap();
        assert_same(&resumed, &whole, &at);
        let again = train(data, config, Some(&folder), &Progress::silent()).unwrap();
        assert_same(&again, &whole, &format!("{at}, and once more when all is done"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
    whole
}

/// The steps on both sides of each position of a schedule of `steps` steps at which something is
/// decided, and the last ones.
fn around(positions: &[f64], steps: u32) -> Vec<u64> {
    let first_at = |p: &f64| (1..=steps).find(|&i| f64::from(i) / f64::from(steps) >= *p).unwrap();
    let mut stops: Vec<u32> = positions.iter().map(first_at).flat_map(|i| [i - 1, i]).collect();
    stops.extend([steps - 1, steps]);
    stops.dedup();
    stops.into_iter().map(u64::from).collect()
}

/// Looks for gains, the end of growth and the removal of redundant Gaussians.
const DECISIONS: [f64; 6] = [0.25, 0.4, 0.55, 0.7, 0.85, 0.9];

#[test]
fn stopping_and_resuming_changes_no_bit() {
    let stops = [1, 99, 100, 101, 206, 207, 208, 229, 230];
    stopped_and_resumed("opaque", &dataset(8, false), &config(230), &stops);
    // Between the decision for full resolution and its beginning.
    let early = EARLY_FROM_STEPS as u32;
    stopped_and_resumed("early", &dataset(2, false), &config(early), &[u64::from(early) * 23 / 40]);
}

/// Backgrounds are drawn anew in each step; what hardly any view sees goes in each round, what lies
/// outside the mattes after the last one. The rates are low, so that what is wrong does not fade
/// before it is removed.
#[test]
fn stopping_and_resuming_with_mattes_changes_no_bit() {
    let mut small = truth();
    small.means.iter_mut().for_each(|m| *m *= 0.5);
    small.log_scales.iter_mut().for_each(|s| *s -= Vec3::splat(0.7));
    let mut dataset = pictures_of(&small, 24, true, SIZE);
    // Beside the object, and above it where no camera looks.
    let beside = (0..12).map(|k| Quat::from_rotation_z(k as f32 / 2.0) * Vec3::new(0.4, 0.0, 0.2));
    let wrong: Vec<Vec3> = beside.chain((0..6).map(|k| Vec3::Z * (1.2 + 0.1 * k as f32))).collect();
    dataset.points.extend(wrong.into_iter().map(|p| (p, [90; 3])));
    let config = TrainConfig { learning_rate: 0.2, ..config(130) };
    let stops = [&[1, 49, 50, 51], around(&DECISIONS, 130).as_slice()].concat();
    let whole = stopped_and_resumed("mattes", &dataset, &config, &stops);
    for decided in [Subject::UnobservedGaussians, Subject::OutsideSilhouettes, Subject::RedundantGaussians] {
        assert!(removed(&whole, decided) > 0, "{:?}", whole.decisions);
    }
}

#[test]
fn stopping_and_resuming_with_exposure_changes_no_bit() {
    let data = with_gains(&dataset(24, false));
    let whole = stopped_and_resumed("exposure", &data, &config(200), &around(&DECISIONS, 200));
    assert!(decision(&whole, Subject::Exposure).is_taken());
}

#[test]
fn stopping_and_resuming_repeats_what_validation_views_judged() {
    // The degree is judged at 0.5, the number of Gaussians at each eighth of growth.
    let stops = around(&[0.0875, 0.175, 0.4375, 0.5, 0.6125, 0.7], 230);
    let whole = stopped_and_resumed("judged", &dataset(72, false), &config(230), &stops);
    decision(&whole, Subject::ShDegree);
    decision(&whole, Subject::GaussianCount);
}

/// More Gaussians than a task takes (512), pictures of more rows than a band has (32 and 64), and
/// rounds of densification.
#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let mut dataset = pictures_of(&truth(), 40, true, [172, 164]);
    let points = dataset.points.clone();
    let copy = |k: u32| Quat::from_rotation_z(0.1 * k as f32);
    dataset.points = (0..14).flat_map(|k| points.iter().map(move |(p, c)| (copy(k) * *p, *c))).collect();
    let config = TrainConfig { max_gaussians: 3000, coarse_levels: 0, ..config(120) };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| train(&dataset, &config, None, &Progress::silent()).unwrap())
    };
    let one = run(1);
    let most = one.curve.iter().map(|p| p.gaussians).max().unwrap();
    assert!(most > dataset.points.len() && most > 2 * 512, "{most}");
    for threads in [2, 3] {
        assert_same(&run(threads), &one, &format!("{threads} threads"));
    }
}

/// Views begin to move a tenth into the schedule and move each twentieth.
#[test]
fn stopping_and_resuming_with_refined_poses_changes_no_bit() {
    let config = TrainConfig { refine_poses: crate::PoseRefinement::On, ..config(130) };
    let whole =
        stopped_and_resumed("poses", &dataset(12, false), &config, &around(&[0.1, 0.15, 0.5, 0.95], 130));
    decision(&whole, Subject::RefinedPoses);
}
