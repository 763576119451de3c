//! What of moving Gaussians is kept in files.

use super::Moving;
use super::shape::MOST_IN_FILES;
use crate::field::Kept;
use crate::kept::{Restored, kept_arrays};
use glam::{Quat, Vec3};
use scene::Gaussians;
use serde_json::{Value, json};
use splat::model::Model;
use splat::moved::MovedGaussians;
use splat::statistics::Statistics;

impl Moving {
    /// See [`crate::RadianceField::arrays`].
    pub(super) fn kept_arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        let model = self.gaussians.model();
        let mut arrays: Vec<&[f32]> = model.geometry.iter().map(Vec::as_slice).collect();
        arrays.push(&model.sh);
        if kept == Kept::Training {
            let moments = model.geometry_m.iter().chain(&model.geometry_v).chain(&model.sh_v);
            arrays.extend(moments.chain([&model.steps]).map(Vec::as_slice));
            let seen = self.gaussians.statistics();
            arrays.extend([&seen.gradient[..], &seen.visible]);
        }
        let own = &self.deformation;
        let planes = own.planes.values.iter().map(Vec::as_slice).zip(&own.plane_moments);
        arrays.extend(kept_arrays(kept, planes.chain([(&own.weights[..], &own.weight_moments)])));
        let notes = json!({ "gaussians": model.len, "degree": model.sh_degree, "rounds": self.rounds });
        (arrays, notes)
    }

    /// See [`crate::RadianceField::restore`].
    pub(super) fn take_arrays(
        &mut self,
        kept: Kept,
        arrays: Vec<Vec<f32>>,
        notes: &Value,
    ) -> Result<(), String> {
        let mut restored = Restored::new(kept, arrays)?;
        let mut model = empty(notes)?;
        let mut seen = Statistics::default();
        seen.reset(model.len);
        let mut arrays: Vec<&mut Vec<f32>> = model.geometry.iter_mut().chain([&mut model.sh]).collect();
        if kept == Kept::Training {
            let moments = model.geometry_m.iter_mut().chain(&mut model.geometry_v);
            arrays.extend(moments.chain(&mut model.sh_v).chain([&mut model.steps]));
            arrays.extend([&mut seen.gradient, &mut seen.visible]);
        }
        for array in arrays {
            *array = restored.take(array.len(), false)?;
        }
        self.gaussians = MovedGaussians::new(model).map_err(|e| e.to_string())?;
        self.gaussians.set_statistics(seen).map_err(|e| e.to_string())?;
        let own = &mut self.deformation;
        for (values, moments) in own.planes.values.iter_mut().zip(&mut own.plane_moments) {
            restored.take_trained(values, moments)?;
        }
        restored.take_trained(&mut own.weights, &mut own.weight_moments)?;
        let rounds = notes["rounds"].as_u64().and_then(|r| u32::try_from(r).ok());
        self.rounds = rounds.ok_or("it does not say how often it was densified")?;
        Ok(())
    }
}

/// A number of the notes, which is `most` at most.
fn number(notes: &Value, what: &str, most: usize) -> Result<usize, String> {
    let n = notes[what].as_u64().and_then(|n| usize::try_from(n).ok());
    n.filter(|n| *n <= most).ok_or_else(|| format!("its number of {what} makes no sense"))
}

/// Gaussians as many as the notes say, of zeros.
fn empty(notes: &Value) -> Result<Model, String> {
    let (n, degree) = (number(notes, "gaussians", MOST_IN_FILES)?, number(notes, "degree", 3)?);
    Ok(Model::from_gaussians(&Gaussians {
        means: vec![Vec3::ZERO; n],
        log_scales: vec![Vec3::ZERO; n],
        rotations: vec![Quat::IDENTITY; n],
        opacity_logits: vec![0.0; n],
        sh: vec![0.0; n * 3 * (degree + 1).pow(2)],
        sh_degree: degree as u32,
    }))
}
