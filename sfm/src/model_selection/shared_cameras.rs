//! Whether groups of images that their files tell apart were taken with one camera all the same.

use super::camera::{CameraSelection, CameraTrial, before_the_choice};
use super::evidence::Comparison;
use crate::bundle::BundleProblem;
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use scene::decision::{Alternative, Choice, Measurement, Quantity};
use scene::{CameraModel, Progress};

/// Whether a camera for each group predicts what was held out so much better than fewer cameras do
/// that it pays for its parameters; and what was found. `apart`, `together`: the same observations,
/// with what is known of their cameras.
pub(crate) fn groups_differ(
    apart: (&BundleProblem, &[Knowledge]),
    together: (&BundleProblem, &[Knowledge]),
    named: Option<CameraModel>,
    sigma: f64,
    progress: &Progress,
) -> Result<(bool, Vec<Alternative>), SfmError> {
    let [one, several] = [together, apart].map(|(problem, known)| {
        CameraSelection::new(problem, known, sigma, progress).trial(problem, before_the_choice(named))
    });
    let (one, several) = (one?, several?);
    let found = Comparison::new(&several.score, &one.score);
    let differ = found.prefers_richer();
    let mut alternatives = vec![group_alternative(&several, differ), group_alternative(&one, !differ)];
    alternatives[0].scores.extend(found.measurements());
    Ok((differ, alternatives))
}

/// So many cameras, with their focal lengths.
fn group_alternative(trial: &CameraTrial, accepted: bool) -> Alternative {
    let cameras = &trial.problem.cameras;
    let focals = cameras.iter().map(|c| Measurement::new(Quantity::FocalLength, c.mean_focal()));
    let scores = [Measurement::new(Quantity::Bic, trial.score.bic)].into_iter().chain(focals).collect();
    Alternative { choice: Choice::count(cameras.len()), accepted, scores }
}
