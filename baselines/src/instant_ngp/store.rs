//! What of an Instant NeRF is kept in files.

use super::InstantNgp;
use crate::field::Kept;
use crate::kept::{Restored, kept_arrays};
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
        arrays.extend(kept_arrays(kept, networks.chain(tables)));
        (arrays, json!({ "rays": self.rays }))
    }

    /// See [`crate::RadianceField::restore`].
    pub(super) fn take_arrays(
        &mut self,
        kept: Kept,
        arrays: Vec<Vec<f32>>,
        notes: &Value,
    ) -> Result<(), String> {
        let mut restored = Restored::new(kept, arrays)?;
        let density = restored.take(self.occupancy.density.len(), false)?;
        self.occupancy.set_density(density);
        for (weights, moments) in self.weights.iter_mut().zip(&mut self.moments) {
            restored.take_trained(weights, moments)?;
        }
        for table in &mut self.grid.tables {
            restored.take_trained(table.values.as_flattened_mut(), &mut table.moments)?;
        }
        let rays = notes["rays"].as_u64().and_then(|r| usize::try_from(r).ok());
        self.rays = rays.ok_or("it does not say how many rays a step has")?.max(1);
        Ok(())
    }
}
