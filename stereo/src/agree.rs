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

/// The fields with those depths only on which enough other views agree.
pub(crate) fn filtered(
    fields: &[PlaneField],
    pairs: &[Vec<Pair>],
    settings: &StereoSettings,
) -> Vec<PlaneField> {
    fields.par_iter().zip(pairs).map(|(field, pairs)| kept(field, pairs, fields, settings)).collect()
}

fn kept(field: &PlaneField, pairs: &[Pair], fields: &[PlaneField], settings: &StereoSettings) -> PlaneField {
    let mut kept = field.clone();
    for i in 0..field.depth.len() {
        let (x, y) = field.place(i);
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let z = field.depth[i];
        let meets =
            |p: &&Pair| meeting(pixel, z, p, &fields[p.view]).is_some_and(|m| m.is_near(&settings.tolerance));
        let count = if z > 0.0 { pairs.iter().filter(meets).count() } else { 0 };
        kept.agreeing[i] = count.min(255) as u8;
        if kept.agreeing[i] < settings.agreeing || !(field.cost[i] < settings.most_cost) {
            kept.depth[i] = 0.0;
        }
    }
    kept
}
