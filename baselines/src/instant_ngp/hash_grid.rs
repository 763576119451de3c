//! The multiresolution hash encoding (Müller et al. 2022, section 3): tables of features at the
//! corners of grids from coarse to fine, interpolated at a point.

use super::settings::{GridSettings, NgpShape};
use crate::adam::{AdamMoments, AdamRates};
use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::{Rng, rng};

/// Features of a corner: one register of 128 bits.
/// Source: the authors' base configuration (8 levels of 4 features; the paper has 16 of 2).
pub(crate) const FEATURES: usize = 4;
/// Features of one corner.
pub(crate) type Corner = [f32; FEATURES];
/// Multipliers of the coordinates in the hash. Source: Müller et al. 2022, section 3.
const PRIMES: [u32; 3] = [1, 2_654_435_761, 805_459_861];
/// Samples or cells of a task: many tasks for many threads, few enough samples that a level's
/// features stay in the cache. Source: chosen by hand.
pub(super) const CHUNK: usize = 1 << 14;

/// One grid: where the corners of a cell lie in its table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridLevel {
    /// Position in cells = position in [0, 1] × this + ½.
    pub(crate) scale: f32,
    /// Multipliers of the three coordinates of a corner.
    pub(super) strides: [u32; 3],
    /// Whether the coordinates are added (a grid small enough to be stored whole) or mixed.
    pub(super) dense: bool,
    /// Entries of the table, a power of two where it is hashed.
    pub(crate) entries: usize,
}

/// The corners of the cell around a point.
pub(crate) struct Cell {
    /// Places in the table.
    pub(crate) at: [u32; 8],
    /// Shares, which add up to 1.
    pub(crate) share: [f32; 8],
}

/// The tables of one level and their optimiser.
#[derive(Clone, Debug)]
pub(crate) struct GridTable {
    pub(crate) level: GridLevel,
    pub(crate) values: Vec<Corner>,
    pub(crate) gradient: Vec<Corner>,
    pub(crate) moments: AdamMoments,
}

/// All levels.
#[derive(Clone, Debug)]
pub(crate) struct HashGrid {
    pub(crate) tables: Vec<GridTable>,
}

impl GridLevel {
    fn new(cells: f64, most: usize) -> Self {
        // The grid is shifted by half a cell, so that a point never lies on a corner of all levels.
        let scale = cells - 1.0;
        let side = scale.ceil() as usize + 2;
        let whole = side.pow(3);
        let dense = whole <= most;
        let strides = if dense { [1, side as u32, (side * side) as u32] } else { PRIMES };
        Self { scale: scale as f32, strides, dense, entries: if dense { whole } else { most } }
    }

    /// The cell around a point of the unit cube.
    #[inline(always)]
    pub(crate) fn cell(&self, position: [f32; 3]) -> Cell {
        let mut low = [0u32; 3];
        let mut high = [0u32; 3];
        let mut f = [0f32; 3];
        for a in 0..3 {
            let x = position[a] * self.scale + 0.5;
            let whole = x as u32;
            f[a] = x - whole as f32;
            low[a] = whole.wrapping_mul(self.strides[a]);
            high[a] = low[a].wrapping_add(self.strides[a]);
        }
        let g = [1.0 - f[0], 1.0 - f[1], 1.0 - f[2]];
        let mut cell = Cell { at: [0; 8], share: [0.0; 8] };
        let mask = self.entries as u32 - 1;
        for c in 0..8 {
            let x = if c & 1 == 0 { low[0] } else { high[0] };
            let y = if c & 2 == 0 { low[1] } else { high[1] };
            let z = if c & 4 == 0 { low[2] } else { high[2] };
            cell.at[c] = if self.dense { x + y + z } else { (x ^ y ^ z) & mask };
            let (wx, wy, wz) = (
                if c & 1 == 0 { g[0] } else { f[0] },
                if c & 2 == 0 { g[1] } else { f[1] },
                if c & 4 == 0 { g[2] } else { f[2] },
            );
            cell.share[c] = wx * wy * wz;
        }
        cell
    }
}

