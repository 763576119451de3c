//! The verdict on a run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How well something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Not measured.
    Unknown,
    /// As it should be.
    Good,
    /// Usable, with a doubt.
    Fair,
    /// Not to be relied on.
    Bad,
}

/// One light of the verdict.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Light {
    /// What is judged.
    pub what: String,
    /// The colour.
    pub level: Level,
    /// Why, with the figures.
    pub reason: String,
}
