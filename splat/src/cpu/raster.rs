//! rasterise: the Gaussians of a tile → its pixels, forward and backward.
//! in: `records`, the tile's list (front to back). Pixels are planes whose rows are padded to whole tiles.
//!
//! `C = Σ T_i α_i c_i + T background`, `T_i = Π_{j<i} (1 − α_j)` (Kerbl et al. 2023, eq. 3). SIMD across the pixels of
//! a row; inside a tile only the columns and rows of the Gaussian's box are visited.

use super::bin::TILE;
use super::project::{LOG2_255, Record};
use super::simd::{Simd, array, simd_kernel};

/// Pixels of a tile.
pub const PIXELS: usize = TILE * TILE;
/// Alpha never exceeds this.
pub const MAX_ALPHA: f32 = 0.99;
/// A pixel is finished when its transmittance would fall below this.
pub const MIN_TRANSMITTANCE: f32 = 1e-4;
/// Sums that backward keeps of each Gaussian–tile pair, see [`Backward::sums`].
pub const SUMS: usize = 12;

/// Where a tile lies in padded planes.
#[derive(Clone, Copy, Debug)]
pub struct Tile {
    /// First pixel, x.
    pub x: usize,
    /// First pixel, y.
    pub y: usize,
    /// Pixels that belong to the image.
    pub width: usize,
    /// Rows that belong to the image.
    pub height: usize,
    /// Pixels from one row of the plane to the next.
    pub stride: usize,
}

impl Tile {
    /// Offset of row `y` of the tile in a plane.
    pub fn row(&self, y: usize) -> usize {
        (self.y + y) * self.stride + self.x
    }

    /// Transmittance before the first Gaussian: 1, and −1 (finished) outside the image.
    fn start(&self) -> [f32; PIXELS] {
        std::array::from_fn(|i| if i % TILE < self.width && i / TILE < self.height { 1.0 } else { -1.0 })
    }
}

/// Pixels of a tile whose centres lie in `low ..= high` (relative to the tile's first pixel corner), half-open.
#[inline(always)]
fn pixels(low: f32, high: f32) -> [usize; 2] {
    // Truncation is the floor of what is not negative; 0.51 instead of 0.5 keeps pixels on the rim.
    // NaN becomes 0, so that the cast is always within range.
    let clamp = |v: f32| unsafe { least(most(v, 0.0), TILE as f32).to_int_unchecked::<i32>() as usize };
    [clamp(low + 0.49), clamp(high + 0.51)]
}

/// The larger; `b` where either is NaN. One instruction, unlike `f32::max`.
#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller; `b` where either is NaN. One instruction, unlike `f32::min`.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Columns of vectors that the Gaussian's box covers, half-open.
#[inline(always)]
fn columns<S: Simd>(g: &Record, tile: &Tile) -> [usize; 2] {
    let x = g.x - tile.x as f32;
    let [x0, x1] = pixels(x - g.extent_x, x + g.extent_x);
    [x0 / S::LANES, x1.div_ceil(S::LANES)]
}

/// Rows that the ellipse covers within the column of vectors at `x`, half-open: between the lowest and the highest
/// point of the part of the ellipse above the column.
#[inline(always)]
fn rows<S: Simd>(g: &Record, tile: &Tile, x: usize) -> [usize; 2] {
    // Offsets here are pixel − centre; the ellipse's lowest and highest points lie at ± tilt.
    let left = (tile.x + x) as f32 + 0.5 - g.x;
    let right = left + (S::LANES - 1) as f32;
    let clamp = |dx: f32| least(most(dx, left), right);
    let (high_x, low_x) = (clamp(-g.tilt), clamp(g.tilt));
    let (high, low) = (g.chord - g.bend * high_x * high_x, g.chord - g.bend * low_x * low_x);
    let root = |v: f32| most(v, 0.0).sqrt();
    let y = g.y - tile.y as f32;
    pixels(y - g.slope * low_x - root(low), y - g.slope * high_x + root(high))
}

