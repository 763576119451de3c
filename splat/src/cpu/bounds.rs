//! Which pixels of a tile Gaussians cover, worked out before any of them is drawn and for several
//! at once: how many rows a Gaussian has cannot be foreseen, and a processor that guesses it
//! wrongly should find all it needs for the next one.

use super::project::Record;
use super::simd::{Simd, array};
use super::tile::{ACROSS, PIXELS, STRIPS, TILE, Tile};
use crate::model::LANE_PAD;

/// A number for each Gaussian of a batch.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Lanes([f32; LANE_PAD]);

/// Bounds of a batch. Invariant: every number is at least 0 and at most [`TILE`]; only `fill`
/// writes them.
pub(super) struct Bounds {
    /// Columns of pixels, half-open, as numbers to be truncated.
    left: Lanes,
    right: Lanes,
    /// Rows by strip, likewise.
    top: [Lanes; STRIPS],
    bottom: [Lanes; STRIPS],
}

impl Bounds {
    pub(super) fn new() -> Self {
        let zero = Lanes([0.0; LANE_PAD]);
        Self { left: zero, right: zero, top: [zero; STRIPS], bottom: [zero; STRIPS] }
    }

    /// Works out the bounds of up to [`LANE_PAD`] of a tile's Gaussians.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(&mut self, records: &[Record], list: &[u32], tile: &Tile) {
        // x, y, extent, tilt, chord, bend, slope
        let mut shapes = [Lanes([0.0; LANE_PAD]); 7];
        for (k, &i) in list.iter().take(LANE_PAD).enumerate() {
            let g = &records[i as usize];
            let (x, y) = (g.x - tile.x as f32, g.y - tile.y as f32);
            for (to, from) in shapes.iter_mut().zip([x, y, g.extent_x, g.tilt, g.chord, g.bend, g.slope]) {
                to.0[k] = from;
            }
        }
        for at in (0..LANE_PAD).step_by(S::LANES) {
            let [x, y, extent, tilt, chord, bend, slope] = array!(f in 7 => S::read(&shapes[f].0[at..]));
            first_pixel(x.sub(extent)).write(&mut self.left.0[at..]);
            last_pixel(x.add(extent)).write(&mut self.right.0[at..]);
            // Rows that the ellipse covers within a strip: between the lowest and the highest point
            // of the part of the ellipse above the strip. Offsets are pixel − centre; the whole
            // ellipse's lie at ± tilt.
            let zero = S::splat(0.0);
            for strip in 0..STRIPS {
                let left = S::splat((strip * ACROSS) as f32 + 0.5).sub(x);
                let right = left.add(S::splat((ACROSS - 1) as f32));
                let (high_x, low_x) = (zero.sub(tilt).max(left).min(right), tilt.max(left).min(right));
                let low = slope.fnma(low_x, y).sub(half_chord(chord, bend, low_x));
                let high = slope.fnma(high_x, y).add(half_chord(chord, bend, high_x));
                first_pixel(low).write(&mut self.top[strip].0[at..]);
                last_pixel(high).write(&mut self.bottom[strip].0[at..]);
            }
        }
    }

    /// Vectors of a tile's pixels that Gaussian `k` of the batch reaches: bit b is that from pixel
    /// `b · LANES` of a [`super::tile::TilePlane`] on.
    #[inline(always)]
    pub(super) fn blocks<S: Simd>(&self, k: usize) -> u64 {
        let rows = S::LANES / ACROSS;
        let of_strip = TILE / rows;
        // SAFETY: every bound is at least 0 and at most TILE.
        let [left, right] = unsafe { [truncated(self.left.0[k]), truncated(self.right.0[k])] };
        let mut blocks = 0;
        for strip in left / ACROSS..right.div_ceil(ACROSS) {
            // SAFETY: every bound is at least 0 and at most TILE.
            let [top, bottom] =
                unsafe { [truncated(self.top[strip].0[k]), truncated(self.bottom[strip].0[k])] };
            let (first, end) = (top / rows, bottom.div_ceil(rows));
            let reached = (1u64 << end.max(first)) - (1u64 << first);
            blocks |= reached << (strip * of_strip);
        }
        blocks
    }
}

