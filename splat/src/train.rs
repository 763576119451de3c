//! The training loop.

mod align;
mod decide;
mod degree;
mod exposure;
mod poses;
mod prune;
mod watch;

pub use crate::decision::Decision;
pub use decide::Findings;

use crate::backend::{Backend, KernelTimes, Round, StepInput, StepOutput, Target};
use crate::checkpoint::{self, Checkpoint, State};
use crate::dataset::AlphaMode;
use crate::footprint::footprint;
use crate::hull::VisualHull;
use crate::init::initial_gaussians;
use crate::model::Model;
use crate::schedule;
use crate::statistics::Statistics;
use crate::{Dataset, RenderOptions, SplatError, TrainConfig};
use rand::Rng as _;
use rand::seq::SliceRandom as _;
use scene::{Gaussians, Progress};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A point of the training curve: means over the steps since the point before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Steps done.
    pub iteration: u32,
    /// Seconds spent.
    pub seconds: f64,
    /// Loss of the training views.
    pub loss: f32,
    /// PSNR of the training views at the resolution in use, dB.
    pub psnr: f32,
    /// Gaussians.
    pub gaussians: usize,
}

/// What training yields.
#[derive(Clone, Debug, Default)]
pub struct TrainResult {
    /// World frame.
    pub gaussians: Gaussians,
    /// Loss and PSNR over time.
    pub curve: Vec<CurvePoint>,
    /// What was decided and why.
    pub decisions: Vec<Decision>,
    /// Wall seconds by kernel.
    pub timings: KernelTimes,
    /// Steps done.
    pub iterations: u32,
    /// Names and refined poses (`cam_from_world`, world frame) of the training views; empty where they stayed as given.
    pub poses: Vec<(String, scene::Pose)>,
    /// How to render the result as training saw it.
    pub render: RenderOptions,
}

/// Steps between points of the curve.
const CURVE_EVERY: u32 = 50;

struct Trainer<'a> {
    dataset: &'a Dataset,
    config: &'a TrainConfig,
    backend: Box<dyn Backend>,
    /// The configured number of Gaussians, or what the device can hold.
    max_gaussians: usize,
    state: State,
    /// Seconds and steps since steps were last reported, and seconds of a step before that.
    lap: (f64, u32, f64),
    clock: fn() -> f64,
    /// The clock when `state.seconds` was last brought up to date.
    mark: f64,
    /// Width of a pixel in the scene, normalised units.
    pixel: f32,
    /// Training views.
    views: Vec<usize>,
    /// What they and the sparse cloud have to determine Gaussians by.
    capture: schedule::Capture,
    /// Those of them that only judge until growth ends.
    validation: Vec<usize>,
    /// What the mattes leave room for, where the background shows through.
    hull: Option<VisualHull>,
    /// The order of the views in a round, and which round that is.
    order: (Option<(bool, usize)>, Vec<usize>),
}

/// Trains Gaussians on the views that are not held out. With `checkpoint_dir`, continues from the checkpoint there if it
/// belongs to the same configuration, and leaves one when cancelled; stopping and resuming changes no bit of the result
/// (with --time-limit the number of steps depends on the machine's speed).
pub fn train(
    dataset: &Dataset,
    config: &TrainConfig,
    checkpoint_dir: Option<&Path>,
    progress: &Progress,
) -> Result<TrainResult, SplatError> {
    check(config)?;
    let mut trainer = Trainer::new(dataset, config, checkpoint_dir)?;
    progress.begin("train", if config.time_limit.is_some() { 0 } else { config.iterations as usize });
    let saved = |trainer: &mut Trainer| -> Result<(), SplatError> {
        checkpoint_dir.map_or(Ok(()), |folder| trainer.save(folder))
    };
    while trainer.state.position < 1.0 {
        trainer.step()?;
        trainer.decide()?;
        trainer.note_time();
        let point = trainer.state.curve.last().copied().unwrap_or_default();
        let detail = format!("{:.2} dB, {} gaussians", point.psnr, trainer.backend.gaussians());
        if let Err(cancelled) = progress.tick_with(&detail) {
            saved(&mut trainer)?;
            return Err(cancelled.into());
        }
        let every = config.checkpoint_every;
        if every > 0 && trainer.state.iteration.is_multiple_of(every) {
            saved(&mut trainer)?;
        }
    }
    saved(&mut trainer)?;
    trainer.finish()
}

