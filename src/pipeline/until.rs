//! How far a run goes, and what its stages are called.

/// Where to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Until {
    /// After the frames.
    Frames,
    /// After the poses.
    Sfm,
    /// After the training.
    Train,
    /// After the metrics.
    Eval,
    /// After the report.
    Report,
}

/// The stages in their order: the name of the record, and the one that users see.
const STAGES: [[&str; 2]; 6] = [
    ["frames", "frames"],
    ["sfm", "poses"],
    ["undistort", "undistort"],
    ["train", "train"],
    ["eval", "eval"],
    ["report", "report"],
];

impl Until {
    /// How many stages there are up to this one.
    fn stages(self) -> usize {
        match self {
            Self::Frames => 1,
            Self::Sfm => 2,
            Self::Train => 4,
            Self::Eval => 5,
            Self::Report => 6,
        }
    }

    /// Which of how many stages it is, for a name of [`STAGES`].
    pub(super) fn place(self, stage: &str) -> (usize, usize) {
        let before = STAGES.iter().position(|names| names.contains(&stage)).unwrap_or(0);
        (before + 1, self.stages())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_has_the_same_place_under_both_of_its_names() {
        assert_eq!(Until::Report.place("poses"), (2, 6));
        assert_eq!(Until::Sfm.place("sfm"), (2, 2));
    }
}
