//! Views that are held out by name: by the data set, or as a sector of directions.

use super::Pipeline;
use anyhow::Result;
use std::collections::BTreeSet;

impl Pipeline {
    /// These views are held out, where the flags do not say otherwise.
    pub(super) fn hold_out(&mut self, views: BTreeSet<String>) {
        self.args.dataset.test_views = views;
        self.record.config.dataset = self.args.dataset.clone();
    }

    /// A whole sector of directions, where that is asked for.
    pub(super) fn hold_out_sector(&mut self) -> Result<()> {
        if let Some(degrees) = self.args.dataset.test_sector {
            let model = scene::io::read_model(&self.out.join("sparse/0"))?;
            self.hold_out(scene::sector(&model, f64::from(degrees).to_radians()));
        }
        Ok(())
    }
}