fn check(config: &TrainConfig) -> Result<(), SplatError> {
    let wrong = |flag, value: String, expected| Err(SplatError::Config { flag, value, expected });
    if !(0.0..=1.0).contains(&config.lambda_dssim) {
        return wrong("--lambda-dssim", config.lambda_dssim.to_string(), "a number in [0, 1]");
    }
    if !(config.learning_rate.is_finite() && config.learning_rate > 0.0) {
        return wrong("--learning-rate", config.learning_rate.to_string(), "a positive number");
    }
    if config.max_gaussians == 0 {
        return wrong("--max-gaussians", "0".to_owned(), "at least 1");
    }
    if config.iterations == 0 && config.time_limit.is_none() {
        return wrong("--iterations", "0".to_owned(), "at least 1");
    }
    Ok(())
}

impl<'a> Trainer<'a> {
    fn new(dataset: &'a Dataset, config: &'a TrainConfig, folder: Option<&Path>) -> Result<Self, SplatError> {
        let views = dataset.training_views();
        if views.is_empty() {
            return Err(SplatError::TooFewViews(0));
        }
        let clock =
            if config.recipe.cpu_time { crate::clock::cpu_seconds } else { crate::clock::wall_seconds };
        let begun = clock();
        let told = TrainConfig { seconds_gone: 0.0, ..config.clone() };
        let fingerprint = format!("{told:?} {:?} {}", dataset.normalisation, dataset.views.len());
        let (mut backend, decision) = crate::device::open(&config.device)?;
        let pixels = dataset.views.iter().map(|v| v.view.width * v.view.height).max().unwrap_or(0);
        let room = backend.capacity(config.sh_degree, pixels);
        let max_gaussians = room.as_ref().map_or(config.max_gaussians, |r| r.0.min(config.max_gaussians));
        if max_gaussians == 0 {
            let (flag, expected) =
                ("--vram-limit", "enough for the pictures and some Gaussians; scale the pictures down");
            let value = config.device.vram_limit.map_or("not given".to_owned(), |mib| mib.to_string());
            return Err(SplatError::Config { flag, value, expected });
        }
        let resumed = folder.map_or(Ok(None), |f| Checkpoint::read(f, &fingerprint))?;
        let mut state = match resumed {
            Some(checkpoint) => {
                backend.upload(checkpoint.model, checkpoint.statistics)?;
                checkpoint.state
            }
            None => {
                let first =
                    initial_gaussians(dataset, max_gaussians, config.recipe.hull_points, config.seed)?;
                let mut statistics = Statistics::default();
                statistics.reset(first.len());
                backend.upload(Model::from_gaussians(&first), statistics)?;
                let mut decisions = vec![decision];
                if let Some((room, why)) = room.filter(|r| r.0 < config.max_gaussians) {
                    let (subject, choice) = ("most gaussians".to_owned(), room.to_string());
                    decisions.push(Decision { subject, choice, evidence: why });
                }
                State { fingerprint, first: first.len(), decisions, ..State::default() }
            }
        };
        // A part of the limit went by before training could begin; more so where it was interrupted.
        state.seconds += config.seconds_gone;
        let validation = if config.recipe.evidence { decide::validation(&views) } else { Vec::new() };
        let few = views.len() < decide::VALIDATION_FROM;
        let points = crate::init::cloud(dataset).filter(|_| few).map(|cloud| cloud.len());
        let capture = schedule::Capture { views: views.len(), points };
        let matted = views.iter().filter(|_| dataset.is_transparent()).map(|&v| &dataset.views[v]);
        let hull = VisualHull::of(matted);
        let (mark, order, lap) = (begun, (None, Vec::new()), (0.0, 0, 0.0));
        Ok(Self {
            dataset,
            config,
            backend,
            max_gaussians,
            state,
            lap,
            clock,
            mark,
            pixel: footprint(dataset),
            views,
            capture,
            validation,
            hull,
            order,
        })
    }

