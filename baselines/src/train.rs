//! The training loop of all methods: schedule, curve, checkpoints.

use crate::accelerator::Accelerator;
use crate::error::FieldError;
use crate::field::{RadianceField, StepPlace};
use crate::method::{FieldShape, Method};
use crate::rays::PhotoRays;
use crate::store;
use crate::trained::TrainedField;
use scene::Progress;
use scene::clock::LimitClock;
use serde::{Deserialize, Serialize};
use splat::train::CurvePoint;
use splat::{Dataset, DeviceConfig};
use std::path::Path;

/// Steps between points of the curve. Source: as the splats' trainer.
const CURVE_EVERY: u32 = 50;
/// Name of the checkpoint.
const FILE: &str = "field.checkpoint";

/// What training can be told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldConfig {
    /// How.
    pub method: Method,
    /// Steps, where there is no time limit.
    pub iterations: u32,
    /// Seconds: the schedule fits itself into it.
    pub time_limit: Option<f64>,
    /// What the time limit counts.
    pub limit_clock: LimitClock,
    /// Steps between checkpoints (0: only when stopped).
    pub checkpoint_every: u32,
    /// Seed of all randomness.
    pub seed: u64,
    /// Where to compute.
    pub device: DeviceConfig,
    /// Seconds of the time limit that went by before training began.
    #[serde(skip)]
    pub seconds_gone: f64,
}

impl FieldConfig {
    /// So many steps, with a checkpoint only when stopped.
    pub fn new(method: Method, iterations: u32) -> Self {
        Self {
            method,
            iterations,
            time_limit: None,
            limit_clock: LimitClock::Wall,
            checkpoint_every: 0,
            seed: 0,
            device: DeviceConfig::default(),
            seconds_gone: 0.0,
        }
    }
}

/// What training yields.
pub struct FieldResult {
    /// The field.
    pub field: TrainedField,
    /// Where it was trained, in words.
    pub by: String,
    /// Loss and PSNR of the training rays over time; no Gaussians.
    pub curve: Vec<CurvePoint>,
    /// Steps done.
    pub iterations: u32,
    /// Parameters learnt.
    pub parameters: usize,
    /// Products and sums of the networks' layers in all steps of this call.
    pub operations: f64,
}

/// Place in the schedule, and what was noted on the way.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct FieldState {
    /// What the run was told, as JSON: another configuration starts afresh.
    fingerprint: String,
    iteration: u32,
    position: f64,
    seconds: f64,
    curve: Vec<CurvePoint>,
    /// Sums since the last point of the curve.
    loss: f64,
    square_error: f64,
}

/// Trains a field on the views that are not held out; `times` has the time of each view, in
/// [0, 1], and is empty where the scene stands still. With `checkpoint_dir`, continues from the
/// checkpoint there if it belongs to the same configuration, and leaves one when cancelled;
/// stopping and resuming changes no bit of the result (with a time limit the number of steps
/// depends on the machine's speed).
pub fn train(
    dataset: &Dataset,
    times: &[f32],
    config: &FieldConfig,
    checkpoint_dir: Option<&Path>,
    progress: &Progress,
) -> Result<FieldResult, FieldError> {
    let Some(shape) = FieldShape::of(config.method, dataset, times, config.time_limit.is_some()) else {
        let (value, expected) = (config.method.name().to_owned(), "a method that is no splat");
        return Err(FieldError::Config { flag: "--method", value, expected });
    };
    train_shape(shape, (dataset, times), config, checkpoint_dir, progress)
}

