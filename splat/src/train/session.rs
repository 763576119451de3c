//! A training under way: the step, the order of the views, the clock.

use super::checkpoint::{self, Checkpoint};
use super::context::RuleContext;
use super::loss_trend::{runaway, stuck};
use super::pace::StepCost;
use super::result::TrainResult;
use super::rules::Rules;
use super::schedule::{GROWTH_END, Place, rates};
use super::setup::TrainingSetup;
use super::state::TrainingState;
use crate::backend::{Backend, StepInput, StepOutput, Target};
use crate::camera::DEFAULT_NEAR;
use crate::config::TrainConfig;
use crate::dataset::{Dataset, Pixels};
use crate::error::SplatError;
use crate::init::initial_model;
use crate::statistics::Statistics;
use crate::view::RenderOptions;
use rand::Rng as _;
use rand::seq::SliceRandom as _;
use scene::decision::{Choice, Measurement, Quantity, Remark, Rule, Subject};
use scene::{Decision, Gaussians, Preview};
use std::path::Path;

/// Steps between points of the curve. Source: chosen by hand; what divergence is told by.
pub(super) const CURVE_EVERY: u32 = 50;
/// Times that a time limit lets each training view be seen, at most: more steps learn the photos by
/// heart.
/// Source: docs/decisions/12.
const PASSES: f64 = 300.0;
/// A run that ends before this share of a time limit, or with fewer than this share of the passes,
/// ends for another reason.
/// Source: chosen by hand; limits are kept to 1 %.
const NEARLY: f64 = 0.95;

/// A training under way.
pub(crate) struct Session<'a> {
    pub(crate) setup: TrainingSetup<'a>,
    pub(crate) backend: Box<dyn Backend>,
    pub(crate) state: TrainingState,
    pub(crate) rules: Rules,
    order: ViewOrder,
    cost: StepCost,
    /// The clock when the state's seconds were last brought up to date.
    mark: f64,
}

/// The order of the views: a fresh permutation each time round.
#[derive(Default)]
struct ViewOrder {
    /// Whether the validation views only judge, and the number of the round.
    round: Option<(bool, usize)>,
    views: Vec<usize>,
}

impl ViewOrder {
    /// The view of a step; those that judge take their turn once growth has ended.
    fn view(&mut self, setup: &TrainingSetup, place: &Place) -> usize {
        let judging = place.position < GROWTH_END;
        let n = setup.views.len() - if judging { setup.validation.len() } else { 0 };
        let (round, at) = (place.iteration as usize / n, place.iteration as usize % n);
        if self.round != Some((judging, round)) {
            self.round = Some((judging, round));
            self.views = setup.views.clone();
            self.views.retain(|v| !judging || !setup.validation.contains(v));
            self.views.shuffle(&mut scene::rng::rng(setup.config.seed, "views", round as u64));
        }
        self.views[at]
    }
}

impl<'a> Session<'a> {
    /// A new training, or the one whose checkpoint lies in the folder.
    pub(crate) fn open(
        dataset: &'a Dataset,
        config: &'a TrainConfig,
        folder: Option<&Path>,
    ) -> Result<Self, SplatError> {
        let mark = config.limit_clock.seconds();
        let device = config.device.for_parts(dataset.articulation.is_some());
        let (mut backend, decision) = crate::device::open(&device)?;
        let (max_gaussians, limit) = capacity(backend.as_ref(), dataset, config)?;
        let setup = TrainingSetup::new(dataset, config, max_gaussians)?;
        let fingerprint = fingerprint(dataset, config);
        let resumed = folder.map_or(Ok(None), |f| Checkpoint::read(f, &fingerprint))?;
        let (mut state, rules) = match resumed {
            Some(Checkpoint { state, rules, model, statistics }) => {
                backend.upload(model, statistics)?;
                (state, rules)
            }
            None => {
                let model = initial_model(dataset, max_gaussians, config.seed)?;
                let (mut statistics, first) = (Statistics::default(), model.len);
                statistics.reset(first);
                backend.upload(model, statistics)?;
                let sky = setup.sky.map(|_| {
                    let decision = Decision::new(Subject::BlackSky, true, Rule::Evidence);
                    decision.remarked(Remark::BlackRims)
                });
                let decisions = std::iter::once(decision).chain(limit).chain(sky).collect();
                let state = TrainingState { fingerprint, first, decisions, ..TrainingState::default() };
                (state, Rules::default())
            }
        };
        // A part of the limit went by before training could begin; more so where it was
        // interrupted.
        state.place.seconds += config.seconds_gone;
        let (order, cost) = (ViewOrder::default(), StepCost::default());
        Ok(Self { setup, backend, state, rules, order, cost, mark })
    }

    /// Whether the schedule has come to its end.
    pub(super) fn is_done(&self) -> bool {
        self.state.place.position >= 1.0
    }

