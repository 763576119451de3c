//! rasterise: the Gaussians of a tile → its pixels, forward and backward.
//! in: `records`, the tile's list (front to back). Pixels are planes whose rows are padded to whole
//! tiles.
//!
//! `C = Σ T_i α_i c_i + T background`, `T_i = Π_{j<i} (1 − α_j)` (Kerbl et al. 2023, eq. 3). SIMD
//! across blocks of pixels; inside a tile only the blocks are visited that the Gaussian's ellipse
//! reaches and that are not finished.

use super::bounds::{Bounds, all_blocks};
use super::dispatch::simd_kernel;
use super::project::{LOG2_255, Record};
use super::simd::{Simd, array};
use super::tile::{CENTRES, PIXELS, Tile, TilePlane};
use crate::model::LANE_PAD;
use crate::reference::constants::{MAX_ALPHA, MIN_TRANSMITTANCE};

/// Sums that backward keeps of each Gaussian–tile pair: with `v = α dL/dα`, `d` = centre − pixel:
/// Σ v, Σ v dx, Σ v dy, Σ v dx², Σ v dx dy, Σ v dy², Σ T α dL/dC (3), Σ T α. Source: derived.
pub(super) const SUMS: usize = 10;

/// A Gaussian's ellipse over a tile.
struct Ellipse<S: Simd> {
    x: S,
    y: S,
    half_xx: S,
    xy: S,
    half_yy: S,
}

impl<S: Simd> Ellipse<S> {
    #[inline(always)]
    fn new(g: &Record, tile: &Tile) -> Self {
        Self {
            x: S::splat(g.x - tile.x as f32),
            y: S::splat(g.y - tile.y as f32),
            half_xx: S::splat(g.half_xx),
            xy: S::splat(g.xy),
            half_yy: S::splat(g.half_yy),
        }
    }

    /// Centre − pixel of the vector of pixels from `at` on.
    #[inline(always)]
    fn offset(&self, at: usize) -> [S; 2] {
        [self.x.sub(CENTRES[0].get(at)), self.y.sub(CENTRES[1].get(at))]
    }

    /// Its exponent there, `dy (dy half_yy + dx xy) + dx² half_xx`.
    #[inline(always)]
    fn power(&self, [dx, dy]: [S; 2]) -> S {
        dy.fma(self.half_yy, dx.mul(self.xy)).fma(dy, dx.mul(dx).mul(self.half_xx))
    }
}

/// Arguments of [`forward`].
pub(super) struct Forward<'a> {
    /// Of all Gaussians.
    pub(super) records: &'a [Record],
    /// The tile's Gaussians, front to back.
    pub(super) list: &'a [u32],
    /// The tile.
    pub(super) tile: Tile,
    /// Colour behind everything.
    pub(super) background: [f32; 3],
    /// Out: \[3\] planes of the colour, composed over the background, the tile's 256 pixels row by
    /// row.
    pub(super) rgb: &'a mut [TilePlane; 3],
    /// Out: transmittance.
    pub(super) transmittance: &'a mut TilePlane,
    /// Out: `Σ T α z`, if asked for.
    pub(super) depth: Option<&'a mut TilePlane>,
    /// Out: how many of the list were looked at before all pixels were finished.
    pub(super) used: usize,
}

#[inline(always)]
fn forward_generic<S: Simd>(a: &mut Forward) {
    *a.transmittance = a.tile.start();
    a.rgb.fill(TilePlane::filled(0.0));
    match a.depth.take() {
        Some(depth) => {
            *depth = TilePlane::filled(0.0);
            forward_loop::<S, true>(a, depth);
        }
        None => forward_loop::<S, false>(a, &mut TilePlane::filled(0.0)),
    }
    for i in (0..PIXELS).step_by(S::LANES) {
        let t = a.transmittance.get::<S>(i).abs();
        a.transmittance.set(i, t);
        for (plane, background) in a.rgb.iter_mut().zip(a.background) {
            plane.set(i, t.fma(S::splat(background), plane.get(i)));
        }
    }
}

