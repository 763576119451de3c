//! A growing model whose poses are a turn: triangulated, adjusted and filtered under the
//! constraint.

use super::axis::Elevation;
use super::motion::CircularMotion;
use super::prior::AnglePrior;
use super::problem::{CircularCovariance, CircularProblem, Relation};
use crate::bundle::{BundleProblem, RobustLoss, SolveOptions};
use crate::error::SfmError;
use crate::incremental::adjust::{Adjustment, Selected, plausible, select, take};
use crate::incremental::growth::freedom;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use crate::limits::OUTLIER_SIGMAS;
use crate::model_selection::camera::{FreeIntrinsics, apply};
use crate::model_selection::noise::{error_sq, noise};
use crate::statistics::median;
use scene::{Camera, Progress};

/// Points that an image contributes while the model settles.
/// Source: chosen by hand, never measured.
const POINTS_PER_IMAGE: usize = 150;
/// Iterations times observations of an adjustment of all points: what is left after three
/// iterations on many observations is in single points, which settle alone before each.
/// Source: docs/decisions/08; ten times as much changed nothing.
const EFFORT: usize = 400_000;
/// Relative decrease of the cost at which such an adjustment ends.
/// Source: chosen by hand, never measured.
const SETTLED: f64 = 1e-6;

/// Degrees of freedom of the prior on the noise of a track.
/// Source: judgement, the least that is whole.
const TRACK_FREEDOM: f64 = 1.0;
/// Independent views that a followed point counts as, at most.
/// Source: derived; two see a point, the others find the same window again.
const FOLLOWED_VIEWS: f64 = 2.0;

/// A model under the constraint.
#[derive(Clone, Debug)]
pub(crate) struct AxisModel {
    /// Poses (those of the turn), points, cameras.
    pub state: MapState,
    /// The motion.
    pub turn: CircularMotion,
    /// The elevation of the camera that is believed.
    pub elevation: Option<Elevation>,
}

/// What stays the same while a model is adjusted.
#[derive(Clone)]
pub(crate) struct CircularContext<'a> {
    /// Keypoints and tracks.
    pub input: &'a MappingInput<'a>,
    /// What is known of the cameras.
    pub known: &'a [Knowledge],
    /// The cameras that priors refer to.
    pub starts: &'a [Camera],
    /// What is known of the angles beside the observations.
    pub priors: &'a [AnglePrior<'a>],
    /// How the camera looks down on the plane of the turn, where a user measured it.
    pub elevation: Option<Elevation>,
    /// For each frame how many of its keypoints, the first ones, are features; the others are
    /// followed points, which are measured otherwise. Empty where all are features.
    pub features: &'a [usize],
    /// Says how far it is, and when to stop.
    pub progress: &'a Progress,
}

impl CircularContext<'_> {
    /// Whether a keypoint (frame, number) is a followed point and no feature.
    fn is_followed(&self, [frame, number]: [u32; 2]) -> bool {
        self.features.get(frame as usize).is_some_and(|&n| number as usize >= n)
    }
}

impl AxisModel {
    /// Triangulates all tracks from the turn's poses.
    pub(crate) fn new(input: &MappingInput<'_>, cameras: Vec<Camera>, turn: CircularMotion) -> Self {
        let mut state = MapState::new(input, cameras);
        for frame in 0..input.keypoints.len() {
            if let Some(pose) = turn.pose(frame) {
                state.register(frame, pose);
            }
        }
        state.grow_all(input);
        Self { state, turn, elevation: None }
    }

    /// The adjustment of the present model.
    pub(crate) fn problem(
        &self,
        context: &CircularContext<'_>,
        what: &Adjustment,
    ) -> (CircularProblem, Selected) {
        let mut selected = select(&self.state, context.input, what);
        let angles = selected.images.iter().map(|&i| self.turn.angles[i].unwrap_or(0.0)).collect();
        let bundle = std::mem::take(&mut selected.problem);
        let mut problem = CircularProblem::new(bundle, self.turn.axis, angles);
        let relations = context.priors.iter().flat_map(|p| p.relations(&self.turn.angles));
        problem.relations.extend(relations.filter_map(|r| renumbered(&r, &selected.images)));
        problem.levels.extend(self.elevation.as_ref().map(|e| e.level(&self.turn)));
        (problem, selected)
    }

