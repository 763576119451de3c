//! Best and second-best partners of all descriptors of two images, from both sides in one sweep.
//!
//! Dot products are formed tile by tile and compared at once; no distance is ever stored. Every
//! kernel gives the same result: integers are exact, and among equals the lowest index stays.

use super::prepared::PreparedFeatures;
use super::top_two::{TopTwo, add_bias};
use crate::sift::dispatch;

/// The two best partners above `floor`, seen from `a` and from `b`, by the fastest kernel of this
/// machine.
pub(super) fn top_two(a: &PreparedFeatures, b: &PreparedFeatures, floor: u16) -> (TopTwo, TopTwo) {
    #[cfg(target_arch = "x86_64")]
    {
        let (mut rows, mut columns) = (TopTwo::new(a.len(), floor), TopTwo::new(b.len(), floor));
        if b.group() == 4 && super::prepared::best_group() == 4 {
            // SAFETY: the processor has AVX-512 with VNNI.
            unsafe { super::avx512::sweep(a, b, &mut rows, &mut columns) };
            return (rows, columns);
        }
        if b.group() == 2 && std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { super::avx2::sweep(a, b, &mut rows, &mut columns) };
            return (rows, columns);
        }
    }
    #[cfg(target_arch = "aarch64")]
    if b.group() == 1 {
        let (mut rows, mut columns) = (TopTwo::new(a.len(), floor), TopTwo::new(b.len(), floor));
        // SAFETY: every aarch64 has NEON.
        unsafe { super::neon::sweep(a, b, &mut rows, &mut columns) };
        return (rows, columns);
    }
    portable_top_two(a, b, floor)
}

dispatch! {
    /// Dot product of two prepared descriptors, modulo 2¹⁶ as in every kernel.
    pub(super) fn dot(x: &[u8], y: &[u8]) -> u16 {
        let sum: u32 = x.iter().zip(y).map(|(&x, &y)| u32::from(u16::from(x) * u16::from(y))).sum();
        sum as u16
    }
}

/// [`top_two`] in plain loops, which the compiler turns into what the target's baseline offers.
pub(super) fn portable_top_two(a: &PreparedFeatures, b: &PreparedFeatures, floor: u16) -> (TopTwo, TopTwo) {
    let (mut rows, mut columns) = (TopTwo::new(a.len(), floor), TopTwo::new(b.len(), floor));
    for j0 in (0..b.len()).step_by(256) {
        for i in 0..a.len() {
            for j in j0..(j0 + 256).min(b.len()) {
                let dot = add_bias(dot(a.row(i), b.row(j)));
                if dot > rows.second[i] || dot > columns.second[j] {
                    rows.offer(i, dot, j as u32);
                    columns.offer(j, dot, i as u32);
                }
            }
        }
    }
    (rows, columns)
}
