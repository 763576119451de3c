//! Whether photos show a turn about one axis, an orbit or neither.

use super::config::Motion;
use super::evidence::MotionComparison;
use super::job::{FreeModel, MotionInput};
use super::limits::{FINAL_ROUNDS, TIGHT};
use super::model::CircularContext;
use super::motion::CircularMotion;
use super::orbit;
use super::photos;
use super::solution::{ChosenModel, CircularSolution, rough_noise};
use crate::error::SfmError;
use crate::incremental::finish::noise_of;
use crate::incremental::state::MapState;
use crate::limits::WHOLE;
use scene::decision::{Decision, Measurement, MotionModel, Quantity, Remark, Rule, Subject};

/// One axis is not looked at further where it leaves so many times the residuals of free poses.
/// Source: chosen by hand, never measured.
const HOPELESS: f64 = 3.0;

/// What the search for a turn or an orbit came to.
pub(crate) struct MotionOutcome {
    /// The model about one axis, if it is to be taken.
    pub taken: Option<CircularSolution>,
    /// The general model, adjusted once more with its cameras near a circle, if that is to be
    /// taken.
    pub circled: Option<MapState>,
    /// Why.
    pub decision: Option<Decision>,
}

impl MotionOutcome {
    /// Free poses; `evidence` says why.
    fn free(evidence: Decision) -> Self {
        let decision = Decision { choice: MotionModel::Free.into(), ..evidence };
        Self { taken: None, circled: None, decision: Some(decision) }
    }
}

/// Looks whether the images show a turn about one axis or an orbit, as far as the configuration
/// asks for it. `unrotated`: no image was rotated on its way here.
pub(crate) fn consider(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    unrotated: bool,
) -> Result<MotionOutcome, SfmError> {
    let motion = job.config.motion;
    if matches!(motion, Motion::Free | Motion::Tumble) {
        return Ok(MotionOutcome::free(motion_decision(Rule::Requested)));
    }
    let mut evidence = motion_decision(Rule::Evidence);
    if job.cameras.len() != 1 {
        let several = evidence.remarked(Remark::SeveralCameras);
        return Ok(MotionOutcome::free(several.measured(Quantity::Cameras, job.cameras.len() as f64)));
    }
    let solved =
        if unrotated && motion != Motion::Orbit { one_axis(job, free, &mut evidence)? } else { None };
    compare(job, free, solved, evidence)
}

/// Single axis, orbit or free by their evidence on the same observations.
fn compare(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    solved: Option<ChosenModel>,
    mut evidence: Decision,
) -> Result<MotionOutcome, SfmError> {
    let motion = job.config.motion;
    let single = solved.as_ref().map(|s| &s.model);
    let images = single.map_or(0, |s| s.state.registered_count());
    // The general model's observations, unless it has fewer images.
    let base = free.filter(|f| f.state.registered_count() >= images);
    let Some(state) = base.map(|f| f.state).or(single.map(|s| &s.state)) else {
        return Ok(MotionOutcome::free(evidence.remarked(Remark::NoSingleAxisModel)));
    };
    if solved.is_none() && motion == Motion::Auto && !orbit::is_possible(state) {
        return Ok(MotionOutcome::free(evidence.remarked(Remark::NoCircle)));
    }
    let context = job.context(&[]);
    let freedom = base.map(|f| f.intrinsics).or(solved.as_ref().map(|s| s.intrinsics));
    let comparison = match freedom {
        Some(freedom) => MotionComparison::of(single, state, &context, freedom)?,
        None => None,
    };
    evidence = with_comparison(evidence, comparison.as_ref());
    if matches!(motion, Motion::SingleAxis | Motion::Orbit) {
        evidence.rule = Rule::Requested;
    }
    let choice = comparison.as_ref().map_or(MotionModel::Free, MotionComparison::choice);
    let fewer = solved.is_some() && images < free.map_or(0, |f| f.state.registered_count());
    let is_single = motion == Motion::SingleAxis || (choice == MotionModel::SingleAxis && !fewer);
    if let Some(solved) = solved.filter(|_| is_single) {
        let decision = Some(Decision { choice: MotionModel::SingleAxis.into(), ..evidence });
        return Ok(MotionOutcome {
            taken: Some(solved.finish(&context, job, 1.0, None)?),
            circled: None,
            decision,
        });
    }
    match (base, comparison) {
        (Some(free), Some(c)) if choice == MotionModel::Orbit || motion == Motion::Orbit => {
            Ok(MotionOutcome {
                taken: None,
                circled: on_a_circle(&context, free, c.orbit_sigma)?,
                decision: Some(Decision { choice: MotionModel::Orbit.into(), ..evidence }),
            })
        }
        _ => Ok(MotionOutcome::free(evidence)),
    }
}