    /// Takes a solved adjustment over.
    pub(crate) fn take(&mut self, problem: CircularProblem, mut selected: Selected) {
        self.turn.axis = problem.axis;
        for (&image, angle) in selected.images.iter().zip(&problem.angles) {
            self.turn.angles[image] = Some(*angle);
        }
        selected.problem = problem.bundle;
        take(&mut self.state, &selected);
    }

    /// Adjusts, filters and triangulates a few times; robustly, with focal length and distortion
    /// free. `false` where it ends in nonsense.
    pub(crate) fn settle(&mut self, context: &CircularContext<'_>, rounds: usize) -> Result<bool, SfmError> {
        self.settle_with(context, rounds, POINTS_PER_IMAGE, self.state.registered_count())
    }

    /// One round with few points.
    pub(crate) fn settle_rough(
        &mut self,
        context: &CircularContext<'_>,
        images: usize,
    ) -> Result<bool, SfmError> {
        self.settle_with(context, 1, POINTS_PER_IMAGE / 3, images)
    }

    /// [`AxisModel::settle`] with so many points an image; `images` stands for how many images the
    /// general solver would need to free as much of the intrinsics.
    pub(crate) fn settle_with(
        &mut self,
        context: &CircularContext<'_>,
        rounds: usize,
        points_per_image: usize,
        images: usize,
    ) -> Result<bool, SfmError> {
        for _ in 0..rounds {
            let (free, priors) = freedom(&self.state.cameras, context.known, context.starts, images);
            let mut what = Adjustment::growing(free, priors);
            what.points_per_image = Some(points_per_image);
            let (mut problem, selected) = self.problem(context, &what);
            let summary = problem.solve(&what.solve, context.progress)?;
            if !summary.usable || !problem.bundle.cameras.iter().all(plausible) {
                return Ok(false);
            }
            self.take(problem, selected);
            self.state.refine_points(context.input, |_| false);
            let gone = self.state.filter(context.input, context.input.config.max_reprojection_px);
            let added = self.state.grow_all(context.input);
            let all: usize = self.state.live().map(|(_, p)| p.views.len()).sum();
            if all < 3 * context.input.config.min_observations {
                return Ok(false);
            }
            if (added + gone) * 100 < all {
                break;
            }
        }
        Ok(true)
    }

    /// The adjustment of all points with the chosen intrinsics, its observations at the measured
    /// noise.
    pub(crate) fn prepare(
        &self,
        context: &CircularContext<'_>,
        intrinsics: FreeIntrinsics,
        points_per_image: Option<usize>,
    ) -> (CircularProblem, Selected, SolveOptions) {
        let (free, priors) = freedom(&self.state.cameras, context.known, context.starts, usize::MAX);
        let what = Adjustment { points_per_image, ..Adjustment::growing(free, priors) };
        let (mut problem, selected) = self.problem(context, &what);
        apply(&mut problem.bundle, intrinsics, context.known);
        self.weigh(context, &mut problem.bundle, &selected);
        let most = (EFFORT / problem.bundle.observations.len().max(1)).clamp(3, 20);
        let options = SolveOptions {
            loss: RobustLoss::Cauchy(2.0),
            max_iterations: most as u32,
            function_tolerance: SETTLED,
            points_first: points_per_image.is_none(),
            ..SolveOptions::default()
        };
        (problem, selected, options)
    }

    /// Gives features and followed points each the noise that their residuals show,
    /// `r² ≈ 2 ln 2 σ²` at the median, corrected for what the points' three coordinates take up.
    pub(crate) fn weigh(
        &self,
        context: &CircularContext<'_>,
        bundle: &mut BundleProblem,
        selected: &Selected,
    ) {
        let Some(followed) = self.followed(context, bundle, selected) else {
            let sigma = noise(bundle);
            bundle.observations.iter_mut().for_each(|o| o.sigma_px = sigma);
            return;
        };
        let [features, points] = [false, true].map(|kind| noise_of_kind(bundle, &followed, kind));
        for (o, followed) in bundle.observations.iter_mut().zip(&followed) {
            o.sigma_px *= if *followed { points } else { features };
        }
    }

