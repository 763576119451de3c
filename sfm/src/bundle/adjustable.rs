//! What adjustments of any motion have in common.

use super::{BundleProblem, BundleSummary, SolveOptions};
use crate::error::SfmError;
use scene::Progress;

/// An adjustment of some motion.
pub(crate) trait Adjustable: Clone {
    /// Cameras, points, observations.
    fn bundle(&self) -> &BundleProblem;
    /// The same, to be changed (its poses are read only).
    fn bundle_mut(&mut self) -> &mut BundleProblem;
    /// Minimises in place.
    fn minimise(&mut self, options: &SolveOptions, progress: &Progress) -> Result<BundleSummary, SfmError>;
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
}