#[inline(always)]
fn forward_loop<S: Simd, const DEPTH: bool>(a: &mut Forward, depth: &mut TilePlane) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA as f32), S::splat(MIN_TRANSMITTANCE as f32));
    let threshold = S::splat(-LOG2_255);
    // Locals, because a store may not change where they lie.
    let (records, all, tile) = (a.records, a.list, a.tile);
    let (rgb, transmittance) = (&mut *a.rgb, &mut *a.transmittance);
    let mut bounds = Bounds::new();
    let mut open = all_blocks::<S>();
    for (index, list) in all.chunks(LANE_PAD).enumerate() {
        if open == 0 {
            a.used = index * LANE_PAD;
            return;
        }
        prefetch::<S>(records, all, (index + 1) * LANE_PAD);
        bounds.fill::<S>(records, list, &tile);
        for (k, &i) in list.iter().enumerate() {
            let mut blocks = bounds.blocks::<S>(k) & open;
            let g = &records[i as usize];
            let log2_opacity = S::splat(g.log2_opacity);
            let colours = array!(c in 3 => S::splat(g.rgb[c]));
            let ellipse = Ellipse::<S>::new(g, &tile);
            while blocks != 0 {
                let at = blocks.trailing_zeros() as usize * S::LANES;
                let block = blocks & blocks.wrapping_neg();
                blocks ^= block;
                let t = transmittance.get::<S>(at);
                let unfinished = t.ge(zero);
                if !S::any(unfinished) {
                    open ^= block;
                    continue;
                }
                let p = ellipse.power(ellipse.offset(at));
                let exponent = log2_opacity.sub(p);
                let valid = S::and(S::and(p.ge(zero), exponent.ge(threshold)), unfinished);
                let alpha = exponent.exp2().min(max_alpha);
                let next = t.mul(one.sub(alpha));
                let drawn = S::and(valid, next.ge(min_t));
                let weight = t.mul(alpha).keep(drawn);
                for (plane, colour) in rgb.iter_mut().zip(colours) {
                    plane.set(at, weight.fma(colour, plane.get(at)));
                }
                if DEPTH {
                    depth.set(at, weight.fma(S::splat(g.depth), depth.get(at)));
                }
                // Finished pixels keep their transmittance with the sign turned.
                let stopped = S::select(valid, zero.sub(t), t);
                transmittance.set(at, S::select(drawn, next, stopped));
            }
        }
    }
    a.used = all.len();
}

/// Arguments of [`visit`].
pub(super) struct Visit<'a> {
    /// Of all Gaussians.
    pub(super) records: &'a [Record],
    /// What forward looked at of the tile's list.
    pub(super) list: &'a [u32],
    /// The tile.
    pub(super) tile: Tile,
    /// Out: pixels (lanes of vectors) that [`forward`] evaluates for them.
    pub(super) pixels: u64,
}

#[inline(always)]
fn visit_generic<S: Simd>(a: &mut Visit) {
    let mut bounds = Bounds::new();
    for list in a.list.chunks(LANE_PAD) {
        bounds.fill::<S>(a.records, list, &a.tile);
        for k in 0..list.len() {
            a.pixels += u64::from(bounds.blocks::<S>(k).count_ones()) * S::LANES as u64;
        }
    }
}

simd_kernel!(
    /// Counts the work of a tile.
    pub(super) fn visit(arguments: &mut Visit) = visit_generic
);

/// Fetches the records of the batch that begins at `index`: records lie in no order of the tile's.
#[inline(always)]
fn prefetch<S: Simd>(records: &[Record], list: &[u32], index: usize) {
    for &next in list.iter().skip(index).take(LANE_PAD) {
        S::prefetch(records.as_ptr().wrapping_add(next as usize).cast());
    }
}

simd_kernel!(
    /// Renders a tile.
    pub(super) fn forward(arguments: &mut Forward) = forward_generic
);

