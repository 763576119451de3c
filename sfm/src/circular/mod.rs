//! Objects that turn about one axis before a camera that stands still: modelled as one axis (direction and place), one
//! angle a frame, shared intrinsics and points, instead of six numbers a frame.
//!
//! Fitzgibbon, Cross & Zisserman, "Automatic 3D model construction for turn-table sequences" (SMILE 1998).

mod axis;
#[cfg(test)]
mod axis_tests;
mod config;
mod evidence;
#[cfg(test)]
mod extreme_tests;
pub(crate) mod initialize;
mod intrinsics;
mod jumps;
mod loop_closure;
mod model;
pub mod motion;
#[cfg(test)]
mod motion_tests;
mod orbit;
mod photos;
mod prior;
pub mod problem;
mod register;
pub(crate) mod ring;
#[cfg(test)]
mod tests;
mod vertical_lines;
mod video;
mod whiten;

pub use config::{Motion, MotionConfig};
pub(crate) use video::{VideoJob, solve_video};

use crate::Knowledge;
use crate::incremental::adjust::Adjustment;
use crate::incremental::finish::noise_of;
use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::camera::{FreeIntrinsics, convert_camera};
use crate::skip::StepName;
use crate::{Decision, PoseDeviation, SfmError, Uncertainty};
use axis::Elevation;
use evidence::{Comparison, MotionModel};
use intrinsics::choose_for_turn;
use model::{AxisModel, CircularContext};
use motion::CircularMotion;
use scene::{Camera, CameraModel, FrameSet, Progress};
use vertical_lines::Segment;

/// Points an image contributes to a first look.
const POINTS_ROUGH: usize = 50;
/// Points that the images contribute to the choice of the camera model, all together, and most of one.
const POINTS_TO_CHOOSE: usize = 25_000;
const POINTS_TO_CHOOSE_OF_ONE: usize = 250;
/// Most rounds of the last adjustment, and of the one before the evidence about the motion, after which it follows.
const ROUNDS: usize = 3;
const ROUNDS_BEFORE: usize = 2;

/// Adjustments near a circle: observations that fit the first one take part in the next.
const CIRCLE_ROUNDS: usize = 2;
/// A circle that cameras keep to no better than this (radians, radii) holds them no firmer than their observations do.
const TIGHT: f64 = 0.01;

/// One axis is not looked at further where it leaves so many times the residuals of free poses.
const HOPELESS: f64 = 3.0;

/// Share of the images with which the general model needs no other start.
const WHOLE: f64 = 0.9;

/// The general model, as the general solver left it.
pub(crate) struct FreeModel<'a> {
    /// Poses, points, cameras.
    pub state: &'a MapState,
    /// Its camera model.
    pub intrinsics: FreeIntrinsics,
}

/// A model under the constraint of one axis, and what was learned with it.
pub(crate) struct CircularSolution {
    pub state: MapState,
    pub decisions: Vec<Decision>,
    pub uncertainty: Option<Uncertainty>,
}

/// What the search for a turn or an orbit came to.
pub(crate) struct MotionOutcome {
    /// The model about one axis, if it is to be taken.
    pub taken: Option<CircularSolution>,
    /// The general model, adjusted once more with its cameras near a circle, if that is to be taken.
    pub circled: Option<MapState>,
    /// Why.
    pub decision: Option<Decision>,
}

impl MotionOutcome {
    fn free(evidence: String) -> Self {
        Self { taken: None, circled: None, decision: Some(decision("free", evidence)) }
    }
}

/// Everything the search needs beside the models.
pub(crate) struct MotionInput<'a> {
    pub input: &'a MappingInput<'a>,
    pub cameras: &'a [Camera],
    pub known: &'a [Knowledge],
    pub starts: &'a [Camera],
    pub named: Option<CameraModel>,
    pub config: &'a MotionConfig,
    pub features: &'a [usize],
    /// Images in which the room may be looked at.
    pub room: Option<&'a FrameSet>,
    pub progress: &'a Progress,
}

impl MotionInput<'_> {
    pub(crate) fn context<'a>(&'a self, relations: &'a [problem::Relation]) -> CircularContext<'a> {
        CircularContext {
            input: self.input,
            known: self.known,
            starts: self.starts,
            relations,
            elevation: self.config.known_elevation.map(Elevation::from_measurement),
            closing: None,
            times: &[],
            features: self.features,
            progress: self.progress,
        }
    }
}

impl MotionInput<'_> {
    /// Lines of the room, where they are asked how the camera looks down.
    fn edges(&self, turn: &CircularMotion) -> Result<Vec<Segment>, SfmError> {
        let asked = !self.known[0].fixed
            && self.config.known_elevation.is_none()
            && !self.input.skips(StepName::VerticalLines);
        self.room.filter(|_| asked).map_or(Ok(Vec::new()), |frames| vertical_lines::room_edges(frames, turn))
    }
}