/// Exponents of a Gaussian along a column of vectors: `power = dy (dy half_yy + dx xy) + dx² half_xx`.
struct Column<S: Simd> {
    dx: S,
    square: S,
    linear: S,
}

impl<S: Simd> Column<S> {
    #[inline(always)]
    fn new(g: &Record, x: usize) -> Self {
        let dx = S::splat(g.x - x as f32 - 0.5).sub(S::iota());
        Self { dx, square: dx.mul(dx).mul(S::splat(g.half_xx)), linear: dx.mul(S::splat(g.xy)) }
    }

    /// `power` of row offset `dy`, with `half_yy_dy = half_yy · dy`.
    #[inline(always)]
    fn power(&self, dy: f32, half_yy_dy: f32) -> S {
        self.linear.add(S::splat(half_yy_dy)).fma(S::splat(dy), self.square)
    }
}

/// Arguments of [`forward`].
pub struct Forward<'a> {
    /// Of all Gaussians.
    pub records: &'a [Record],
    /// The tile's Gaussians, front to back.
    pub list: &'a [u32],
    /// The tile.
    pub tile: Tile,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Out: \[3\] planes of the colour, composed over the background, the tile's 256 pixels row by row.
    pub rgb: &'a mut [[f32; PIXELS]; 3],
    /// Out: transmittance.
    pub transmittance: &'a mut [f32; PIXELS],
    /// Out: `Σ T α z`, if asked for.
    pub depth: Option<&'a mut [f32; PIXELS]>,
    /// Out: how many of the list were looked at before all pixels were finished.
    pub used: usize,
}

#[inline(always)]
fn forward_generic<S: Simd>(a: &mut Forward) {
    *a.transmittance = a.tile.start();
    a.rgb.iter_mut().for_each(|plane| plane.fill(0.0));
    match a.depth.take() {
        Some(depth) => {
            depth.fill(0.0);
            forward_loop::<S, true>(a, depth);
        }
        None => forward_loop::<S, false>(a, &mut [0.0; PIXELS]),
    }
    for i in (0..PIXELS).step_by(S::LANES) {
        unsafe {
            let t = S::load(a.transmittance.as_ptr().add(i)).abs();
            t.store(a.transmittance.as_mut_ptr().add(i));
            for (plane, background) in a.rgb.iter_mut().zip(a.background) {
                let p = plane.as_mut_ptr().add(i);
                t.fma(S::splat(background), S::load(p)).store(p);
            }
        }
    }
}

#[inline(always)]
fn forward_loop<S: Simd, const DEPTH: bool>(a: &mut Forward, depth: &mut [f32; PIXELS]) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA), S::splat(MIN_TRANSMITTANCE));
    let t_plane = a.transmittance.as_mut_ptr();
    let rgb: [*mut f32; 3] = [a.rgb[0].as_mut_ptr(), a.rgb[1].as_mut_ptr(), a.rgb[2].as_mut_ptr()];
    for (index, &i) in a.list.iter().enumerate() {
        if index % 16 == 0 && finished::<S>(a.transmittance) {
            a.used = index;
            return;
        }
        let g = unsafe { a.records.get_unchecked(i as usize) };
        prefetch::<S>(a.records, a.list, index);
        let [x0, x1] = columns::<S>(g, &a.tile);
        let (log2_opacity, threshold) = (S::splat(g.log2_opacity), S::splat(-LOG2_255));
        let colours = array!(c in 3 => S::splat(g.rgb[c]));
        for column in x0..x1 {
            let x = column * S::LANES;
            let [y0, y1] = rows::<S>(g, &a.tile, x);
            let power = Column::<S>::new(g, a.tile.x + x);
            for y in y0..y1 {
                // All offsets stay inside the arrays of 256: x + LANES ≤ 16, y < 16.
                let at = y * TILE + x;
                unsafe {
                    let dy = g.y - (a.tile.y + y) as f32 - 0.5;
                    let p = power.power(dy, g.half_yy * dy);
                    let exponent = log2_opacity.sub(p);
                    let t = S::load(t_plane.add(at));
                    let valid = S::and(S::and(p.ge(zero), exponent.ge(threshold)), t.ge(zero));
                    if !S::any(valid) {
                        continue;
                    }
                    let alpha = exponent.exp2().min(max_alpha);
                    let next = t.mul(one.sub(alpha));
                    let drawn = S::and(valid, next.ge(min_t));
                    let weight = t.mul(alpha).keep(drawn);
                    for (plane, colour) in rgb.iter().zip(colours) {
                        let c = plane.add(at);
                        weight.fma(colour, S::load(c)).store(c);
                    }
                    if DEPTH {
                        let d = depth.as_mut_ptr().add(at);
                        weight.fma(S::splat(g.depth), S::load(d)).store(d);
                    }
                    // Finished pixels keep their transmittance with the sign turned.
                    let stopped = S::select(valid, zero.sub(t), t);
                    S::select(drawn, next, stopped).store(t_plane.add(at));
                }
            }
        }
    }
    a.used = a.list.len();
}