/// A point inside the unit cube, whatever is given (NaN becomes 0): tables are indexed by it.
#[inline(always)]
pub(crate) fn inside(position: [f32; 3]) -> [f32; 3] {
    position.map(|v| if v > 0.0 { v.min(1.0) } else { 0.0 })
}

impl GridTable {
    /// Random features, up to `initial` either way.
    fn new(level: GridLevel, initial: f32, rng: &mut Rng) -> Self {
        let values = (0..level.entries)
            .map(|_| std::array::from_fn(|_| rng.random_range(-initial..initial)))
            .collect();
        let gradient = vec![[0.0; FEATURES]; level.entries];
        Self { level, values, gradient, moments: AdamMoments::new(level.entries * FEATURES) }
    }

    /// The features at a point of the unit cube.
    #[inline(always)]
    pub(crate) fn features(&self, position: [f32; 3]) -> Corner {
        let cell = self.level.cell(inside(position));
        let mut sum = [0.0; FEATURES];
        for c in 0..8 {
            let value = self.values[cell.at[c] as usize];
            for k in 0..FEATURES {
                sum[k] += cell.share[c] * value[k];
            }
        }
        sum
    }

    /// Adds the gradients of the features at points to those of the corners.
    pub(crate) fn scatter(&mut self, points: impl Iterator<Item = ([f32; 3], Corner)>) {
        for (position, gradient) in points {
            let cell = self.level.cell(inside(position));
            for c in 0..8 {
                let sum = &mut self.gradient[cell.at[c] as usize];
                for k in 0..FEATURES {
                    sum[k] += cell.share[c] * gradient[k];
                }
            }
        }
    }

    /// Adam on the corners that were touched; leaves the gradients at 0.
    pub(crate) fn step(&mut self, rates: &AdamRates) {
        let values = self.values.as_flattened_mut();
        self.moments.step_where_touched(values, self.gradient.as_flattened_mut(), rates);
    }
}

impl HashGrid {
    /// Small random features: cells grow by the same factor from level to level.
    pub(super) fn new(shape: &NgpShape, settings: &GridSettings, seed: u64) -> Self {
        let GridSettings { coarsest, finest, initial } = *settings;
        let steps = (shape.levels.max(2) - 1) as f64;
        let growth = (finest * f64::from(shape.side()) / coarsest).powf(1.0 / steps);
        let tables = (0..shape.levels).into_par_iter().map(|index| {
            let cells = coarsest * growth.powi(index as i32);
            let level = GridLevel::new(cells, 1 << shape.log2_entries);
            GridTable::new(level, initial, &mut rng(seed, "hash grid", index as u64))
        });
        Self { tables: tables.collect() }
    }

    /// Features of many points, by level: `[levels][points]`.
    pub(crate) fn encode(&self, points: &[[f32; 3]], features: &mut Vec<Vec<Corner>>) {
        features.resize(self.tables.len(), Vec::new());
        features.iter_mut().for_each(|f| f.resize(points.len(), [0.0; FEATURES]));
        let tasks = self.tables.iter().zip(features).rev().flat_map(|(table, features)| {
            points.chunks(CHUNK).zip(features.chunks_mut(CHUNK)).map(move |(p, f)| (table, p, f))
        });
        let tasks: Vec<_> = tasks.collect();
        tasks.into_par_iter().for_each(|(table, points, features)| {
            for (f, &p) in features.iter_mut().zip(points) {
                *f = table.features(p);
            }
        });
    }

    /// Features of points into rows of inputs, `width` wide.
    pub(crate) fn encode_rows(&self, points: &[[f32; 3]], rows: &mut [f32], width: usize) {
        for (level, table) in self.tables.iter().enumerate() {
            for (row, &p) in rows.chunks_exact_mut(width).zip(points) {
                row[level * FEATURES..][..FEATURES].copy_from_slice(&table.features(p));
            }
        }
    }
}
