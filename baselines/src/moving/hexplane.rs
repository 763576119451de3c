//! HexPlane (Cao and Johnson 2023; Wu et al. 2024, section 4.2): features of a place and a time
//! from six planes, one for each pair of coordinates, multiplied with each other.

use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::{Rng, rng};

/// Features of a cell. Source: Wu et al. 2024's settings.
pub(super) const FEATURES: usize = 16;
/// Resolutions, each twice that of the one before along the axes of space.
/// Source: Wu et al. 2024's settings for synthetic scenes.
pub(super) const LEVELS: usize = 2;
/// The planes' coordinates: x, y, z, time.
const PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3]];
/// The coordinate that is the time.
const TIME: usize = 3;
/// Features of planes of space at the start; those of planes of time are 1.
/// Source: docs/decisions/19 (Wu et al. 2024's program has 0.1 to 0.5).
const INITIAL: std::ops::Range<f32> = 0.5..1.5;
/// Samples of a task. Source: chosen by hand: many tasks for many threads.
pub(super) const CHUNK: usize = 512;

/// Features at one place of one plane.
type Cell = [f32; FEATURES];
/// A place, in [0, 1] in all coordinates.
pub(super) type Place = [f32; 4];

/// One plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct HexShape {
    axes: [usize; 2],
    /// Cells along both axes.
    size: [usize; 2],
}

/// Weights of what planes should be like besides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Smoothness {
    /// Squared differences between neighbours in space.
    pub(super) space: f32,
    /// Squared second differences in time.
    pub(super) time: f32,
    /// Distance of planes of time from 1.
    pub(super) still: f32,
}

/// All planes: [`PAIRS`] of the first level, then of the next.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct HexPlanes {
    pub(super) shapes: Vec<HexShape>,
    /// By plane: [second axis × first axis × FEATURES].
    pub(super) values: Vec<Vec<f32>>,
}

/// The four cells around a place, and their shares.
struct Corners {
    at: [usize; 4],
    share: [f32; 4],
}

impl HexShape {
    /// Whether its second axis is the time.
    fn is_of_time(&self) -> bool {
        self.axes[1] == TIME
    }

    fn len(&self) -> usize {
        self.size[0] * self.size[1] * FEATURES
    }

    /// Values at the start.
    fn initial(&self, rng: &mut Rng) -> Vec<f32> {
        if self.is_of_time() {
            return vec![1.0; self.len()];
        }
        (0..self.len()).map(|_| rng.random_range(INITIAL)).collect()
    }

    /// The values' gradient from those of what is read at places.
    fn scatter<'a>(&self, read: impl Iterator<Item = (&'a Place, &'a Cell)>) -> Vec<f32> {
        let mut gradient = vec![0.0; self.len()];
        for (place, cell) in read {
            let corners = self.corners(place);
            for (at, share) in corners.at.iter().zip(corners.share) {
                let sum = &mut gradient[*at..][..FEATURES];
                for k in 0..FEATURES {
                    sum[k] += share * cell[k];
                }
            }
        }
        gradient
    }

    #[inline(always)]
    fn corners(&self, place: &Place) -> Corners {
        let mut low = [0; 2];
        let mut f = [0.0; 2];
        for k in 0..2 {
            let last = self.size[k] - 1;
            // Places beyond a side, and NaN, lie on it.
            let at = place[self.axes[k]];
            let x = if at > 0.0 { at.min(1.0) } else { 0.0 } * last as f32;
            low[k] = (x as usize).min(last.saturating_sub(1));
            f[k] = x - low[k] as f32;
        }
        let right = usize::from(self.size[0] > 1);
        let up = if self.size[1] > 1 { self.size[0] } else { 0 };
        let first = low[1] * self.size[0] + low[0];
        Corners {
            at: [first, first + right, first + up, first + right + up].map(|c| c * FEATURES),
            share: [(1.0 - f[0]) * (1.0 - f[1]), f[0] * (1.0 - f[1]), (1.0 - f[0]) * f[1], f[0] * f[1]],
        }
    }
}

impl Corners {
    #[inline(always)]
    fn read(&self, values: &[f32]) -> Cell {
        let mut sum = [0.0; FEATURES];
        for (at, share) in self.at.iter().zip(self.share) {
            let cell = &values[*at..][..FEATURES];
            for k in 0..FEATURES {
                sum[k] += share * cell[k];
            }
        }
        sum
    }
}

