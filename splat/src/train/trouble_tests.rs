//! Data and settings that should not be, and every so often are.

use super::*;
use crate::backend::{Backend, KernelTimes, Round, StepInput, StepOutput, Target};
use crate::train::checkpoint;
use crate::train::rules::smoothing::raise_scales;
use crate::view::{PinholeView, RenderOutput};

#[test]
fn ten_times_the_learning_rates_recover_or_say_why_not() {
    for (views, rate) in [(1, 10.0), (1, 3.0), (12, 10.0), (12, 3.0)] {
        let wild = TrainConfig { learning_rate: rate, ..config(1000) };
        match train(&dataset(views, false), &wild, None, &Progress::silent()) {
            Ok(result) => {
                assert!(result.gaussians.means.iter().all(|m| m.is_finite()));
                let losses: Vec<f32> = result.curve.iter().map(|p| p.loss).collect();
                assert!(losses.iter().all(|l| l.is_finite()));
                let told = result.decisions.iter().any(|d| d.subject == Subject::Convergence);
                let share = losses[losses.len() - 1] / losses[0];
                assert_eq!(told, share >= 0.9, "{views} at {rate}: {losses:?}");
                assert!(share < 0.7 || rate > 5.0, "{views} at {rate}: {losses:?}");
            }
            Err(SplatError::Diverged { reason, .. }) => {
                assert!(rate > 5.0 && reason.contains("--learning-rate"), "{views} at {rate}: {reason}");
            }
            Err(other) => panic!("{views} at {rate}: {other}"),
        }
    }
}

#[test]
fn one_view_is_learnt() {
    let result = train(&dataset(1, false), &config(400), None, &Progress::silent()).unwrap();
    let losses: Vec<f32> = result.curve.iter().map(|p| p.loss).collect();
    assert!(losses[losses.len() - 1] < 0.3 * losses[0], "{losses:?}");
}

/// The processor, which from a step on reports a loss of its own; at once or, as a device does,
/// later.
struct Breaks {
    inner: CpuBackend,
    steps: u32,
    at: u32,
    loss: f32,
    late: bool,
    unreported: Vec<StepOutput>,
}

impl Backend for Breaks {
    fn name(&self) -> String {
        "breaks".to_owned()
    }
    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError> {
        Backend::upload(&mut self.inner, model, statistics)
    }
    fn download(&mut self) -> Result<(Model, Statistics), SplatError> {
        self.inner.download()
    }
    fn edit(&mut self, change: &mut dyn FnMut(&mut Model, &mut Statistics)) -> Result<(), SplatError> {
        self.inner.edit(change)
    }
    fn densify(&mut self, round: &Round) -> Result<usize, SplatError> {
        self.inner.densify(round)
    }
    fn gaussians(&self) -> usize {
        self.inner.gaussians()
    }
    fn sh_degree(&self) -> u32 {
        self.inner.sh_degree()
    }
    fn capacity(&self, sh_degree: u32, pixels: usize) -> Option<(usize, String)> {
        self.inner.capacity(sh_degree, pixels)
    }
    fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<RenderOutput, SplatError> {
        Backend::render(&mut self.inner, view, options)
    }
    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        self.steps += 1;
        let output = self.inner.step(input)?;
        Ok(if self.steps >= self.at { StepOutput { loss: self.loss, ..output } } else { output })
    }
    fn advance(&mut self, input: &StepInput) -> Result<Vec<StepOutput>, SplatError> {
        let output = self.step(input)?;
        self.unreported.push(output);
        Ok(if self.late { Vec::new() } else { std::mem::take(&mut self.unreported) })
    }
    fn settle(&mut self) -> Result<Vec<StepOutput>, SplatError> {
        Ok(std::mem::take(&mut self.unreported))
    }
    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError> {
        Backend::mean_square_error(&mut self.inner, view, target, options)
    }
    fn opacity_gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Vec<f32>, SplatError> {
        self.inner.opacity_gradients(view, options, gradient)
    }
    fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        Backend::set_gain(&mut self.inner, gain);
    }
    fn times(&self) -> KernelTimes {
        self.inner.times()
    }
}

/// A training whose losses are `loss` from step `at` on.
fn breaking<'a>(data: &'a Dataset, config: &'a TrainConfig, loss: f32, at: u32, late: bool) -> Session<'a> {
    let mut session = Session::open(data, config, None).unwrap();
    let (model, statistics) = session.backend.release().unwrap();
    let mut inner = CpuBackend::default();
    Backend::upload(&mut inner, model, statistics).unwrap();
    session.backend = Box::new(Breaks { inner, steps: 0, at, loss, late, unreported: Vec::new() });
    session
}

/// Training ends at the step whose loss is no number; where a device reports later, at the next
/// point of the curve.
#[test]
fn a_loss_that_is_not_finite_stops_training_with_the_flag_to_change() {
    let (dataset, config) = (dataset(4, false), config(200));
    for (loss, late, told) in [
        (f32::NAN, false, 7),
        (f32::INFINITY, false, 7),
        (f32::NEG_INFINITY, false, 7),
        (f32::NAN, true, CURVE_EVERY),
    ] {
        let mut session = breaking(&dataset, &config, loss, 7, late);
        (1..7).for_each(|_| session.step().unwrap());
        let error = (7..=200).find_map(|_| session.step().err()).expect("training goes on");
        let SplatError::Diverged { iteration, .. } = error else { panic!("{error}") };
        assert_eq!(iteration, told, "{loss}, late {late}");
        assert!(error.to_string().contains("--learning-rate"), "{error}");
    }
}

