//! Writing `.sog`.

use super::{
    CodebookMeta, FilesMeta, HarmonicsMeta, LARGEST_W, MeansMeta, Meta, ORDER, PALETTE_ROW, codebook, others,
};
use crate::Gaussians;
use crate::io::atomic::write_file_atomic;
use crate::io::error::IoError;
use crate::io::splats::item::unit_byte;
use crate::io::splats::ready::{ready, rounded, slack};
use glam::{Quat, Vec3};
use std::io::{self, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Steps of log scales, colours and harmonics: entries of a codebook are so far apart where values
/// are common. Source: chosen in trials on two splats, fox and temple_ring, which lost
/// 0.08 dB by all three.
const STEPS: [f32; 3] = [0.05, 0.04, 0.03];

/// Writes a `.sog` file.
pub fn write_sog(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    if g.is_empty() {
        return Err(IoError::format(path, "a .sog file cannot hold an empty splat"));
    }
    let g = ready(g);
    let mut sog = SogWriter::new(g.len());
    let means = sog.means(&g);
    let scales: Vec<f32> = g.log_scales.iter().flat_map(Vec3::to_array).collect();
    let scales = sog.coded("scales.webp", &scales, STEPS[0], |_| 255);
    sog.rotations(&g.rotations);
    let stride = g.sh_coefficients() * 3;
    let colours: Vec<f32> = g.sh.chunks_exact(stride).flat_map(|sh| sh[..3].iter().copied()).collect();
    let sh0 = sog.coded("sh0.webp", &colours, STEPS[1], |n| unit_byte(g.opacity(n)));
    let rest: Vec<f32> = g.sh.chunks_exact(stride).flat_map(|sh| sh[3..].iter().copied()).collect();
    let sh_n = (stride > 3).then(|| sog.harmonics(&rest, stride - 3, g.sh_degree));
    let quats = FilesMeta { files: ["quats.webp".into()] };
    let meta = Meta { version: 2, count: g.len(), antialias: false, means, scales, quats, sh0, sh_n };
    write_file_atomic(path, |file| sog.finish(file, &meta))
}

/// Images of a pixel a Gaussian, as they are made.
struct SogWriter {
    width: usize,
    height: usize,
    images: Vec<(&'static str, usize, usize, Vec<u8>)>,
}

impl SogWriter {
    fn new(count: usize) -> Self {
        // Sides are multiples of four, as textures like them.
        let width = ((count as f64).sqrt().ceil() as usize).next_multiple_of(4);
        let height = count.div_ceil(width).next_multiple_of(4);
        Self { width, height, images: Vec::new() }
    }

    fn add(&mut self, name: &'static str, pixels: impl Iterator<Item = [u8; 4]>) {
        let mut bytes: Vec<u8> = pixels.flatten().collect();
        bytes.resize(self.width * self.height * 4, 0);
        self.images.push((name, self.width, self.height, bytes));
    }

    fn means(&mut self, g: &Gaussians) -> MeansMeta {
        let logs: Vec<Vec3> = g.means.iter().map(|m| m.signum() * m.abs().map(f32::ln_1p)).collect();
        let low = logs.iter().fold(Vec3::INFINITY, |a, v| a.min(*v));
        let high = logs.iter().fold(Vec3::NEG_INFINITY, |a, v| a.max(*v));
        let last = f32::from(u16::MAX);
        let steps = Vec3::splat(last) / (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
        let step_of = |i: usize, k: usize| {
            let slack = slack(g.log_scales[i]) / (1.0 + g.means[i][k].abs()) * steps[k];
            rounded((logs[i][k] - low[k]) * steps[k], slack).min(last) as u16
        };
        let codes: Vec<[u16; 3]> = (0..g.len()).map(|i| [0, 1, 2].map(|k| step_of(i, k))).collect();
        let names = ["means_l.webp", "means_u.webp"];
        for (byte, name) in names.into_iter().enumerate() {
            let bytes = codes.iter().map(|code| code.map(|c| c.to_le_bytes()[byte]));
            self.add(name, bytes.map(|[x, y, z]| [x, y, z, 255]));
        }
        MeansMeta { mins: low.to_array(), maxs: high.to_array(), files: names.map(str::to_owned) }
    }

    /// Three numbers a Gaussian by their place in a codebook, and its alpha.
    fn coded(
        &mut self,
        name: &'static str,
        values: &[f32],
        step: f32,
        alpha: impl Fn(usize) -> u8,
    ) -> CodebookMeta {
        let book = codebook::of_numbers(values, step);
        let pixels = values.chunks_exact(3).enumerate().map(|(n, v)| {
            let [a, b, c] = [v[0], v[1], v[2]].map(|v| codebook::nearest(&book, v));
            [a, b, c, alpha(n)]
        });
        self.add(name, pixels);
        CodebookMeta { codebook: book, files: [name.into()] }
    }

    fn rotations(&mut self, rotations: &[Quat]) {
        let pixels = rotations.iter().map(|q| {
            let wxyz = ORDER.map(|c| q.to_array()[c]);
            let largest = (0..4).max_by(|&a, &b| wxyz[a].abs().total_cmp(&wxyz[b].abs())).unwrap_or(0);
            let sign = wxyz[largest].signum();
            // The three others are at most 1/√2 in size.
            let [a, b, c] =
                others(largest).map(|c| unit_byte((sign * wxyz[c] * std::f32::consts::SQRT_2 + 1.0) / 2.0));
            [a, b, c, LARGEST_W + largest as u8]
        });
        self.add("quats.webp", pixels);
    }

    /// `width`: numbers a Gaussian, coefficient-major.
    fn harmonics(&mut self, values: &[f32], width: usize, bands: u32) -> HarmonicsMeta {
        let (palette, labels) = codebook::of_vectors(values, width, usize::from(u16::MAX) + 1);
        let book = codebook::of_numbers(&palette, STEPS[2]);
        let (entries, coefficients) = (palette.len() / width, width / 3);
        let (columns, rows) = (PALETTE_ROW * coefficients, entries.div_ceil(PALETTE_ROW));
        let mut pixels: Vec<u8> = palette
            .chunks_exact(3)
            .flat_map(|v| [0, 1, 2].map(|c| codebook::nearest(&book, v[c])).into_iter().chain([255]))
            .collect();
        pixels.resize(columns * rows * 4, 0);
        self.images.push(("shN_centroids.webp", columns, rows, pixels));
        self.add("shN_labels.webp", labels.iter().map(|l| [l.to_le_bytes()[0], l.to_le_bytes()[1], 0, 255]));
        let files = ["shN_centroids.webp", "shN_labels.webp"].map(str::to_owned);
        HarmonicsMeta { count: entries, bands, codebook: book, files }
    }

    fn finish(self, file: &Path, meta: &Meta) -> io::Result<()> {
        let mut zip = ZipWriter::new(io::BufWriter::new(std::fs::File::create(file)?));
        // WebP is compressed already.
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file("meta.json", options)?;
        zip.write_all(&serde_json::to_vec(meta)?)?;
        for (name, width, height, pixels) in self.images {
            zip.start_file(name, options)?;
            zip.write_all(&lossless(&pixels, width as u32, height as u32)?)?;
        }
        zip.finish()?.flush()
    }
}

/// A lossless WebP that keeps the colours of transparent pixels too. An encoder that searches is
/// worth a seventh of the file.
fn lossless(rgba: &[u8], width: u32, height: u32) -> io::Result<Vec<u8>> {
    let mut config = webp::WebPConfig::new().map_err(|()| io::Error::other("WebP: no encoder"))?;
    config.lossless = 1;
    config.exact = 1;
    config.quality = 100.0;
    config.method = 6;
    let webp = webp::Encoder::from_rgba(rgba, width, height).encode_advanced(&config);
    Ok(webp.map_err(|e| io::Error::other(format!("WebP: {e:?}")))?.to_vec())
}
