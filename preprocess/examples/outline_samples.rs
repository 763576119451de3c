//! Writes what the key's network is trained with (`tools/train_outline.py`).
//!
//! `cargo run --release -p preprocess --example outline_samples -- OUT [--every K] FOLDER...`: of
//! every K-th frame of each folder's `video.mp4` with a true matte (`mattes/frame_NNNNNN.png`),
//! rows of little-endian f32: inputs, alpha of the key, true alpha.

use image::RgbImage;
use preprocess::matting::{KeyConfig, Keyer, Scratch, THUMBNAIL_SIDE};
use preprocess::{FrameConfig, video_frames};
use rayon::prelude::*;
use scene::Progress;
use scene::io::{load_rgb, resize_area};
use std::io::Write;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (mut out, mut every) =
        (std::io::BufWriter::new(std::fs::File::create(args.next().ok_or("OUT")?)?), 1);
    let mut folders = Vec::new();
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--every" => every = args.next().ok_or("K")?.parse::<usize>()?.max(1),
            _ => folders.push(PathBuf::from(arg)),
        }
    }
    for folder in folders {
        let rows = samples(&folder, every)?;
        println!("{}: {} numbers", folder.display(), rows.len());
        for v in rows {
            out.write_all(&v.to_le_bytes())?;
        }
    }
    Ok(out.flush()?)
}

fn samples(folder: &Path, every: usize) -> Result<Vec<f32>, Box<dyn std::error::Error>> {
    let decoded = std::env::temp_dir().join(format!("outline_samples_{}", std::process::id()));
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, ..FrameConfig::default() };
    let set = video_frames(&folder.join("video.mp4"), &decoded.join("out"), &all, &Progress::silent())?;
    let frames = set.frames.iter().map(|f| load_rgb(&f.path)).collect::<Result<Vec<RgbImage>, _>>()?;
    std::fs::remove_dir_all(&decoded)?;
    let thumbnails: Vec<RgbImage> = frames
        .iter()
        .map(|f| resize_area(f, THUMBNAIL_SIDE, THUMBNAIL_SIDE * f.height() / f.width()))
        .collect();
    let Ok(mut keyer) = Keyer::find(&thumbnails, &KeyConfig::with_key("auto"))? else {
        return Ok(Vec::new()); // No screen was found: nothing to learn from.
    };
    let some: Vec<RgbImage> = frames.iter().step_by(frames.len().div_ceil(24)).cloned().collect();
    keyer.learn(&some);
    let truth =
        |i: usize| image::open(folder.join(format!("mattes/frame_{i:06}.png"))).ok().map(|t| t.to_luma8());
    let rows = (0..frames.len()).into_par_iter().step_by(every).map_init(Scratch::default, |scratch, i| {
        truth(i).map_or_else(Vec::new, |t| keyer.outline_samples(&frames[i], &t, scratch))
    });
    Ok(rows.collect::<Vec<_>>().concat())
}
