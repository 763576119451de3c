//! How far a place in a picture lies from the outline of the object.

use crate::level::LevelImage;
use scene::Camera;

/// The signed distances from the outline of a view's mask.
pub(crate) struct Outline {
    /// Of the mask's size.
    pub(crate) camera: Camera,
    width: usize,
    height: usize,
    /// [height × width] pixels to the outline, negative inside.
    distance: Vec<f32>,
}

/// Squared pixels to what is not there. Source: more than any picture's diagonal, and exact in
/// single precision.
const FAR: f32 = 1e9;

impl Outline {
    /// None where the mask is all black or all white.
    pub(crate) fn of(image: &LevelImage) -> Option<Self> {
        let (inside, width) = (&image.inside, image.width);
        let is_one_colour = inside.iter().all(|i| *i) || !inside.iter().any(|i| *i);
        (!is_one_colour).then(|| {
            let outside: Vec<bool> = inside.iter().map(|i| !i).collect();
            let to_object = squared_distances(inside, width);
            let to_background = squared_distances(&outside, width);
            // The outline is half a pixel from the middle of the last one.
            let signed = to_object.iter().zip(&to_background).map(|(object, background)| {
                if *object > 0.0 { object.sqrt() - 0.5 } else { 0.5 - background.sqrt() }
            });
            let (camera, distance) = (image.camera.clone(), signed.collect());
            Self { camera, width, height: image.height, distance }
        })
    }

    /// Pixels to the outline, negative inside; none outside the picture.
    #[inline]
    pub(crate) fn distance(&self, [x, y]: [f32; 2]) -> Option<f32> {
        let (w, h) = (self.width as f32, self.height as f32);
        if !(x >= 0.0 && y >= 0.0 && x < w && y < h) {
            return None;
        }
        // Between the middles of pixels.
        let (x, y) = ((x - 0.5).clamp(0.0, w - 1.0), (y - 0.5).clamp(0.0, h - 1.0));
        let (u, v) = ((x as usize).min(self.width.max(2) - 2), (y as usize).min(self.height.max(2) - 2));
        let (a, b) = (x - u as f32, y - v as f32);
        let at =
            |u: usize, v: usize| self.distance[v.min(self.height - 1) * self.width + u.min(self.width - 1)];
        let above = at(u, v) + a * (at(u + 1, v) - at(u, v));
        let below = at(u, v + 1) + a * (at(u + 1, v + 1) - at(u, v + 1));
        Some(above + b * (below - above))
    }

    /// Direction in which the distance grows most, unit; none outside the picture or on a ridge.
    pub(crate) fn outwards(&self, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
        let along = self.distance([x + 1.0, y])? - self.distance([x - 1.0, y])?;
        let across = self.distance([x, y + 1.0])? - self.distance([x, y - 1.0])?;
        let length = along.hypot(across);
        (length > 0.0).then(|| [along / length, across / length])
    }
}

/// Squared pixels to the nearest of these (Felzenszwalb and Huttenlocher, "Distance Transforms of
/// Sampled Functions", Theory of Computing 2012).
fn squared_distances(these: &[bool], width: usize) -> Vec<f32> {
    let rows = these.len() / width.max(1);
    let mut all: Vec<f32> = these.iter().map(|is_one| if *is_one { 0.0 } else { FAR }).collect();
    for x in 0..width {
        let column: Vec<f32> = (0..rows).map(|y| all[y * width + x]).collect();
        lower_envelope(&column).into_iter().enumerate().for_each(|(y, d)| all[y * width + x] = d);
    }
    for row in all.chunks_mut(width.max(1)) {
        let nearest = lower_envelope(row);
        row.copy_from_slice(&nearest);
    }
    all
}

/// `min over q of (p − q)² + f(q)` for every p.
fn lower_envelope(f: &[f32]) -> Vec<f32> {
    // Parabolas of the envelope and where each begins.
    let mut parts: Vec<(usize, f64)> = Vec::with_capacity(f.len());
    let height: Vec<f64> = f.iter().enumerate().map(|(q, f)| f64::from(*f) + (q * q) as f64).collect();
    for q in 0..f.len() {
        let mut begin = f64::NEG_INFINITY;
        while let Some(&(last, from)) = parts.last() {
            begin = (height[q] - height[last]) / (2 * (q - last)) as f64;
            if begin > from {
                break;
            }
            parts.pop();
            begin = f64::NEG_INFINITY;
        }
        parts.push((q, begin));
    }
    let mut at = 0;
    let lowest = (0..f.len()).map(|p| {
        while parts.get(at + 1).is_some_and(|(_, begin)| *begin < p as f64) {
            at += 1;
        }
        let q = parts[at].0;
        (p.abs_diff(q) as f32).powi(2) + f[q]
    });
    lowest.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_equal_those_to_the_nearest_pixel_of_all() {
        let width = 23;
        let these: Vec<bool> = (0..width * 17).map(|i| i * i % 31 == 3 || i == 200).collect();
        let found = squared_distances(&these, width);
        for (i, d) in found.iter().enumerate() {
            let nearest = (0..these.len())
                .filter(|&k| these[k])
                .map(|k| (i % width).abs_diff(k % width).pow(2) + (i / width).abs_diff(k / width).pow(2))
                .min();
            assert_eq!(Some(*d as usize), nearest, "{i}");
        }
        assert!(squared_distances(&[], 3).is_empty());
        assert_eq!(squared_distances(&[false; 6], 3), [FAR; 6]);
    }
}