/// All vectors of a tile, as [`Bounds::blocks`].
#[inline(always)]
pub(super) fn all_blocks<S: Simd>() -> u64 {
    u64::MAX >> (u64::BITS as usize - PIXELS / S::LANES)
}

/// Half the ellipse's height at an offset.
#[inline(always)]
fn half_chord<S: Simd>(chord: S, bend: S, dx: S) -> S {
    bend.mul(dx).fnma(dx, chord).max(S::splat(0.0)).sqrt()
}

/// The first pixel whose centre lies at `edge` (relative to the tile's first pixel corner) or
/// behind it, to be truncated.
#[inline(always)]
fn first_pixel<S: Simd>(edge: S) -> S {
    // 0.51 and 0.49 instead of 0.5 keep pixels on the rim. NaN becomes 0.
    edge.add(S::splat(0.49)).max(S::splat(0.0)).min(S::splat(TILE as f32))
}

/// One behind the last pixel whose centre lies at `edge` or before it, to be truncated.
#[inline(always)]
fn last_pixel<S: Simd>(edge: S) -> S {
    edge.add(S::splat(0.51)).max(S::splat(0.0)).min(S::splat(TILE as f32))
}

/// # Safety
/// `v` is at least 0 and at most 2^31 − 1.
#[inline(always)]
unsafe fn truncated(v: f32) -> usize {
    // SAFETY: the caller vouches that it fits.
    unsafe { v.to_int_unchecked::<i32>() as usize }
}

#[cfg(test)]
mod tests {
    use super::super::dispatch::{Isa, simd_kernel};
    use super::*;

    struct Extreme {
        records: Vec<Record>,
        outside: usize,
        most: u32,
    }

    #[inline(always)]
    fn extreme_generic<S: Simd>(a: &mut Extreme) {
        let tile = Tile { x: 16, y: 32, width: 16, height: 16, stride: 64 };
        let mut bounds = Bounds::new();
        for i in 0..a.records.len() as u32 {
            bounds.fill::<S>(&a.records, &[i], &tile);
            let blocks = bounds.blocks::<S>(0);
            a.outside += usize::from(blocks & !all_blocks::<S>() != 0);
            a.most = a.most.max((blocks & all_blocks::<S>()).count_ones() * S::LANES as u32);
        }
    }
    simd_kernel!(fn extreme(arguments: &mut Extreme) = extreme_generic);

    #[test]
    fn bounds_of_any_numbers_lie_within_the_tile() {
        let numbers = [0.0, -1.0, 1e30, -1e30, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 20.0];
        let any = |k: usize| numbers[k % numbers.len()];
        let record = |k: usize| Record {
            x: any(k),
            y: any(k / 8),
            extent_x: any(k / 64),
            tilt: any(k / 3),
            chord: any(k / 5),
            bend: any(k / 7),
            slope: any(k / 11),
            ..Record::default()
        };
        // Miri is a thousand times slower.
        let some = if cfg!(miri) { 61 } else { 1 };
        let records: Vec<Record> = (0..4096).step_by(some).map(record).collect();
        for isa in Isa::available() {
            let mut a = Extreme { records: records.clone(), outside: 0, most: 0 };
            extreme(isa, &mut a);
            assert_eq!((a.outside, a.most), (0, PIXELS as u32), "{isa:?}");
        }
    }

    #[test]
    #[should_panic(expected = "index out of bounds")]
    fn a_gaussian_that_is_not_there_is_not_read() {
        let tile = Tile { x: 0, y: 0, width: 16, height: 16, stride: 16 };
        Bounds::new().fill::<super::super::simd_portable::Portable>(&[Record::default()], &[1], &tile);
    }
}
