//! An order of points in which neighbours in space are neighbours in memory and in files.
//!
//! ```
//! use glam::Vec3;
//! use scene::morton::morton_order;
//!
//! let places = [Vec3::ZERO, Vec3::ONE, Vec3::splat(0.1), Vec3::splat(0.9)];
//! assert_eq!(morton_order(&places), [0, 2, 3, 1]);
//! ```

use glam::Vec3;

/// Bits of a coordinate in a code. Source: three of them fill a word of 64.
const BITS: u32 = 21;

/// The indices of `places`, each once, along a Morton curve (Morton 1966) through the box of the
/// finite ones; equal ones stay in their order. Where others lie is not determined.
pub fn morton_order(places: &[Vec3]) -> Vec<usize> {
    let finite = places.iter().filter(|place| place.is_finite());
    let (low, high) = finite
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &place| (low.min(place), high.max(place)));
    let cells = Vec3::splat((1u32 << BITS) as f32 - 1.0) / (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
    let mut keyed: Vec<(u64, usize)> =
        places.iter().enumerate().map(|(i, &x)| (code((x - low) * cells), i)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// The bits of the three coordinates by turns; what is not a number counts as 0.
fn code(cell: Vec3) -> u64 {
    let [x, y, z] = cell.to_array().map(|v| every_third_bit(v as u32));
    x << 2 | y << 1 | z
}

/// The lowest [`BITS`] of `v`, two zeros between each and the next.
fn every_third_bit(v: u32) -> u64 {
    // Halves move apart, then halves of halves.
    let v = u64::from(v) & 0x1f_ffff;
    let v = (v | v << 32) & 0x001f_0000_0000_ffff;
    let v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    let v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    let v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for v in [0u32, 1, 5, 0x1f_ffff, 0x12_3456] {
            let slow = (0..BITS).fold(0u64, |out, bit| out | u64::from(v >> bit & 1) << (3 * bit));
            assert_eq!(every_third_bit(v), slow, "{v:x}");
        }
    }

    #[test]
    fn every_place_is_there_once_whatever_the_numbers() {
        let places = [
            Vec3::NAN,
            Vec3::splat(1e30),
            Vec3::ZERO,
            Vec3::new(f32::INFINITY, 0.0, 0.0),
            Vec3::splat(-1e30),
        ];
        let mut order = morton_order(&places);
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3, 4]);
        assert!(morton_order(&[]).is_empty());
        assert_eq!(morton_order(&[Vec3::ONE; 3]), [0, 1, 2]);
    }
}
