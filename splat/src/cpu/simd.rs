//! Vectors of f32 with one source for every instruction set.
//!
//! A kernel is written once, generic over [`Simd`] and `#[inline(always)]`; `simd_kernel!` makes
//! the wrappers that carry `#[target_feature]`, so that the intrinsics inline into code compiled
//! for them, and picks one at run time.

/// A vector of `LANES` f32.
///
/// # Safety
/// Values may only be made where the instruction set of the type is present. That holds for code
/// reached through `simd_kernel!`, because an `Isa` exists only if it was detected.
pub unsafe trait Simd: Copy {
    /// Result of a comparison.
    type Mask: Copy;
    /// Lanes, a divisor of 16. Source: the size of the registers.
    const LANES: usize = size_of::<Self>() / size_of::<f32>();

    /// All lanes `v`.
    fn splat(v: f32) -> Self;
    /// From memory.
    /// # Safety
    /// `p` points to `LANES` readable f32.
    unsafe fn load(p: *const f32) -> Self;
    /// To memory.
    /// # Safety
    /// `p` points to `LANES` writable f32.
    unsafe fn store(self, p: *mut f32);
    /// The first `LANES` of `values`, of which there must be so many.
    #[inline(always)]
    fn read(values: &[f32]) -> Self {
        let values = &values[..Self::LANES];
        // SAFETY: the slice has LANES values.
        unsafe { Self::load(values.as_ptr()) }
    }
    /// Into the first `LANES` of `values`, of which there must be so many.
    #[inline(always)]
    fn write(self, values: &mut [f32]) {
        let values = &mut values[..Self::LANES];
        // SAFETY: the slice has LANES values.
        unsafe { self.store(values.as_mut_ptr()) }
    }
    /// `self + o`
    fn add(self, o: Self) -> Self;
    /// `self − o`
    fn sub(self, o: Self) -> Self;
    /// `self · o`
    fn mul(self, o: Self) -> Self;
    /// `self / o`
    fn div(self, o: Self) -> Self;
    /// `1 / self` of normal numbers; relative error below 3e-7. A division of 16 lanes takes as
    /// long as a dozen products.
    #[inline(always)]
    fn reciprocal(self) -> Self {
        Self::splat(1.0).div(self)
    }
    /// `self · m + a` (rounded once where the machine can)
    fn fma(self, m: Self, a: Self) -> Self;
    /// `a − self · m`
    fn fnma(self, m: Self, a: Self) -> Self;
    /// The smaller; `o` where either is NaN.
    fn min(self, o: Self) -> Self;
    /// The larger; `o` where either is NaN.
    fn max(self, o: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// `self ≥ o`, false for NaN.
    fn ge(self, o: Self) -> Self::Mask;
    /// `self < o`, false for NaN.
    fn lt(self, o: Self) -> Self::Mask;
    /// Both.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Whether a lane is set.
    fn any(m: Self::Mask) -> bool;
    /// Lane i is bit i.
    fn bits(m: Self::Mask) -> u32;
    /// `self` where `m`, else 0.
    fn keep(self, m: Self::Mask) -> Self;
    /// `a` where `m`, else `b`.
    fn select(m: Self::Mask, a: Self, b: Self) -> Self;
    /// `self · 2^n` with `magic = 1.5·2^23 + n` as float; `self · 2^n` must be a normal number.
    fn scale_by_magic(self, magic: Self) -> Self;
    /// Sum of the lanes in a fixed order.
    fn sum(self) -> f32;

    /// Asks for the cache line at `p` to be fetched, where the machine can; any address will do.
    #[inline(always)]
    fn prefetch(_p: *const u8) {}

    /// 0, 1, 2 …
    #[inline(always)]
    fn iota() -> Self {
        Self::read(&[0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.])
    }

    /// `2^self` for self in [−126, 127]; relative error below 2e-7. The minimax polynomial was
    /// fitted for this.
    #[inline(always)]
    fn exp2(self) -> Self {
        let magic = self.add(Self::splat(MAGIC));
        let f = self.sub(magic.sub(Self::splat(MAGIC)));
        let p = Self::splat(EXP2[5]).fma(f, Self::splat(EXP2[4]));
        let p = p.fma(f, Self::splat(EXP2[3]));
        let p = p.fma(f, Self::splat(EXP2[2]));
        let p = p.fma(f, Self::splat(EXP2[1]));
        p.fma(f, Self::splat(EXP2[0])).scale_by_magic(magic)
    }

    /// `exp(self)`, the argument limited to ±87.
    #[inline(always)]
    fn exp(self) -> Self {
        let x = self.max(Self::splat(-87.0)).min(Self::splat(87.0));
        x.mul(Self::splat(std::f32::consts::LOG2_E)).exp2()
    }
}

/// Adding 1.5·2^23 rounds to an integer in the low bits of the mantissa. Source: derived.
const MAGIC: f32 = 12_582_912.0;
/// Coefficients of 2^x, [−½, ½]. Source: fitted for this: the least relative error.
const EXP2: [f32; 6] =
    [1.000_000_1, 0.693_146_97, 0.240_221_2, 0.055_507_133, 0.009_675_542, 0.001_327_647_2];

/// `array!(k in 3 => f(k))` is `[f(0), f(1), f(2)]` without a closure: closures are functions of
/// their own, which the compiler may leave without the instruction set of the kernel around them.
macro_rules! array {
    ($k:ident in 2 => $e:expr) => {
        [{ let $k: usize = 0; $e }, { let $k: usize = 1; $e }]
    };
    ($k:ident in 3 => $e:expr) => {
        [{ let $k: usize = 0; $e }, { let $k: usize = 1; $e }, { let $k: usize = 2; $e }]
    };
    ($k:ident in 7 => $e:expr) => {
        [
            { let $k: usize = 0; $e }, { let $k: usize = 1; $e }, { let $k: usize = 2; $e }, { let $k: usize = 3; $e },
            { let $k: usize = 4; $e }, { let $k: usize = 5; $e }, { let $k: usize = 6; $e },
        ]
    };
    ($k:ident in 4 => $e:expr) => {
        [{ let $k: usize = 0; $e }, { let $k: usize = 1; $e }, { let $k: usize = 2; $e }, { let $k: usize = 3; $e }]
    };
}
pub(crate) use array;
