//! Something that was decided by itself, for the report.

use serde::{Deserialize, Serialize};

/// Something training decided by itself, for the report.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decision {
    /// What was decided on.
    pub subject: String,
    /// What was chosen.
    pub choice: String,
    /// Why.
    pub evidence: String,
}