    /// Adds to the time spent what has gone by since the last call.
    fn note_time(&mut self) {
        let now = (self.clock)();
        self.state.seconds += now - std::mem::replace(&mut self.mark, now);
    }

    /// Leaves a checkpoint in the folder.
    fn save(&mut self, folder: &Path) -> Result<(), SplatError> {
        self.settle()?;
        let (state, mut written) = (&self.state, Ok(()));
        self.backend.show(&mut |model, statistics| {
            written = checkpoint::write(state, model, statistics, folder);
        })?;
        written
    }

    /// The view of a step: a fresh permutation of all views each time round; those that judge only once they are done.
    fn view_of_step(&mut self) -> usize {
        let judging = self.state.position < self.config.recipe.densify_until;
        let n = self.views.len() - if judging { self.validation.len() } else { 0 };
        let (round, at) = (self.state.iteration as usize / n, self.state.iteration as usize % n);
        if self.order.0 != Some((judging, round)) {
            let mut order = self.views.clone();
            order.retain(|v| !judging || !self.validation.contains(v));
            order.shuffle(&mut scene::rng::rng(self.config.seed, "views", round as u64));
            self.order = (Some((judging, round)), order);
        }
        self.order.1[at]
    }

    fn options(&self) -> RenderOptions {
        let mut rng = scene::rng::rng(self.config.seed, "background", u64::from(self.state.iteration));
        let transparent = self.dataset.is_transparent();
        RenderOptions {
            background: if transparent {
                std::array::from_fn(|_| rng.random_range(0.0..1.0))
            } else {
                [0.0; 3]
            },
            near: None,
            antialias: self.config.antialias,
            sh_degree: None,
        }
    }

    fn step(&mut self) -> Result<(), SplatError> {
        let begun = (self.clock)();
        let position = self.state.position;
        if self.state.early.is_none() && position >= schedule::EARLY_DECIDED {
            let steps = self.state.pace.steps(&self.state, self.config);
            self.state.early = Some(schedule::is_early(steps, &self.config.recipe));
        }
        let highest = self.config.sh_degree.min(self.state.findings.sh_limit.unwrap_or(3));
        let degree = schedule::sh_degree(position, highest);
        if self.backend.sh_degree() < degree {
            self.backend.set_sh_degree(degree)?;
        }
        let chosen = self.view_of_step();
        let view = &self.dataset.views[chosen];
        let level = self.level().min(view.levels.len() as u32 - 1);
        let (camera, pixels) = (self.camera(chosen).at_level(level), &view.levels[level as usize]);
        self.backend.set_gain(self.gain(chosen));
        let steps = self.state.pace.steps(&self.state, self.config);
        let rates = schedule::rates(position, steps, self.pixel, self.config);
        let outputs = self.backend.advance(&StepInput {
            view: &camera,
            target: Target {
                rgb: &pixels.rgb,
                mask: pixels.mask.as_deref(),
                transparent: self.dataset.alpha == AlphaMode::Transparent,
                photo: Some(chosen as u32),
            },
            options: self.options(),
            rates,
            lambda_dssim: self.config.lambda_dssim,
        })?;
        self.state.iteration += 1;
        let iteration = self.state.iteration;
        self.note_steps(&outputs)?;
        if schedule::is_round(iteration, position, self.state.last_round, &self.config.recipe) {
            self.state.last_round = (iteration, position);
            self.densify()?;
        }
        self.note_time();
        let cost = self.cost(self.mark - begun, !outputs.is_empty());
        let mut pace = self.state.pace.clone();
        self.state.position = pace.advance(&self.state, self.config, level, cost, self.most_steps());
        self.state.pace = pace;
        if iteration.is_multiple_of(CURVE_EVERY) || self.state.position >= 1.0 {
            self.settle()?;
            self.note_curve();
            if let Some(reason) = watch::runaway(&self.state.curve) {
                return Err(SplatError::Diverged { iteration, reason });
            }
        }
        Ok(())
    }

    /// What a step costs. A device reports several at a time: those that were only begun seem to cost nothing and the last
    /// one everything, so that the mean over the report counts.
    fn cost(&mut self, spent: f64, reported: bool) -> f64 {
        let (seconds, steps, mean) = self.lap;
        self.lap = (seconds + spent, steps + 1, mean);
        if reported {
            self.lap = (0.0, 0, (seconds + spent) / f64::from(steps + 1));
            return self.lap.2;
        }
        if mean > 0.0 { mean } else { spent }
    }

