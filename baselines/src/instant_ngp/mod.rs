//! Instant NeRF: a multiresolution hash encoding and two small perceptrons, marched through an
//! occupancy grid (Müller et al., "Instant Neural Graphics Primitives with a Multiresolution Hash
//! Encoding", SIGGRAPH 2022).

mod gradient;
mod hash_grid;
mod network;
mod occupancy;
mod render;
mod store;
mod train;

#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;

use crate::adam::AdamMoments;
use crate::domain::Domain;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::rays::{PhotoRays, Ray};
use crate::{FieldError, rays};
use hash_grid::HashGrid;
use network::{NgpNetwork, Weights};
use occupancy::{LocalRay, Occupancy};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use splat::{PinholeView, RenderOutput};

/// Levels of the hash grid. Source: the authors' base configuration.
const LEVELS: usize = 8;
/// Most corners of a level, as a power of two. Source: docs/decisions/19 (the paper: 19).
const LOG2_ENTRIES: u32 = 17;
/// Samples of a step. Source: docs/decisions/19 (the paper: 2¹⁸).
const SAMPLES: usize = 1 << 16;

/// Rays of the first step, when every cell may hold something.
/// Source: a thousand samples each make the samples of a step.
const FIRST_RAYS: usize = 256;
/// Most levels and powers of two in files. Source: twice the paper's, or more.
const MOST_LEVELS: usize = 32;
/// See [`MOST_LEVELS`].
const MOST_LOG2: u32 = 24;

/// The shape of an Instant NeRF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NgpShape {
    pub(crate) domain: Domain,
    pub(crate) levels: usize,
    pub(crate) log2_entries: u32,
    /// Samples of a step.
    pub(crate) samples: usize,
}

/// An Instant NeRF.
#[derive(Clone, Debug)]
pub(crate) struct InstantNgp {
    shape: NgpShape,
    grid: HashGrid,
    network: NgpNetwork,
    /// Weights of the density network, then of the colour network.
    weights: [Vec<f32>; 2],
    moments: [AdamMoments; 2],
    occupancy: Occupancy,
    /// Rays of the next step.
    rays: usize,
}

impl NgpShape {
    /// The defaults for a data set.
    pub(crate) fn new(domain: Domain) -> Self {
        Self { domain, levels: LEVELS, log2_entries: LOG2_ENTRIES, samples: SAMPLES }
    }

    /// Whether fields of this shape can be made.
    pub(crate) fn is_sane(&self) -> bool {
        self.domain.is_sane()
            && (1..=MOST_LEVELS).contains(&self.levels)
            && (1..=MOST_LOG2).contains(&self.log2_entries)
            && (1..=SAMPLES).contains(&self.samples)
    }

    /// Side of the outermost cube, where the smallest has side 1.
    fn side(&self) -> f32 {
        (1u32 << (self.domain.cascades - 1)) as f32
    }
}

impl InstantNgp {
    /// Untrained; `views` are the cameras of the training views.
    pub(crate) fn new(shape: NgpShape, views: &[PinholeView], seed: u64) -> Self {
        let levels = hash_grid::levels(shape.levels, shape.log2_entries, shape.side());
        let network = NgpNetwork::new(shape.levels);
        let weights = network.initial(seed);
        let moments = [AdamMoments::new(weights[0].len()), AdamMoments::new(weights[1].len())];
        let grid = HashGrid::new(&levels, seed);
        let occupancy = Occupancy::new(&shape.domain, views);
        Self { shape, grid, network, weights, moments, occupancy, rays: FIRST_RAYS }
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

    fn render(&self, view: &PinholeView, time: f32, background: [f32; 3]) -> RenderOutput {
        rays::picture(view, time, background, &|rays, out| self.trace(rays, background, out))
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
