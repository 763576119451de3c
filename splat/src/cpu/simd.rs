//! Vectors of f32 with one source for every instruction set.
//!
//! A kernel is written once, generic over [`Simd`] and `#[inline(always)]`; `simd_kernel!` makes the wrappers that
//! carry `#[target_feature]`, so that the intrinsics inline into code compiled for them, and picks one at run time.

/// A vector of `LANES` f32.
///
/// # Safety
/// Values may only be made where the instruction set of the type is present. That holds for code reached through
/// `simd_kernel!`, because an [`Isa`] exists only if it was detected.
pub unsafe trait Simd: Copy {
    /// Result of a comparison.
    type Mask: Copy;
    /// Lanes, a divisor of 16.
    const LANES: usize;

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
    /// `self + o`
    fn add(self, o: Self) -> Self;
    /// `self − o`
    fn sub(self, o: Self) -> Self;
    /// `self · o`
    fn mul(self, o: Self) -> Self;
    /// `self / o`
    fn div(self, o: Self) -> Self;
    /// `1 / self` of normal numbers; relative error below 3e-7. A division of 16 lanes takes as long as a dozen products.
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
    /// `a` and not `b`.
    fn and_not(a: Self::Mask, b: Self::Mask) -> Self::Mask;
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
        const IOTA: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];
        unsafe { Self::load(IOTA.as_ptr()) }
    }

    /// `2^self` for self in [−126, 127]; relative error below 2e-7. The minimax polynomial was fitted for this.
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

/// Adding 1.5·2^23 rounds to an integer in the low bits of the mantissa.
const MAGIC: f32 = 12_582_912.0;
const EXP2: [f32; 6] =
    [1.000_000_1, 0.693_146_97, 0.240_221_2, 0.055_507_133, 0.009_675_542, 0.001_327_647_2];

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Kind);

/// Names of the instruction sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Plain Rust, 8 lanes.
    Portable,
    /// AVX2 and FMA, 8 lanes.
    Avx2,
    /// AVX-512 F, 16 lanes.
    Avx512,
    /// NEON, 4 lanes.
    Neon,
}

impl Isa {
    /// All that were detected, the portable one first, the widest last.
    pub fn available() -> Vec<Self> {
        let mut found = vec![Self(Kind::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                found.push(Self(Kind::Avx2));
            }
            if is_x86_feature_detected!("avx512f") {
                found.push(Self(Kind::Avx512));
            }
        }
        #[cfg(target_arch = "aarch64")]
        found.push(Self(Kind::Neon));
        found
    }

    /// The widest.
    pub fn best() -> Self {
        static BEST: std::sync::OnceLock<Isa> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Self::available().pop().unwrap_or(Self(Kind::Portable)))
    }

    /// Its name.
    pub fn kind(self) -> Kind {
        self.0
    }
}

/// `array!(k in 3 => f(k))` is `[f(0), f(1), f(2)]` without a closure: closures are functions of their own, which the
/// compiler may leave without the instruction set of the kernel around them.
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

/// `simd_kernel!(pub fn name(arguments: &mut Type) = generic::<_>)`: `name(isa, arguments)` runs `generic::<S>(arguments)` compiled
/// for the instruction set.
macro_rules! simd_kernel {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($argument:ident: $type:ty) = $generic:ident) => {
        $(#[$meta])*
        $visibility fn $name(isa: $crate::cpu::simd::Isa, $argument: $type) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($argument: $type) {
                $generic::<$crate::cpu::simd_x86::Avx2>($argument);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($argument: $type) {
                $generic::<$crate::cpu::simd_x86::Avx512>($argument);
            }
            match isa.kind() {
                $crate::cpu::simd::Kind::Portable => $generic::<$crate::cpu::simd::Portable>($argument),
                // An Isa of this kind exists only where the features were detected.
                #[cfg(target_arch = "x86_64")]
                $crate::cpu::simd::Kind::Avx2 => unsafe { avx2($argument) },
                #[cfg(target_arch = "x86_64")]
                $crate::cpu::simd::Kind::Avx512 => unsafe { avx512($argument) },
                #[cfg(target_arch = "aarch64")]
                $crate::cpu::simd::Kind::Neon => $generic::<$crate::cpu::simd_neon::Neon>($argument),
                #[allow(unreachable_patterns)]
                _ => $generic::<$crate::cpu::simd::Portable>($argument),
            }
        }
    };
}
pub(crate) use simd_kernel;

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

