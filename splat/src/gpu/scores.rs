//! What densification chooses by, on the device.

use super::layout::MAGNITUDES;
use crate::SplatError;
use crate::backend::Scores;

/// The flag of a frame whose statistics are to be these.
pub(super) fn score_flag(scores: Scores) -> Result<u32, SplatError> {
    match scores {
        Scores::Gradient => Ok(0),
        Scores::Magnitudes => Ok(MAGNITUDES),
        Scores::Error => {
            let expected =
                "a gradient or the opacity on a graphics adapter; errors are summed on the CPU only";
            Err(SplatError::Config { flag: "selection", value: "Error".to_owned(), expected })
        }
    }
}
