//! What of an Instant NeRF is kept in files.

use super::InstantNgp;
use super::occupancy::Occupancy;
use crate::adam::AdamMoments;
use crate::field::Kept;
use serde_json::{Value, json};

impl InstantNgp {
    /// The weights of both networks that pictures are made with.
    pub(super) fn shown(&self) -> [&[f32]; 2] {
        [0, 1].map(|i| self.moments[i].shown(&self.weights[i]))
    }

    /// See [`crate::RadianceField::arrays`].
    pub(super) fn kept_arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        let mut arrays = vec![self.occupancy.density.as_slice()];
        let networks = self.weights.iter().map(Vec::as_slice).zip(&self.moments);
        let tables = self.grid.tables.iter().map(|t| (t.values.as_flattened(), &t.moments));
        for (values, moments) in networks.chain(tables) {
            let AdamMoments { first, second, average } = moments;
            match kept {
                Kept::Pictures => arrays.push(moments.shown(values)),
                Kept::Training => arrays.extend([values, first, second, average]),
            }
        }
        (arrays, json!({ "rays": self.rays }))
    }

    /// See [`crate::RadianceField::restore`].
    pub(super) fn take_arrays(
        &mut self,
        kept: Kept,
        arrays: Vec<Vec<f32>>,
        notes: &Value,
    ) -> Result<(), String> {
        if arrays.iter().flatten().any(|v| !v.is_finite()) {
            return Err("it holds numbers that are not finite".to_owned());
        }
        let mut arrays = arrays.into_iter();
        let mut take = |length: usize, may_be_empty: bool| {
            let array = arrays.next().ok_or("it is cut short")?;
            let fits = array.len() == length || may_be_empty && array.is_empty();
            if fits { Ok(array) } else { Err(format!("an array has {} values, not {length}", array.len())) }
        };
        let density = take(self.occupancy.density.len(), false)?;
        self.occupancy = Occupancy::from_density(self.shape.domain.cascades, density);
        let mut take_values = |values: &mut [f32], moments: &mut AdamMoments| -> Result<(), String> {
            let length = values.len();
            values.copy_from_slice(&take(length, false)?);
            if kept == Kept::Training {
                let [first, second] = [take(length, false)?, take(length, false)?];
                *moments = AdamMoments { first, second, average: take(length, true)? };
            }
            Ok(())
        };
        for (weights, moments) in self.weights.iter_mut().zip(&mut self.moments) {
            take_values(weights, moments)?;
        }
        for table in &mut self.grid.tables {
            take_values(table.values.as_flattened_mut(), &mut table.moments)?;
        }
        let rays = notes["rays"].as_u64().and_then(|r| usize::try_from(r).ok());
        self.rays = rays.ok_or("it does not say how many rays a step has")?.max(1);
        Ok(())
    }
}