/// What a device has not yet told when a checkpoint is due is asked for first.
#[test]
fn no_checkpoint_is_left_of_a_training_that_has_diverged() {
    let (dataset, config, folder) = (dataset(4, false), config(200), folder("diverged"));
    let mut session = breaking(&dataset, &config, f32::NAN, 3, true);
    (0..5).for_each(|_| session.step().unwrap());
    assert!(matches!(session.save(&folder), Err(SplatError::Diverged { .. })));
    assert!(!folder.join(checkpoint::FILE).exists());
}

#[test]
fn empty_masks_and_saturated_pictures_are_survived() {
    for (value, cover, alpha) in [
        (255, 0, AlphaMode::Transparent),
        (255, 0, AlphaMode::Ignore),
        (255, 255, AlphaMode::Ignore),
        (0, 255, AlphaMode::Transparent),
    ] {
        let mut dataset = dataset(3, true);
        dataset.alpha = alpha;
        for pixels in dataset.views.iter_mut().flat_map(|v| &mut v.levels) {
            pixels.rgb.fill(value);
            pixels.mask = Some(vec![cover; pixels.width * pixels.height]);
        }
        let result = train(&dataset, &config(120), None, &Progress::silent()).unwrap();
        assert!(result.gaussians.means.iter().all(|m| m.is_finite()), "{value} {cover} {alpha:?}");
    }
}

#[test]
fn nonsense_is_refused_with_the_flag_to_change() {
    let dataset = dataset(2, false);
    for (wrong, flag) in [
        (TrainConfig { lambda_dssim: 1.5, ..config(10) }, "--lambda-dssim"),
        (TrainConfig { learning_rate: f32::NAN, ..config(10) }, "--learning-rate"),
        (TrainConfig { max_gaussians: 0, ..config(10) }, "--max-gaussians"),
        (config(0), "--iterations"),
    ] {
        let error = train(&dataset, &wrong, None, &Progress::silent()).unwrap_err();
        assert!(error.to_string().contains(flag), "{error}");
    }
}

#[test]
fn points_at_one_place_on_the_cameras_or_far_away_do_not_stop_training() {
    let ordinary = dataset(12, false);
    let eye = ordinary.views[1].view.position();
    for (what, place) in [("one place", Vec3::ZERO), ("a camera", eye), ("far away", Vec3::splat(1e6))] {
        let mut dataset = ordinary.clone();
        dataset.points = vec![(place, [128; 3]); 2000];
        // Half of them where the object is, so that there is something to learn from.
        let good = ordinary.points.iter().copied();
        dataset.points.extend(good);
        let result =
            train(&dataset, &TrainConfig { max_gaussians: 3000, ..config(200) }, None, &Progress::silent());
        let result = result.unwrap_or_else(|e| panic!("{what}: {e}"));
        assert!(result.gaussians.means.iter().all(|m| m.is_finite()), "{what}");
        let psnr = held_out_psnr(&dataset, &result);
        assert!(psnr > 20.0, "{what}: {psnr:.2} dB");
    }
}

#[test]
fn one_view_with_an_empty_mask_among_others_does_no_harm() {
    let psnr = |empty: bool| {
        let mut dataset = dataset(24, false);
        dataset.alpha = AlphaMode::Ignore;
        if empty {
            for pixels in &mut dataset.views[7].levels {
                pixels.rgb.fill(255);
                pixels.mask = Some(vec![0; pixels.width * pixels.height]);
            }
        }
        held_out_psnr(&dataset, &train(&dataset, &config(300), None, &Progress::silent()).unwrap())
    };
    let (without, with) = (psnr(false), psnr(true));
    assert!(with > without - 1.0, "{without:.2} dB, with an empty mask {with:.2} dB");
}

/// Without --smoothing this scene ends with Gaussians finer than its pictures, with it none is.
#[test]
fn smoothing_leaves_no_gaussian_finer_than_what_the_views_sample() {
    let specks = Gaussians { log_scales: vec![Vec3::splat(-6.0); 80], ..truth() };
    let dataset = pictures_of(&specks, 12, false, SIZE);
    let views: Vec<_> = dataset.training_views().iter().map(|&v| dataset.views[v].view).collect();
    let finer = |smoothing: bool| {
        let config = TrainConfig { smoothing, ..config(150) };
        let result = train(&dataset, &config, None, &Progress::silent()).unwrap();
        let before = Model::from_gaussians(&result.gaussians);
        let mut after = before.clone();
        raise_scales(&mut after, &views);
        let planes = crate::model::LOG_SCALE..crate::model::LOG_SCALE + 3;
        let lifts = planes.flat_map(|p| {
            let pairs = after.geometry[p].iter().zip(&before.geometry[p]);
            pairs.map(|(a, b)| a - b).collect::<Vec<_>>()
        });
        lifts.filter(|lift| *lift > 1e-3).count()
    };
    assert!(finer(false) > 0);
    assert_eq!(finer(true), 0);
}
