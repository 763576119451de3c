//! Compressed PLY (PlayCanvas/SuperSplat): chunks of 256 Gaussians with the bounds of their
//! positions, scales and colours; in each, positions and scales as 11 + 10 + 11 bits, rotations as
//! 2 + 3 × 10 bits (smallest three), colour and alpha as 4 × 8 bits; higher harmonics as bytes over
//! [−4, 4].

use super::item::{Item, push, unit, unit_byte};
use crate::Gaussians;
use crate::gaussians::SH_C0;
use crate::io::error::IoError;
use crate::io::ply::Ply;
use crate::io::write_atomic;
use crate::morton::morton_order;
use glam::{DVec3, Quat, Vec3};
use std::io::{self, Write};
use std::path::Path;

/// Gaussians of a chunk. Source: PlayCanvas's compressed PLY.
const CHUNK: usize = 256;
const BOUNDS: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Whether a PLY is a compressed one.
pub(super) fn is_compressed(ply: &Ply) -> bool {
    ply.element("vertex").is_some_and(|v| v.has(PACKED[0]))
}

/// Bounds of a chunk: position, scale, colour, lower and upper each.
type Bounds = [[Vec3; 2]; 3];

/// The Gaussians of a compressed PLY.
pub(super) fn decode(ply: &Ply) -> Result<Gaussians, IoError> {
    let path = ply.path;
    let coloured = ply.element("chunk").is_some_and(|c| c.has("min_r"));
    let mut chunks: Vec<Bounds> = Vec::new();
    ply.rows("chunk", if coloured { &BOUNDS } else { &BOUNDS[..12] }, |_, v| {
        // Bounds as in the list above, three numbers each.
        let v: Vec<Vec3> = v.chunks_exact(3).map(|v| DVec3::from_slice(v).as_vec3()).collect();
        let colour = if coloured { [v[4], v[5]] } else { [Vec3::ZERO, Vec3::ONE] };
        chunks.push([[v[0], v[1]], [v[2], v[3]], colour]);
        Ok(())
    })?;
    let rest = read_rest(ply)?;
    let per = rest.as_ref().map_or(0, |r| r.0);
    let mut g = Gaussians { sh_degree: ((per / 3 + 1) as f64).sqrt() as u32 - 1, ..Default::default() };
    let mut sh = vec![0.0; per + 3];
    ply.rows("vertex", &PACKED, |i, v| {
        let Some(bounds) = chunks.get(i / CHUNK) else {
            return Err(IoError::format(path, format!("vertex {i} has no chunk; the file is damaged")));
        };
        let [position, rotation, scale, colour] = [0, 1, 2, 3].map(|k| v[k] as u32);
        let bytes = colour.to_be_bytes().map(|b| f32::from(b) / 255.0);
        let rgb = mix(bounds[2], Vec3::new(bytes[0], bytes[1], bytes[2]));
        sh[..3].copy_from_slice(&((rgb - 0.5) / SH_C0).to_array());
        if let Some((per, values)) = &rest {
            let Some(own) = values.get(i * per..(i + 1) * per) else {
                return Err(IoError::format(
                    path,
                    format!("vertex {i} has no harmonics; the file is damaged"),
                ));
            };
            let k = per / 3;
            (0..*per).for_each(|j| sh[3 + j] = own[(j % 3) * k + j / 3]);
        }
        let mean = mix(bounds[0], unpack_11_10_11(position));
        let log_scale = mix(bounds[1], unpack_11_10_11(scale));
        push(
            path,
            &mut g,
            &Item { mean, log_scale, rotation: unpack_rotation(rotation), opacity: bytes[3], sh: &sh },
        )
    })?;
    Ok(g)
}

/// Higher coefficients: how many a Gaussian, and all of them, channel-major.
fn read_rest(ply: &Ply) -> Result<Option<(usize, Vec<f32>)>, IoError> {
    let Some(element) = ply.element("sh") else { return Ok(None) };
    let n = (0..).take_while(|i| element.has(&format!("f_rest_{i}"))).count();
    if ![9, 24, 45].contains(&n) {
        return Err(IoError::format(ply.path, format!("expected 9, 24 or 45 f_rest properties, found {n}")));
    }
    let names: Vec<String> = (0..n).map(|i| format!("f_rest_{i}")).collect();
    let mut values = Vec::new();
    ply.rows("sh", &names.iter().map(String::as_str).collect::<Vec<_>>(), |_, v| {
        values.extend(v.iter().map(|&b| match b as u8 {
            0 => -4.0,
            255 => 4.0,
            b => ((f32::from(b) + 0.5) / 256.0 - 0.5) * 8.0,
        }));
        Ok(())
    })?;
    Ok(Some((n, values)))
}

fn unpack_11_10_11(v: u32) -> Vec3 {
    Vec3::new((v >> 21) as f32 / 2047.0, (v >> 11 & 1023) as f32 / 1023.0, (v & 2047) as f32 / 2047.0)
}

fn pack_11_10_11(v: Vec3) -> u32 {
    let [x, y, z] = (v.clamp(Vec3::ZERO, Vec3::ONE) * Vec3::new(2047.0, 1023.0, 2047.0)).to_array();
    (x.round() as u32) << 21 | (y.round() as u32) << 11 | z.round() as u32
}