/// Arguments of [`visit`].
pub struct Visit<'a> {
    /// Of all Gaussians.
    pub records: &'a [Record],
    /// What forward looked at of the tile's list.
    pub list: &'a [u32],
    /// The tile.
    pub tile: Tile,
    /// Out: pixels (lanes of vectors) that [`forward`] evaluates for them.
    pub pixels: u64,
}

#[inline(always)]
fn visit_generic<S: Simd>(a: &mut Visit) {
    for &i in a.list {
        let g = &a.records[i as usize];
        let [x0, x1] = columns::<S>(g, &a.tile);
        for column in x0..x1 {
            let [y0, y1] = rows::<S>(g, &a.tile, column * S::LANES);
            a.pixels += (y1.saturating_sub(y0) * S::LANES) as u64;
        }
    }
}

simd_kernel!(
    /// Counts the work of a tile.
    pub fn visit(arguments: &mut Visit) = visit_generic
);

/// Fetches the record that comes a few places after `index`: records lie in no order of the tile's.
#[inline(always)]
fn prefetch<S: Simd>(records: &[Record], list: &[u32], index: usize) {
    const AHEAD: usize = 6;
    if let Some(&next) = list.get(index + AHEAD) {
        S::prefetch(unsafe { records.as_ptr().add(next as usize) }.cast());
    }
}

/// Whether all pixels are finished.
#[inline(always)]
fn finished<S: Simd>(t: &[f32; PIXELS]) -> bool {
    let mut most = S::splat(-1.0);
    for i in (0..PIXELS).step_by(S::LANES) {
        most = most.max(unsafe { S::load(t.as_ptr().add(i)) });
    }
    !S::any(most.ge(S::splat(0.0)))
}

simd_kernel!(
    /// Renders a tile.
    pub fn forward(arguments: &mut Forward) = forward_generic
);

/// Arguments of [`backward`].
pub struct Backward<'a> {
    /// Of all Gaussians.
    pub records: &'a [Record],
    /// What forward looked at of the tile's list.
    pub list: &'a [u32],
    /// The tile.
    pub tile: Tile,
    /// dL/dC, \[3\] planes.
    pub gradient: &'a [[f32; PIXELS]; 3],
    /// `Σ_channels C · dL/dC` of the finished picture (background included).
    pub remaining: &'a mut [f32; PIXELS],
    /// Out, for each of `list`: with `v = α dL/dα`, `d` = centre − pixel:
    /// Σ v, Σ v dx, Σ v dy, Σ v dx², Σ v dx dy, Σ v dy², Σ T α dL/dC (3), Σ T α, Σ |v (conic d)| by component (2).
    pub sums: &'a mut [[f32; SUMS]],
    /// Whether the last two are wanted; they are 0 otherwise.
    pub magnitudes: bool,
}

#[inline(always)]
fn backward_generic<S: Simd>(a: &mut Backward) {
    if a.magnitudes { backward_loop::<S, true>(a) } else { backward_loop::<S, false>(a) }
}

