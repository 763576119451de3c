//! What a reconstruction is given, and what stays as it is from the first step to the last.

use crate::config::SfmConfig;
use crate::skip::StepName;
use scene::{FrameSet, Progress};

/// Where features come from, and so what may be read from the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FeatureOrigin {
    /// They are found in the images, which may be read again.
    Images,
    /// They were supplied; the images are read for the points' colours alone.
    Supplied,
    /// They were supplied and no image is read.
    WithoutImages,
}

/// What all steps may look at.
pub(crate) struct StepContext<'a> {
    pub frames: &'a FrameSet,
    pub config: &'a SfmConfig,
    pub source: FeatureOrigin,
    pub progress: &'a Progress,
}

impl<'a> StepContext<'a> {
    /// The images, where more may be taken from them than colours.
    pub(crate) fn images(&self) -> Option<&'a FrameSet> {
        (self.source == FeatureOrigin::Images).then_some(self.frames)
    }

    /// Whether a step or a part of one is left out.
    pub(crate) fn skips(&self, step: StepName) -> bool {
        self.config.skip.contains(&step)
    }
}
