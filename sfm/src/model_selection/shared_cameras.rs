//! Whether groups of images that their files tell apart were taken with one camera all the same.

use super::camera::{CameraSelection, CameraTrial, FreeIntrinsics, before_the_choice, clearly_better, split};
use super::noise::gain;
use crate::bundle::BundleProblem;
use crate::{Knowledge, SfmError};
use scene::{CameraModel, Progress};

/// Whether a camera for each group predicts what was held out so much better than fewer cameras do that it pays for its
/// parameters; and what was found. `apart`, `together`: the same observations, with what is known of their cameras.
pub(crate) fn groups_differ(
    apart: (&BundleProblem, &[Knowledge]),
    together: (&BundleProblem, &[Knowledge]),
    named: Option<CameraModel>,
    sigma: f64,
    progress: &Progress,
) -> Result<(bool, String), SfmError> {
    let intrinsics: FreeIntrinsics = before_the_choice(named);
    let adjusted = |(problem, known): (&BundleProblem, &[Knowledge])| {
        let (training, held_out) = split(problem);
        CameraSelection { training, held_out, sigma, known, progress }.trial(problem, intrinsics)
    };
    let (one, several) = (adjusted(together)?, adjusted(apart)?);
    let (gain, error) = gain(&one.by_pose, &several.by_pose);
    let focals = |t: &super::camera::CameraTrial| {
        let of = |c: &scene::Camera| format!("{:.1}", c.mean_focal());
        t.problem.cameras.iter().map(of).collect::<Vec<_>>().join(", ")
    };
    let evidence = format!(
        "focal lengths of {} px apart, {} px together; BIC {:.0} apart, {:.0} together, held-out gain of cameras apart {gain:.4} ± {error:.4}",
        focals(&several),
        focals(&one),
        several.bic,
        one.bic
    );
    Ok((clearly_better((gain, error), several.bic, one.bic), evidence))
}