    pub(crate) fn context(&mut self) -> (RuleContext<'_>, &mut Rules) {
        let Self { setup, backend, state, rules, .. } = self;
        (RuleContext { setup, backend: backend.as_mut(), state }, rules)
    }

    /// Takes a step, and moves the position.
    pub(super) fn step(&mut self) -> Result<(), SplatError> {
        let begun = self.seconds();
        let (step, _) = self.context();
        let steps = step.expected_steps();
        step.state.place.decide_early(steps);
        self.hold_photos();
        let (mut step, rules) = self.context();
        rules.before_step(&mut step)?;
        let (view, outputs) = self.train_on_next_view()?;
        self.state.place.iteration += 1;
        self.note_steps(&outputs)?;
        let (mut step, rules) = self.context();
        outputs.iter().for_each(|output| rules.after_view(&mut step, view, output));
        rules.after_step(&mut step)?;
        self.note_time();
        let cost = self.cost.of_step(self.mark - begun, !outputs.is_empty());
        self.advance(cost);
        if self.state.place.iteration.is_multiple_of(CURVE_EVERY) || self.is_done() {
            self.settle()?;
            self.state.add_curve_point(self.backend.gaussians());
            if let Some(reason) = runaway(&self.state.curve) {
                return Err(SplatError::Diverged { iteration: self.state.place.iteration, reason });
            }
        }
        Ok(())
    }

    /// Forward, loss, backward and Adam on the next view: its number, and what those steps saw that
    /// have ended.
    fn train_on_next_view(&mut self) -> Result<(usize, Vec<StepOutput>), SplatError> {
        let chosen = self.order.view(&self.setup, &self.state.place);
        let sky = self.sky(chosen);
        let background = self.background(sky.is_some());
        let (step, _) = self.context();
        let (setup, steps, level) = (step.setup, step.expected_steps(), step.level());
        let (camera, mut target) = step.photo(chosen, level);
        if let Some(Pixels { rgb, mask, .. }) = &sky {
            target = Target { rgb, mask: mask.as_deref(), transparent: true, photo: None };
        }
        step.backend.set_gain(step.gain(chosen));
        let outputs = step.backend.advance(&StepInput {
            view: &camera,
            target,
            options: RenderOptions { background, ..step.options() },
            rates: rates(step.position(), steps, setup.pixel, setup.config),
            lambda_dssim: setup.config.lambda_dssim,
        })?;
        Ok((chosen, outputs))
    }

    /// A view's photo with a matte, in steps in which what is behind a black sky shows through.
    fn sky(&self, view: usize) -> Option<Pixels> {
        let place = &self.state.place;
        let sky = self.setup.sky?;
        let shows = sky.shows(self.setup.config.seed, u64::from(place.iteration));
        shows.then(|| sky.matted(self.setup.photo(view, place.level(self.setup.config.coarse_levels)).0))
    }

    /// A random colour where the background shows through, else black.
    fn background(&self, shows: bool) -> [f32; 3] {
        let iteration = u64::from(self.state.place.iteration);
        let mut rng = scene::rng::rng(self.setup.config.seed, "background", iteration);
        if shows || self.setup.dataset.is_transparent() {
            std::array::from_fn(|_| rng.random_range(0.0..1.0))
        } else {
            [0.0; 3]
        }
    }

    /// Moves the position by a step that took `cost` seconds.
    fn advance(&mut self, cost: f64) {
        let most = self.most_steps();
        let (config, state) = (self.setup.config, &mut self.state);
        let level = state.place.level(config.coarse_levels);
        state.place.position = state.pace.advance(&state.place, config, level, cost, most);
        self.hold_photos();
    }

    /// Has the photos at the level in use at hand.
    fn hold_photos(&mut self) {
        self.setup.hold(self.state.place.level(self.setup.config.coarse_levels));
    }

    /// Lets the rules look at what was learnt so far.
    pub(super) fn review(&mut self) -> Result<(), SplatError> {
        let (mut step, rules) = self.context();
        rules.review(&mut step)?;
        self.note_time();
        Ok(())
    }

    /// The clock that the time limit is counted by.
    fn seconds(&self) -> f64 {
        self.setup.config.limit_clock.seconds()
    }

    /// Adds to the time spent what has gone by since the last call.
    fn note_time(&mut self) {
        let now = self.seconds();
        self.state.place.seconds += now - std::mem::replace(&mut self.mark, now);
    }

    /// Adds up what steps saw.
    fn note_steps(&mut self, outputs: &[StepOutput]) -> Result<(), SplatError> {
        if outputs.iter().all(|output| self.state.note_step(output)) {
            return Ok(());
        }
        let reason = "the loss is not finite; lower --learning-rate".to_owned();
        Err(SplatError::Diverged { iteration: self.state.place.iteration, reason })
    }

