//! Thresholds that several steps of a circular motion share.

/// Largest error of an observation or a match that agrees with a motion, pixels.
/// Source: the default of `--max-reprojection-px`.
pub(crate) const INLIER_PX: f64 = 4.0;
/// Fewest observations that hold a frame or a pair of frames.
/// Source: decision 0017, an angle is one unknown where a pose has six.
pub(crate) const LEAST_OBSERVATIONS: usize = 8;
/// Share of the images with which a model counts as whole.
/// Source: chosen by hand, never measured.
pub(crate) const WHOLE: f64 = 0.9;
/// Share of the images or steps that must follow a motion before it is believed.
/// Source: chosen by hand, never measured.
pub(crate) const MOST: f64 = 0.8;
/// Deviations from a motion are never held to be smaller: radians, radii.
/// Source: chosen by hand, never measured; far below what images show.
pub(crate) const LEAST_SIGMA: f64 = 1e-4;
/// Distance from which on a value is an outlier, standard deviations.
/// Source: chosen by hand, never measured.
pub(crate) const OUTLIER_SIGMAS: f64 = 6.0;
/// Most rounds (adjust, filter, triangulate) that end a model.
/// Source: decision 0018; five and six made thin objects worse (decision 0019).
pub(crate) const FINAL_ROUNDS: usize = 3;

/// Whether at least half of `all` agree.
pub(crate) fn is_majority(agreeing: usize, all: usize) -> bool {
    2 * agreeing >= all
}
