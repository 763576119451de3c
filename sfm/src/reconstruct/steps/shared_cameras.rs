//! One camera for images of several groups, where the evidence does not tell them apart.

use crate::incremental::adjust::{Adjustment, select};
use crate::incremental::finish::{OBSERVATIONS, part_of};
use crate::incremental::growth::freedom;
use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::noise::noise_in_units;
use crate::model_selection::shared_cameras::groups_differ;
use crate::reconstruct::StepContext;
use crate::reconstruct::setup::Setup;
use crate::{CameraSharing, SfmError};
use scene::Progress;
use scene::decision::{Choice, Decision, Rule, Subject};

/// Fewer cameras, and the model with them, where a camera for each group of images does no better; and what was found.
/// Groups are joined if their images have one size and nothing but a focal length is known of them.
pub(crate) fn share_cameras(
    given: &StepContext<'_>,
    input: &MappingInput<'_>,
    state: &MapState,
    progress: &Progress,
) -> Result<(Option<(Setup, MapState)>, Option<Decision>), SfmError> {
    let setup = given.setup;
    if given.config.cameras != CameraSharing::Group || setup.known.iter().any(|k| k.fixed) {
        return Ok((None, None));
    }
    let (fewer, becomes) = merge_by_size(setup, state);
    if fewer.cameras.len() == setup.cameras.len() {
        return Ok((None, None));
    }
    let starts =
        |setup: &Setup, state: &MapState| crate::incremental::starts_of(&setup.cameras, &setup.known, state);
    let mut merged = state.clone();
    merged.cameras.clone_from(&fewer.cameras);
    let (free, priors) =
        freedom(&state.cameras, &setup.known, &starts(setup, state), state.registered_count());
    let what = Adjustment {
        points_per_image: Some(part_of(state, OBSERVATIONS)),
        ..Adjustment::growing(free, priors)
    };
    let apart = select(state, input, &what).problem;
    let mut one = apart.clone();
    one.cameras.clone_from(&fewer.cameras);
    one.pose_camera.iter_mut().for_each(|c| *c = becomes[*c as usize] as u32);
    let (free, priors) =
        freedom(&merged.cameras, &fewer.known, &starts(&fewer, &merged), merged.registered_count());
    (one.camera_free, one.priors) = (free, priors);
    let sigma = noise_in_units(&apart);
    let (named, known) = (given.config.camera_model.model(), (&setup.known, &fewer.known));
    let (differ, evidence) = groups_differ((&apart, known.0), (&one, known.1), named, sigma, progress)?;
    let kept = if differ { setup.cameras.len() } else { fewer.cameras.len() };
    let choice = Choice::share(kept, setup.cameras.len());
    let decision = Decision::new(Subject::SharedCameras, choice, Rule::Evidence).compared_all(evidence);
    Ok(((!differ).then_some((fewer, merged)), Some(decision)))
}

/// One camera for all images of a size, and which camera each becomes. Its intrinsics are those of the group with the most
/// images of the model, its prior is the first there is.
fn merge_by_size(setup: &Setup, state: &MapState) -> (Setup, Vec<usize>) {
    let mut images = vec![0usize; setup.cameras.len()];
    state.order.iter().for_each(|&i| images[setup.camera_of[i]] += 1);
    let mut fewer = Setup { cameras: Vec::new(), known: Vec::new(), camera_of: Vec::new() };
    let mut most: Vec<usize> = Vec::new();
    let mut becomes = Vec::new();
    for (i, camera) in state.cameras.iter().enumerate() {
        let same = |c: &scene::Camera| (c.width, c.height) == (camera.width, camera.height);
        let number = fewer.cameras.iter().position(same).unwrap_or(fewer.cameras.len());
        becomes.push(number);
        if number == fewer.cameras.len() {
            fewer.cameras.push(scene::Camera { id: number as u32 + 1, ..camera.clone() });
            fewer.known.push(setup.known[i].clone());
            most.push(images[i]);
            continue;
        }
        if images[i] > most[number] {
            most[number] = images[i];
            fewer.cameras[number].params.clone_from(&camera.params);
        }
        if fewer.known[number].focal_sigma.is_none() {
            fewer.known[number] = setup.known[i].clone();
        }
    }
    fewer.camera_of = setup.camera_of.iter().map(|&c| becomes[c]).collect();
    (fewer, becomes)
}
