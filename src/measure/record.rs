//! What `measure` leaves in a run's folder.

use scene::world::WorldUnit;
use serde::{Deserialize, Serialize};
use shape::measure::Measures;
use std::path::Path;

/// The file of the measures in a run folder.
pub(crate) const FILE: &str = "measure.json";
/// The drawing beside it.
pub(crate) const DRAWING: &str = "measure.svg";
/// What `measure.json` holds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct MeasureRecord {
    /// What lengths are in.
    pub unit: WorldUnit,
    /// What was measured, in words.
    pub surface: String,
    /// BLAKE3 of the splat whose surface it is.
    pub splat: Option<String>,
    /// How near a surface is to a shape that it belongs to, share of the longest side of its box.
    pub tolerance: f64,
    /// The measures; lengths are in `unit`, areas in its square.
    #[serde(flatten)]
    pub measures: Measures,
}

impl MeasureRecord {
    /// The measures of a run, unless they are of an earlier splat.
    pub(crate) fn of_run(out: &Path) -> Option<Self> {
        let text = std::fs::read(out.join(FILE)).ok()?;
        let record: Self = serde_json::from_slice(&text).ok()?;
        (record.splat == splat_hash(out)).then_some(record)
    }

    /// A short name of the unit.
    pub(crate) fn unit_name(&self) -> &'static str {
        match self.unit {
            WorldUnit::Metre => "m",
            WorldUnit::ObjectRadius => "object radii",
            WorldUnit::Unchanged => "units",
        }
    }
}

/// BLAKE3 of a run's splat.
pub(super) fn splat_hash(out: &Path) -> Option<String> {
    let bytes = std::fs::read(out.join("splat.ply")).ok()?;
    Some(blake3::hash(&bytes).to_hex().to_string())
}
