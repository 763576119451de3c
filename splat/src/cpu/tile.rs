//! Tiles, and planes of pixels whose rows are padded to whole tiles.

use super::simd::Simd;

/// Side of a tile, pixels. Source: Kerbl et al. 2023, section 6.
pub(crate) const TILE: usize = 16;
/// Pixels of a tile. Source: derived.
pub(crate) const PIXELS: usize = TILE * TILE;

/// A value for each pixel of a tile, row by row. Aligned, so that no vector lies across two cache
/// lines: those cost twice, and what was just stored comes late to the load that wants it.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub(crate) struct TilePlane(pub(crate) [f32; PIXELS]);

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
        for (y, row) in out.0.chunks_exact_mut(TILE).enumerate() {
            row.copy_from_slice(&plane[self.row(y)..self.row(y) + TILE]);
        }
        out
    }

    /// Transmittance before the first Gaussian: 1, and −1 (finished) outside the image.
    pub(crate) fn start(&self) -> TilePlane {
        let mut start = TilePlane::filled(-1.0);
        for row in start.0.chunks_exact_mut(TILE).take(self.height) {
            row[..self.width].fill(1.0);
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
