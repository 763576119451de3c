//! Kernels written once for every instruction set, for the trainers of other crates.
//!
//! A kernel is generic over [`Simd`] and `#[inline(always)]`; [`simd_kernel!`](crate::simd_kernel)
//! compiles it for each instruction set and picks one at run time.
//!
//! ```
//! use splat::simd::{Isa, Simd};
//!
//! #[inline(always)]
//! fn double_generic<S: Simd>(values: &mut [f32; 16]) {
//!     for i in (0..16).step_by(S::LANES) {
//!         let v = S::read(&values[i..]);
//!         v.add(v).write(&mut values[i..]);
//!     }
//! }
//! splat::simd_kernel!(fn double(values: &mut [f32; 16]) = double_generic);
//!
//! let mut values = [1.5; 16];
//! double(Isa::best(), &mut values);
//! assert_eq!(values, [3.0; 16]);
//! ```

#[cfg(target_arch = "aarch64")]
pub use crate::cpu::simd_neon::Neon;
#[cfg(target_arch = "x86_64")]
pub use crate::cpu::simd_x86::{Avx2, Avx512};
pub use crate::cpu::{
    dispatch::{InstructionSet, Isa},
    simd::Simd,
    simd_portable::Portable,
};
