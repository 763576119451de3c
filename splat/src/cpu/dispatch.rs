//! Which instruction sets this machine has, and kernels compiled for each of them.

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(InstructionSet);

/// Names of the instruction sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// Plain Rust, 8 lanes.
    Portable,
    /// AVX2 and FMA, 8 lanes.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F, 16 lanes.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// NEON, 4 lanes.
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl Isa {
    /// All that were detected, the portable one first, the widest last.
    pub(crate) fn available() -> Vec<Self> {
        let mut found = vec![Self(InstructionSet::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                found.push(Self(InstructionSet::Avx2));
            }
            if is_x86_feature_detected!("avx512f") && found.len() > 1 {
                found.push(Self(InstructionSet::Avx512));
            }
        }
        #[cfg(target_arch = "aarch64")]
        found.push(Self(InstructionSet::Neon));
        found
    }

    /// The widest.
    pub fn best() -> Self {
        static BEST: std::sync::OnceLock<Isa> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Self::available().pop().unwrap_or(Self(InstructionSet::Portable)))
    }

    /// Its name.
    pub fn kind(self) -> InstructionSet {
        self.0
    }
}

/// `simd_kernel!(pub fn name(arguments: &mut Type) = generic::<_>)`: `name(isa, arguments)` runs
/// `generic::<S>(arguments)` compiled for the instruction set.
#[macro_export]
macro_rules! simd_kernel {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($argument:ident: $type:ty) = $generic:ident) => {
        $(#[$meta])*
        $visibility fn $name(isa: $crate::simd::Isa, $argument: $type) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($argument: $type) {
                $generic::<$crate::simd::Avx2>($argument);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($argument: $type) {
                $generic::<$crate::simd::Avx512>($argument);
            }
            match isa.kind() {
                $crate::simd::InstructionSet::Portable => $generic::<$crate::simd::Portable>($argument),
                #[cfg(target_arch = "x86_64")]
                // SAFETY: an `Isa` of this kind exists only where AVX2 and FMA were detected.
                $crate::simd::InstructionSet::Avx2 => unsafe { avx2($argument) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: an `Isa` of this kind exists only where AVX-512 F, AVX2 and FMA were
                // detected.
                $crate::simd::InstructionSet::Avx512 => unsafe { avx512($argument) },
                #[cfg(target_arch = "aarch64")]
                $crate::simd::InstructionSet::Neon => $generic::<$crate::simd::Neon>($argument),
            }
        }
    };
}
pub(crate) use crate::simd_kernel;

#[cfg(test)]
mod tests {
    use super::super::simd::Simd;
    use super::*;

    struct Exp<'a> {
        input: &'a [f32; 16],
        output: &'a mut [f32; 16],
    }

    #[inline(always)]
    fn exp_generic<S: Simd>(a: &mut Exp) {
        for i in (0..16).step_by(S::LANES) {
            S::read(&a.input[i..]).exp().write(&mut a.output[i..]);
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
            S::read(&a.input[i..]).reciprocal().write(&mut a.output[i..]);
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
