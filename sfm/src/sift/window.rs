//! The part of a masked image whose scale space is needed.

use super::blur::LumaPlane;

/// Windows begin at multiples of this, pixels, so that octaves sample the same places as they do in
/// the whole image; and so much is kept around the mask's white (a descriptor reaches 9 σ).
/// Source: derived; 2⁵ for six octaves of which the first is doubled.
const GRID: usize = 32;

/// A rectangle of an image.
pub(super) struct Window {
    /// Its first column and row.
    pub first: [usize; 2],
    /// Its width and height.
    pub size: [usize; 2],
}

impl Window {
    /// Around all pixels whose centre is kept; the whole image where none is.
    pub(super) fn around(image: &LumaPlane, keep: impl Fn(f32, f32) -> bool) -> Self {
        let whole = [image.width, image.height];
        let (mut low, mut high) = (whole, [0; 2]);
        for y in 0..image.height {
            let kept = |x: &usize| keep(*x as f32 + 0.5, y as f32 + 0.5);
            let Some(left) = (0..image.width).find(kept) else { continue };
            let right = (left..image.width).rev().find(kept).unwrap_or(left);
            (low, high) = ([low[0].min(left), low[1].min(y)], [high[0].max(right), high[1].max(y)]);
        }
        if low[0] > high[0] {
            return Self { first: [0; 2], size: whole };
        }
        let first = low.map(|n| n.saturating_sub(GRID) / GRID * GRID);
        let end = [0, 1].map(|i| (high[i] + 1 + GRID).min(whole[i]));
        Self { first, size: [end[0] - first[0], end[1] - first[1]] }
    }

    /// The window of a plane: the plane itself where it is all of it, else a copy in `part`.
    pub(super) fn part_of<'a>(&self, plane: &'a LumaPlane, part: &'a mut LumaPlane) -> &'a LumaPlane {
        let ([x, y], [width, height]) = (self.first, self.size);
        if [width, height] == [plane.width, plane.height] {
            return plane;
        }
        part.data.clear();
        for row in plane.data.chunks_exact(plane.width).skip(y).take(height) {
            part.data.extend_from_slice(&row[x..x + width]);
        }
        (part.width, part.height) = (width, height);
        part
    }
}