/// The value between two bounds, at a share of each axis.
fn mix([low, high]: [Vec3; 2], share: Vec3) -> Vec3 {
    low + (high - low) * share
}

/// Where a value lies between two bounds: the inverse of [`mix`].
fn share([low, high]: [Vec3; 2], v: Vec3) -> Vec3 {
    (v - low) / (high - low).max(Vec3::splat(1e-30))
}

/// The bounds of some values.
fn bounds_of(values: impl Iterator<Item = Vec3> + Clone) -> [Vec3; 2] {
    [values.clone().fold(Vec3::INFINITY, Vec3::min), values.fold(Vec3::NEG_INFINITY, Vec3::max)]
}

fn colour(g: &Gaussians, i: usize) -> Vec3 {
    Vec3::from_slice(&g.sh[i * g.sh_coefficients() * 3..]) * SH_C0 + 0.5
}

fn bounded_log_scale(g: &Gaussians, i: usize) -> Vec3 {
    g.log_scales[i].clamp(Vec3::splat(-20.0), Vec3::splat(20.0))
}

/// Top two bits: which of w, x, y, z is largest and left out; the others in that order, 10 bits
/// each, over ±1/√2.
fn unpack_rotation(v: u32) -> Quat {
    let [a, b, c] =
        [20, 10, 0].map(|shift| ((v >> shift & 1023) as f32 / 1023.0 - 0.5) * std::f32::consts::SQRT_2);
    let m = (1.0 - a * a - b * b - c * c).max(0.0).sqrt();
    let (w, x, y, z) = match v >> 30 {
        0 => (m, a, b, c),
        1 => (a, m, b, c),
        2 => (a, b, m, c),
        _ => (a, b, c, m),
    };
    Quat::from_xyzw(x, y, z, w)
}

fn pack_rotation(q: Quat) -> u32 {
    let q = unit(q);
    let v = [q.w, q.x, q.y, q.z];
    let largest = (1..4).fold(0, |m, i| if v[i].abs() > v[m].abs() { i } else { m });
    let sign = v[largest].signum();
    let others = (0..4).filter(|&i| i != largest).map(|i| v[i] * sign);
    others.fold(largest as u32, |packed, v| {
        let t = v * std::f32::consts::FRAC_1_SQRT_2 + 0.5;
        packed << 10 | (t.clamp(0.0, 1.0) * 1023.0).round() as u32
    })
}

/// Writes a compressed PLY; the Gaussians are put into spatial order.
pub fn write_compressed_ply(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    if let Some(i) = g.means.iter().position(|m| !m.is_finite()) {
        return Err(IoError::not_finite(path, format!("the position of gaussian {i}")));
    }
    write_atomic(path, |w| write_to(w, g))
}

fn write_to(w: &mut impl Write, g: &Gaussians) -> io::Result<()> {
    let k = g.sh_coefficients();
    let order = morton_order(&g.means);
    writeln!(w, "ply\nformat binary_little_endian 1.0\nelement chunk {}", g.len().div_ceil(CHUNK))?;
    BOUNDS.iter().try_for_each(|name| writeln!(w, "property float {name}"))?;
    writeln!(w, "element vertex {}", g.len())?;
    PACKED.iter().try_for_each(|name| writeln!(w, "property uint {name}"))?;
    if k > 1 {
        writeln!(w, "element sh {}", g.len())?;
        (0..3 * (k - 1)).try_for_each(|i| writeln!(w, "property uchar f_rest_{i}"))?;
    }
    writeln!(w, "end_header")?;
    let chunks: Vec<(&[usize], Bounds)> = order
        .chunks(CHUNK)
        .map(|c| {
            let means = bounds_of(c.iter().map(|&i| g.means[i]));
            let log_scales = bounds_of(c.iter().map(|&i| bounded_log_scale(g, i)));
            (c, [means, log_scales, bounds_of(c.iter().map(|&i| colour(g, i)))])
        })
        .collect();
    for v in chunks.iter().flat_map(|c| c.1.as_flattened().iter().flat_map(|v| v.to_array())) {
        w.write_all(&v.to_le_bytes())?;
    }
    for (members, bounds) in &chunks {
        for &i in *members {
            let c = share(bounds[2], colour(g, i)).to_array().map(unit_byte);
            let packed_colour = u32::from_be_bytes([c[0], c[1], c[2], unit_byte(g.opacity(i))]);
            let position = pack_11_10_11(share(bounds[0], g.means[i]));
            let scale = pack_11_10_11(share(bounds[1], bounded_log_scale(g, i)));
            for v in [position, pack_rotation(g.rotations[i]), scale, packed_colour] {
                w.write_all(&v.to_le_bytes())?;
            }
        }
    }
    for &i in order.iter().filter(|_| k > 1) {
        let values = (0..3 * (k - 1)).map(|j| g.sh[i * k * 3 + (j % (k - 1) + 1) * 3 + j / (k - 1)]);
        let bytes = values.map(|v| ((v / 8.0 + 0.5) * 256.0).clamp(0.0, 255.0) as u8);
        w.write_all(&bytes.collect::<Vec<_>>())?;
    }
    Ok(())
}
