//! [`Simd`] in plain Rust.

use super::simd::Simd;

/// Plain Rust: arrays of 8 that LLVM vectorises as far as the target's baseline allows.
#[derive(Clone, Copy, Debug)]
pub struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(f))
    }

    #[inline(always)]
    fn zip(self, o: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], o.0[i])))
    }
}

// SAFETY: plain Rust runs everywhere.
unsafe impl Simd for Portable {
    type Mask = [bool; 8];

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([v; 8])
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for eight readable values; they need not be aligned.
        Self(unsafe { p.cast::<[f32; 8]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for eight writable values; they need not be aligned.
        unsafe { p.cast::<[f32; 8]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        self.zip(o, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.zip(o, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.zip(o, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        self.zip(o, |a, b| a / b)
    }
    #[inline(always)]
    fn fma(self, m: Self, a: Self) -> Self {
        self.mul(m).add(a)
    }
    #[inline(always)]
    fn fnma(self, m: Self, a: Self) -> Self {
        a.sub(self.mul(m))
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        self.zip(o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        self.zip(o, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.map(f32::abs)
    }
    #[inline(always)]
    fn ge(self, o: Self) -> Self::Mask {
        std::array::from_fn(|i| self.0[i] >= o.0[i])
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        std::array::from_fn(|i| self.0[i] < o.0[i])
    }
    #[inline(always)]
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        std::array::from_fn(|i| a[i] & b[i])
    }
    #[inline(always)]
    fn any(m: Self::Mask) -> bool {
        m.iter().any(|&b| b)
    }
    #[inline(always)]
    fn bits(m: Self::Mask) -> u32 {
        m.iter().enumerate().fold(0, |bits, (i, &b)| bits | (u32::from(b) << i))
    }
    #[inline(always)]
    fn keep(self, m: Self::Mask) -> Self {
        Self(std::array::from_fn(|i| if m[i] { self.0[i] } else { 0.0 }))
    }
    #[inline(always)]
    fn select(m: Self::Mask, a: Self, b: Self) -> Self {
        Self(std::array::from_fn(|i| if m[i] { a.0[i] } else { b.0[i] }))
    }
    #[inline(always)]
    fn scale_by_magic(self, magic: Self) -> Self {
        self.zip(magic, |v, m| f32::from_bits(v.to_bits().wrapping_add(m.to_bits() << 23)))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        let v = self.0;
        ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
    }
}
