//! [`Simd`] by NEON.

use super::simd::Simd;
use std::arch::aarch64::*;

/// Calls intrinsics of NEON.
macro_rules! detected {
    ($call:expr) => {
        // SAFETY: every aarch64 has NEON.
        unsafe { $call }
    };
}

/// 4 lanes of NEON, which every aarch64 has.
#[derive(Clone, Copy, Debug)]
pub struct Neon(float32x4_t);

// SAFETY: NEON is part of the aarch64 baseline.
unsafe impl Simd for Neon {
    type Mask = uint32x4_t;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(detected!(vdupq_n_f32(v)))
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for the memory; every aarch64 has NEON.
        Self(unsafe { vld1q_f32(p) })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for the memory; every aarch64 has NEON.
        unsafe { vst1q_f32(p, self.0) }
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(detected!(vaddq_f32(self.0, o.0)))
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self(detected!(vsubq_f32(self.0, o.0)))
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(detected!(vmulq_f32(self.0, o.0)))
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        Self(detected!(vdivq_f32(self.0, o.0)))
    }
    #[inline(always)]
    fn fma(self, m: Self, a: Self) -> Self {
        Self(detected!(vfmaq_f32(a.0, self.0, m.0)))
    }
    #[inline(always)]
    fn fnma(self, m: Self, a: Self) -> Self {
        Self(detected!(vfmsq_f32(a.0, self.0, m.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(detected!(vbslq_f32(vcltq_f32(self.0, o.0), self.0, o.0)))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(detected!(vbslq_f32(vcgtq_f32(self.0, o.0), self.0, o.0)))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(detected!(vsqrtq_f32(self.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(detected!(vabsq_f32(self.0)))
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self::Mask {
        detected!(vcgeq_f32(self.0, o.0))
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        detected!(vcltq_f32(self.0, o.0))
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        detected!(vandq_u32(a, b))
    }
    #[inline(always)]
    fn any(m: Self::Mask) -> bool {
        detected!(vmaxvq_u32(m) != 0)
    }
    #[inline(always)]
    fn bits(m: Self::Mask) -> u32 {
        let weights: [u32; 4] = [1, 2, 4, 8];
        detected!(vaddvq_u32(vandq_u32(m, vld1q_u32(weights.as_ptr()))))
    }
    #[inline(always)]
    fn keep(self, m: Self::Mask) -> Self {
        Self(detected!(vreinterpretq_f32_u32(vandq_u32(vreinterpretq_u32_f32(self.0), m))))
    }
    #[inline(always)]
    fn select(m: Self::Mask, a: Self, b: Self) -> Self {
        Self(detected!(vbslq_f32(m, a.0, b.0)))
    }
    #[inline(always)]
    fn scale_by_magic(self, magic: Self) -> Self {
        // SAFETY: every aarch64 has NEON.
        unsafe {
            let shifted = vshlq_n_u32::<23>(vreinterpretq_u32_f32(magic.0));
            Self(vreinterpretq_f32_u32(vaddq_u32(vreinterpretq_u32_f32(self.0), shifted)))
        }
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        detected!(vaddvq_f32(self.0))
    }
}