#[inline(always)]
fn backward_loop<S: Simd, const MAGNITUDES: bool>(a: &mut Backward) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA), S::splat(MIN_TRANSMITTANCE));
    let mut transmittance = a.tile.start();
    let t_plane = transmittance.as_mut_ptr();
    let rest = a.remaining.as_mut_ptr();
    let grad: [*const f32; 3] = [a.gradient[0].as_ptr(), a.gradient[1].as_ptr(), a.gradient[2].as_ptr()];
    for (index, (&i, sums)) in a.list.iter().zip(a.sums.iter_mut()).enumerate() {
        let g = unsafe { a.records.get_unchecked(i as usize) };
        prefetch::<S>(a.records, a.list, index);
        let [x0, x1] = columns::<S>(g, &a.tile);
        let (log2_opacity, threshold) = (S::splat(g.log2_opacity), S::splat(-LOG2_255));
        let rgb = array!(c in 3 => S::splat(g.rgb[c]));
        let mut total = [zero; SUMS];
        for column in x0..x1 {
            let x = column * S::LANES;
            let [y0, y1] = rows::<S>(g, &a.tile, x);
            let power = Column::<S>::new(g, a.tile.x + x);
            let (mut v0, mut v1, mut v2) = (zero, zero, zero);
            let slope = power.dx.mul(S::splat(2.0 * g.half_xx));
            for y in y0..y1 {
                let at = y * TILE + x;
                unsafe {
                    let dy = g.y - (a.tile.y + y) as f32 - 0.5;
                    let p = power.power(dy, g.half_yy * dy);
                    let exponent = log2_opacity.sub(p);
                    let t = S::load(t_plane.add(at));
                    let valid = S::and(S::and(p.ge(zero), exponent.ge(threshold)), t.ge(zero));
                    if !S::any(valid) {
                        continue;
                    }
                    let raw = exponent.exp2();
                    let alpha = raw.min(max_alpha);
                    let clear = one.sub(alpha);
                    let next = t.mul(clear);
                    let drawn = S::and(valid, next.ge(min_t));
                    let weight = t.mul(alpha).keep(drawn);
                    let gradient =
                        [S::load(grad[0].add(at)), S::load(grad[1].add(at)), S::load(grad[2].add(at))];
                    for c in 0..3 {
                        total[6 + c] = weight.fma(gradient[c], total[6 + c]);
                    }
                    total[9] = total[9].add(weight);
                    let own = gradient[0].fma(rgb[0], gradient[1].fma(rgb[1], gradient[2].mul(rgb[2])));
                    let behind = weight.fnma(own, S::load(rest.add(at)));
                    behind.store(rest.add(at));
                    // α dL/dα = α (T c·g − behind / (1 − α)); zero where alpha is limited.
                    let v = weight.mul(own).sub(alpha.mul(behind).div(clear));
                    let v = v.keep(S::and(drawn, raw.lt(max_alpha)));
                    let vdy = v.mul(S::splat(dy));
                    v0 = v0.add(v);
                    v1 = v1.add(vdy);
                    v2 = vdy.fma(S::splat(dy), v2);
                    if MAGNITUDES {
                        let size = v.abs();
                        let across = slope.add(S::splat(g.xy * dy)).abs();
                        let down = power.linear.add(S::splat(2.0 * g.half_yy * dy)).abs();
                        total[10] = size.fma(across, total[10]);
                        total[11] = size.fma(down, total[11]);
                    }
                    let stopped = S::select(valid, zero.sub(t), t);
                    S::select(drawn, next, stopped).store(t_plane.add(at));
                }
            }
            let dx = power.dx;
            let vdx = v0.mul(dx);
            total[0] = total[0].add(v0);
            total[1] = total[1].add(vdx);
            total[2] = total[2].add(v1);
            total[3] = vdx.fma(dx, total[3]);
            total[4] = v1.fma(dx, total[4]);
            total[5] = total[5].add(v2);
        }
        for (sum, total) in sums.iter_mut().zip(total) {
            *sum = total.sum();
        }
    }
}

simd_kernel!(
    /// Gradients of a tile, replayed front to back.
    pub fn backward(arguments: &mut Backward) = backward_generic
);