/// Arguments of [`backward`].
pub(super) struct Backward<'a> {
    /// Of all Gaussians.
    pub(super) records: &'a [Record],
    /// What forward looked at of the tile's list.
    pub(super) list: &'a [u32],
    /// The tile.
    pub(super) tile: Tile,
    /// dL/dC, \[3\] planes.
    pub(super) gradient: &'a [TilePlane; 3],
    /// `Σ_channels C · dL/dC` of the finished picture (background included).
    pub(super) remaining: &'a mut TilePlane,
    /// Out, for each of `list`.
    pub(super) sums: &'a mut [[f32; SUMS]],
}

#[inline(always)]
fn backward_generic<S: Simd>(a: &mut Backward) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA as f32), S::splat(MIN_TRANSMITTANCE as f32));
    // Locals, because a store may not change where they lie.
    let (records, all, tile, gradients) = (a.records, a.list, a.tile, a.gradient);
    let remaining = &mut *a.remaining;
    let mut transmittance = tile.start();
    let threshold = S::splat(-LOG2_255);
    let mut bounds = Bounds::new();
    let mut open = all_blocks::<S>();
    for (index, (list, sums)) in all.chunks(LANE_PAD).zip(a.sums.chunks_mut(LANE_PAD)).enumerate() {
        prefetch::<S>(records, all, (index + 1) * LANE_PAD);
        bounds.fill::<S>(records, list, &tile);
        for (k, (&i, sums)) in list.iter().zip(sums).enumerate() {
            let mut blocks = bounds.blocks::<S>(k) & open;
            let g = &records[i as usize];
            let log2_opacity = S::splat(g.log2_opacity);
            let rgb = array!(c in 3 => S::splat(g.rgb[c]));
            let ellipse = Ellipse::<S>::new(g, &tile);
            let mut total = [zero; SUMS];
            while blocks != 0 {
                let at = blocks.trailing_zeros() as usize * S::LANES;
                let block = blocks & blocks.wrapping_neg();
                blocks ^= block;
                let t = transmittance.get::<S>(at);
                let unfinished = t.ge(zero);
                if !S::any(unfinished) {
                    open ^= block;
                    continue;
                }
                let [dx, dy] = ellipse.offset(at);
                let p = ellipse.power([dx, dy]);
                let exponent = log2_opacity.sub(p);
                let valid = S::and(S::and(p.ge(zero), exponent.ge(threshold)), unfinished);
                let raw = exponent.exp2();
                let alpha = raw.min(max_alpha);
                let clear = one.sub(alpha);
                let next = t.mul(clear);
                let drawn = S::and(valid, next.ge(min_t));
                let weight = t.mul(alpha).keep(drawn);
                let gradient = array!(c in 3 => gradients[c].get::<S>(at));
                for c in 0..3 {
                    total[6 + c] = weight.fma(gradient[c], total[6 + c]);
                }
                total[9] = total[9].add(weight);
                let own = gradient[0].fma(rgb[0], gradient[1].fma(rgb[1], gradient[2].mul(rgb[2])));
                let behind = weight.fnma(own, remaining.get(at));
                remaining.set(at, behind);
                // α dL/dα = α (T c·g − behind / (1 − α)); zero where alpha is limited.
                let v = weight.mul(own).sub(alpha.mul(behind).mul(clear.reciprocal()));
                let v = v.keep(S::and(drawn, raw.lt(max_alpha)));
                let (vdx, vdy) = (v.mul(dx), v.mul(dy));
                total[0] = total[0].add(v);
                total[1] = total[1].add(vdx);
                total[2] = total[2].add(vdy);
                total[3] = vdx.fma(dx, total[3]);
                total[4] = vdx.fma(dy, total[4]);
                total[5] = vdy.fma(dy, total[5]);
                let stopped = S::select(valid, zero.sub(t), t);
                transmittance.set(at, S::select(drawn, next, stopped));
            }
            for (sum, total) in sums.iter_mut().zip(total) {
                *sum = total.sum();
            }
        }
    }
}

simd_kernel!(
    /// Gradients of a tile, replayed front to back.
    pub(super) fn backward(arguments: &mut Backward) = backward_generic
);
