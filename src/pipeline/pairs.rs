//! `--pairs`: a run that only matches, as one of many jobs.

use super::{Pipeline, SFM};
use crate::database;
use crate::input::Input;
use crate::stage::{StageSpec, fingerprint};
use anyhow::Result;
use scene::FrameSet;

impl Pipeline {
    /// One part of the pairs, for a later run.
    pub(super) fn match_part(
        &mut self,
        block: sfm::PairBlock,
        frames: &FrameSet,
        frames_print: &str,
    ) -> Result<()> {
        if let Input::Posed { .. } = self.input {
            database::refuse(&self.args)?;
        }
        let print = fingerprint(&("pairs", env!("SFM_SOURCES"), frames_print, &self.args.sfm, block))?;
        let stage = StageSpec { name: "sfm", fingerprint: &print, owns: &SFM };
        let done = self
            .stages
            .run(&stage, |new| database::match_part(&self.args, block, frames, new, &self.progress("sfm")))?;
        let line = format!("part {block} of the pairs: {} match", done.finished.value);
        self.finish("poses", done, &line);
        Ok(())
    }
}
