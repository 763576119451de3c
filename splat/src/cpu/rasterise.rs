//! rasterise: the Gaussians of a tile → its pixels, forward and backward.
//! in: `records`, the tile's list (front to back). Pixels are planes whose rows are padded to whole tiles.
//!
//! `C = Σ T_i α_i c_i + T background`, `T_i = Π_{j<i} (1 − α_j)` (Kerbl et al. 2023, eq. 3). SIMD across the pixels of
//! a row; inside a tile only the columns and rows of the Gaussian's box are visited.

use super::sort::TILE;
use super::project::{LOG2_255, Record};
use super::simd::{Simd, array, simd_kernel};

/// Pixels of a tile.
pub const PIXELS: usize = TILE * TILE;
/// A value for each pixel of a tile, row by row. Aligned, so that no vector lies across two cache lines: those cost twice, and what
/// was just stored comes late to the load that wants it.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub struct Plane(pub [f32; PIXELS]);

impl Plane {
    /// All pixels `value`.
    pub fn filled(value: f32) -> Self {
        Self([value; PIXELS])
    }
}

impl std::ops::Deref for Plane {
    type Target = [f32; PIXELS];

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl std::ops::DerefMut for Plane {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

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
    fn start(&self) -> Plane {
        let inside = |i: usize| i % TILE < self.width && i / TILE < self.height;
        Plane(std::array::from_fn(|i| if inside(i) { 1.0 } else { -1.0 }))
    }
}

/// Gaussians whose bounds are worked out together.
const BATCH: usize = 16;
/// Most columns of vectors of a tile.
const COLUMNS: usize = TILE / 4;

/// A number for each Gaussian of a batch.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Lanes([f32; BATCH]);

/// Which pixels of a tile some Gaussians cover, worked out before any of them is drawn and for several at once: how many rows a
/// Gaussian has cannot be foreseen, and a processor that guesses it wrongly should find all it needs for the next one.
struct Bounds {
    /// Columns of pixels, half-open, as numbers to be truncated.
    left: Lanes,
    right: Lanes,
    /// Rows by column of vectors, likewise.
    top: [Lanes; COLUMNS],
    bottom: [Lanes; COLUMNS],
}

/// What [`Bounds`] need of a [`Record`]: x, y, extent, tilt, chord, bend, slope.
const SHAPE: usize = 7;

impl Bounds {
    fn new() -> Self {
        let zero = Lanes([0.0; BATCH]);
        Self { left: zero, right: zero, top: [zero; COLUMNS], bottom: [zero; COLUMNS] }
    }

    /// Works out the bounds of up to [`BATCH`] of a tile's Gaussians.
    #[inline(always)]
    fn fill<S: Simd>(&mut self, records: &[Record], list: &[u32], tile: &Tile) {
        let mut shapes = [Lanes([0.0; BATCH]); SHAPE];
        for (k, &i) in list.iter().take(BATCH).enumerate() {
            let g = unsafe { records.get_unchecked(i as usize) };
            let (x, y) = (g.x - tile.x as f32, g.y - tile.y as f32);
            for (to, from) in shapes.iter_mut().zip([x, y, g.extent_x, g.tilt, g.chord, g.bend, g.slope]) {
                to.0[k] = from;
            }
        }
        for at in (0..BATCH).step_by(S::LANES) {
            // at + LANES ≤ BATCH
            unsafe {
                let [x, y, extent, tilt, chord, bend, slope] =
                    array!(f in 7 => S::load(shapes[f].0.as_ptr().add(at)));
                first_pixel(x.sub(extent)).store(self.left.0.as_mut_ptr().add(at));
                last_pixel(x.add(extent)).store(self.right.0.as_mut_ptr().add(at));
                // Rows that the ellipse covers within a column of vectors: between the lowest and the highest point of the part
                // of the ellipse above the column. Offsets are pixel − centre; the whole ellipse's lie at ± tilt.
                let zero = S::splat(0.0);
                for column in 0..TILE / S::LANES {
                    let left = S::splat((column * S::LANES) as f32 + 0.5).sub(x);
                    let right = left.add(S::splat((S::LANES - 1) as f32));
                    let (high_x, low_x) = (zero.sub(tilt).max(left).min(right), tilt.max(left).min(right));
                    let low = slope.fnma(low_x, y).sub(half_chord(chord, bend, low_x));
                    let high = slope.fnma(high_x, y).add(half_chord(chord, bend, high_x));
                    first_pixel(low).store(self.top[column].0.as_mut_ptr().add(at));
                    last_pixel(high).store(self.bottom[column].0.as_mut_ptr().add(at));
                }
            }
        }
    }

