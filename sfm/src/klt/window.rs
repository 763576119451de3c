//! Windows of an image in rows of a vector's length, of which the last column is empty.
//!
//! Sums run in sixteen lanes side by side: one after the other, every addition would wait for the
//! last.

use crate::sift::LANES;

/// Side of the window, pixels.
/// Source: derived: the largest odd number of samples that with one more, for those between, fill a
/// vector.
pub(super) const SIDE: usize = LANES - 1;

/// Rows of a window; what lies beyond [`SIDE`] is 0.
pub(super) type KltWindow = [[f32; LANES]; SIDE];

/// The pixels of a window and of the ring about it, which gradients need.
pub(crate) type ReferencePatch = [f32; (SIDE + 2) * (SIDE + 2)];

/// `Σ a b`
#[inline(always)]
pub(super) fn dot(a: &KltWindow, b: &KltWindow) -> f32 {
    let mut sums = [0.0f32; LANES];
    for (a, b) in a.iter().zip(b) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    total(sums)
}

/// Takes the mean away.
#[inline(always)]
pub(super) fn centre(window: &mut KltWindow) {
    let mut sums = [0.0f32; LANES];
    for row in window.iter() {
        for k in 0..LANES {
            sums[k] += row[k];
        }
    }
    let mut mean = [total(sums) / (SIDE * SIDE) as f32; LANES];
    mean[SIDE] = 0.0;
    for row in window {
        for k in 0..LANES {
            row[k] -= mean[k];
        }
    }
}

/// The sum of the lanes. They are put into memory first: the compiler would take what adds them up
/// here for a reason to keep the loop before it in vectors of two.
#[inline(always)]
fn total(sums: [f32; LANES]) -> f32 {
    let sums = std::hint::black_box(sums);
    let mut some: [f32; 8] = std::array::from_fn(|k| sums[k] + sums[k + 8]);
    for half in [4, 2, 1] {
        for k in 0..half {
            some[k] += some[k + half];
        }
    }
    some[0]
}
