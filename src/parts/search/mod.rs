//! Parts that no tracks follow, such as a dish without texture, from the photos.
//!
//! The rigid splat is cut into `pieces`, which are let `loose`: trained for a short while, each
//! with a motion and a light of its own. What most of them do is the body's motion. The joints that
//! explain best what single pieces do beside it are candidates; with one of them photos that were
//! not trained on must be explained better than without (`judge`). A training of the part on its
//! joint then turns that, and finds the angles (`refined`).

mod judge;
mod loose;
mod pieces;
mod refined;
#[cfg(test)]
mod tests;

use crate::record::KnownRun;
use anyhow::Result;
use loose::{Freedom, LooseTraining, Seen};
use pieces::Pieces;
use refined::{PhotoCandidate, World, refined};
use scene::{FrameSet, Gaussians, Progress, Reconstruction};
use sfm::{LooseJoint, MovingPart};
use splat::{Dataset, TrainConfig};
use std::path::Path;

/// How candidates are made.
struct PhotoSearchLimits {
    /// Candidates that are judged. Source: chosen by hand: each costs a training.
    candidates: usize,
    /// Points of the splat within so many times a piece's extent of its middle are tried as the
    /// part's. Source: chosen by hand: a piece is some of a part; what is the body's fades.
    reach: f64,
    /// Points of a part at most. Source: chosen by hand.
    points: usize,
    /// Steps and Gaussians of a short training at most. Source: those of `--quality fast`.
    steps: u32,
    gaussians: usize,
}

/// The values in force.
const SEARCH: PhotoSearchLimits =
    PhotoSearchLimits { candidates: 2, reach: 2.0, points: 1000, steps: 1500, gaussians: 60_000 };

/// The part of a run's object whose motion its photos tell of, if they do. `model`: the poses;
/// `folder` is where photos without distortion are put for the while.
pub(super) fn part_from_photos(
    run: &Path,
    folder: &Path,
    frames: &FrameSet,
    model: &Reconstruction,
    progress: &Progress,
) -> Result<Option<MovingPart>> {
    let config = KnownRun::read(run)?.config;
    // Not where the run or a splat of parts has such photos, which stay.
    let set = folder.join(".search");
    let dataset = sfm::undistort(frames, model, &set, progress)
        .map_err(anyhow::Error::from)
        .and_then(|_| crate::evaluate::load_to_train(&set, &config.dataset, progress));
    std::fs::remove_dir_all(&set).ok();
    let dataset = dataset?;
    let known = run.join("splat.ply");
    let gaussians = if known.is_file() {
        scene::io::ply::read_splat_ply(&known)?
    } else {
        splat::train(&dataset, &quick(&config.train), None, progress)?.gaussians
    };
    let gaussians = dataset.normalisation.normalise(gaussians);
    search(dataset, &gaussians, frames, &config.train, progress)
}

/// The same for a splat in the data set's frame that was trained as `run` says.
fn search(
    dataset: Dataset,
    gaussians: &Gaussians,
    frames: &FrameSet,
    run: &TrainConfig,
    progress: &Progress,
) -> Result<Option<MovingPart>> {
    let pieces = Pieces::of(gaussians, run.seed);
    let times = times(&dataset, frames);
    let [judges, views] = judge::split(&dataset.training_views());
    if judges.is_empty() || pieces.centres.is_empty() {
        return Ok(None);
    }
    let seen = Seen { dataset: &dataset, pieces: &pieces, times: &times, views: &views, seed: run.seed };
    for candidate in candidates(seen, progress)? {
        let joint = refined(&dataset, &judges, &times, &candidate, &quick(run), progress)?;
        let normalised = World(dataset.normalisation).normalised(&joint);
        let gain = judge::gain_db(seen, &judges, &normalised, &candidate.points, progress)?;
        if let Some(gain_db) = gain {
            // Gaussians that begin anew let the joint turn on, and no photo need be spared now.
            let again = PhotoCandidate { joint: normalised, ..candidate };
            let joint = refined(&dataset, &[], &times, &again, &quick(run), progress)?;
            return Ok(Some(refined::told(&dataset, frames, &again, &joint, gain_db)));
        }
    }
    Ok(None)
}

/// The joints that explain best what single pieces do, by how much errors grow where the piece
/// rests.
fn candidates(seen: Seen, progress: &Progress) -> Result<Vec<PhotoCandidate>> {
    let mut training = LooseTraining::new(seen, Freedom::Loose)?;
    training.run(progress)?;
    let gains = training.gains()?;
    let joints = sfm::loose_joints(&training.pieces());
    let scored = joints.into_iter().zip(gains).enumerate().filter_map(|(piece, (joint, gain))| {
        let joint = joint?;
        Some((gain * joint.explained, piece, joint)).filter(|(score, ..)| *score > 0.0)
    });
    let mut order: Vec<(f64, usize, LooseJoint)> = scored.collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    let best = order.into_iter().take(SEARCH.candidates);
    Ok(best
        .map(|(_, piece, joint)| PhotoCandidate {
            joint,
            points: seen.pieces.around(piece, SEARCH.reach, SEARCH.points),
        })
        .collect())
}

/// A short training, otherwise as a run's.
fn quick(run: &TrainConfig) -> TrainConfig {
    TrainConfig {
        iterations: run.iterations.min(SEARCH.steps),
        max_gaussians: run.max_gaussians.min(SEARCH.gaussians),
        time_limit: None,
        antialias: false,
        ..run.clone()
    }
}

/// When the views were taken.
fn times(dataset: &Dataset, frames: &FrameSet) -> Vec<f64> {
    let known = sfm::frame_times(frames);
    let numbers = dataset.views.iter().map(|v| frames.frames.iter().position(|f| f.name == v.name));
    numbers.map(|k| k.map_or(0.0, |k| known[k])).collect()
}
