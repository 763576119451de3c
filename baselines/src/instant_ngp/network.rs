//! The two perceptrons and what they make of an encoded point: density and colour.

use super::hash_grid::{FEATURES, HashGrid};
use crate::mlp::{Activations, Mlp};
use crate::rays::Ray;
use scene::rng::rng;
use scene::sh::{SH_COUNT, sh_basis};

/// Outputs of the density network, the first of which is the density's logarithm.
/// Source: Müller et al. 2022, section 5.4.
pub(crate) const LATENT: usize = 16;
/// Largest logarithm of a density: the exponential's gradient is truncated there.
/// Source: Müller et al. 2022's published settings.
pub(super) const LOG_DENSITY: f32 = 15.0;

/// The perceptrons' shapes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NgpNetwork {
    pub(crate) density: Mlp,
    pub(crate) colour: Mlp,
}

/// Weights of both, as the passes read them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights<'a> {
    pub(crate) density: &'a [f32],
    pub(crate) colour: &'a [f32],
}

/// Activations of both.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layers {
    pub(crate) density: Activations,
    pub(crate) colour: Activations,
}

/// The density of an output of the network.
#[inline(always)]
pub(crate) fn density(x: f32) -> f32 {
    x.clamp(-LOG_DENSITY, LOG_DENSITY).exp()
}

/// Spherical harmonics of a ray's direction.
pub(crate) fn encode_direction(ray: &Ray) -> [f32; SH_COUNT] {
    sh_basis(ray.direction.as_dvec3()).map(|v| v as f32)
}

impl NgpNetwork {
    /// For a hash grid of so many levels, with hidden layers of so many units.
    pub(crate) fn new(levels: usize, hidden: usize) -> Self {
        Self {
            density: Mlp::new(&[levels * FEATURES, hidden, LATENT]),
            colour: Mlp::new(&[LATENT + SH_COUNT, hidden, hidden, 3]),
        }
    }

    /// Random weights of both.
    pub(crate) fn initial(&self, seed: u64) -> [Vec<f32>; 2] {
        let mut rng = rng(seed, "networks", 0);
        [self.density.initial(&mut rng), self.colour.initial(&mut rng)]
    }

    /// Densities of points: encodes them into the first activations and evaluates.
    pub(crate) fn densities(
        &self,
        grid: &HashGrid,
        weights: &[f32],
        points: &[[f32; 3]],
        layers: &mut Activations,
    ) {
        self.density.reserve(points.len(), layers);
        grid.encode_rows(points, &mut layers.layers[0], self.density.inputs());
        self.density.forward(weights, layers);
    }

    /// Colours (before the logistic function) from the density network's outputs and the encoded
    /// direction of each sample.
    pub(crate) fn colours<'a>(
        &self,
        weights: &[f32],
        layers: &mut Layers,
        directions: impl ExactSizeIterator<Item = &'a [f32; SH_COUNT]>,
    ) {
        self.colour.reserve(directions.len(), &mut layers.colour);
        let latent = layers.density.layers.last().map_or(&[][..], Vec::as_slice);
        let rows = layers.colour.layers[0].chunks_exact_mut(LATENT + SH_COUNT);
        for ((row, latent), direction) in rows.zip(latent.chunks_exact(LATENT)).zip(directions) {
            row[..LATENT].copy_from_slice(latent);
            row[LATENT..].copy_from_slice(direction);
        }
        self.colour.forward(weights, &mut layers.colour);
    }
}