// Plain Rust runs everywhere.
unsafe impl Simd for Portable {
    type Mask = [bool; 8];
    const LANES: usize = 8;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([v; 8])
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        Self(unsafe { p.cast::<[f32; 8]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
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
    fn and_not(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        std::array::from_fn(|i| a[i] & !b[i])
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

#[cfg(test)]
mod tests {
    use super::*;

    struct Exp<'a> {
        input: &'a [f32; 16],
        output: &'a mut [f32; 16],
    }

    #[inline(always)]
    fn exp_generic<S: Simd>(a: &mut Exp) {
        for i in (0..16).step_by(S::LANES) {
            unsafe { S::load(a.input.as_ptr().add(i)).exp().store(a.output.as_mut_ptr().add(i)) };
        }
    }
    simd_kernel!(fn exp(arguments: &mut Exp) = exp_generic);

    #[test]
    fn the_exponential_is_accurate_on_every_instruction_set() {
        for isa in Isa::available() {
            for step in 0..2000 {
                let input: [f32; 16] = std::array::from_fn(|i| (step * 16 + i) as f32 * 0.0025 - 40.0);
                let mut output = [0.0; 16];
                exp(isa, &mut Exp { input: &input, output: &mut output });
                assert!(
                    input.iter().zip(output).all(|(&x, y)| is_exponential(x, y)),
                    "{isa:?} {input:?} {output:?}"
                );
            }
        }
    }

    #[inline(always)]
    fn reciprocal_generic<S: Simd>(a: &mut Exp) {
        for i in (0..16).step_by(S::LANES) {
            unsafe { S::load(a.input.as_ptr().add(i)).reciprocal().store(a.output.as_mut_ptr().add(i)) };
        }
    }
    simd_kernel!(fn reciprocal(arguments: &mut Exp) = reciprocal_generic);

    #[test]
    fn the_reciprocal_is_accurate_on_every_instruction_set() {
        for isa in Isa::available() {
            for step in 0..500 {
                let input: [f32; 16] =
                    std::array::from_fn(|i| 1.02f32.powi(step * 4 - 1000) * (1.0 + 0.063 * i as f32));
                let mut output = [0.0; 16];
                reciprocal(isa, &mut Exp { input: &input, output: &mut output });
                let error = |(&x, y): (&f32, f32)| (f64::from(x) * f64::from(y) - 1.0).abs();
                let worst = input.iter().zip(output).map(error).fold(0.0, f64::max);
                assert!(worst < 3e-7, "{isa:?} {input:?} {output:?}");
            }
        }
    }

    /// Apart from the test, because LLVM 22 crashes when it vectorises the two loops as one.
    #[inline(never)]
    fn is_exponential(x: f32, y: f32) -> bool {
        let truth = f64::from(x).exp();
        (f64::from(y) - truth).abs() / truth < 3e-7 * (1.0 + f64::from(x.abs()))
    }

    #[test]
    fn the_exponential_of_anything_is_finite_and_never_nan_for_numbers() {
        let input = [
            -f32::INFINITY,
            f32::INFINITY,
            1e30,
            -1e30,
            0.0,
            -0.0,
            1e-40,
            87.0,
            -87.0,
            88.0,
            1.,
            2.,
            3.,
            4.,
            5.,
            6.,
        ];
        for isa in Isa::available() {
            let mut output = [0.0; 16];
            exp(isa, &mut Exp { input: &input, output: &mut output });
            assert!(output.iter().all(|v| v.is_finite() && *v >= 0.0), "{isa:?} {output:?}");
        }
    }
}