/// The decision on the motion, before it is made.
pub(crate) fn motion_decision(rule: Rule) -> Decision {
    Decision::new(Subject::Motion, MotionModel::Free, rule)
}

/// The evidence with what the comparison of motions says.
pub(crate) fn with_comparison(evidence: Decision, comparison: Option<&MotionComparison>) -> Decision {
    match comparison {
        Some(comparison) => evidence.absorbing(comparison.describe()),
        None => Decision { rule: Rule::TooFewObservations, ..evidence },
    }
}

/// The general model adjusted once more, its cameras near the circle; `None` where that is too
/// wide.
fn on_a_circle(
    context: &CircularContext<'_>,
    free: &FreeModel<'_>,
    sigma: [f64; 2],
) -> Result<Option<MapState>, SfmError> {
    if !sigma.iter().all(|s| *s < TIGHT) {
        return Ok(None);
    }
    orbit::hold(free.state, context, free.intrinsics, sigma)
}

/// A model about one axis, from the free poses where they turn, else from three images; what was
/// found is noted.
fn one_axis(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    evidence: &mut Decision,
) -> Result<Option<ChosenModel>, SfmError> {
    let registered = free.map_or(0, |f| f.state.registered_count());
    let is_whole = registered as f64 >= WHOLE * job.input.keypoints.len() as f64;
    let context = job.context(&[]);
    let mut solved = None;
    if let Some((free, turn)) = free.zip(near_turn(job, free, evidence)) {
        let cameras = &free.state.cameras;
        let free_px = noise_of(free.state, job.input);
        let axis_px = rough_noise(&context, cameras, turn.clone())?;
        if job.config.motion != Motion::SingleAxis && is_whole && axis_px > HOPELESS * free_px {
            evidence.measurements.extend([
                Measurement::new(Quantity::SingleAxisResidual, axis_px),
                Measurement::new(Quantity::FreeResidual, free_px),
            ]);
            return Ok(None);
        }
        solved = ChosenModel::adjust(&context, job, cameras, turn, FINAL_ROUNDS)?;
    }
    // Where the general solver left images out, a turn may take them in.
    let Some(model) = (if is_whole { None } else { photos::from_photos(job)? }) else { return Ok(solved) };
    let registered = model.state.registered_count();
    if solved.as_ref().is_some_and(|s| registered <= s.model.state.registered_count()) {
        return Ok(solved);
    }
    evidence.remarks.push(Remark::ThreeImages);
    evidence.measurements.push(Measurement::count(Quantity::RegisteredImages, registered));
    let larger = ChosenModel::adjust(&context, job, &model.state.cameras, model.turn, FINAL_ROUNDS)?;
    Ok(larger.or(solved))
}

/// The turn that free poses show, where they are near enough to one or one is asked for.
fn near_turn(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    evidence: &mut Decision,
) -> Option<CircularMotion> {
    let Some((turn, misfit)) = free.and_then(|f| CircularMotion::of_poses(&f.state.poses)) else {
        evidence.remarks.push(Remark::NoRotation);
        return None;
    };
    evidence.measurements.extend([
        Measurement::new(Quantity::AxisMisalignment, misfit.tilt.to_degrees()),
        Measurement::new(Quantity::CircleMisfit, misfit.slip),
    ]);
    (job.config.motion == Motion::SingleAxis || orbit::is_near(&misfit)).then_some(turn)
}
