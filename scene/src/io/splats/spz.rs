//! Niantic's `.spz`, versions 2 to 4 (<https://github.com/nianticlabs/spz>): attribute after
//! attribute, quantised.
//!
//! Positions 24-bit fixed point, alphas, colours `0.15 sh0 + 0.5`, log scales `b/16 − 10`,
//! rotations (version 2: x y z as bytes; later: smallest three in 32 bits), harmonics `(b −
//! 128)/128`. Versions 2 and 3 are one gzip stream behind a 16-byte header, version 4 has a table
//! of zstd streams. Axes: right, up, back.

use super::item::{Item, push, turn_upright, unit, unit_byte};
use super::ready::{ready, rounded, slack};
use crate::Gaussians;
use crate::io::bytes::ByteReader;
use crate::io::error::IoError;
use crate::io::limits;
use crate::io::write_atomic;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::{Quat, Vec3};
use std::io::{Read, Write};
use std::path::Path;

/// The magic number. Source: Niantic's spz format.
const MAGIC: u32 = 0x5053_474e;
/// Scale of colour coefficients. Source: Niantic's spz format.
const COLOUR_SCALE: f32 = 0.15;
/// Least log scale. Source: Niantic's spz format.
const LEAST_LOG_SCALE: f32 = -10.0;
/// Harmonics are multiples of so many 128ths. Source: as near as `.sog`'s; Niantic's own writer
/// takes 8 and 16.
const SH_STEP: f32 = 4.0;

struct SpzHeader {
    version: u32,
    n: usize,
    sh_degree: u32,
    fractional_bits: u32,
    streams: usize,
}

fn parse_header(path: &Path, data: &[u8]) -> Result<SpzHeader, IoError> {
    let mut r = ByteReader::new(path, data);
    if r.u32("a header")? != MAGIC {
        return Err(IoError::format(
            path,
            "expected an .spz file, which begins with NGSP; found something else",
        ));
    }
    let (version, n) = (r.u32("a version")?, r.u32("a count")?);
    let rest = r.take(4, "a header")?;
    let (sh_degree, fractional_bits) = (u32::from(rest[0]), u32::from(rest[1]));
    if !(2..=4).contains(&version) || sh_degree > 3 || fractional_bits > 23 || n > limits::GAUSSIANS {
        let message = format!(
            "expected .spz version 2 to 4, degree 0 to 3, at most {} gaussians; found version {version}, degree {sh_degree}, {n} gaussians",
            limits::GAUSSIANS
        );
        return Err(IoError::format(path, message));
    }
    Ok(SpzHeader { version, n: n as usize, sh_degree, fractional_bits, streams: usize::from(rest[3]) })
}

/// Bytes a Gaussian of each attribute: positions, alphas, colours, scales, rotations, harmonics.
fn widths(version: u32, sh_degree: u32) -> [usize; 6] {
    let rest = (sh_degree as usize + 1).pow(2) * 3 - 3;
    [9, 1, 3, 3, if version == 2 { 3 } else { 4 }, rest]
}

/// Parses an `.spz` of version 2, 3 or 4.
pub(super) fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let too_big =
        || IoError::format(path, "claims far more gaussians than its size can hold; the file is damaged");
    if data.starts_with(&[0x1f, 0x8b]) {
        let broken = |e: std::io::Error| IoError::format(path, format!("the gzip stream is damaged: {e}"));
        let mut decoder = GzDecoder::new(data);
        let mut head = [0; 16];
        decoder.read_exact(&mut head).map_err(broken)?;
        let header = parse_header(path, &head)?;
        let size = (header.n * widths(header.version, header.sh_degree).iter().sum::<usize>()) as u64;
        if !limits::may_unpack(data.len() as u64, size) {
            return Err(too_big());
        }
        let mut body = Vec::new();
        decoder.take(size).read_to_end(&mut body).map_err(broken)?;
        return decode(path, &header, &body);
    }
    let header = parse_header(path, data)?;
    if header.version < 4 {
        return decode(path, &header, &data[16..]);
    }
    let body = inflate_streams(path, data, &header)?;
    decode(path, &header, &body)
}

