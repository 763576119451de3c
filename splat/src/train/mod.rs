//! The training loop.
//!
//! A `session` takes steps; its `schedule` says at which resolution and by which step sizes,
//! its `pace` how many there will be within a time limit; `rules` change the Gaussians and
//! decide by evidence. `setup` is what stays as it is, `state` what a `checkpoint` keeps.
//!
//! ```no_run
//! use scene::Progress;
//! use splat::{Dataset, DatasetConfig, TrainConfig, train};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let model = scene::io::read_model(Path::new("out/sparse/0"))?;
//! let (data, progress) = (DatasetConfig::default(), Progress::silent());
//! let dataset = Dataset::load(Path::new("out/images"), None, &model, &data, &progress)?;
//! let result = train(&dataset, &TrainConfig::default(), None, &progress)?;
//! scene::io::write_splat_ply(Path::new("splat.ply"), &result.gaussians)?;
//! for decision in &result.decisions {
//!     println!("{}", decision.sentences());
//! }
//! # Ok(())
//! # }
//! ```

mod checkpoint;
mod context;
mod evidence;
mod loss_trend;
mod pace;
mod result;
mod rules;
pub(crate) mod schedule;
mod session;
mod setup;
mod state;

pub use self::{result::TrainResult, state::CurvePoint};

use crate::config::{MAX_COARSE_LEVELS, TrainConfig};
use crate::dataset::Dataset;
use crate::error::SplatError;
use scene::Progress;
use session::Session;
use std::path::Path;

/// Trains Gaussians on the views that are not held out. With `checkpoint_dir`, continues from the
/// checkpoint there if it belongs to the same configuration, and leaves one when cancelled;
/// stopping and resuming changes no bit of the result (with --time-limit the number of steps
/// depends on the machine's speed).
pub fn train(
    dataset: &Dataset,
    config: &TrainConfig,
    checkpoint_dir: Option<&Path>,
    progress: &Progress,
) -> Result<TrainResult, SplatError> {
    check(config)?;
    let mut session = Session::open(dataset, config, checkpoint_dir)?;
    progress.begin("train", if config.time_limit.is_some() { 0 } else { config.iterations as usize });
    while !session.is_done() {
        session.step()?;
        session.review()?;
        let point = session.state.curve.last().copied().unwrap_or_default();
        let detail = format!("{:.2} dB, {} gaussians", point.psnr, session.backend.gaussians());
        let cancelled = progress.tick_with(&detail).err();
        let every = config.checkpoint_every;
        let due = every > 0 && session.state.place.iteration.is_multiple_of(every);
        if let Some(folder) = checkpoint_dir.filter(|_| cancelled.is_some() || due || session.is_done()) {
            session.save(folder)?;
        }
        if let Some(cancelled) = cancelled {
            return Err(cancelled.into());
        }
        if progress.wants_preview() {
            progress.preview(session.preview()?);
        }
    }
    session.finish()
}

/// Refuses values that make no sense, with the flag to change.
fn check(config: &TrainConfig) -> Result<(), SplatError> {
    let iterations = if config.time_limit.is_some() { 1 } else { config.iterations };
    for (fine, flag, value, expected) in [
        (
            (0.0..=1.0).contains(&config.lambda_dssim),
            "--lambda-dssim",
            config.lambda_dssim.to_string(),
            "a number in [0, 1]",
        ),
        (
            config.learning_rate.is_finite() && config.learning_rate > 0.0,
            "--learning-rate",
            config.learning_rate.to_string(),
            "a positive number",
        ),
        (config.max_gaussians > 0, "--max-gaussians", config.max_gaussians.to_string(), "at least 1"),
        (iterations > 0, "--iterations", iterations.to_string(), "at least 1"),
        (
            config.coarse_levels <= MAX_COARSE_LEVELS,
            "--coarse-levels",
            config.coarse_levels.to_string(),
            "at most 4",
        ),
    ] {
        if !fine {
            return Err(SplatError::Config { flag, value, expected });
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests;
