//! One camera for images of several groups, where a camera for each does no better.

use crate::config::CameraSharing;
use crate::incremental::adjust::{Adjustment, select};
use crate::incremental::finish::{OBSERVATIONS, part_of};
use crate::incremental::growth::{freedom, starts_of};
use crate::incremental::state::MapState;
use crate::model_selection::noise::noise_in_units;
use crate::model_selection::shared_cameras::groups_differ;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::reconstruct::setup::Setup;
use scene::decision::{Choice, Decision, Rule, Subject};

/// Joins groups if their images have one size and nothing but a focal length is known of them.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let setup = &model.setup;
    if context.config.cameras != CameraSharing::Group || setup.known.iter().any(|k| k.fixed) {
        return Ok((model, Vec::new()));
    }
    let (fewer, becomes) = merge_by_size(setup, &model.state);
    let groups = setup.cameras.len();
    if fewer.cameras.len() == groups {
        return Ok((model, Vec::new()));
    }
    let images = model.state.registered_count();
    let (free, priors) = freedom(
        &model.state.cameras,
        &setup.known,
        &starts_of(&setup.cameras, &setup.known, &model.state),
        images,
    );
    let what = Adjustment {
        points_per_image: Some(part_of(&model.state, OBSERVATIONS)),
        ..Adjustment::growing(free, priors)
    };
    let apart = select(&model.state, &model.input(context), &what).problem;
    let mut one = apart.clone();
    one.cameras.clone_from(&fewer.cameras);
    one.pose_camera.iter_mut().for_each(|c| *c = becomes[*c as usize] as u32);
    let mut merged = model.state.clone();
    merged.cameras.clone_from(&fewer.cameras);
    let starts = starts_of(&fewer.cameras, &fewer.known, &merged);
    (one.camera_free, one.priors) = freedom(&merged.cameras, &fewer.known, &starts, images);
    let sigma = noise_in_units(&apart);
    let (named, progress) = (context.config.camera_model.model(), context.progress);
    let (differ, evidence) =
        groups_differ((&apart, &setup.known), (&one, &fewer.known), named, sigma, progress)?;
    let kept = if differ { groups } else { fewer.cameras.len() };
    let choice = Choice::share(kept, groups);
    let decision = Decision::new(Subject::SharedCameras, choice, Rule::Evidence).compared_all(evidence);
    if !differ {
        (model.setup, model.state) = (fewer, merged);
    }
    Ok((model, vec![decision]))
}

/// One camera for all images of a size, and which camera each becomes. Its intrinsics are those of
/// the group with the most images of the model, its prior is the first there is.
fn merge_by_size(setup: &Setup, state: &MapState) -> (Setup, Vec<usize>) {
    let mut images = vec![0usize; setup.cameras.len()];
    state.order.iter().for_each(|&i| images[setup.camera_of[i]] += 1);
    let mut fewer = Setup::default();
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
