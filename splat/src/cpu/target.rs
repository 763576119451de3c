//! Target planes (and weights) from 8-bit pixels, composed over the background where masks mean
//! transparency.
//! in: interleaved bytes, optional mask, the rendering. out: \[3\] planes and one of weights, rows
//! padded to whole tiles.

use super::dispatch::{Isa, simd_kernel};
use super::loss::BAND;
use super::simd::Simd;
use super::tile::{PlaneShape, TILE};
use crate::backend::Target;
use rayon::prelude::*;
use scene::metrics::SSIM_REACH;

/// A level of 8 bits. Source: derived.
const BYTE: f32 = 1.0 / 255.0;

/// What the planes are made of.
pub(super) struct TargetSource<'a> {
    /// Size of the planes.
    pub(super) shape: PlaneShape,
    /// The pixels.
    pub(super) target: &'a Target<'a>,
    /// What lies behind transparent pixels.
    pub(super) background: [f32; 3],
    /// Colours are divided by this.
    pub(super) gain: Option<[f32; 3]>,
}

/// Fills `planes`, and `weight` if the mask means weights (a pixel of weight 0 equals its rendering
/// in `rgb`, so that its neighbours' SSIM does not see it).
pub(super) fn compose(
    isa: Isa,
    source: &TargetSource,
    rgb: &[Vec<f32>; 3],
    planes: &mut [Vec<f32>; 3],
    weight: &mut [f32],
) {
    let shape = source.shape;
    let bands = shape.height.div_ceil(BAND);
    let weighted = source.target.mask.is_some() && !source.target.transparent;
    planes
        .par_iter_mut()
        .enumerate()
        .flat_map(|(channel, plane)| {
            let parts = plane.par_chunks_mut(shape.stride() * BAND).take(bands).enumerate();
            parts.map(move |(b, out)| (channel, b * BAND, out))
        })
        .for_each(|(channel, y0, out)| {
            let rendered = weighted.then_some(rgb[channel].as_slice());
            compose_rows(isa, &mut TargetRows { source, channel, y0, rendered, out });
        });
    if let Some(mask) = source.target.mask.filter(|_| weighted) {
        for (out, mask) in weight.chunks_exact_mut(shape.stride()).zip(mask.chunks_exact(shape.width)) {
            for (out, &m) in out.iter_mut().zip(mask) {
                *out = f32::from(m) * BYTE;
            }
        }
    }
}

/// `BAND` rows of one channel.
struct TargetRows<'a> {
    source: &'a TargetSource<'a>,
    channel: usize,
    y0: usize,
    /// The rendering, if masks are weights.
    rendered: Option<&'a [f32]>,
    out: &'a mut [f32],
}

simd_kernel!(fn compose_rows(arguments: &mut TargetRows) = compose_generic);

/// Plain loops, which the compiler makes vectors of for each instruction set.
#[inline(always)]
#[allow(clippy::extra_unused_type_parameters)] // it stands for the instruction set that this is compiled for
fn compose_generic<S: Simd>(a: &mut TargetRows) {
    let (shape, target) = (a.source.shape, a.source.target);
    let (width, stride) = (shape.width, shape.stride());
    let unit = a.source.gain.map_or(BYTE, |gain| BYTE / gain[a.channel]);
    let behind = a.source.background[a.channel];
    let rows = (a.y0..shape.height).zip(a.out.chunks_exact_mut(stride));
    for (y, out) in rows {
        let out = &mut out[..width];
        let (bytes, _) = target.rgb[y * width * 3..(y + 1) * width * 3].as_chunks::<3>();
        let Some(mask) = target.mask else {
            for (out, pixel) in out.iter_mut().zip(bytes) {
                *out = f32::from(pixel[a.channel]) * unit;
            }
            continue;
        };
        let mask = &mask[y * width..(y + 1) * width];
        if let Some(rendered) = a.rendered {
            let rendered = &rendered[y * stride..y * stride + width];
            for (((out, pixel), &m), &behind) in out.iter_mut().zip(bytes).zip(mask).zip(rendered) {
                *out = if m > 0 { f32::from(pixel[a.channel]) * unit } else { behind };
            }
        } else {
            for ((out, pixel), &m) in out.iter_mut().zip(bytes).zip(mask) {
                let value = f32::from(pixel[a.channel]) * unit;
                *out = behind + f32::from(m) * BYTE * (value - behind);
            }
        }
    }
}

/// Which tiles have a pixel that some pixel of weight above 0 sees through the loss's window:
/// nothing else has a gradient. `weights`: [height × width] bytes.
pub(super) fn reached_tiles(weights: &[u8], shape: PlaneShape, reached: &mut Vec<bool>) {
    let (columns, rows) = (shape.stride() / TILE, shape.height.div_ceil(TILE));
    reached.clear();
    reached.resize(columns * rows, false);
    for (y, row) in weights.chunks_exact(shape.width).enumerate() {
        for x in (0..row.len()).filter(|&x| row[x] > 0) {
            for ty in tiles_around(y, shape.height) {
                tiles_around(x, shape.width).for_each(|tx| reached[ty * columns + tx] = true);
            }
        }
    }
}

/// Tiles along a side of `size` pixels that the window at pixel `at` touches.
fn tiles_around(at: usize, size: usize) -> std::ops::RangeInclusive<usize> {
    at.saturating_sub(SSIM_REACH) / TILE..=(at + SSIM_REACH).min(size - 1) / TILE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_is_reached_where_a_weight_is_within_the_window() {
        let shape = PlaneShape { width: 70, height: 40 };
        let mut reached = Vec::new();
        for (x, y) in [(0, 0), (10, 3), (11, 3), (36, 20), (37, 26), (69, 39), (31, 15)] {
            let mut weights = vec![0u8; shape.width * shape.height];
            weights[y * shape.width + x] = 1;
            reached_tiles(&weights, shape, &mut reached);
            assert_eq!(reached.len(), 5 * 3);
            for (t, &found) in reached.iter().enumerate() {
                let tile = shape.tile(t);
                let away = |at: usize, first: usize, size: usize| {
                    first.saturating_sub(at).max((at + 1).saturating_sub(first + size))
                };
                let near =
                    away(x, tile.x, tile.width) <= SSIM_REACH && away(y, tile.y, tile.height) <= SSIM_REACH;
                assert_eq!(found, near, "({x}, {y}) tile {t}");
            }
        }
        reached_tiles(&vec![0; shape.width * shape.height], shape, &mut reached);
        assert!(reached.iter().all(|r| !r));
    }
}
