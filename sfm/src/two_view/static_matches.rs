//! Matches that do not move between the images: watermarks, sensor dust, the background of a
//! turntable.

use super::config::TwoViewConfig;
use super::correspondences::Correspondences;

/// Static matches must outnumber the slow ones (up to four times the displacement) by this factor:
/// where a camera moves, displacements are spread, and some are small by chance.
/// Source: judgement; no bench chose it.
const PEAK: usize = 2;

/// What is known about matches that stay in place.
pub(crate) struct StaticMatches {
    /// Indices of the matches that move, ascending.
    pub moving: Vec<usize>,
    /// Indices of those that do not.
    pub still: Vec<usize>,
    /// Whether the static ones are an isolated peak that no motion explains.
    pub suspicious: bool,
}

impl StaticMatches {
    /// Splits by displacement in pixels.
    pub(crate) fn of(all: &Correspondences, config: &TwoViewConfig) -> Self {
        let (still, moving): (Vec<usize>, Vec<usize>) =
            (0..all.len()).partition(|&i| all.displacement(i) <= config.static_px);
        let slow = moving.iter().filter(|&&i| all.displacement(i) <= 4.0 * config.static_px).count();
        // Fewer than a pair needs cannot win.
        let suspicious = still.len() >= config.min_inliers && still.len() > PEAK * slow;
        Self { moving, still, suspicious }
    }
}