    /// Waits for steps that were only begun.
    fn settle(&mut self) -> Result<(), SplatError> {
        let begun = self.seconds();
        let outputs = self.backend.settle()?;
        self.note_time();
        self.cost.note_wait(self.mark - begun, !outputs.is_empty());
        self.note_steps(&outputs)
    }

    /// Steps that a time limit is filled with at most.
    fn most_steps(&self) -> f64 {
        PASSES * self.setup.views.len() as f64
    }

    /// Leaves a checkpoint in the folder.
    pub(super) fn save(&mut self, folder: &Path) -> Result<(), SplatError> {
        self.settle()?;
        let (noted, mut written) = ((&self.state, &self.rules), Ok(()));
        self.backend.show(&mut |model, statistics| {
            written = checkpoint::write(noted, model, statistics, folder);
        })?;
        written
    }

    /// The Gaussians as they are now, in the world frame.
    pub(super) fn preview(&mut self) -> Result<Preview, SplatError> {
        self.settle()?;
        let mut gaussians = Gaussians::default();
        self.backend.show(&mut |model, _| gaussians = model.to_gaussians())?;
        Ok(Preview::Splat(self.setup.dataset.normalisation.denormalise(gaussians)))
    }

    /// The trained Gaussians in the world frame.
    pub(super) fn finish(mut self) -> Result<TrainResult, SplatError> {
        let timings = self.backend.times();
        let (mut model, _) = self.backend.release()?;
        model.forget_moments();
        let (mut step, rules) = self.context();
        rules.after_training(&step, &mut model);
        let moving = rules.moving(&step, &mut model);
        let mut gaussians = model.into_gaussians();
        let poses = rules.conclude(&mut step, &mut gaussians);
        self.conclude();
        let (dataset, config) = (self.setup.dataset, self.setup.config);
        let near = DEFAULT_NEAR / dataset.normalisation.scale as f32;
        Ok(TrainResult {
            gaussians: dataset.normalisation.denormalise(gaussians),
            curve: self.state.curve,
            decisions: self.state.decisions,
            timings,
            iterations: self.state.place.iteration,
            poses,
            moving,
            render: RenderOptions {
                near: Some(near),
                antialias: config.antialias,
                ..RenderOptions::default()
            },
        })
    }

    /// Reports what is no rule's and only known at the end.
    fn conclude(&mut self) {
        let skipped = self.state.non_finite;
        if skipped > 0 {
            let choice = Choice::count(skipped);
            let decision = Decision::new(Subject::NonFiniteGradients, choice, Rule::Evidence);
            self.state.decisions.push(decision.remarked(Remark::StepSkipped));
        }
        let early = self.end_before_limit();
        self.state.decisions.extend(early);
        self.state.decisions.extend(stuck(&self.state.curve));
        self.state.decisions.extend(self.backend.remarks());
    }

    /// The decision to end before the time limit, if that was made.
    fn end_before_limit(&self) -> Option<Decision> {
        let (steps, seconds) = (f64::from(self.state.place.iteration), self.state.place.seconds);
        let limit = self.setup.config.time_limit?;
        let early = steps > NEARLY * self.most_steps() && seconds < NEARLY * limit;
        early.then(|| {
            Decision::new(Subject::TrainingTime, Measurement::new(Quantity::Time, seconds), Rule::Evidence)
                .remarked(Remark::Overfitting)
                .measured(Quantity::TimeLimit, limit)
                .measured(Quantity::Steps, steps)
                .measured(Quantity::Passes, steps / self.setup.views.len() as f64)
        })
    }
}

/// What a checkpoint must have been told to be continued.
fn fingerprint(dataset: &Dataset, config: &TrainConfig) -> String {
    let told = TrainConfig { seconds_gone: 0.0, ..config.clone() };
    let moving = &dataset.articulation;
    format!("{told:?} {:?} {} {moving:?}", dataset.normalisation, dataset.views.len())
}

/// The configured number of Gaussians or what the device can hold, and the decision that makes of
/// it.
fn capacity(
    backend: &dyn Backend,
    dataset: &Dataset,
    config: &TrainConfig,
) -> Result<(usize, Option<Decision>), SplatError> {
    let pixels = dataset.views.iter().map(|v| v.view.width * v.view.height).max().unwrap_or(0);
    let limit = backend.capacity(config.sh_degree, pixels).filter(|(room, _)| *room < config.max_gaussians);
    match limit {
        None => Ok((config.max_gaussians, None)),
        Some((0, _)) => Err(SplatError::Config {
            flag: "--vram-limit",
            value: config.device.vram_limit.map_or("not given".to_owned(), |mib| mib.to_string()),
            expected: "enough for the pictures and some Gaussians; scale the pictures down",
        }),
        Some((room, why)) => {
            let decision = Decision::new(Subject::GaussianLimit, Choice::count(room), Rule::OutOfMemory);
            Ok((room, Some(decision.quoting(why))))
        }
    }
}