    /// Which observations of an adjustment are followed points; `None` where it lacks some of the
    /// model's.
    fn followed(
        &self,
        context: &CircularContext<'_>,
        bundle: &BundleProblem,
        selected: &Selected,
    ) -> Option<Vec<bool>> {
        let points = selected.points.iter().filter_map(|&id| self.state.points[id as usize].as_ref());
        let followed: Vec<bool> = points.flat_map(|p| &p.views).map(|v| context.is_followed(*v)).collect();
        (followed.len() == bundle.observations.len()).then_some(followed)
    }

    /// Adjusts with the chosen intrinsics, triangulates and filters at the level of the noise, for
    /// so many rounds at most; then the turn and the points alone, each track with its own noise.
    pub(crate) fn polish(
        &mut self,
        context: &CircularContext<'_>,
        intrinsics: FreeIntrinsics,
        rounds: usize,
    ) -> Result<(), SfmError> {
        for round in 0..rounds {
            let part = (round == 0).then_some(2 * POINTS_PER_IMAGE);
            let (mut problem, selected, options) = self.prepare(context, intrinsics, part);
            let summary = problem.solve(&options, context.progress)?;
            if !summary.usable {
                break;
            }
            let all = problem.bundle.observations.len();
            let sigma = noise(&problem.bundle);
            self.take(problem, selected);
            if part.is_some() {
                self.state.refine_points(context.input, |_| false);
            }
            let limit = (OUTLIER_SIGMAS * sigma).clamp(1.0, context.input.config.max_reprojection_px);
            let gone = self.state.filter(context.input, limit);
            let added = if round + 1 < rounds { self.state.grow_all(context.input) } else { 0 };
            if round > 0 && (gone + added) * 500 < all {
                break;
            }
        }
        self.weigh_out_sliding(context, intrinsics)
    }

    /// Adjusts the turn and the points, each track with its own noise (see [`weigh_tracks`]). The
    /// intrinsics, which need all observations, are held.
    fn weigh_out_sliding(
        &mut self,
        context: &CircularContext<'_>,
        intrinsics: FreeIntrinsics,
    ) -> Result<(), SfmError> {
        let (mut problem, selected, options) = self.prepare(context, intrinsics, None);
        let Some(followed) = self.followed(context, &problem.bundle, &selected) else { return Ok(()) };
        weigh_tracks(&mut problem.bundle, &followed);
        problem.bundle.camera_free.iter_mut().flatten().for_each(|free| *free = false);
        if problem.solve(&options, context.progress)?.usable {
            self.take(problem, selected);
        }
        Ok(())
    }

    /// Standard deviations of the final adjustment, with the problem they belong to. `excess`:
    /// factor on the observations' variances.
    pub(crate) fn covariance(
        &self,
        context: &CircularContext<'_>,
        intrinsics: FreeIntrinsics,
        excess: f64,
    ) -> Result<Option<(CircularProblem, Vec<usize>, CircularCovariance)>, SfmError> {
        let (problem, selected, options) = self.prepare(context, intrinsics, None);
        let covariance = problem.covariance(&options, excess)?;
        Ok(covariance.map(|c| (problem, selected.images, c)))
    }

    /// Puts the model into the turntable's frame: axis up, first camera at azimuth 0, `radius` from
    /// the axis, the origin at the height of the points' median.
    pub(crate) fn orient(&mut self, radius: f64) {
        let height = median(self.state.live().map(|(_, p)| p.position.z).collect());
        let (turn, moved) = self.turn.canonical(height, radius);
        for (frame, pose) in self.state.poses.iter_mut().enumerate() {
            if pose.is_some() {
                *pose = turn.pose(frame);
            }
        }
        for point in self.state.points.iter_mut().flatten() {
            point.position = moved(point.position);
        }
        self.turn = turn;
    }
}

