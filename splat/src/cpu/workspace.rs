//! The buffers of a view and the kernels run over them in parallel.

use super::sort::{Bins, TILE};
use super::loss::Shape;
use super::adam::{Optimise, SharedModel, SharedPlane, Sink, optimise};
use super::project::{CULLED, CameraConstants, Parameters, Project, Record, project};
use super::rasterise::{Backward, Extra, Forward, PIXELS, Plane, SUMS, Tile, Visit, backward, forward, visit};
use super::simd::Isa;
use super::target::{Source, compose, reached_tiles};
use crate::backend::{Scores, Target};
use rayon::prelude::*;

/// Gaussians a task projects or optimises.
const CHUNK: usize = 512;

/// Everything that lives between the kernels of a step. Kept between steps, so that nothing is allocated in the loop.
#[derive(Debug, Default)]
pub struct Workspace {
    pub records: Vec<Record>,
    pub keys: Vec<u32>,
    pub bins: Bins,
    pub shape: Shape,
    pub rgb: [Vec<f32>; 3],
    pub transmittance: Vec<f32>,
    pub depth: Vec<f32>,
    pub used: Vec<u32>,
    /// Tiles that weights reach; empty: all.
    pub reached: Vec<bool>,
    pub target: [Vec<f32>; 3],
    pub weight: Vec<f32>,
    pub gradient: [Vec<f32>; 3],
    pub sums: Vec<[f32; SUMS]>,
    /// Of the loss.
    pub parts: Vec<[f64; 3]>,
    /// Targets are divided by this.
    pub gain: Option<[f32; 3]>,
    /// What backward sums for the statistics.
    pub scores: Scores,
}

impl Workspace {
    /// project, sort, bin.
    pub fn project(&mut self, isa: Isa, parameters: Parameters, n: usize, camera: &CameraConstants) {
        self.records.resize(n, Record::default());
        self.keys.resize(n, CULLED);
        let chunks = self.records.par_chunks_mut(CHUNK).zip(self.keys.par_chunks_mut(CHUNK)).enumerate();
        chunks.for_each(|(chunk, (records, keys))| {
            project(isa, &mut Project { parameters, camera, start: chunk * CHUNK, records, keys });
        });
    }

    /// Sizes the planes for an image.
    pub fn resize(&mut self, shape: Shape) {
        self.shape = shape;
        let plane = shape.plane();
        for planes in [&mut self.rgb, &mut self.target, &mut self.gradient] {
            planes.iter_mut().for_each(|p| p.resize(plane, 0.0));
        }
        self.transmittance.resize(plane, 1.0);
        self.used.resize(plane / PIXELS, 0);
    }

    /// What of the next picture counts: all of it without a target, or where its mask is not a weight.
    pub fn limit(&mut self, target: Option<&Target>, shape: Shape) {
        self.reached.clear();
        if let Some(Target { mask: Some(mask), transparent: false, .. }) = target {
            reached_tiles(mask, shape, &mut self.reached);
        }
    }

    /// Rasterises all tiles that count; the others keep what they show.
    pub fn forward(&mut self, isa: Isa, background: [f32; 3], with_depth: bool) {
        if with_depth {
            self.depth.resize(self.shape.plane(), 0.0);
        }
        let (shape, records, bins, reached) = (self.shape, &self.records, &self.bins, &self.reached);
        let rgb = self.rgb.each_mut().map(|p| SharedPlane(p.as_mut_ptr()));
        let transmittance = SharedPlane(self.transmittance.as_mut_ptr());
        let depth = with_depth.then_some(SharedPlane(self.depth.as_mut_ptr()));
        self.used.par_iter_mut().enumerate().for_each(|(t, used)| {
            if reached.get(t) == Some(&false) {
                *used = 0;
                return;
            }
            let tile = shape.tile(t);
            let list = &bins.list[bins.offsets[t] as usize..bins.offsets[t + 1] as usize];
            let (mut colour, mut clear, mut far) =
                ([Plane::filled(0.0); 3], Plane::filled(1.0), Plane::filled(0.0));
            let mut a = Forward {
                records,
                list,
                tile,
                background,
                rgb: &mut colour,
                transmittance: &mut clear,
                depth: depth.map(|_| &mut far),
                used: 0,
            };
            forward(isa, &mut a);
            *used = a.used as u32;
            // Tiles do not overlap, so every task writes pixels of its own.
            unsafe {
                for (plane, values) in rgb.iter().zip(&colour) {
                    scatter(values, plane, &tile);
                }
                scatter(&clear, &transmittance, &tile);
                if let Some(depth) = &depth {
                    scatter(&far, depth, &tile);
                }
            }
        });
    }

    /// Gaussian–pixel pairs that the last [`Workspace::forward`] evaluated.
    pub fn gaussian_pixels(&self, isa: Isa) -> u64 {
        let of = |(t, &used): (usize, &u32)| {
            let begin = self.bins.offsets[t] as usize;
            let list = &self.bins.list[begin..begin + used as usize];
            let mut a = Visit { records: &self.records, list, tile: self.shape.tile(t), pixels: 0 };
            visit(isa, &mut a);
            a.pixels
        };
        self.used.iter().enumerate().map(of).sum()
    }

