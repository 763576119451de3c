//! A model about one axis: adjusted, its intrinsics chosen, and finished for the result.

use super::axis_report;
use super::deviations::AxisDeviation;
use super::intrinsics::choose_for_turn;
use super::job::MotionInput;
use super::model::{AxisModel, CircularContext};
use super::motion::CircularMotion;
use super::motion_report;
use crate::error::SfmError;
use crate::incremental::adjust::Adjustment;
use crate::incremental::finish::noise_of;
use crate::incremental::growth::freedom;
use crate::incremental::state::MapState;
use crate::model_selection::camera::{FreeIntrinsics, convert_camera};
use crate::model_selection::noise::noise;
use crate::result::{FramePose, Uncertainty};
use scene::Camera;
use scene::decision::Decision;
use scene::motion_report::MotionReport;

/// Points that the images contribute to the choice of the intrinsics, all together; one image at
/// most a hundredth.
/// Source: docs/decisions/08, trials start from each other.
const POINTS_TO_CHOOSE: usize = 25_000;

/// A model under the constraint of one axis, and what was learned with it.
pub(crate) struct CircularSolution {
    pub state: MapState,
    pub decisions: Vec<Decision>,
    pub uncertainty: Option<Uncertainty>,
    /// How the object turns, where times are known.
    pub motion: Option<MotionReport>,
    /// The turn in the frame of the world.
    pub turn: CircularMotion,
    pub axis_deviation: AxisDeviation,
    /// Poses of all frames of a video, chosen or not.
    pub frames: Vec<FramePose>,
}

/// A model about one axis with its intrinsics.
pub(crate) struct ChosenModel {
    pub model: AxisModel,
    pub intrinsics: FreeIntrinsics,
    /// Why these intrinsics.
    pub camera: Decision,
}

impl ChosenModel {
    /// From a first guess, adjusted for so many rounds; `None` where none stands.
    pub(crate) fn adjust(
        context: &CircularContext<'_>,
        job: &MotionInput<'_>,
        cameras: &[Camera],
        turn: CircularMotion,
        rounds: usize,
    ) -> Result<Option<Self>, SfmError> {
        let mut model = AxisModel::new(context.input, as_at_the_start(cameras, context), turn);
        if !model.settle(context, 5)? {
            return Ok(None);
        }
        let (free, priors) = freedom(&model.state.cameras, context.known, context.starts, usize::MAX);
        let points = POINTS_TO_CHOOSE / model.state.registered_count().max(1);
        let points_per_image = Some(points.clamp(1, POINTS_TO_CHOOSE / 100));
        let what = Adjustment { points_per_image, ..Adjustment::growing(free, priors) };
        let (mut problem, selected) = model.problem(context, &what);
        model.weigh(context, &mut problem.bundle, &selected);
        let edges = job.edges(&model.turn)?;
        let (intrinsics, camera, elevation) = choose_for_turn(&problem, context, &edges, job.named)?;
        model.elevation = elevation;
        model.polish(context, intrinsics, rounds)?;
        Ok(Some(Self { model, intrinsics, camera }))
    }

    /// Figures of the finished model, and the world frame. `excess`: factor on the observations'
    /// variances, as they err together. `times`: by frame, seconds.
    pub(crate) fn finish(
        mut self,
        context: &CircularContext<'_>,
        job: &MotionInput<'_>,
        excess: f64,
        times: Option<&[f64]>,
    ) -> Result<CircularSolution, SfmError> {
        let Self { model, intrinsics, camera } = &mut self;
        model.orient(job.config.known_distance.unwrap_or(1.0));
        let mut decisions = vec![camera.clone()];
        let (mut uncertainty, mut motion) = (None, None);
        let mut axis_deviation = AxisDeviation::default();
        if let Some((problem, images, covariance)) = model.covariance(context, *intrinsics, excess)? {
            let sigma_px = noise(&problem.bundle);
            let mut result = Uncertainty { sigma_px, ..Uncertainty::default() };
            for (camera, c) in problem.bundle.cameras.iter().zip(&covariance.cameras) {
                let n = camera.params.len();
                result.cameras.insert(camera.id, (0..n).map(|i| c[i * n + i].max(0.0).sqrt()).collect());
            }
            let (said, of_axis) = axis_report::decisions(model, context, *intrinsics, &covariance, excess)?;
            decisions.extend(said);
            for ((&image, angle), sigma) in images.iter().zip(&problem.angles).zip(&covariance.angles) {
                result.images.insert(image as u32 + 1, of_axis.of_pose(&model.turn.axis, *angle, *sigma));
            }
            axis_deviation = of_axis;
            uncertainty = Some(result);
            motion = times.and_then(|t| motion_report::report(model, &covariance, of_axis, &images, t));
        }
        let AxisModel { state, turn, .. } = self.model;
        let frames = Vec::new();
        Ok(CircularSolution { state, decisions, uncertainty, motion, turn, axis_deviation, frames })
    }
}

/// Cameras in the model that the priors refer to, until the evidence has spoken.
fn as_at_the_start(cameras: &[Camera], context: &CircularContext<'_>) -> Vec<Camera> {
    let pairs = cameras.iter().zip(context.starts);
    pairs.map(|(camera, start)| convert_camera(camera, start.model)).collect()
}

/// Standard deviation of a residual that one axis leaves after a short adjustment, pixels.
pub(crate) fn rough_noise(
    context: &CircularContext<'_>,
    cameras: &[Camera],
    turn: CircularMotion,
) -> Result<f64, SfmError> {
    let mut model = AxisModel::new(context.input, as_at_the_start(cameras, context), turn);
    let stands = model.settle_rough(context, model.state.registered_count())?;
    Ok(if stands { noise_of(&model.state, context.input) } else { f64::INFINITY })
}