/// Gives each track its own noise. A glint, a contour or a shadow slides over the surface and fits
/// no single point: with a scaled inverse χ² prior of [`TRACK_FREEDOM`] degrees of freedom about
/// the noise σ of its kind, the variance expected of a track of n views whose residuals r are in σ
/// is `σ² (ν + Σ r²) / (ν + 2 n − 3)` (the point takes up 3 coordinates). What a followed point
/// errs by stays with its window from frame to frame: however long it is followed, its views count
/// as [`FOLLOWED_VIEWS`].
fn weigh_tracks(bundle: &mut BundleProblem, followed: &[bool]) {
    let mut tracks = vec![(0.0, 0.0); bundle.points.len()];
    for o in &bundle.observations {
        let (squares, views) = &mut tracks[o.point as usize];
        *squares += (error_sq(bundle, o) / o.sigma_px.powi(2)).min(OUTLIER_SIGMAS.powi(2));
        *views += 1.0;
    }
    for (o, followed) in bundle.observations.iter_mut().zip(followed) {
        let (squares, views) = tracks[o.point as usize];
        let redundancy = (2.0 * views - 3.0f64).max(1.0);
        let own = (TRACK_FREEDOM + squares) / (TRACK_FREEDOM + redundancy);
        let together = if *followed { (views / FOLLOWED_VIEWS).max(1.0) } else { 1.0 };
        o.sigma_px *= (own * together).sqrt();
    }
}

/// A relation between frames as one between the poses of a problem; `None` where it lacks one.
fn renumbered(relation: &Relation, images: &[usize]) -> Option<Relation> {
    let mut frames = [None; 3];
    for (pose, frame) in frames.iter_mut().zip(relation.frames) {
        if let Some(frame) = frame {
            *pose = Some(images.binary_search(&(frame as usize)).ok()? as u32);
        }
    }
    Some(Relation { frames, ..*relation })
}

/// Noise of the observations that are followed points, or of those that are not, in units of what
/// is thought of each.
fn noise_of_kind(bundle: &BundleProblem, followed: &[bool], kind: bool) -> f64 {
    let mut views = vec![0usize; bundle.points.len()];
    bundle.observations.iter().for_each(|o| views[o.point as usize] += 1);
    let (mut errors, mut taken) = (Vec::new(), 0.0);
    for (o, _) in bundle.observations.iter().zip(followed).filter(|(_, followed)| **followed == kind) {
        errors.push(error_sq(bundle, o) / o.sigma_px.powi(2));
        taken += 3.0 / views[o.point as usize] as f64;
    }
    let n = 2.0 * errors.len() as f64;
    let freedom = ((n - taken) / n.max(1.0)).clamp(0.1, 1.0);
    (median(errors) / (2.0 * std::f64::consts::LN_2) / freedom).sqrt().max(1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::BundleObservation;
    use glam::{DVec2, DVec3};
    use scene::{CameraModel, Pose};

    /// Two points, each seen in twelve images: the first to a hundredth of its noise, the second
    /// three times its noise away, on alternate sides.
    fn still_and_sliding() -> BundleProblem {
        let points = vec![DVec3::new(-0.5, 0.0, 5.0), DVec3::new(0.5, 0.0, 5.0)];
        let mut problem = BundleProblem {
            poses: vec![Pose::IDENTITY; 12],
            pose_camera: vec![0; 12],
            cameras: vec![Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 500.0)],
            points,
            ..BundleProblem::default()
        };
        for pose in 0..12u32 {
            for (point, error) in [(0u32, 0.01), (1, 3.0)] {
                let seen = problem.cameras[0].project(problem.points[point as usize]).unwrap();
                let pixel = seen + DVec2::X * error * if pose % 2 == 0 { 1.0 } else { -1.0 };
                problem.observations.push(BundleObservation { pose, point, pixel, sigma_px: 1.0 });
            }
        }
        problem
    }

    #[test]
    fn a_track_that_slides_counts_for_less_and_a_followed_one_for_two_views() {
        let mut features = still_and_sliding();
        weigh_tracks(&mut features, &[false; 24]);
        let [still, sliding] = [0, 1].map(|i| features.observations[i].sigma_px);
        // 12 views of 9 σ² over 24 − 3 coordinates, with one that is as the noise.
        assert!((sliding - (109.0f64 / 22.0).sqrt()).abs() < 1e-9, "{sliding}");
        assert!((still - (1.0012f64 / 22.0).sqrt()).abs() < 1e-9, "{still}");
        let mut followed = still_and_sliding();
        weigh_tracks(&mut followed, &[true; 24]);
        assert!((followed.observations[1].sigma_px / sliding - 6.0f64.sqrt()).abs() < 1e-9);
    }
}
