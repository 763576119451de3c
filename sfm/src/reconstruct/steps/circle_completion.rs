//! Images that a ring of cameras misses, put in their places on it, where one camera took them all.

use crate::SfmError;
use crate::circular::{Motion, MotionInput, ring};
use crate::incremental::growth::starts_of;
use crate::incremental::state::{MapState, MappingInput};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::skip::StepName;
use scene::Decision;

/// Completes the ring.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let completed = complete_circle(&model, &model.state, &model.input(context), context)?;
    let Some((state, decision)) = completed else { return Ok((model, Vec::new())) };
    model.state = state;
    Ok((model, vec![decision]))
}

/// The poses and points of `state` with the images that its ring misses; `None` where it is no ring
/// or misses none.
pub(super) fn complete_circle(
    model: &SfmModel,
    state: &MapState,
    input: &MappingInput<'_>,
    context: &StepContext<'_>,
) -> Result<Option<(MapState, Decision)>, SfmError> {
    let asked = context.config.motion.motion != Motion::Free && !context.skips(StepName::CircleCompletion);
    if !asked || model.setup.cameras.len() != 1 {
        return Ok(None);
    }
    let starts = starts_of(&model.setup.cameras, &model.setup.known, state);
    let motion = MotionInput { starts: &starts, ..model.motion_input(input, context) };
    ring::complete(state, &motion.context(&[]), model.intrinsics)
}