    /// Columns of vectors that Gaussian `k` of the batch covers, half-open.
    #[inline(always)]
    fn columns<S: Simd>(&self, k: usize) -> [usize; 2] {
        [truncated(self.left.0[k]) / S::LANES, truncated(self.right.0[k]).div_ceil(S::LANES)]
    }

    /// Rows that it covers within a column of vectors, half-open.
    #[inline(always)]
    fn rows(&self, k: usize, column: usize) -> [usize; 2] {
        [truncated(self.top[column].0[k]), truncated(self.bottom[column].0[k])]
    }
}

/// Half the ellipse's height at an offset.
#[inline(always)]
fn half_chord<S: Simd>(chord: S, bend: S, dx: S) -> S {
    bend.mul(dx).fnma(dx, chord).max(S::splat(0.0)).sqrt()
}

/// The first pixel whose centre lies at `edge` (relative to the tile's first pixel corner) or behind it, to be truncated.
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

#[inline(always)]
fn truncated(v: f32) -> usize {
    // Limited to 0 ..= TILE by `first_pixel` and `last_pixel`.
    unsafe { v.to_int_unchecked::<i32>() as usize }
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
    pub rgb: &'a mut [Plane; 3],
    /// Out: transmittance.
    pub transmittance: &'a mut Plane,
    /// Out: `Σ T α z`, if asked for.
    pub depth: Option<&'a mut Plane>,
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
        None => forward_loop::<S, false>(a, &mut Plane::filled(0.0)),
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
fn forward_loop<S: Simd, const DEPTH: bool>(a: &mut Forward, depth: &mut Plane) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA), S::splat(MIN_TRANSMITTANCE));
    let t_plane = a.transmittance.as_mut_ptr();
    let rgb: [*mut f32; 3] = [a.rgb[0].as_mut_ptr(), a.rgb[1].as_mut_ptr(), a.rgb[2].as_mut_ptr()];
    let threshold = S::splat(-LOG2_255);
    let mut bounds = Bounds::new();
    for (index, list) in a.list.chunks(BATCH).enumerate() {
        if finished::<S>(a.transmittance) {
            a.used = index * BATCH;
            return;
        }
        prefetch::<S>(a.records, a.list, (index + 1) * BATCH);
        bounds.fill::<S>(a.records, list, &a.tile);
        for (k, &i) in list.iter().enumerate() {
            let g = unsafe { a.records.get_unchecked(i as usize) };
            let log2_opacity = S::splat(g.log2_opacity);
            let colours = array!(c in 3 => S::splat(g.rgb[c]));
            let [x0, x1] = bounds.columns::<S>(k);
            for column in x0..x1 {
                let x = column * S::LANES;
                let [y0, y1] = bounds.rows(k, column);
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
    let mut bounds = Bounds::new();
    for list in a.list.chunks(BATCH) {
        bounds.fill::<S>(a.records, list, &a.tile);
        for k in 0..list.len() {
            let [x0, x1] = bounds.columns::<S>(k);
            for column in x0..x1 {
                let [y0, y1] = bounds.rows(k, column);
                a.pixels += (y1.saturating_sub(y0) * S::LANES) as u64;
            }
        }
    }
}

simd_kernel!(
    /// Counts the work of a tile.
    pub fn visit(arguments: &mut Visit) = visit_generic
);

/// Fetches the records of the batch that begins at `index`: records lie in no order of the tile's.
#[inline(always)]
fn prefetch<S: Simd>(records: &[Record], list: &[u32], index: usize) {
    for &next in list.iter().skip(index).take(BATCH) {
        S::prefetch(unsafe { records.as_ptr().add(next as usize) }.cast());
    }
}

/// Whether all pixels are finished.
#[inline(always)]
fn finished<S: Simd>(t: &Plane) -> bool {
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
    pub gradient: &'a [Plane; 3],
    /// `Σ_channels C · dL/dC` of the finished picture (background included).
    pub remaining: &'a mut Plane,
    /// Out, for each of `list`: with `v = α dL/dα`, `d` = centre − pixel:
    /// Σ v, Σ v dx, Σ v dy, Σ v dx², Σ v dx dy, Σ v dy², Σ T α dL/dC (3), Σ T α, and two that `extra` says.
    pub sums: &'a mut [[f32; SUMS]],
    /// What the last two are.
    pub extra: Extra<'a>,
}

/// What backward sums beside gradients, for densification.
#[derive(Clone, Copy)]
pub enum Extra<'a> {
    /// Nothing: zeros.
    Nothing,
    /// Σ |v (conic d)| by component.
    Magnitudes,
    /// Σ T α e with the error e of each pixel, and 0.
    Error(&'a Plane),
}

/// [`Extra`] for the compiler.
const NOTHING: u8 = 0;
const MAGNITUDES: u8 = 1;
const ERROR: u8 = 2;

#[inline(always)]
fn backward_generic<S: Simd>(a: &mut Backward) {
    match a.extra {
        Extra::Nothing => backward_loop::<S, NOTHING>(a, &Plane::filled(0.0)),
        Extra::Magnitudes => backward_loop::<S, MAGNITUDES>(a, &Plane::filled(0.0)),
        Extra::Error(plane) => backward_loop::<S, ERROR>(a, plane),
    }
}

#[inline(always)]
fn backward_loop<S: Simd, const EXTRA: u8>(a: &mut Backward, error: &Plane) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let (max_alpha, min_t) = (S::splat(MAX_ALPHA), S::splat(MIN_TRANSMITTANCE));
    let mut transmittance = a.tile.start();
    let t_plane = transmittance.as_mut_ptr();
    let rest = a.remaining.as_mut_ptr();
    let grad: [*const f32; 3] = [a.gradient[0].as_ptr(), a.gradient[1].as_ptr(), a.gradient[2].as_ptr()];
    let threshold = S::splat(-LOG2_255);
    let mut bounds = Bounds::new();
    for (index, (list, sums)) in a.list.chunks(BATCH).zip(a.sums.chunks_mut(BATCH)).enumerate() {
        prefetch::<S>(a.records, a.list, (index + 1) * BATCH);
        bounds.fill::<S>(a.records, list, &a.tile);
        for (k, (&i, sums)) in list.iter().zip(sums).enumerate() {
            let g = unsafe { a.records.get_unchecked(i as usize) };
            let log2_opacity = S::splat(g.log2_opacity);
            let rgb = array!(c in 3 => S::splat(g.rgb[c]));
            let mut total = [zero; SUMS];
            let [x0, x1] = bounds.columns::<S>(k);
            for column in x0..x1 {
                let x = column * S::LANES;
                let [y0, y1] = bounds.rows(k, column);
                let power = Column::<S>::new(g, a.tile.x + x);
                let dx = power.dx;
                let (mut v0, mut v1, mut v2) = (zero, zero, zero);
                let slope = dx.mul(S::splat(2.0 * g.half_xx));
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
                        let v = weight.mul(own).sub(alpha.mul(behind).mul(clear.reciprocal()));
                        let v = v.keep(S::and(drawn, raw.lt(max_alpha)));
                        let vdy = v.mul(S::splat(dy));
                        v0 = v0.add(v);
                        v1 = v1.add(vdy);
                        v2 = vdy.fma(S::splat(dy), v2);
                        if EXTRA == ERROR {
                            total[10] = weight.fma(S::load(error.as_ptr().add(at)), total[10]);
                        }
                        if EXTRA == MAGNITUDES {
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
}

simd_kernel!(
    /// Gradients of a tile, replayed front to back.
    pub fn backward(arguments: &mut Backward) = backward_generic
);
