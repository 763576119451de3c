//! [`Simd`] by NEON.

use super::simd::Simd;
use std::arch::aarch64::*;

/// 4 lanes of NEON, which every aarch64 has.
#[derive(Clone, Copy, Debug)]
pub struct Neon(float32x4_t);

// NEON is part of the aarch64 baseline.
unsafe impl Simd for Neon {
    type Mask = uint32x4_t;
    const LANES: usize = 4;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(unsafe { vdupq_n_f32(v) })
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        Self(unsafe { vld1q_f32(p) })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        unsafe { vst1q_f32(p, self.0) }
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(unsafe { vaddq_f32(self.0, o.0) })
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self(unsafe { vsubq_f32(self.0, o.0) })
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(unsafe { vmulq_f32(self.0, o.0) })
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        Self(unsafe { vdivq_f32(self.0, o.0) })
    }
    #[inline(always)]
    fn fma(self, m: Self, a: Self) -> Self {
        Self(unsafe { vfmaq_f32(a.0, self.0, m.0) })
    }
    #[inline(always)]
    fn fnma(self, m: Self, a: Self) -> Self {
        Self(unsafe { vfmsq_f32(a.0, self.0, m.0) })
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(unsafe { vbslq_f32(vcltq_f32(self.0, o.0), self.0, o.0) })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(unsafe { vbslq_f32(vcgtq_f32(self.0, o.0), self.0, o.0) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { vsqrtq_f32(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { vabsq_f32(self.0) })
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self::Mask {
        unsafe { vcgeq_f32(self.0, o.0) }
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        unsafe { vcltq_f32(self.0, o.0) }
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { vandq_u32(a, b) }
    }
    #[inline(always)]
    fn and_not(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { vbicq_u32(a, b) }
    }
    #[inline(always)]
    fn any(m: Self::Mask) -> bool {
        unsafe { vmaxvq_u32(m) != 0 }
    }
    #[inline(always)]
    fn bits(m: Self::Mask) -> u32 {
        const WEIGHTS: [u32; 4] = [1, 2, 4, 8];
        unsafe { vaddvq_u32(vandq_u32(m, vld1q_u32(WEIGHTS.as_ptr()))) }
    }
    #[inline(always)]
    fn keep(self, m: Self::Mask) -> Self {
        Self(unsafe { vreinterpretq_f32_u32(vandq_u32(vreinterpretq_u32_f32(self.0), m)) })
    }
    #[inline(always)]
    fn select(m: Self::Mask, a: Self, b: Self) -> Self {
        Self(unsafe { vbslq_f32(m, a.0, b.0) })
    }
    #[inline(always)]
    fn scale_by_magic(self, magic: Self) -> Self {
        unsafe {
            let shifted = vshlq_n_u32::<23>(vreinterpretq_u32_f32(magic.0));
            Self(vreinterpretq_f32_u32(vaddq_u32(vreinterpretq_u32_f32(self.0), shifted)))
        }
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        unsafe { vaddvq_f32(self.0) }
    }
}
