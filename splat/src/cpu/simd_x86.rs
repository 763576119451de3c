//! [`Simd`] by AVX2 + FMA and by AVX-512 F.

use super::simd::Simd;
use std::arch::x86_64::*;

/// Calls intrinsics of a detected instruction set.
macro_rules! detected {
    ($call:expr) => {
        // SAFETY: values exist only where their instruction set was detected (contract of `Simd`).
        unsafe { $call }
    };
}

/// 8 lanes of AVX2 with FMA.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(__m256);

// SAFETY: values are made only by kernels that `simd_kernel!` starts, after detection.
unsafe impl Simd for Avx2 {
    type Mask = __m256;

    #[inline(always)]
    fn prefetch(p: *const u8) {
        // SAFETY: a prefetch of any address is allowed.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(p.cast()) }
    }
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(detected!(_mm256_set1_ps(v)))
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for the memory; the instruction set was detected.
        Self(unsafe { _mm256_loadu_ps(p) })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for the memory; the instruction set was detected.
        unsafe { _mm256_storeu_ps(p, self.0) }
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(detected!(_mm256_add_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self(detected!(_mm256_sub_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(detected!(_mm256_mul_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        Self(detected!(_mm256_div_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn reciprocal(self) -> Self {
        // Newton: y (2 − x y) squares the relative error of the machine's 1.5·2^−12.
        let y = Self(detected!(_mm256_rcp_ps(self.0)));
        y.mul(self.fnma(y, Self::splat(2.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(detected!(_mm256_min_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(detected!(_mm256_max_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn fma(self, m: Self, a: Self) -> Self {
        Self(detected!(_mm256_fmadd_ps(self.0, m.0, a.0)))
    }
    #[inline(always)]
    fn fnma(self, m: Self, a: Self) -> Self {
        Self(detected!(_mm256_fnmadd_ps(self.0, m.0, a.0)))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(detected!(_mm256_sqrt_ps(self.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(detected!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self::Mask {
        detected!(_mm256_cmp_ps::<_CMP_GE_OQ>(self.0, o.0))
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        detected!(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, o.0))
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        detected!(_mm256_and_ps(a, b))
    }
    #[inline(always)]
    fn any(m: Self::Mask) -> bool {
        detected!(_mm256_movemask_ps(m) != 0)
    }
    #[inline(always)]
    fn bits(m: Self::Mask) -> u32 {
        detected!(_mm256_movemask_ps(m) as u32)
    }
    #[inline(always)]
    fn keep(self, m: Self::Mask) -> Self {
        Self(detected!(_mm256_and_ps(self.0, m)))
    }
    #[inline(always)]
    fn select(m: Self::Mask, a: Self, b: Self) -> Self {
        Self(detected!(_mm256_blendv_ps(b.0, a.0, m)))
    }
    #[inline(always)]
    fn scale_by_magic(self, magic: Self) -> Self {
        // SAFETY: values of this type exist only where its instruction set was detected.
        unsafe {
            let shifted = _mm256_slli_epi32::<23>(_mm256_castps_si256(magic.0));
            Self(_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(self.0), shifted)))
        }
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: values of this type exist only where its instruction set was detected.
        unsafe {
            let half = _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let pair = _mm_add_ps(half, _mm_movehl_ps(half, half));
            _mm_cvtss_f32(_mm_add_ss(pair, _mm_shuffle_ps::<1>(pair, pair)))
        }
    }
}

/// 16 lanes of AVX-512 F.
#[derive(Clone, Copy, Debug)]
pub struct Avx512(__m512);

// SAFETY: values are made only by kernels that `simd_kernel!` starts, after detection.
unsafe impl Simd for Avx512 {
    type Mask = __mmask16;

    #[inline(always)]
    fn prefetch(p: *const u8) {
        // SAFETY: a prefetch of any address is allowed.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(p.cast()) }
    }
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(detected!(_mm512_set1_ps(v)))
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for the memory; the instruction set was detected.
        Self(unsafe { _mm512_loadu_ps(p) })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for the memory; the instruction set was detected.
        unsafe { _mm512_storeu_ps(p, self.0) }
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(detected!(_mm512_add_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self(detected!(_mm512_sub_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(detected!(_mm512_mul_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        Self(detected!(_mm512_div_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn reciprocal(self) -> Self {
        // Newton: y (2 − x y) squares the relative error of the machine's 2^−14.
        let y = Self(detected!(_mm512_rcp14_ps(self.0)));
        y.mul(self.fnma(y, Self::splat(2.0)))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self(detected!(_mm512_min_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self(detected!(_mm512_max_ps(self.0, o.0)))
    }
    #[inline(always)]
    fn fma(self, m: Self, a: Self) -> Self {
        Self(detected!(_mm512_fmadd_ps(self.0, m.0, a.0)))
    }
    #[inline(always)]
    fn fnma(self, m: Self, a: Self) -> Self {
        Self(detected!(_mm512_fnmadd_ps(self.0, m.0, a.0)))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(detected!(_mm512_sqrt_ps(self.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(detected!(_mm512_abs_ps(self.0)))
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self::Mask {
        detected!(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(self.0, o.0))
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        detected!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, o.0))
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        a & b
    }
    #[inline(always)]
    fn any(m: Self::Mask) -> bool {
        m != 0
    }
    #[inline(always)]
    fn bits(m: Self::Mask) -> u32 {
        u32::from(m)
    }
    #[inline(always)]
    fn keep(self, m: Self::Mask) -> Self {
        Self(detected!(_mm512_maskz_mov_ps(m, self.0)))
    }
    #[inline(always)]
    fn select(m: Self::Mask, a: Self, b: Self) -> Self {
        Self(detected!(_mm512_mask_blend_ps(m, b.0, a.0)))
    }
    #[inline(always)]
    fn scale_by_magic(self, magic: Self) -> Self {
        // SAFETY: values of this type exist only where its instruction set was detected.
        unsafe {
            let shifted = _mm512_slli_epi32::<23>(_mm512_castps_si512(magic.0));
            Self(_mm512_castsi512_ps(_mm512_add_epi32(_mm512_castps_si512(self.0), shifted)))
        }
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        detected!(_mm512_reduce_add_ps(self.0))
    }
}