    /// Adds up what steps saw.
    fn note_steps(&mut self, outputs: &[StepOutput]) -> Result<(), SplatError> {
        for output in outputs {
            if !(output.loss.is_finite() && output.mse.is_finite()) {
                let reason = "the loss is not finite; lower --learning-rate".to_owned();
                return Err(SplatError::Diverged { iteration: self.state.iteration, reason });
            }
            self.state.findings.non_finite += output.non_finite;
            for (sum, value) in self.state.pending.iter_mut().zip([output.loss, output.mse, 1.0]) {
                *sum += f64::from(value);
            }
        }
        Ok(())
    }

    /// Waits for steps that were only begun.
    fn settle(&mut self) -> Result<(), SplatError> {
        let begun = (self.clock)();
        let outputs = self.backend.settle()?;
        self.note_time();
        self.lap.0 += self.mark - begun;
        if !outputs.is_empty() {
            self.lap = (0.0, 0, self.lap.0 / f64::from(self.lap.1.max(1)));
        }
        self.note_steps(&outputs)
    }

    /// Level in use now (0: full resolution), if the view has it.
    fn level(&self) -> u32 {
        let early = self.state.early.unwrap_or(false);
        schedule::level(self.state.position, self.config.coarse_levels, &self.config.recipe, early)
    }

    fn densify(&mut self) -> Result<(), SplatError> {
        let recipe = &self.config.recipe;
        let (now, max) = (self.backend.gaussians(), self.max_gaussians);
        let steps = self.state.pace.steps(&self.state, self.config);
        let last = schedule::gaussians_at_end(self.state.first, steps, self.capture, self.config);
        let last = self.state.findings.gaussians_limit.map_or(last, |limit| last.min(limit));
        let wanted = schedule::gaussians(self.state.position, self.state.first, last, recipe);
        let room = wanted.min(max).saturating_sub(now);
        let (seed, iteration) = (self.config.seed, self.state.iteration);
        let remove_unseen = recipe.remove_unseen && self.dataset.is_transparent();
        let views: Vec<_> = self.views.iter().map(|&v| self.camera(v)).collect();
        let remove_unseen = remove_unseen.then_some(views.as_slice());
        let unseen = self.backend.densify(&Round { room, seed, iteration, remove_unseen })?;
        self.state.findings.unseen += unseen;
        Ok(())
    }

    /// Steps that a time limit is filled with at most.
    fn most_steps(&self) -> f64 {
        self.config.recipe.passes * self.views.len() as f64
    }

    fn note_curve(&mut self) {
        let [loss, mse, n] = std::mem::take(&mut self.state.pending);
        if n > 0.0 {
            let psnr = -10.0 * (mse / n).max(1e-12).log10();
            self.state.curve.push(CurvePoint {
                iteration: self.state.iteration,
                seconds: self.state.seconds,
                loss: (loss / n) as f32,
                psnr: psnr as f32,
                gaussians: self.backend.gaussians(),
            });
        }
    }

    fn finish(mut self) -> Result<TrainResult, SplatError> {
        let timings = self.backend.times();
        let (mut model, _) = self.backend.release()?;
        // What has wandered off since growth ended.
        self.state.findings.outside += self.hull.as_ref().map_or(0, |hull| hull.prune(&mut model));
        let mut gaussians = model.to_gaussians();
        let refined = self.align(&mut gaussians);
        let decisions = self.decisions(model.len, refined.as_ref().map(|r| r.0));
        let near = crate::camera::DEFAULT_NEAR / self.dataset.normalisation.scale as f32;
        Ok(TrainResult {
            gaussians: self.dataset.normalisation.to_world(gaussians),
            curve: self.state.curve,
            decisions,
            timings,
            iterations: self.state.iteration,
            poses: refined.map_or(Vec::new(), |r| r.1),
            render: RenderOptions {
                near: Some(near),
                antialias: self.config.antialias,
                ..RenderOptions::default()
            },
        })
    }
}

#[cfg(test)]
mod tests;