/// Version 4: at byte 16 the place of a table of (compressed, uncompressed) sizes, then the zstd
/// streams.
fn inflate_streams(path: &Path, data: &[u8], header: &SpzHeader) -> Result<Vec<u8>, IoError> {
    let damaged =
        || IoError::format(path, "the table of streams does not fit the header; the file is damaged");
    let widths = widths(4, header.sh_degree);
    let needed = if header.sh_degree > 0 { 6 } else { 5 };
    let place = ByteReader::new(path, data.get(16..).unwrap_or_default()).u32("a table")? as usize;
    let mut table = ByteReader::new(path, data.get(place..).ok_or_else(damaged)?);
    let mut at = place + 16 * header.streams;
    let mut body = Vec::new();
    for (i, width) in (0..header.streams).zip(widths.into_iter().chain(std::iter::repeat(0))) {
        let (packed, size) = (table.u64("a stream size")?, table.u64("a stream size")?);
        let end = usize::try_from(packed).ok().and_then(|p| at.checked_add(p)).ok_or_else(damaged)?;
        let stream = data.get(at..end).ok_or_else(damaged)?;
        at = end;
        if i >= needed {
            break; // extensions of other makers
        }
        if size != (header.n * width) as u64 || !limits::may_unpack(packed, size) {
            return Err(damaged());
        }
        let broken =
            |e: &dyn std::fmt::Display| IoError::format(path, format!("a zstd stream is damaged: {e}"));
        let decoder = ruzstd::decoding::StreamingDecoder::new(stream).map_err(|e| broken(&e))?;
        decoder.take(size).read_to_end(&mut body).map_err(|e| broken(&e))?;
    }
    Ok(body)
}

fn decode(path: &Path, header: &SpzHeader, body: &[u8]) -> Result<Gaussians, IoError> {
    let (n, widths) = (header.n, widths(header.version, header.sh_degree));
    let mut r = ByteReader::new(path, body);
    let mut parts = [&body[..0]; 6];
    for (part, width) in parts.iter_mut().zip(widths) {
        *part = r.take(n * width, "an attribute")?;
    }
    let [positions, alphas, colours, scales, rotations, harmonics] = parts;
    let mut g = Gaussians { sh_degree: header.sh_degree, ..Default::default() };
    let unit_size = 1.0 / (1u32 << header.fractional_bits) as f32;
    let mut sh = vec![0.0; widths[5] + 3];
    for i in 0..n {
        let fixed = |k: usize| {
            let b = &positions[i * 9 + k * 3..];
            (i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) as f32 * unit_size
        };
        let byte = |part: &[u8], k: usize| f32::from(part[i * 3 + k]);
        (0..3).for_each(|c| sh[c] = (byte(colours, c) / 255.0 - 0.5) / COLOUR_SCALE);
        let own = &harmonics[i * widths[5]..(i + 1) * widths[5]];
        sh[3..].iter_mut().zip(own).for_each(|(v, &b)| *v = (f32::from(b) - 128.0) / 128.0);
        let item = Item {
            mean: Vec3::new(fixed(0), fixed(1), fixed(2)),
            log_scale: Vec3::new(byte(scales, 0), byte(scales, 1), byte(scales, 2)) / 16.0 + LEAST_LOG_SCALE,
            rotation: unpack_rotation(&rotations[i * widths[4]..(i + 1) * widths[4]]),
            opacity: f32::from(alphas[i]) / 255.0,
            sh: &sh,
        };
        push(path, &mut g, &item)?;
    }
    turn_upright(&mut g);
    Ok(g)
}

