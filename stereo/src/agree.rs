//! Depths on which views agree.

use crate::field::PlaneField;
use crate::pair::Pair;
use crate::settings::{StereoSettings, Tolerance};
use rayon::prelude::*;

/// Where the depth that a neighbour has leads back to.
pub(crate) struct Meeting {
    /// The neighbour's pixel.
    pub(crate) index: usize,
    /// Pixels between where it began and where it came back to.
    pub(crate) off_px: f32,
    /// Difference of the depths, share of 1.
    off_depth: f32,
}

impl Meeting {
    /// Whether both mean the same place.
    pub(crate) fn is_near(&self, tolerance: &Tolerance) -> bool {
        self.off_px < tolerance.px && self.off_depth < tolerance.depth
    }
}

/// A pixel and its depth, seen in a neighbour and back from there; none where that has no depth.
pub(crate) fn meeting(pixel: [f32; 2], z: f32, pair: &Pair, other: &PlaneField) -> Option<Meeting> {
    let (there, expected) = pair.there.apply(pixel, z);
    let index = other.index(there[0].floor() as i64, there[1].floor() as i64)?;
    let found = other.depth[index];
    if !(found > 0.0 && expected > 0.0) {
        return None;
    }
    // Along the neighbour's own ray: its plane tells the depth beside its pixel's middle.
    let (back, depth) = pair.back.apply(there, other.depth_along(index, there));
    let off_px = ((back[0] - pixel[0]).powi(2) + (back[1] - pixel[1]).powi(2)).sqrt();
    Some(Meeting { index, off_px, off_depth: (depth / z - 1.0).abs() })
}

/// Leaves only those depths on which enough other views agree.
pub(crate) fn filter(fields: &mut [PlaneField], pairs: &[Vec<Pair>], settings: &StereoSettings) {
    let all = &*fields;
    let counts: Vec<Vec<u8>> =
        all.par_iter().zip(pairs).map(|(field, pairs)| agreeing(field, pairs, all, settings)).collect();
    for (field, counts) in fields.iter_mut().zip(counts) {
        field.agreeing = counts;
        for ((z, &count), &cost) in field.depth.iter_mut().zip(&field.agreeing).zip(&field.cost) {
            if count < settings.agreeing || !(cost < settings.most_cost) {
                *z = 0.0;
            }
        }
    }
}

/// How many other views agree with each pixel of a field.
fn agreeing(field: &PlaneField, pairs: &[Pair], fields: &[PlaneField], settings: &StereoSettings) -> Vec<u8> {
    let counts = (0..field.depth.len()).map(|i| {
        let (x, y) = field.place(i);
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let z = field.depth[i];
        let meets =
            |p: &&Pair| meeting(pixel, z, p, &fields[p.view]).is_some_and(|m| m.is_near(&settings.tolerance));
        if z > 0.0 { pairs.iter().filter(meets).count().min(255) as u8 } else { 0 }
    });
    counts.collect()
}
