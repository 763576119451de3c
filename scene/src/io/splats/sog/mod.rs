//! PlayCanvas' [`.sog`], version 2: a zip archive of lossless WebP images, a pixel a Gaussian, and
//! `meta.json`.
//!
//! [`.sog`]: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/
//!
//! Positions `sign(x) ln(1 + |x|)` in 16 bits between least and most; log scales and colours are
//! numbers of a codebook of 256; rotations smallest three in 8 bits each, alpha says which is the
//! largest; harmonics are numbers of a palette, 64 entries a row. Axes are those of `.ply`.

mod codebook;
mod read;
mod write;

pub(super) use read::parse;
pub use write::write_sog;

use serde::{Deserialize, Serialize};

/// Entries of the palette in a row of its image. Source: the format.
const PALETTE_ROW: usize = 64;
/// Alpha of a rotation whose w is the largest; x, y and z follow. Source: the format.
const LARGEST_W: u8 = 252;
/// Components in the order of the format: w, x, y, z, as indices into glam's x, y, z, w.
const ORDER: [usize; 4] = [3, 0, 1, 2];

#[derive(Serialize, Deserialize)]
struct Meta {
    version: u32,
    count: usize,
    #[serde(default)]
    antialias: bool,
    means: MeansMeta,
    scales: CodebookMeta,
    quats: FilesMeta,
    sh0: CodebookMeta,
    #[serde(rename = "shN", default, skip_serializing_if = "Option::is_none")]
    sh_n: Option<HarmonicsMeta>,
}

#[derive(Serialize, Deserialize)]
struct MeansMeta {
    mins: [f32; 3],
    maxs: [f32; 3],
    files: [String; 2],
}

#[derive(Serialize, Deserialize)]
struct CodebookMeta {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Serialize, Deserialize)]
struct FilesMeta {
    files: [String; 1],
}

#[derive(Serialize, Deserialize)]
struct HarmonicsMeta {
    count: usize,
    bands: u32,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// Three of the components of a rotation, those that are not the largest.
fn others(largest: usize) -> [usize; 3] {
    let mut rest = (0..4).filter(|c| *c != largest);
    std::array::from_fn(|_| rest.next().unwrap_or(0))
}
