//! How commands end.

/// How a command ended, when it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All well.
    Done,
    /// No model could be found.
    NoModel,
    /// A model that lacks some of the frames.
    Partial,
    /// A model that is to be doubted.
    Doubtful,
}
