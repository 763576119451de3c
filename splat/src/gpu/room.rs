//! Room for the pairs of Gaussians and tiles.

use super::backend::GpuBackend;
use super::buffers::{Buffers, Sizes, most_pairs};
use super::layout::{BLOCK, FrameFlag};
use crate::error::SplatError;
use scene::Decision;
use scene::decision::{Choice, Measurement, Quantity, Remark, Rule, Subject};

impl GpuBackend {
    /// Room for the pairs that were too many, and for some more; where there is none, the farthest
    /// will not be drawn.
    pub(super) fn widen(&mut self) -> Result<(), SplatError> {
        let most = std::mem::take(&mut self.crowded);
        if self.truncate != 0 || most == 0 {
            return Ok(());
        }
        let largest = most_pairs(self.gpu.largest_buffer(), self.sizes.pixels);
        let wanted = (most + most / 2).next_multiple_of(BLOCK as usize).min(largest);
        let model: u64 = self.pages.as_ref().map_or(0, |p| p.memory().iter().map(|b| b.1).sum());
        let others = model + self.photos.memory();
        let (before, limit) = (self.sizes, self.limit);
        for pairs in [wanted, most.next_multiple_of(BLOCK as usize).min(largest)] {
            let sizes = Sizes { pairs, ..before };
            let total = Buffers::plan(&sizes).iter().map(|b| b.1).sum::<u64>() + others;
            let allowed = pairs > before.pairs && limit.is_none_or(|limit| total <= limit);
            if allowed && self.try_resize(sizes)? {
                return Ok(());
            }
        }
        if most > self.sizes.pairs {
            self.truncate = FrameFlag::Truncate as u32;
            let decision =
                Decision::new(Subject::TilePairs, Choice::count(self.sizes.pairs), Rule::OutOfMemory)
                    .remarked(Remark::NearestOnly)
                    .with(Measurement::count(Quantity::NeededTilePairs, most))
                    .quoting(self.gpu.adapter.to_string());
            self.remarks.push(decision);
        }
        Ok(())
    }
}
