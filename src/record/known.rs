//! What commands read of the `run.json` of an earlier run.

use super::{Evaluation, Light, PoseSummary, SplatSummary};
use crate::stage::Cost;
use anyhow::{Context, Result};
use glam::DVec3;
use scene::up::{UP, level_up};
use scene::{Decision, FrameSet, Reconstruction};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The parts of [`super::RunRecord`] that are read again; what is missing has its default.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct KnownRun {
    /// Cost of each stage, in order.
    pub costs: Vec<(String, Cost)>,
    /// The configuration.
    pub config: KnownConfig,
    /// The frames.
    pub frames: Option<FrameSet>,
    /// The poses.
    pub poses: Option<PoseSummary>,
    /// The splat.
    pub splat: Option<SplatSummary>,
    /// The metrics.
    pub evaluation: Option<Evaluation>,
    /// The decisions.
    pub decisions: Vec<Decision>,
    /// The verdict.
    pub verdict: Vec<Light>,
}

/// What is read of a run's configuration.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct KnownConfig {
    /// The video, the photos or the data set.
    pub input: PathBuf,
    /// The preset.
    pub quality: Option<splat::Quality>,
    /// What the splat was trained on.
    pub dataset: splat::DatasetConfig,
    /// How it was trained.
    pub train: splat::TrainConfig,
}

/// Direction that is up in a run's world: as its record says, else as its cameras are held.
pub(crate) fn up_of(run: &Path, model: &Reconstruction) -> DVec3 {
    let world = KnownRun::read(run).ok().and_then(|known| known.poses?.world);
    let level = || level_up(model.images.values().map(|i| &i.pose)).unwrap_or(UP);
    world.map_or_else(level, |w| DVec3::from_array(w.up)).normalize_or(UP)
}

impl KnownRun {
    /// Reads `run.json` in the folder of a run.
    pub fn read(run: &Path) -> Result<Self> {
        let path = run.join("run.json");
        let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_slice(&text)
            .with_context(|| format!("{} is damaged; run sat-recon again", path.display()))
    }

    /// What a stage cost.
    pub fn cost(&self, stage: &str) -> Option<&Cost> {
        self.costs.iter().find(|(name, _)| name == stage).map(|(_, cost)| cost)
    }
}
