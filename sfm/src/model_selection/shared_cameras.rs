//! Whether groups of images that their files tell apart were taken with one camera all the same.

use super::camera::{CameraSelection, CameraTrial, FreeIntrinsics, before_the_choice, split};
use super::evidence::Comparison;
use crate::bundle::BundleProblem;
use crate::{Knowledge, SfmError};
use scene::decision::{Alternative, Choice, Measurement, Quantity};
use scene::{CameraModel, Progress};

/// Whether a camera for each group predicts what was held out so much better than fewer cameras do that it pays for its
/// parameters; and what was found. `apart`, `together`: the same observations, with what is known of their cameras.
pub(crate) fn groups_differ(
    apart: (&BundleProblem, &[Knowledge]),
    together: (&BundleProblem, &[Knowledge]),
    named: Option<CameraModel>,
    sigma: f64,
    progress: &Progress,
) -> Result<(bool, Vec<Alternative>), SfmError> {
    let intrinsics: FreeIntrinsics = before_the_choice(named);
    let adjusted = |(problem, known): (&BundleProblem, &[Knowledge])| {
        let (training, held_out) = split(problem);
        CameraSelection { training, held_out, sigma, known, progress }.trial(problem, intrinsics)
    };
    let (one, several) = (adjusted(together)?, adjusted(apart)?);
    let found = Comparison::new(&several.score, &one.score);
    let differ = found.prefers_richer();
    let mut apart = group_alternative(&several, differ);
    apart.scores.extend(found.measurements());
    Ok((differ, vec![apart, group_alternative(&one, !differ)]))
}

/// So many cameras, with their focal lengths.
fn group_alternative(trial: &CameraTrial, accepted: bool) -> Alternative {
    let cameras = &trial.problem.cameras;
    let focals = cameras.iter().map(|c| Measurement::new(Quantity::FocalLength, c.mean_focal()));
    let scores = [Measurement::new(Quantity::Bic, trial.score.bic)].into_iter().chain(focals).collect();
    Alternative { choice: Choice::count(cameras.len()), accepted, scores }
}
