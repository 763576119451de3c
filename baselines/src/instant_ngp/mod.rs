//! Instant NeRF: a multiresolution hash encoding and two small perceptrons, marched through an
//! occupancy grid (Müller et al., "Instant Neural Graphics Primitives with a Multiresolution Hash
//! Encoding", SIGGRAPH 2022).

#[cfg(feature = "gpu")]
mod device;
mod gradient;
mod hash_grid;
mod network;
mod occupancy;
mod render;
mod settings;
mod store;
mod train;

#[cfg(all(test, feature = "gpu"))]
mod device_tests;
#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod twin_tests;

use crate::adam::AdamMoments;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::rays::{PhotoRays, Ray};
use crate::{FieldError, rays};
#[cfg(feature = "gpu")]
pub(crate) use device::NgpOnDevice;
use hash_grid::HashGrid;
use network::{Layers, NgpNetwork, Weights};
use occupancy::{LocalRay, Occupancy};
use serde_json::Value;
use settings::NgpSettings;
pub(crate) use settings::NgpShape;
use splat::{PinholeView, RenderOutput};

/// An Instant NeRF.
#[derive(Clone, Debug)]
pub(crate) struct InstantNgp {
    shape: NgpShape,
    settings: NgpSettings,
    grid: HashGrid,
    network: NgpNetwork,
    /// Weights of the density network, then of the colour network.
    weights: [Vec<f32>; 2],
    moments: [AdamMoments; 2],
    occupancy: Occupancy,
    /// Rays of the next step.
    rays: usize,
}

impl InstantNgp {
    /// Untrained; `views` are the cameras of the training views.
    pub(crate) fn new(shape: NgpShape, views: &[PinholeView], seed: u64) -> Self {
        let settings = NgpSettings::default();
        let network = NgpNetwork::new(shape.levels, settings.hidden);
        let weights = network.initial(seed);
        let moments = [AdamMoments::new(weights[0].len()), AdamMoments::new(weights[1].len())];
        let grid = HashGrid::new(&shape, &settings.grid, seed);
        let occupancy = Occupancy::new(&shape.domain, settings.occupancy, views);
        let rays = settings.first_rays;
        Self { shape, settings, grid, network, weights, moments, occupancy, rays }
    }

    /// A ray in the frame of the smallest cube; distances along it are `2 · half` times as long.
    fn local(&self, ray: &Ray) -> LocalRay {
        let side = 2.0 * self.shape.domain.half;
        LocalRay { origin: (ray.origin - self.shape.domain.centre) / side + 0.5, direction: ray.direction }
    }

    /// A position in the frame of the smallest cube, in that of the hash grid.
    #[inline(always)]
    fn grid_point(&self, position: [f32; 3]) -> [f32; 3] {
        let side = self.shape.side();
        position.map(|v| (v - 0.5) / side + 0.5)
    }

    fn weights(&self) -> Weights<'_> {
        Weights { density: &self.weights[0], colour: &self.weights[1] }
    }
}

impl RadianceField for InstantNgp {
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        Ok(self.step(photos, place))
    }

    fn render(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        rays::picture(view, time, (background, rays::BLOCK), &|rays, out| {
            let mut layers = Layers::default();
            self.trace(rays, background, out, &mut |seen| Ok(self.shade(seen, &mut layers)))
        })
    }

    fn size(&self) -> usize {
        self.weights[0].len()
            + self.weights[1].len()
            + self.grid.tables.iter().map(|t| t.values.len() * hash_grid::FEATURES).sum::<usize>()
    }

    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        self.kept_arrays(kept)
    }

    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, notes: &Value) -> Result<(), String> {
        self.take_arrays(kept, arrays, notes)
    }
}
