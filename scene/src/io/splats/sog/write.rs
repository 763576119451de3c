//! Writing `.sog`.

use super::{
    CodebookMeta, FilesMeta, HarmonicsMeta, LARGEST_W, MeansMeta, Meta, ORDER, PALETTE_ROW, codebook, others,
};
use crate::Gaussians;
use crate::io::atomic::write_file_atomic;
use crate::io::error::IoError;
use crate::io::splats::item::{unit, unit_byte};
use crate::morton::morton_order;
use glam::{Quat, Vec3};
use image::ExtendedColorType::Rgba8;
use image::ImageEncoder;
use image::codecs::webp::WebPEncoder;
use std::io::{self, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Entries of a codebook. Source: the format, a byte.
const BOOK: usize = 256;
/// So many Gaussians share an entry of the palette, and its most entries. Source: the format, 16
/// bits; a quarter was chosen by hand.
const PALETTE: (usize, usize) = (4, 1 << 16);

/// Writes a `.sog` file. Gaussians are sorted along a Morton curve, so that neighbours in the
/// images are neighbours in space.
pub fn write_sog(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    if g.is_empty() {
        return Err(IoError::format(path, "a .sog file cannot hold an empty splat"));
    }
    let order = morton_order(&g.means);
    let mut sog = SogWriter::new(order.len());
    let means = sog.means(order.iter().map(|&i| g.means[i]));
    let scales: Vec<f32> = order.iter().flat_map(|&i| g.log_scales[i].to_array()).collect();
    let scales = sog.coded("scales.webp", &scales, |_| 255);
    sog.rotations(order.iter().map(|&i| unit(g.rotations[i])));
    let stride = g.sh_coefficients() * 3;
    let colours: Vec<f32> = order.iter().flat_map(|&i| g.sh[i * stride..][..3].iter().copied()).collect();
    let sh0 = sog.coded("sh0.webp", &colours, |n| unit_byte(g.opacity(order[n])));
    let rest: Vec<f32> =
        order.iter().flat_map(|&i| g.sh[i * stride + 3..(i + 1) * stride].iter().copied()).collect();
    let sh_n = (stride > 3).then(|| sog.harmonics(&rest, stride - 3, g.sh_degree));
    let quats = FilesMeta { files: ["quats.webp".into()] };
    let meta = Meta { version: 2, count: order.len(), antialias: false, means, scales, quats, sh0, sh_n };
    write_file_atomic(path, |file| sog.finish(file, &meta))
}

/// Images of a pixel a Gaussian, as they are made.
struct SogWriter {
    count: usize,
    width: usize,
    height: usize,
    images: Vec<(&'static str, usize, usize, Vec<u8>)>,
}

impl SogWriter {
    fn new(count: usize) -> Self {
        // Sides are multiples of four, as textures like them.
        let width = ((count as f64).sqrt().ceil() as usize).next_multiple_of(4);
        let height = count.div_ceil(width).next_multiple_of(4);
        Self { count, width, height, images: Vec::new() }
    }

    fn add(&mut self, name: &'static str, pixels: impl Iterator<Item = [u8; 4]>) {
        let mut bytes: Vec<u8> = pixels.flatten().collect();
        bytes.resize(self.width * self.height * 4, 0);
        self.images.push((name, self.width, self.height, bytes));
    }

    fn means(&mut self, means: impl Iterator<Item = Vec3>) -> MeansMeta {
        let logs: Vec<Vec3> = means.map(|m| m.signum() * (m.abs() + 1.0).map(f32::ln)).collect();
        let low = logs.iter().fold(Vec3::INFINITY, |a, v| a.min(*v));
        let high = logs.iter().fold(Vec3::NEG_INFINITY, |a, v| a.max(*v));
        let range = (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
        let names = ["means_l.webp", "means_u.webp"];
        for (byte, name) in names.into_iter().enumerate() {
            let pixels = logs.iter().map(|v| {
                let steps = ((*v - low) / range * 65_535.0).round().to_array();
                let [x, y, z] = steps.map(|s| (s as u16).to_le_bytes()[byte]);
                [x, y, z, 255]
            });
            self.add(name, pixels);
        }
        MeansMeta { mins: low.to_array(), maxs: high.to_array(), files: names.map(str::to_owned) }
    }

    /// Three numbers a Gaussian by their place in a codebook, and its alpha.
    fn coded(&mut self, name: &'static str, values: &[f32], alpha: impl Fn(usize) -> u8) -> CodebookMeta {
        let book = codebook::of_numbers(values, BOOK);
        let pixels = values.chunks_exact(3).enumerate().map(|(n, v)| {
            let [a, b, c] = [v[0], v[1], v[2]].map(|v| codebook::nearest(&book, v));
            [a, b, c, alpha(n)]
        });
        self.add(name, pixels);
        CodebookMeta { codebook: book, files: [name.into()] }
    }

    fn rotations(&mut self, rotations: impl Iterator<Item = Quat>) {
        let pixels = rotations.map(|q| {
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
        let size = (self.count / PALETTE.0).clamp(1, PALETTE.1);
        let (palette, labels) = codebook::of_vectors(values, width, size);
        let book = codebook::of_numbers(&palette, BOOK);
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
            let mut webp = Vec::new();
            WebPEncoder::new_lossless(&mut webp)
                .write_image(&pixels, width as u32, height as u32, Rgba8)
                .map_err(io::Error::other)?;
            zip.start_file(name, options)?;
            zip.write_all(&webp)?;
        }
        zip.finish()?.flush()
    }
}
