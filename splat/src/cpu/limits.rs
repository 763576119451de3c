//! What the machine can do at most, to hold the kernels against: multiply-adds and bytes a second
//! of one core.

use super::dispatch::{Isa, simd_kernel};
use super::simd::Simd;
use std::time::Instant;

/// Chains of multiply-adds that run beside each other: more than latency times ports of any core we
/// know. Source: chosen by hand.
const CHAINS: usize = 16;

/// Arguments of [`chains`].
struct Chains {
    rounds: usize,
    /// First value of each chain and the factor: arguments, for a chain that the compiler can
    /// foresee is not computed.
    starts: [f32; CHAINS],
    factor: f32,
    lanes: usize,
    sum: f32,
}

#[inline(always)]
fn chains_generic<S: Simd>(a: &mut Chains) {
    let mut x = a.starts.map(|start| S::splat(start));
    let (m, c) = (S::splat(a.factor), S::splat(1e-3));
    for _ in 0..a.rounds {
        for x in &mut x {
            *x = x.fma(m, c);
        }
    }
    a.sum = x.iter().map(|x| x.sum()).sum();
    a.lanes = S::LANES;
}

simd_kernel!(fn chains(arguments: &mut Chains) = chains_generic);

/// Multiply-adds of f32 (one lane each) that a core does in a second: the best of some tries.
pub(crate) fn multiply_adds() -> f64 {
    let mut best = 0.0f64;
    for _ in 0..20 {
        let starts = std::array::from_fn(|i| i as f32);
        let mut a =
            std::hint::black_box(Chains { rounds: 200_000, starts, factor: 0.998, lanes: 0, sum: 0.0 });
        let clock = Instant::now();
        chains(Isa::best(), std::hint::black_box(&mut a));
        let seconds = clock.elapsed().as_secs_f64();
        std::hint::black_box(a.sum);
        best = best.max((a.rounds * CHAINS * a.lanes) as f64 / seconds);
    }
    best
}

/// Bytes that a core reads and writes in a second where nothing fits into the caches: a copy, the
/// best of some tries.
pub(crate) fn bytes() -> f64 {
    let (from, mut to) = (vec![1.0f32; 32 << 20], vec![0.0f32; 32 << 20]);
    let mut best = 0.0f64;
    for _ in 0..5 {
        let clock = Instant::now();
        std::hint::black_box(&mut to).copy_from_slice(std::hint::black_box(&from));
        best = best.max((2 * size_of_val(&*from)) as f64 / clock.elapsed().as_secs_f64());
    }
    best
}