impl HexPlanes {
    /// Of so many cells along each axis of space on the first level, and in time.
    pub(super) fn new(space: usize, time: usize, seed: u64) -> Self {
        let mut shapes = Vec::new();
        for level in 0..LEVELS {
            shapes.extend(PAIRS.map(|axes| HexShape {
                axes,
                size: axes.map(|a| if a == TIME { time } else { space << level }),
            }));
        }
        let planes = shapes.iter().enumerate();
        let values = planes.map(|(i, shape)| shape.initial(&mut rng(seed, "planes", i as u64)));
        Self { values: values.collect(), shapes }
    }

    /// Features of a place into a row, level by level.
    #[inline(always)]
    pub(super) fn encode(&self, place: &Place, row: &mut [f32]) {
        let planes = self.shapes.chunks_exact(PAIRS.len()).zip(self.values.chunks_exact(PAIRS.len()));
        for ((shapes, values), out) in planes.zip(row.chunks_exact_mut(FEATURES)) {
            let mut product = [1.0; FEATURES];
            for (shape, values) in shapes.iter().zip(values) {
                let value = shape.corners(place).read(values);
                for k in 0..FEATURES {
                    product[k] *= value[k];
                }
            }
            out.copy_from_slice(&product);
        }
    }

    /// The planes' gradients from those of the features: one row of `of_rows` a place.
    pub(super) fn backward(&self, places: &[Place], of_rows: &[f32], width: usize) -> Vec<Vec<f32>> {
        let planes = self.shapes.len();
        let mut of_cells = vec![[0.0; FEATURES]; places.len() * planes];
        let chunks = of_cells.par_chunks_mut(CHUNK * planes);
        chunks.zip(places.par_chunks(CHUNK)).zip(of_rows.par_chunks(CHUNK * width)).for_each(
            |((of_cells, places), of_rows)| {
                let rows = of_cells.chunks_exact_mut(planes).zip(of_rows.chunks_exact(width));
                rows.zip(places).for_each(|((cells, row), place)| self.of_cells(place, row, cells));
            },
        );
        self.shapes
            .par_iter()
            .enumerate()
            .map(|(plane, shape)| {
                let cells = of_cells.iter().skip(plane).step_by(planes);
                shape.scatter(places.iter().zip(cells))
            })
            .collect()
    }

    /// The gradient of what each plane shows at a place: that of the product, times the others.
    #[inline(always)]
    fn of_cells(&self, place: &Place, of_row: &[f32], cells: &mut [Cell]) {
        let planes = self.shapes.chunks_exact(PAIRS.len()).zip(self.values.chunks_exact(PAIRS.len()));
        let outs = cells.chunks_exact_mut(PAIRS.len()).zip(of_row.chunks_exact(FEATURES));
        for ((shapes, values), (cells, of_product)) in planes.zip(outs) {
            let mut own = [[0.0; FEATURES]; PAIRS.len()];
            for ((shape, values), own) in shapes.iter().zip(values).zip(&mut own) {
                *own = shape.corners(place).read(values);
            }
            for k in 0..FEATURES {
                let mut before = of_product[k];
                for (cell, own) in cells.iter_mut().zip(&own) {
                    cell[k] = before;
                    before *= own[k];
                }
                let mut after = 1.0;
                for (cell, own) in cells.iter_mut().zip(&own).rev() {
                    cell[k] *= after;
                    after *= own[k];
                }
            }
        }
    }

    /// Adds the gradients of smoothness, in the mean over a plane's values.
    pub(super) fn add_smoothness(&self, weights: &Smoothness, gradients: &mut [Vec<f32>]) {
        let planes = self.shapes.par_iter().zip(&self.values).zip(gradients);
        planes.for_each(|((shape, values), gradient)| {
            let share = 1.0 / values.len() as f32;
            let row = shape.size[0] * FEATURES;
            if shape.is_of_time() {
                for i in row..values.len().saturating_sub(row) {
                    let bend = values[i - row] - 2.0 * values[i] + values[i + row];
                    let g = 2.0 * weights.time * share * bend;
                    gradient[i - row] += g;
                    gradient[i] -= 2.0 * g;
                    gradient[i + row] += g;
                }
                for (g, v) in gradient.iter_mut().zip(values) {
                    *g += weights.still * share * (v - 1.0).signum() * f32::from(u8::from(*v != 1.0));
                }
                return;
            }
            let step = 2.0 * weights.space * share;
            for i in row..values.len() {
                let g = step * (values[i] - values[i - row]);
                gradient[i] += g;
                gradient[i - row] -= g;
            }
            for line in 0..shape.size[1] {
                for i in line * row + FEATURES..(line + 1) * row {
                    let g = step * (values[i] - values[i - FEATURES]);
                    gradient[i] += g;
                    gradient[i - FEATURES] -= g;
                }
            }
        });
    }
}