/// Version 2: three bytes, x y z over [−1, 1], w ≥ 0. Later: the index of the largest of x, y, z, w
/// in the top two bits, then the others in order, a sign and 9 bits of magnitude over 1/√2 each.
fn unpack_rotation(b: &[u8]) -> Quat {
    if b.len() == 3 {
        let v = Vec3::new(f32::from(b[0]), f32::from(b[1]), f32::from(b[2])) / 127.5 - 1.0;
        return Quat::from_xyzw(v.x, v.y, v.z, (1.0 - v.length_squared()).max(0.0).sqrt());
    }
    let packed = u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let largest = (packed >> 30) as usize;
    let mut v = [0.0_f32; 4];
    let mut sum = 0.0;
    for (place, i) in (0..4).rev().filter(|&i| i != largest).enumerate() {
        let bits = packed >> (10 * place) & 1023;
        let size = (bits & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        v[i] = if bits >> 9 == 1 { -size } else { size };
        sum += size * size;
    }
    v[largest] = (1.0 - sum).max(0.0).sqrt();
    Quat::from_array(v)
}

fn pack_rotation(q: Quat) -> u32 {
    let v = unit(q).to_array();
    let largest = (1..4).fold(0, |m, i| if v[i].abs() > v[m].abs() { i } else { m });
    let sign = v[largest].signum();
    (0..4).filter(|&i| i != largest).fold(largest as u32, |packed, i| {
        let value = v[i] * sign;
        let size = (value.abs() * std::f32::consts::SQRT_2 * 511.0).round().min(511.0) as u32;
        packed << 10 | u32::from(value < 0.0) << 9 | size
    })
}

/// Writes version 3, with as many fractional bits (at most 12) as the largest coordinate leaves.
pub fn write_spz(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    let bytes = encode_spz(g).map_err(|message| IoError::format(path, message))?;
    write_atomic(path, |w| w.write_all(&bytes))
}

/// What [`write_spz`] writes; or why `.spz` cannot hold it.
pub fn encode_spz(g: &Gaussians) -> Result<Vec<u8>, String> {
    let mut g = g.clone();
    turn_upright(&mut g);
    let g = ready(&g);
    let largest = g.means.iter().fold(0.0_f32, |a, m| a.max(m.abs().max_element()));
    if !g.means.iter().all(|m| m.is_finite()) || largest >= (1 << 23) as f32 {
        return Err(".spz holds coordinates up to 8,388,607; scale the scene down first".to_owned());
    }
    let held = LEAST_LOG_SCALE..=LEAST_LOG_SCALE + 255.0 / 16.0;
    if g.log_scales.iter().filter(|s| !held.contains(&s.max_element())).count() * 2 > g.len() {
        return Err(".spz holds gaussians of sizes 5e-5 to 380; scale the scene first".to_owned());
    }
    let bits = (0..=12).rev().find(|&b| largest * ((1u32 << b) as f32) < 8_388_607.0).unwrap_or(0);
    if g.len() > limits::GAUSSIANS as usize {
        return Err(format!("at most {} gaussians are written to .spz", limits::GAUSSIANS));
    }
    let (magic, version, n) = (MAGIC.to_le_bytes(), 3_u32.to_le_bytes(), (g.len() as u32).to_le_bytes());
    let mut gz = GzEncoder::new(Vec::new(), Compression::best());
    let header = [&magic[..], &version, &n, &[g.sh_degree as u8, bits as u8, 0, 0]].concat();
    let written = gz.write_all(&header).and_then(|()| gz.write_all(&encode(&g, bits)));
    written.and_then(|()| gz.finish()).map_err(|e| e.to_string())
}

fn encode(g: &Gaussians, bits: u32) -> Vec<u8> {
    let k = g.sh_coefficients();
    let mut out = Vec::with_capacity(g.len() * widths(3, g.sh_degree).iter().sum::<usize>());
    let steps = (1u32 << bits) as f32;
    for (m, log_scale) in g.means.iter().zip(&g.log_scales) {
        let fixed = |v: f32| (rounded(v * steps, slack(*log_scale) * steps) as i32).to_le_bytes();
        m.to_array().iter().for_each(|&v| out.extend_from_slice(&fixed(v)[..3]));
    }
    out.extend((0..g.len()).map(|i| unit_byte(g.opacity(i))));
    for i in 0..g.len() {
        out.extend((0..3).map(|c| unit_byte(g.sh[i * k * 3 + c] * COLOUR_SCALE + 0.5)));
    }
    for s in &g.log_scales {
        out.extend(s.to_array().map(|v| ((v - LEAST_LOG_SCALE) * 16.0).round().clamp(0.0, 255.0) as u8));
    }
    g.rotations.iter().for_each(|&q| out.extend_from_slice(&pack_rotation(q).to_le_bytes()));
    for sh in g.sh.chunks_exact(k * 3) {
        let steps = sh[3..].iter().map(|v| (v * 128.0 / SH_STEP).round() * SH_STEP);
        out.extend(steps.map(|v| (v + 128.0).clamp(0.0, 255.0) as u8));
    }
    out
}
