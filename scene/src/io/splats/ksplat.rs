//! `.ksplat` of mkkellogg's GaussianSplats3D, version 0.1: a 4,096-byte header, a 1,024-byte header
//! a section, then per section the lengths of partly filled buckets, bucket centres, and Gaussians
//! in one of three levels of compression (0: floats; 1: 16-bit; 2: 16-bit with 8-bit harmonics).

use super::item::{Item, push, unit};
use crate::Gaussians;
use crate::gaussians::SH_C0;
use crate::io::bytes::ByteReader;
use crate::io::error::IoError;
use glam::{Quat, Vec3};
use std::path::Path;

/// Bytes of the header. Source: the .ksplat format of GaussianSplats3D.
const HEADER: usize = 4096;
/// Bytes of a section's header. Source: the .ksplat format of GaussianSplats3D.
const SECTION_HEADER: usize = 1024;

/// The parts of a section's header that matter.
struct Section {
    count: usize,
    capacity: usize,
    bucket_size: usize,
    buckets: usize,
    block: f32,
    bucket_bytes: usize,
    range: f32,
    partial: usize,
    degree: u32,
}

fn u32_at(b: &[u8], at: usize) -> usize {
    u32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]]) as usize
}

fn f32_at(b: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([b[at], b[at + 1], b[at + 2], b[at + 3]])
}

fn u16_at(b: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([b[at], b[at + 1]])
}

/// IEEE half precision.
fn half(bits: u16) -> f32 {
    let (sign, exponent, fraction) = (bits >> 15, i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        e => (1.0 + fraction / 1024.0) * 2f32.powi(e - 15),
    };
    if sign == 1 { -size } else { size }
}

impl Section {
    fn parse(h: &[u8], level: usize) -> Self {
        let range = u32_at(h, 24);
        let default = if level == 0 { 1 } else { 32_767 };
        Self {
            count: u32_at(h, 0),
            capacity: u32_at(h, 4),
            bucket_size: u32_at(h, 8),
            buckets: u32_at(h, 12),
            block: f32_at(h, 16),
            bucket_bytes: usize::from(u16_at(h, 20)),
            range: if range == 0 { default as f32 } else { range as f32 },
            partial: u32_at(h, 36),
            degree: u32::from(u16_at(h, 40)),
        }
    }

    fn harmonics(&self) -> usize {
        (self.degree as usize + 1).pow(2) * 3 - 3
    }

    fn record(&self, level: usize) -> usize {
        match level {
            0 => 44 + 4 * self.harmonics(),
            1 => 24 + 2 * self.harmonics(),
            _ => 24 + self.harmonics(),
        }
    }
}

/// Parses a `.ksplat`; sections of different degree end up with the lowest.
pub(super) fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let mut r = ByteReader::new(path, data);
    let head = r.take(HEADER, "a header")?;
    let level = usize::from(u16_at(head, 20));
    if (head[0], level > 2) != (0, false) || head[1] == 0 {
        let message =
            format!("expected .ksplat 0.1, level 0 to 2; found {}.{}, level {level}", head[0], head[1]);
        return Err(IoError::format(path, message));
    }
    let (low, high) = (f32_at(head, 36), f32_at(head, 40));
    let sh_range = if low == 0.0 && high == 0.0 { [-1.5, 1.5] } else { [low, high] };
    let sections = r.check_room(u32_at(head, 4) as u64, SECTION_HEADER, "section headers")?;
    let mut list = Vec::with_capacity(sections);
    // Some writers leave the number of used sections at 0; unused ones hold nothing.
    for _ in 0..sections {
        list.push(Section::parse(r.take(SECTION_HEADER, "a section header")?, level));
    }
    let degree = list.iter().filter(|s| s.count > 0).map(|s| s.degree).min().unwrap_or(0);
    if degree > 3 || list.iter().any(|s| s.degree > 3) {
        return Err(IoError::format(path, "expected spherical harmonics of degree 0 to 3"));
    }
    let mut g = Gaussians { sh_degree: degree, ..Default::default() };
    for section in &list {
        read_section(&mut r, section, level, sh_range, &mut g)?;
    }
    Ok(g)
}

