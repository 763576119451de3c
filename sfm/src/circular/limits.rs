//! Thresholds that several steps of a circular motion share, beside [`crate::limits`].

/// Largest error of an observation or a match that agrees with a motion, pixels.
/// Source: the default of `--max-reprojection-px`.
pub(crate) const INLIER_PX: f64 = 4.0;
/// Fewest observations that hold a frame or a pair of frames, and fewest images that show how all
/// go round.
/// Source: docs/decisions/10, an angle is one unknown where a pose has six.
pub(crate) const LEAST_OBSERVATIONS: usize = 8;
/// Share of the images or steps that must follow a motion before it is believed.
/// Source: docs/decisions/09; models that lacked more were wrong.
pub(crate) const MOST: f64 = 0.8;
/// Views of an object that are turned by more than this have little in common, radians.
/// Source: docs/decisions/08, frames within half a radian see the same.
pub(crate) const COMPARABLE: f64 = 0.5;
/// Deviations from a circle that a rig or a steady hand leaves: radians, radii.
/// Source: docs/decisions/09, a circle kept to 0.6 degrees and 1 % held `fountain_p11` back.
pub(crate) const TIGHT: f64 = 0.01;
/// Deviations from a motion are never held to be smaller, and smaller turns say nothing of an axis:
/// radians, radii.
/// Source: derived; a twentieth of a pixel, 500 pixels from the axis.
pub(crate) const LEAST_SIGMA: f64 = 1e-4;
/// What is held is held to this: radians, radii.
/// Source: derived; a hundredth of [`LEAST_SIGMA`] moves nothing that is seen.
pub(crate) const HELD: f64 = 0.01 * LEAST_SIGMA;
/// Standard deviation of the change of the rate from one step to the next, as a share of the rate.
/// Source: docs/decisions/08, "no jumps"; far weaker than a dozen good observations.
pub(crate) const RATE_CHANGE: f64 = 0.5;
/// Most frames that say how all move: the time it takes grows with their cube.
/// Source: docs/decisions/08.
pub(crate) const FRAMES_TO_CHOOSE: usize = 100;
/// Most rounds (adjust, filter, triangulate) that end a model.
/// Source: docs/decisions/08; five and six made thin objects worse (docs/decisions/09).
pub(crate) const FINAL_ROUNDS: usize = 3;

/// Whether at least half of `all` agree.
pub(crate) fn is_majority(agreeing: usize, all: usize) -> bool {
    2 * agreeing >= all
}
/// Errors of steps are evened out over so much of a turn on either side, a closed turn is searched
/// for so far, and pictures up to so far from it are compared, radians.
/// Source: docs/decisions/10; half of what views that have much in common may be turned by.
pub(crate) const NEARBY: f64 = 0.5 * COMPARABLE;
/// Poses farther than this from the motion they show best are no motion of this kind: radians,
/// radii or distances.
/// Source: chosen by hand, never measured.
pub(crate) const FARTHEST: [f64; 2] = [0.1, 0.2];