/// The same for a field of a given shape.
pub(crate) fn train_shape(
    shape: FieldShape,
    (dataset, times): (&Dataset, &[f32]),
    config: &FieldConfig,
    checkpoint_dir: Option<&Path>,
    progress: &Progress,
) -> Result<FieldResult, FieldError> {
    if config.iterations == 0 && config.time_limit.is_none() {
        let (value, expected) = (config.iterations.to_string(), "at least 1");
        return Err(FieldError::Config { flag: "--iterations", value, expected });
    }
    let path = checkpoint_dir.map(|folder| folder.join(FILE));
    let mut mark = config.limit_clock.seconds();
    let by = Accelerator::open(&config.device)?;
    let (mut field, mut state) = open((dataset, &by), shape, config, path.as_deref())?;
    state.seconds += config.seconds_gone;
    let mut operations = 0.0;
    let photos = PhotoRays::new(dataset, times);
    let most = field.most_steps(photos.len());
    progress.begin("train", if config.time_limit.is_some() { 0 } else { config.iterations as usize });
    while state.position < 1.0 {
        let place = StepPlace { step: state.iteration, position: state.position, seed: config.seed };
        let report = field.train_step(&photos, place)?;
        state.iteration += 1;
        operations += report.operations;
        if !(report.loss.is_finite() && report.square_error.is_finite()) {
            let reason = "the loss is not finite";
            return Err(FieldError::Diverged { iteration: state.iteration, reason });
        }
        state.loss += report.loss;
        state.square_error += report.square_error;
        let now = config.limit_clock.seconds();
        state.seconds += now - std::mem::replace(&mut mark, now);
        state.position = match config.time_limit {
            Some(limit) => (state.seconds / limit).max(f64::from(state.iteration) / most),
            None => f64::from(state.iteration) / f64::from(config.iterations),
        };
        state.add_curve_point();
        let psnr = state.curve.last().map_or(0.0, |p| p.psnr);
        let cancelled = progress.tick_with(&format!("{psnr:.2} dB, {} rays", report.rays)).err();
        let every = config.checkpoint_every;
        let due = every > 0 && state.iteration.is_multiple_of(every);
        if let Some(path) = path.as_deref().filter(|_| cancelled.is_some() || due) {
            field.fetch()?;
            store::write(path, shape, dataset.normalisation, field.as_ref(), Some(&state))?;
        }
        if let Some(cancelled) = cancelled {
            return Err(cancelled.into());
        }
    }
    field.fetch()?;
    Ok(FieldResult {
        by: by.name(),
        parameters: field.size(),
        operations,
        field: TrainedField::new(shape, dataset.normalisation, field),
        curve: state.curve,
        iterations: state.iteration,
    })
}

/// The field of a checkpoint, or an untrained one.
fn open(
    (dataset, by): (&Dataset, &Accelerator),
    shape: FieldShape,
    config: &FieldConfig,
    path: Option<&Path>,
) -> Result<(Box<dyn RadianceField>, FieldState), FieldError> {
    let fingerprint = serde_json::to_string(&(config, shape, dataset.normalisation)).unwrap_or_default();
    if let Some(path) = path {
        let read = store::read(path, (Some(dataset), by), |header| {
            header.shape == shape && header.training.as_ref().is_some_and(|t| t.fingerprint == fingerprint)
        })?;
        if let Some((header, field)) = read
            && let Some(state) = header.training
        {
            return Ok((field, state));
        }
    }
    let state = FieldState { fingerprint, ..FieldState::default() };
    Ok((shape.build(Some(dataset), config.seed, by)?, state))
}

impl FieldState {
    /// Ends a stretch of the curve where one is due.
    fn add_curve_point(&mut self) {
        if !(self.iteration.is_multiple_of(CURVE_EVERY) || self.position >= 1.0) {
            return;
        }
        let begun = self.curve.last().map_or(0, |p| p.iteration);
        let steps = f64::from(self.iteration - begun).max(1.0);
        let square_error = std::mem::take(&mut self.square_error) / steps;
        self.curve.push(CurvePoint {
            iteration: self.iteration,
            seconds: self.seconds,
            loss: (std::mem::take(&mut self.loss) / steps) as f32,
            psnr: (-10.0 * square_error.max(f64::EPSILON).log10()) as f32,
            gaussians: 0,
        });
    }
}