/// The decision on the motion.
pub(crate) fn decision(chosen: &str, evidence: String) -> Decision {
    Decision { what: "motion".to_owned(), chosen: chosen.to_owned(), evidence }
}

/// Looks whether the images show a turn about one axis or an orbit, as far as the configuration asks for it. `unrotated`:
/// no image was rotated on its way here.
pub(crate) fn consider(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    unrotated: bool,
) -> Result<MotionOutcome, SfmError> {
    let motion = job.config.motion;
    if motion == Motion::Free {
        return Ok(MotionOutcome::free("asked for".to_owned()));
    }
    if job.cameras.len() != 1 {
        let evidence = format!("{} cameras took the images: none stood still", job.cameras.len());
        return Ok(MotionOutcome::free(evidence));
    }
    let mut notes = Vec::new();
    let solved = if unrotated && motion != Motion::Orbit { one_axis(job, free, &mut notes)? } else { None };
    let registered = free.map_or(0, |f| f.state.registered_count());
    let context = job.context(&[]);
    // The general model's observations, unless it has fewer images.
    let single = solved.as_ref().map(|s| &s.0);
    let base =
        free.filter(|f| single.is_none_or(|s| f.state.registered_count() >= s.state.registered_count()));
    let Some(state) = base.map(|f| f.state).or(single.map(|s| &s.state)) else {
        notes.push("no model about one axis stands".to_owned());
        return Ok(MotionOutcome::free(notes.join("; ")));
    };
    if solved.is_none() && motion == Motion::Auto && !orbit::is_possible(state) {
        notes.push("the poses are on no circle".to_owned());
        return Ok(MotionOutcome::free(notes.join("; ")));
    }
    let freedom = base.map(|f| f.intrinsics).or(solved.as_ref().map(|s| s.1));
    let comparison = match freedom {
        Some(freedom) => Comparison::of(single, state, &context, freedom)?,
        None => None,
    };
    notes
        .push(comparison.as_ref().map_or("too few observations to compare".to_owned(), Comparison::describe));
    let choice = comparison.as_ref().map_or(MotionModel::Free, Comparison::choice);
    let evidence = notes.join("; ");
    let fewer = single.is_some_and(|s| s.state.registered_count() < registered);
    match solved {
        Some((mut model, intrinsics, camera))
            if motion == Motion::SingleAxis || (choice == MotionModel::Single && !fewer) =>
        {
            let turned = finish(&mut model, &context, job, intrinsics, (camera, 1.0))?;
            let decision = Some(decision("single-axis", evidence));
            Ok(MotionOutcome { taken: Some(turned), circled: None, decision })
        }
        _ => match (base, comparison) {
            (Some(free), Some(c)) if choice == MotionModel::Orbit || motion == Motion::Orbit => {
                on_a_circle(&context, free, &c, evidence)
            }
            _ => Ok(MotionOutcome::free(evidence)),
        },
    }
}

/// The general model as an orbit: adjusted once more, its cameras near the circle.
fn on_a_circle(
    context: &CircularContext<'_>,
    free: &FreeModel<'_>,
    comparison: &Comparison,
    evidence: String,
) -> Result<MotionOutcome, SfmError> {
    let mut circled: Option<MapState> = None;
    let [turn, shift] = comparison.orbit_sigma;
    let rounds = if turn < TIGHT && shift < TIGHT { CIRCLE_ROUNDS } else { 0 };
    for _ in 0..rounds {
        let from = circled.as_ref().unwrap_or(free.state);
        let Some(mut next) = orbit::adjust(from, context, free.intrinsics, comparison.orbit_sigma)? else {
            break;
        };
        next.filter(context.input, context.input.config.max_reprojection_px);
        next.grow_all(context.input);
        circled = Some(next);
    }
    Ok(MotionOutcome { taken: None, circled, decision: Some(decision("orbit", evidence)) })
}

