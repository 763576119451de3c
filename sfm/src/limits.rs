//! Numbers that steps of a reconstruction share, and the ways in which they adjust.

use crate::bundle::{RobustLoss, SolveOptions};

/// Residuals farther out than this are outliers, standard deviations.
/// Source: Gaussian residuals are that large once in 16,000; Hampel et al., Robust Statistics, 1986
/// (hard rejection).
pub(crate) const OUTLIER_SIGMAS: f64 = 4.0;
/// Observations are never held to less than this, pixels: what keypoints are found on is a grid.
/// Source: derived from the pixel.
pub(crate) const LEAST_ERROR_PX: f64 = 1.0;
/// Observations that hold something by several times its number of unknowns: a pose by five times
/// its six, a plane by ten times its three. With fewer it is weakly constrained.
/// Source: derived from the unknowns.
pub(crate) const FEW_OBSERVATIONS: usize = 30;
/// Fewest images by which something is told from chance: two always agree on a point.
/// Source: derived; a point of two images has one redundant coordinate.
pub(crate) const FEWEST_VIEWS: usize = 3;
/// Share of the matches that must agree with a pose or a similarity; where fewer do it is
/// contradicted.
/// Source: docs/decisions/09; 87 to 96 % of true matches agree with a motion, 9 to 13 % of false
/// ones.
pub(crate) const AGREEING_SHARE: f64 = 0.3;
/// Share of the images with which a model counts as whole: what it misses finds its place later.
/// Source: docs/decisions/09; models that lacked more were wrong.
pub(crate) const WHOLE: f64 = 0.9;
/// Images up to which all are adjusted, or asked, together; of more a part, as what all say of each
/// other costs the cube of their number.
/// Source: docs/decisions/05 and 06.
pub(crate) const JOINT_IMAGES: usize = 60;
/// Viewing directions farther apart than this share hardly any point, radians.
/// Source: measured; every 4th image of temple_ring has AUC@1 76.7 with 1.2 and 74.3 with 0.9.
pub(crate) const WIDEST_ANGLE: f64 = 1.2;
/// Scale of the robust loss, standard deviations.
/// Source: 2.385 is 95 % efficient under Cauchy's loss (Holland & Welsch 1977), rounded down for
/// the many wrong matches.
pub(crate) const LOSS: f64 = 2.0;

impl SolveOptions {
    /// While a model grows and is still wrong: a loss in pixels that pulls at far observations, and
    /// no more precision than the next image needs.
    pub(crate) fn rough() -> Self {
        let loss = RobustLoss::SoftL1(1.0);
        Self { loss, max_iterations: 20, function_tolerance: 1e-4, ..Self::default() }
    }

    /// When a model stands and observations are in units of the noise: at most `most` iterations.
    pub(crate) fn precise(most: u32) -> Self {
        let loss = RobustLoss::Cauchy(LOSS);
        Self { loss, max_iterations: most, function_tolerance: 2e-5, ..Self::default() }
    }
}
