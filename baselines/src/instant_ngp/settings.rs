//! What an Instant NeRF is told: the settings of the paper and of its authors' base configuration,
//! scaled to a processor (docs/decisions/19).

use crate::adam::AdamSettings;
use crate::domain::Domain;
use serde::{Deserialize, Serialize};

/// The shape of an Instant NeRF: what the arrays have their sizes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NgpShape {
    pub(crate) domain: Domain,
    /// Levels of the hash grid. Source: the authors' base configuration.
    pub(crate) levels: usize,
    /// Most corners of a level, as a power of two. Source: docs/decisions/19 (the paper: 19).
    pub(crate) log2_entries: u32,
    /// Samples of a step. Source: docs/decisions/19 (the paper: 2¹⁸).
    pub(crate) samples: usize,
}

/// How it is made and trained.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NgpSettings {
    pub(super) grid: GridSettings,
    pub(super) occupancy: OccupancySettings,
    /// Units of the networks' hidden layers. Source: Müller et al. 2022, section 5.4.
    pub(super) hidden: usize,
    /// Error from which Huber's loss grows linearly, in colours of [0, 1].
    /// Source: Müller et al. 2022's published settings.
    pub(super) linear_from: f32,
    /// Source: Müller et al. 2022, section 4.
    pub(super) adam: AdamSettings,
    /// Learning rate at the start. Source: Müller et al. 2022, section 4.
    pub(super) learning_rate: f64,
    /// Its factor at each of the positions `falls`. Source: the authors' base configuration.
    pub(super) fall: f64,
    /// Positions in the schedule at which it falls.
    /// Source: the base configuration: steps 20,000, 30,000 and 40,000 of 50,000.
    pub(super) falls: [f64; 3],
    /// Weight decay of the networks. Source: Müller et al. 2022, section 4.
    pub(super) decay: f32,
    /// Share of the weights' average that a step keeps. Source: Müller et al. 2022, section 4.
    pub(super) average: f32,
    /// Position from which the weights are averaged: what lies earlier no longer counts at the end.
    /// Source: 0.95 to the power of the steps left is nothing.
    pub(super) average_from: f64,
    /// Rays of the first step, when every cell may hold something.
    /// Source: half the steps along the diagonal each make the samples of a step.
    pub(super) first_rays: usize,
    /// Most rays of a step. Source: the paper's samples: each ray has one at least.
    pub(super) most_rays: usize,
    /// Stretches of rays whose gradients are added up apart: many enough for many threads.
    /// Source: chosen by hand; part of the result, as sums have a fixed order.
    pub(super) stretches: usize,
}

/// The hash grid.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GridSettings {
    /// Cells along a side of the coarsest grid. Source: Müller et al. 2022, table 1.
    pub(super) coarsest: f64,
    /// Cells along a side of the finest grid over the unit cube.
    /// Source: Müller et al. 2022, section 5.4.
    pub(super) finest: f64,
    /// Largest feature at the start, either sign. Source: Müller et al. 2022, section 4.
    pub(super) initial: f32,
}

/// The occupancy grid and the march through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OccupancySettings {
    /// Steps along the diagonal of the smallest cube.
    /// Source: docs/decisions/19 (Müller et al. 2022, appendix E.1: 1,024).
    pub(super) steps: f32,
    /// A step in distances from the camera, outside the smallest cube.
    /// Source: Müller et al. 2022, appendix E.1.
    pub(super) cone: f32,
    /// Most samples of a ray. Source: the paper's diagonal of the smallest cube.
    pub(super) most: usize,
    /// Opacity of one smallest step from which a cell counts as occupied.
    /// Source: Müller et al. 2022, appendix E.2.
    pub(super) opaque: f32,
    /// Steps of training between updates. Source: Müller et al. 2022, appendix E.2.
    pub(super) every: u32,
    /// Share of all cells that an update looks at, wherever they lie; it looks at all that count as
    /// occupied besides. Source: Müller et al. 2022, appendix E.2 (all cells in the first 256
    /// steps, then a quarter, and as many of the occupied).
    pub(super) anywhere: f32,
    /// Share of a cell's density that an update keeps. Source: Müller et al. 2022, appendix E.2.
    pub(super) kept: f32,
}

impl Default for NgpSettings {
    fn default() -> Self {
        Self {
            grid: GridSettings { coarsest: 16.0, finest: 2048.0, initial: 1e-4 },
            occupancy: OccupancySettings::default(),
            hidden: 64,
            linear_from: 0.1,
            adam: AdamSettings { betas: [0.9, 0.99], epsilon: 1e-15 },
            learning_rate: 1e-2,
            fall: 0.33,
            falls: [0.4, 0.6, 0.8],
            decay: 1e-6,
            average: 0.95,
            average_from: 0.9,
            first_rays: 256,
            most_rays: 1 << 18,
            stretches: 32,
        }
    }
}

impl Default for OccupancySettings {
    fn default() -> Self {
        Self {
            steps: 512.0,
            cone: 1.0 / 256.0,
            most: 1024,
            opaque: 0.01,
            every: 16,
            anywhere: 0.25,
            kept: 0.95,
        }
    }
}

impl NgpShape {
    /// The defaults for a data set.
    pub(crate) fn new(domain: Domain) -> Self {
        Self { domain, levels: 8, log2_entries: 17, samples: 1 << 16 }
    }

    /// Whether fields of this shape can be made: with twice the paper's levels and 2⁵ times its
    /// corners at most.
    pub(crate) fn is_sane(&self) -> bool {
        self.domain.is_sane()
            && (1..=32).contains(&self.levels)
            && (1..=24).contains(&self.log2_entries)
            && (1..=Self::new(self.domain).samples).contains(&self.samples)
    }

    /// Side of the outermost cube, where the smallest has side 1.
    pub(super) fn side(&self) -> f32 {
        (1u32 << (self.domain.cascades - 1)) as f32
    }
}

impl OccupancySettings {
    /// Shortest step, in sides of the smallest cube.
    pub(super) fn shortest(&self) -> f32 {
        3f32.sqrt() / self.steps
    }
}