    /// Target planes (and weights) from 8-bit pixels, composed over the background where masks mean transparency.
    pub fn set_target(&mut self, isa: Isa, target: &Target, background: [f32; 3]) {
        if target.mask.is_some() && !target.transparent {
            self.weight.resize(self.shape.plane(), 0.0);
        }
        let source = Source { shape: self.shape, target, background, gain: self.gain };
        compose(isa, &source, &self.rgb, &mut self.target, &mut self.weight);
    }

    /// Gradients of all pairs from `self.gradient`.
    pub fn backward(&mut self, isa: Isa) {
        let (shape, records, bins, used) = (self.shape, &self.records, &self.bins, &self.used);
        let (rgb, gradient) = (&self.rgb, &self.gradient);
        self.sums.resize(bins.list.len(), [0.0; SUMS]);
        let (scores, target) = (self.scores, &self.target);
        let all = SharedSums(self.sums.as_mut_ptr());
        (0..used.len()).into_par_iter().for_each(|t| {
            let used = used[t] as usize;
            let (begin, end) = (bins.offsets[t] as usize, bins.offsets[t + 1] as usize);
            // The tiles' ranges do not overlap, so every task writes pairs of its own.
            let sums = unsafe { all.slice(begin, end) };
            sums[used..].fill([0.0; SUMS]);
            if used == 0 {
                return;
            }
            let tile = shape.tile(t);
            let local: [Plane; 3] = std::array::from_fn(|c| gather(&gradient[c], &tile));
            let mut remaining = Plane::filled(0.0);
            let mut error = Plane::filled(0.0);
            for (c, gradient) in local.iter().enumerate() {
                let colour = gather(&rgb[c], &tile);
                for i in 0..PIXELS {
                    remaining[i] += colour[i] * gradient[i];
                }
                if scores == Scores::Error {
                    let wanted = gather(&target[c], &tile);
                    for i in 0..PIXELS {
                        error[i] += (colour[i] - wanted[i]).abs();
                    }
                }
            }
            let list = &bins.list[begin..begin + used];
            let sums = &mut sums[..used];
            backward(
                isa,
                &mut Backward {
                    records,
                    list,
                    tile,
                    gradient: &local,
                    remaining: &mut remaining,
                    sums,
                    extra: match scores {
                        Scores::Gradient => Extra::Nothing,
                        Scores::Magnitudes => Extra::Magnitudes,
                        Scores::Error => Extra::Error(&error),
                    },
                },
            );
        });
    }

    /// project backward and Adam (or plain gradients); returns how many gradients were not finite.
    pub fn optimise(
        &self,
        isa: Isa,
        parameters: Parameters,
        shared: SharedModel,
        camera: &CameraConstants,
        sink: Sink,
        penalties: [f32; 2],
    ) -> usize {
        let n = self.keys.len();
        let run = |chunk: usize| {
            let start = chunk * CHUNK;
            let mut a = Optimise {
                parameters,
                shared,
                camera,
                bins: &self.bins,
                keys: &self.keys,
                sums: &self.sums,
                start,
                end: (start + CHUNK).min(n),
                sink,
                opacity_penalty: penalties[0],
                scale_penalty: penalties[1],
                scores: self.scores,
                non_finite: 0,
            };
            optimise(isa, &mut a);
            a.non_finite
        };
        (0..n.div_ceil(CHUNK)).into_par_iter().map(run).sum()
    }
}

/// The pairs' sums, of which every task writes its own range.
#[derive(Clone, Copy)]
struct SharedSums(*mut [f32; SUMS]);
// Ranges of different tasks do not overlap.
unsafe impl Send for SharedSums {}
unsafe impl Sync for SharedSums {}

impl SharedSums {
    /// # Safety
    /// Within the array, and nobody else uses the range meanwhile.
    #[allow(clippy::mut_from_ref)]
    unsafe fn slice(&self, begin: usize, end: usize) -> &mut [[f32; SUMS]] {
        unsafe { std::slice::from_raw_parts_mut(self.0.add(begin), end - begin) }
    }
}

/// # Safety
/// `plane` covers the tile and no other task writes its pixels.
unsafe fn scatter(values: &Plane, plane: &SharedPlane, tile: &Tile) {
    for (y, row) in values.chunks_exact(TILE).enumerate() {
        unsafe { std::ptr::copy_nonoverlapping(row.as_ptr(), plane.0.add(tile.row(y)), TILE) };
    }
}

fn gather(plane: &[f32], tile: &Tile) -> Plane {
    let mut out = Plane::filled(0.0);
    for (y, row) in out.chunks_exact_mut(TILE).enumerate() {
        row.copy_from_slice(&plane[tile.row(y)..tile.row(y) + TILE]);
    }
    out
}
