//! Adjustments that the choice of a camera model can be made by.

use super::{BundleProblem, BundleSummary, SolveOptions};
use crate::SfmError;
use scene::Progress;

/// What the choice of the camera model needs of an adjustment.
pub trait Adjustable: Clone {
    /// Cameras, points, sightings.
    fn bundle(&self) -> &BundleProblem;
    /// The same, to be changed (its poses are read only).
    fn bundle_mut(&mut self) -> &mut BundleProblem;
    /// Minimises in place.
    fn minimise(&mut self, options: &SolveOptions, progress: &Progress) -> Result<BundleSummary, SfmError>;
    /// Covariance of each camera's parameters.
    fn intrinsics_covariance(&self, options: &SolveOptions) -> Result<Option<Vec<Vec<f64>>>, SfmError>;
}

impl Adjustable for BundleProblem {
    fn bundle(&self) -> &BundleProblem {
        self
    }
    fn bundle_mut(&mut self) -> &mut BundleProblem {
        self
    }
    fn minimise(&mut self, options: &SolveOptions, progress: &Progress) -> Result<BundleSummary, SfmError> {
        self.solve(options, progress)
    }
    fn intrinsics_covariance(&self, options: &SolveOptions) -> Result<Option<Vec<Vec<f64>>>, SfmError> {
        Ok(self.covariance(options)?.map(|c| c.cameras))
    }
}
