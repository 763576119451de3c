//! Tiles, and planes of pixels whose rows are padded to whole tiles.

use super::simd::Simd;

/// Side of a tile, pixels. Source: Kerbl et al. 2023, section 6.
pub(crate) const TILE: usize = 16;
/// Pixels of a tile. Source: derived.
pub(crate) const PIXELS: usize = TILE * TILE;

/// Pixels of a tile side by side in a vector; its other lanes are the rows below. Most Gaussians
/// are a few pixels wide: of a vector of a whole row they would not reach most pixels.
/// Source: the fewest lanes are four.
pub(crate) const ACROSS: usize = 4;
/// Strips of [`ACROSS`] columns in a tile.
pub(crate) const STRIPS: usize = TILE / ACROSS;

/// A value for each pixel of a tile, by strips of [`ACROSS`] columns, each row by row: a vector
/// holds a block of [`ACROSS`] columns. Aligned, so that no vector lies across two cache lines:
/// those cost twice, and what was just stored comes late to the load that wants it.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub(crate) struct TilePlane(pub(crate) [f32; PIXELS]);

/// Centre of each pixel from the tile's corner, x and y.
pub(crate) static CENTRES: [TilePlane; 2] = centres();

const fn centres() -> [TilePlane; 2] {
    let mut centres = [TilePlane([0.0; PIXELS]); 2];
    let mut i = 0;
    while i < PIXELS {
        centres[0].0[i] = (i / (ACROSS * TILE) * ACROSS + i % ACROSS) as f32 + 0.5;
        centres[1].0[i] = (i / ACROSS % TILE) as f32 + 0.5;
        i += 1;
    }
    centres
}

impl TilePlane {
    /// All pixels `value`.
    pub(crate) fn filled(value: f32) -> Self {
        Self([value; PIXELS])
    }

    /// The vector of pixels from `at` on, all of which must lie within the tile.
    #[inline(always)]
    pub(crate) fn get<S: Simd>(&self, at: usize) -> S {
        assert!(at <= PIXELS - S::LANES);
        // SAFETY: LANES values from `at` on lie within the plane.
        unsafe { S::load(self.0.as_ptr().add(at)) }
    }

    /// Row `y`, [`ACROSS`] pixels at a time.
    pub(crate) fn row(&self, y: usize) -> impl Iterator<Item = &[f32]> {
        self.0[y * ACROSS..PIXELS].chunks(ACROSS).step_by(TILE)
    }

    fn row_mut(&mut self, y: usize) -> impl Iterator<Item = &mut [f32]> {
        self.0[y * ACROSS..PIXELS].chunks_mut(ACROSS).step_by(TILE)
    }

    /// Stores a vector from pixel `at` on, all of which must lie within the tile.
    #[inline(always)]
    pub(crate) fn set<S: Simd>(&mut self, at: usize, value: S) {
        assert!(at <= PIXELS - S::LANES);
        // SAFETY: LANES values from `at` on lie within the plane.
        unsafe { value.store(self.0.as_mut_ptr().add(at)) }
    }
}

/// Where a tile lies in padded planes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    /// First pixel, x.
    pub(crate) x: usize,
    /// First pixel, y.
    pub(crate) y: usize,
    /// Pixels that belong to the image.
    pub(crate) width: usize,
    /// Rows that belong to the image.
    pub(crate) height: usize,
    /// Pixels from one row of the plane to the next.
    pub(crate) stride: usize,
}

impl Tile {
    /// Offset of row `y` of the tile in a plane.
    pub(crate) fn row(&self, y: usize) -> usize {
        (self.y + y) * self.stride + self.x
    }

    /// The tile's pixels of a plane.
    pub(crate) fn gather(&self, plane: &[f32]) -> TilePlane {
        let mut out = TilePlane::filled(0.0);
        for y in 0..TILE {
            let row = &plane[self.row(y)..self.row(y) + TILE];
            for (to, from) in out.row_mut(y).zip(row.chunks_exact(ACROSS)) {
                to.copy_from_slice(from);
            }
        }
        out
    }

    /// Transmittance before the first Gaussian: 1, and −1 (finished) outside the image.
    pub(crate) fn start(&self) -> TilePlane {
        let mut start = TilePlane::filled(-1.0);
        for y in 0..self.height {
            let row = start.row_mut(y).flatten();
            row.take(self.width).for_each(|pixel| *pixel = 1.0);
        }
        start
    }
}

/// Size of an image whose planes are padded to whole tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PlaneShape {
    /// Width, pixels.
    pub(crate) width: usize,
    /// Height, pixels.
    pub(crate) height: usize,
}

impl PlaneShape {
    /// Pixels from row to row.
    pub(crate) fn stride(&self) -> usize {
        self.width.div_ceil(TILE) * TILE
    }

    /// Pixels of a plane.
    pub(crate) fn plane(&self) -> usize {
        self.stride() * self.height.div_ceil(TILE) * TILE
    }

    /// Tile number `t`, row by row.
    pub(crate) fn tile(&self, t: usize) -> Tile {
        let tiles_x = self.stride() / TILE;
        let (x, y) = (t % tiles_x * TILE, t / tiles_x * TILE);
        Tile {
            x,
            y,
            width: TILE.min(self.width - x),
            height: TILE.min(self.height - y),
            stride: self.stride(),
        }
    }
}