/// A model about one axis, from the free poses where they turn, else from three images; what was found is noted.
fn one_axis(
    job: &MotionInput<'_>,
    free: Option<&FreeModel<'_>>,
    notes: &mut Vec<String>,
) -> Result<Option<(AxisModel, FreeIntrinsics, Decision)>, SfmError> {
    let single = job.config.motion == Motion::SingleAxis;
    let from_free = free.and_then(|f| CircularMotion::of_poses(&f.state.poses));
    notes.push(match &from_free {
        Some((_, misfit)) => format!(
            "the axes of the free poses' rotations are {:.2}° apart, their places {:.2} % of the radius",
            misfit.tilt.to_degrees(),
            100.0 * misfit.slip
        ),
        None => "the general solver has no poses that turn".to_owned(),
    });
    let near = from_free.filter(|(_, m)| single || orbit::is_near(m));
    let registered = free.map_or(0, |f| f.state.registered_count());
    let whole = registered as f64 >= WHOLE * job.input.keypoints.len() as f64;
    let context = job.context(&[]);
    let mut solved = match (near, free) {
        (Some((turn, _)), Some(f)) => {
            let free_px = noise_of(f.state, job.input);
            let axis_px = rough_noise(&context, &f.state.cameras, turn.clone())?;
            if !single && whole && axis_px > HOPELESS * free_px {
                notes.push(format!(
                    "one axis leaves residuals of {axis_px:.2} px, free poses of {free_px:.2} px"
                ));
                return Ok(None);
            }
            adjust_and_choose(&context, job, &f.state.cameras, turn, ROUNDS)?
        }
        _ => None,
    };
    // Where the general solver left images out, a turn may take them in.
    if !whole && let Some(model) = photos::from_photos(job)? {
        let more =
            solved.as_ref().is_none_or(|s| model.state.registered_count() > s.0.state.registered_count());
        if more {
            notes.push(format!(
                "{} images grew from three of them under one axis",
                model.state.registered_count()
            ));
            let cameras = model.state.cameras.clone();
            solved = adjust_and_choose(&context, job, &cameras, model.turn, ROUNDS)?.or(solved);
        }
    }
    Ok(solved)
}

/// Cameras in the model that the priors refer to, until the evidence has spoken.
fn as_at_the_start(cameras: &[Camera], context: &CircularContext<'_>) -> Vec<Camera> {
    let same = |(camera, start): (&Camera, &Camera)| convert_camera(camera, start.model);
    cameras.iter().zip(context.starts).map(same).collect()
}

/// Standard deviation of a residual that one axis leaves after a short adjustment, pixels.
fn rough_noise(
    context: &CircularContext<'_>,
    cameras: &[Camera],
    turn: CircularMotion,
) -> Result<f64, SfmError> {
    let mut model = AxisModel::new(context.input, as_at_the_start(cameras, context), turn);
    let stands = model.settle_with(context, 1, POINTS_ROUGH, model.state.registered_count())?;
    Ok(if stands { noise_of(&model.state, context.input) } else { f64::INFINITY })
}

/// The model about one axis from a first guess, adjusted for so many rounds; `None` where none stands.
pub(crate) fn adjust_and_choose(
    context: &CircularContext<'_>,
    job: &MotionInput<'_>,
    cameras: &[Camera],
    turn: CircularMotion,
    rounds: usize,
) -> Result<Option<(AxisModel, FreeIntrinsics, Decision)>, SfmError> {
    let mut model = AxisModel::new(context.input, as_at_the_start(cameras, context), turn);
    if !model.settle(context, 5)? {
        return Ok(None);
    }
    let (free, priors) =
        crate::incremental::growth::freedom(&model.state.cameras, context.known, context.starts, usize::MAX);
    let points = (POINTS_TO_CHOOSE / model.state.registered_count().max(1)).clamp(1, POINTS_TO_CHOOSE_OF_ONE);
    let what = Adjustment { points_per_image: Some(points), ..Adjustment::growing(free, priors) };
    let (mut problem, selected) = model.problem(context, &what);
    model.weigh(context, &mut problem.bundle, &selected);
    let edges = job.edges(&model.turn)?;
    let (intrinsics, decision, elevation) = choose_for_turn(&problem, context, &edges, job.named)?;
    model.elevation = elevation;
    model.polish(context, intrinsics, rounds)?;
    Ok(Some((model, intrinsics, decision)))
}

/// Figures of the finished model, and the world frame. `excess`: factor on variances that the noise of single observations
/// gives, for the axis.
pub(crate) fn finish(
    model: &mut AxisModel,
    context: &CircularContext<'_>,
    job: &MotionInput<'_>,
    intrinsics: FreeIntrinsics,
    (camera, excess): (Decision, f64),
) -> Result<CircularSolution, SfmError> {
    model.orient(job.config.known_distance.unwrap_or(1.0));
    let mut uncertainty = None;
    let mut decisions = vec![camera];
    if let Some((problem, images, covariance)) = model.covariance(context, intrinsics)? {
        let mut result = Uncertainty {
            sigma_px: crate::model_selection::noise::noise(&problem.bundle),
            ..Uncertainty::default()
        };
        for (camera, c) in problem.bundle.cameras.iter().zip(&covariance.cameras) {
            let n = camera.params.len();
            result.cameras.insert(camera.id, (0..n).map(|i| c[i * n + i].max(0.0).sqrt()).collect());
        }
        for (&image, d) in images.iter().zip(&problem.pose_deviations(&covariance)) {
            let deviation = PoseDeviation { rotation: [d[0], d[1], d[2]], centre: [d[3], d[4], d[5]] };
            result.images.insert(image as u32 + 1, deviation);
        }
        decisions.extend(axis::decisions(model, context, intrinsics, &covariance, excess.sqrt())?);
        uncertainty = Some(result);
    }
    Ok(CircularSolution { state: model.state.clone(), decisions, uncertainty })
}