fn read_section(
    r: &mut ByteReader,
    s: &Section,
    level: usize,
    sh_range: [f32; 2],
    g: &mut Gaussians,
) -> Result<(), IoError> {
    let path = r.path;
    r.check_room(s.partial as u64, 4, "bucket lengths")?;
    let lengths = r.take(s.partial * 4, "bucket lengths")?;
    r.check_room(s.buckets as u64, s.bucket_bytes.max(1), "buckets")?;
    let centres = r.take(s.buckets * s.bucket_bytes, "buckets")?;
    let record = s.record(level);
    r.check_room(s.capacity as u64, record, "gaussians")?;
    let body = r.take(s.capacity * record, "gaussians")?;
    if s.count > s.capacity
        || (level > 0 && (s.bucket_bytes < 12 || s.bucket_size == 0 || s.buckets < s.partial))
    {
        return Err(IoError::format(path, "the section header contradicts itself; the file is damaged"));
    }
    let full = if level == 0 { 0 } else { s.buckets - s.partial };
    let length = |p: usize| lengths.get(p * 4..p * 4 + 4).map(|b| u32_at(b, 0));
    let (mut partial, mut left) = (0, length(0).unwrap_or(0));
    for (i, b) in body.chunks_exact(record).take(s.count).enumerate() {
        let mut centre = Vec3::ZERO;
        if level > 0 {
            let mut bucket = i / s.bucket_size;
            if bucket >= full {
                while left == 0 {
                    partial += 1;
                    left = length(partial).ok_or_else(|| {
                        IoError::format(path, format!("gaussian {i} has no bucket; the file is damaged"))
                    })?;
                }
                left -= 1;
                bucket = full + partial;
            }
            let at = bucket * s.bucket_bytes;
            centre = Vec3::new(f32_at(centres, at), f32_at(centres, at + 4), f32_at(centres, at + 8));
        }
        decode(path, s, level, sh_range, b, centre, g)?;
    }
    Ok(())
}

fn decode(
    path: &Path,
    s: &Section,
    level: usize,
    [low, high]: [f32; 2],
    b: &[u8],
    centre: Vec3,
    g: &mut Gaussians,
) -> Result<(), IoError> {
    let value = |k: usize| if level == 0 { f32_at(b, 4 * k) } else { half(u16_at(b, 2 * k)) };
    let mean = if level == 0 {
        Vec3::new(value(0), value(1), value(2))
    } else {
        let step = s.block / 2.0 / s.range;
        Vec3::from_array([0, 1, 2].map(|k| (f32::from(u16_at(b, 2 * k)) - s.range) * step)) + centre
    };
    let colour = if level == 0 { 40 } else { 20 };
    let mut sh: Vec<f32> = (0..3).map(|c| (f32::from(b[colour + c]) / 255.0 - 0.5) / SH_C0).collect();
    let rest = &b[colour + 4..];
    let harmonic = |k: usize| match level {
        0 => f32_at(rest, 4 * k),
        1 => half(u16_at(rest, 2 * k)),
        _ => low + f32::from(rest[k]) / 255.0 * (high - low),
    };
    // Channel-major inside each degree: all red coefficients of the degree, then green, then blue.
    for degree in 1..=g.sh_degree as usize {
        let (first, n) = ((degree * degree - 1) * 3, 2 * degree + 1);
        for k in 0..n {
            sh.extend((0..3).map(|c| harmonic(first + c * n + k)));
        }
    }
    let item = Item {
        mean,
        log_scale: Vec3::from_array([3, 4, 5].map(|k| value(k).max(0.0).ln())),
        rotation: unit(Quat::from_xyzw(value(7), value(8), value(9), value(6))),
        opacity: f32::from(b[colour + 3]) / 255.0,
        sh: &sh,
    };
    push(path, g, &item)
}
