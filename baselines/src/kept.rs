//! Arrays of parameters and their moments, to files and back.

use crate::adam::AdamMoments;
use crate::field::Kept;

/// The arrays of trained parameters in the order of [`Restored::take_trained`].
pub(crate) fn kept_arrays<'a>(
    kept: Kept,
    parts: impl Iterator<Item = (&'a [f32], &'a AdamMoments)>,
) -> Vec<&'a [f32]> {
    let mut arrays = Vec::new();
    for (values, moments) in parts {
        let AdamMoments { first, second, average } = moments;
        match kept {
            Kept::Pictures => arrays.push(moments.shown(values)),
            Kept::Training => arrays.extend([values, first, second, average]),
        }
    }
    arrays
}

/// Arrays of a file, of which all are finite, to be taken one after the other.
pub(crate) struct Restored {
    kept: Kept,
    arrays: std::vec::IntoIter<Vec<f32>>,
}

impl Restored {
    /// Refuses numbers that are not finite.
    pub(crate) fn new(kept: Kept, arrays: Vec<Vec<f32>>) -> Result<Self, String> {
        if arrays.iter().flatten().any(|v| !v.is_finite()) {
            return Err("it holds numbers that are not finite".to_owned());
        }
        Ok(Self { kept, arrays: arrays.into_iter() })
    }

    /// The next array, which must be so long or, where it `may_be_empty`, be empty.
    pub(crate) fn take(&mut self, length: usize, may_be_empty: bool) -> Result<Vec<f32>, String> {
        let array = self.arrays.next().ok_or("it is cut short")?;
        let fits = array.len() == length || may_be_empty && array.is_empty();
        if fits { Ok(array) } else { Err(format!("an array has {} values, not {length}", array.len())) }
    }

    /// Parameters and, where training goes on, their moments.
    pub(crate) fn take_trained(
        &mut self,
        values: &mut [f32],
        moments: &mut AdamMoments,
    ) -> Result<(), String> {
        let length = values.len();
        values.copy_from_slice(&self.take(length, false)?);
        if self.kept == Kept::Training {
            let [first, second] = [self.take(length, false)?, self.take(length, false)?];
            *moments = AdamMoments { first, second, average: self.take(length, true)? };
        }
        Ok(())
    }
}
