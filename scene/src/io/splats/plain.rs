//! `.splat` (antimatter15): 32 bytes a Gaussian, no header: `f32 x y z`, `f32 scale` × 3 (linear),
//! `u8 r g b a`, `u8` quaternion w x y z as `128 q + 128`. No view-dependent colour.

use super::item::{Item, push, unit, unit_byte};
use crate::Gaussians;
use crate::gaussians::SH_C0;
use crate::io::bytes::ByteReader;
use crate::io::error::IoError;
use crate::io::write_atomic;
use glam::{Quat, Vec3};
use std::io::Write;
use std::path::Path;

/// Bytes of a Gaussian. Source: the .splat format of antimatter15/splat.
const RECORD: usize = 32;

/// Parses a `.splat`.
pub(super) fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    if !data.len().is_multiple_of(RECORD) {
        let message =
            format!("expected a multiple of {RECORD} bytes, found {}; the file is cut off", data.len());
        return Err(IoError::format(path, message));
    }
    let mut g = Gaussians::default();
    let mut r = ByteReader::new(path, data);
    for _ in 0..data.len() / RECORD {
        let mean = r.vec3("a position")?;
        let scale = r.vec3("a scale")?;
        let c = r.take(8, "a colour and rotation")?;
        let sh = [0, 1, 2].map(|i| (f32::from(c[i]) / 255.0 - 0.5) / SH_C0);
        let q = [4, 5, 6, 7].map(|i| (f32::from(c[i]) - 128.0) / 128.0);
        let rotation = unit(Quat::from_xyzw(q[1], q[2], q[3], q[0]));
        let log_scale = scale.map(|s| s.max(0.0).ln());
        push(path, &mut g, &Item { mean, log_scale, rotation, opacity: f32::from(c[3]) / 255.0, sh: &sh })?;
    }
    Ok(g)
}

/// Writes a `.splat`, the largest and most opaque Gaussians first (viewers show them while they
/// load).
pub fn write_dot_splat(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    let sizes = g.log_scales.iter().enumerate();
    let weights: Vec<f32> = sizes.map(|(i, s)| g.opacity(i) * s.element_sum().exp()).collect();
    let mut order: Vec<usize> = (0..g.len()).collect();
    order.sort_by(|&i, &j| weights[j].total_cmp(&weights[i]).then(i.cmp(&j)));
    let stride = g.sh_coefficients() * 3;
    write_atomic(path, |w| {
        for i in order {
            let numbers = [g.means[i], g.log_scales[i].map(f32::exp)];
            numbers.iter().flat_map(|v| v.to_array()).try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
            let sh = &g.sh[i * stride..];
            w.write_all(&[0, 1, 2].map(|c| unit_byte(0.5 + SH_C0 * sh[c])))?;
            w.write_all(&[unit_byte(g.opacity(i))])?;
            let q = unit(g.rotations[i]);
            w.write_all(&[q.w, q.x, q.y, q.z].map(|v| (v * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8))?;
        }
        Ok(())
    })
}

impl ByteReader<'_> {
    /// Three floats.
    pub(super) fn vec3(&mut self, what: &str) -> Result<Vec3, IoError> {
        let b = self.take(12, what)?;
        let floats = [0, 4, 8].map(|i| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]));
        Ok(Vec3::from_array(floats))
    }
}
