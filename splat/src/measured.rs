//! Depths of a view that were measured otherwise than by Gaussians.

use crate::fusion::LIMITS;

/// Depths of a view: of a rectangle around the object, as nothing is known elsewhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredDepth {
    /// Columns and rows of the whole picture: those of one of the view's levels.
    pub size: [usize; 2],
    /// First column and row of the rectangle.
    pub corner: [usize; 2],
    /// Columns of the rectangle.
    pub columns: usize,
    /// [rows × columns] camera z, scene units; 0 where nothing is known.
    pub depth: Vec<f32>,
}

impl MeasuredDepth {
    /// Depths of a whole picture, [rows × columns].
    pub fn whole(columns: usize, depth: Vec<f32>) -> Self {
        let size = [columns, depth.len() / columns.max(1)];
        Self { size, corner: [0; 2], columns, depth }
    }

    /// These depths of a splat, of a picture's size, joined with those by stereo of any size;
    /// nothing where the splat shows nothing.
    pub fn joined(&self, stereo: &Self) -> Self {
        let [width, height] = self.size;
        let shrunk = |v: usize| v * stereo.size[0] / width.max(1);
        let joined = (0..width * height).map(|i| {
            let (x, y) = (i % width, i / width);
            match (self.at(x, y), stereo.at(shrunk(x), shrunk(y))) {
                (Some(splat), Some(stereo)) => joined(splat, stereo),
                (splat, _) => splat.unwrap_or(0.0),
            }
        });
        Self::whole(width, joined.collect())
    }

    /// What is known at a place of the whole picture.
    fn at(&self, x: usize, y: usize) -> Option<f32> {
        let column = x.checked_sub(self.corner[0]).filter(|c| *c < self.columns)?;
        let row = y.checked_sub(self.corner[1])?;
        self.depth.get(row * self.columns + column).copied().filter(|z| *z > 0.0)
    }

    /// The pixels of the whole picture at which something is known, and their depths.
    pub(crate) fn known(&self) -> impl Iterator<Item = (usize, f32)> {
        let all = self.depth.iter().enumerate().filter(|(_, z)| **z > 0.0);
        all.map(|(i, z)| {
            let (x, y) = (self.corner[0] + i % self.columns, self.corner[1] + i / self.columns);
            (y * self.size[0] + x, *z)
        })
    }
}

/// The depth by stereo, but where the splat lies well before it: there the photos of a blank face
/// have deceived stereo. NaN of the splat is nothing.
pub(crate) fn joined(splat: f32, stereo: f32) -> f32 {
    if splat < stereo * (1.0 - LIMITS.seen_through) { splat } else { stereo }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stereo_counts_unless_it_looks_through_the_splat() {
        assert_eq!([joined(f32::NAN, 2.0), joined(2.5, 2.0), joined(1.99, 2.0)], [2.0; 3]);
        assert_eq!(joined(1.5, 2.0), 1.5);
    }

    #[test]
    fn a_rectangle_is_known_at_its_place_and_nowhere_else() {
        let depth = vec![0.0, 2.0, 3.0, 4.0];
        let stereo = MeasuredDepth { size: [4, 3], corner: [2, 1], columns: 2, depth };
        assert_eq!(stereo.known().collect::<Vec<_>>(), [(7, 2.0), (10, 3.0), (11, 4.0)]);
        // A splat of twice the size, 5 away wherever it is: what stereo knows is nearer.
        let joined = MeasuredDepth::whole(8, vec![5.0; 48]).joined(&stereo);
        for (i, z) in joined.depth.iter().enumerate() {
            let expected = match (i % 8 / 2, i / 8 / 2) {
                (3, 1) => 2.0,
                (2, 2) => 3.0,
                (3, 2) => 4.0,
                _ => 5.0,
            };
            assert_eq!(*z, expected, "pixel {i}");
        }
    }
}
