//! Prints how well mattes of a simulated green screen are recovered, beside simpler ways.
//!
//! `cargo run --release -p preprocess --example key_table` (needs `../shared/data`, or SAT_RECON_SHARED).

#[path = "../tests/common/screen.rs"]
mod screen;

use image::{GrayImage, RgbImage};
use preprocess::chroma::{KeyConfig, Keyer, MatteMode, Scratch, THUMBNAIL_SIDE};
use preprocess::{FrameConfig, video_frames};
use rayon::prelude::*;
use scene::Progress;
use scene::io::{load_rgb, resize_area};
use screen::{HEIGHT, LIGHTS, Light, SCREEN, Score, Shot, WIDTH, cut_outs, encode, film, score};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

fn main() {
    let root = std::env::var_os("SAT_RECON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    println!("| capture | light | way | IoU | mean alpha error | boundary F, 1 px | spill, levels of 255 |");
    println!("|---|---|---|---|---|---|---|");
    for (name, step) in [("lego400", 8), ("temple_ring", 6)] {
        let cut_outs = cut_outs(&root.join("data").join(name), step);
        for light in LIGHTS {
            rows(name, light, &cut_outs);
        }
    }
}

fn rows(name: &str, light: Light, cut_outs: &[image::RgbaImage]) {
    let folder = std::env::temp_dir().join(format!("key_table_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let shots: Vec<Shot> = cut_outs.iter().enumerate().map(|(i, c)| film(c, light, i as u64)).collect();
    let video = folder.join("video.mp4");
    encode(&shots, &video);
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, ..FrameConfig::default() };
    let set = video_frames(&video, &folder.join("out"), &all, &Progress::silent()).expect("frames");
    let frames: Vec<RgbImage> = set.frames.iter().map(|f| load_rgb(&f.path).expect("frame")).collect();
    assert_eq!(frames.len(), shots.len());
    let print = |way: &str, mattes: &[(GrayImage, RgbImage)]| {
        let scores: Vec<Score> = mattes.iter().zip(&shots).map(|((m, c), s)| score(m, c, s)).collect();
        let s = Score::mean(&scores);
        println!(
            "| {name} | {} | {way} | {:.4} | {:.4} | {:.4} | {:.2} |",
            light.name, s.iou, s.alpha_error, s.boundary_f, s.spill
        );
    };
    print("ours", &keyed(&frames, MatteMode::Soft, light));
    if std::env::var_os("KEY_TABLE_BRIEF").is_some() {
        std::fs::remove_dir_all(&folder).expect("clean up");
        return;
    }
    print("green to black", &keyed(&frames, MatteMode::Plain, light));
    let best = [0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.16]
        .map(|similarity| chromakey(&video, &frames, light, similarity));
    let iou = |mattes: &[(GrayImage, RgbImage)]| {
        mattes.iter().zip(&shots).map(|((m, c), s)| score(m, c, s).iou).sum::<f64>()
    };
    if let Some(best) = best.iter().max_by(|a, b| iou(a).total_cmp(&iou(b))) {
        print("ffmpeg chromakey (best of 7)", best);
    }
    if let Some(dump) = std::env::var_os("KEY_TABLE_DUMP") {
        let dump = PathBuf::from(dump);
        let (matte, colours) = &keyed(&frames[..1], MatteMode::Soft, light)[0];
        let stem = format!("{name}_{}", light.gain);
        frames[0].save(dump.join(format!("{stem}_frame.png"))).expect("dump");
        matte.save(dump.join(format!("{stem}_matte.png"))).expect("dump");
        colours.save(dump.join(format!("{stem}_colours.png"))).expect("dump");
        shots[0].alpha.save(dump.join(format!("{stem}_true.png"))).expect("dump");
    }
    std::fs::remove_dir_all(&folder).expect("clean up");
}

fn keyed(frames: &[RgbImage], matte: MatteMode, light: Light) -> Vec<(GrayImage, RgbImage)> {
    let thumbnails: Vec<RgbImage> =
        frames.iter().map(|f| resize_area(f, THUMBNAIL_SIDE, THUMBNAIL_SIDE * HEIGHT / WIDTH)).collect();
    // The screen is the same in all frames, but the camera is taken for moving: nothing is learnt over time.
    let config = KeyConfig { matte, ..KeyConfig::with_key("auto") };
    let keyer = Keyer::find(&thumbnails, &config).expect("config").expect("a screen");
    let (start, cpu) = (Instant::now(), cpu_seconds());
    let repeats = if matte == MatteMode::Soft { 6 } else { 1 };
    let mut result = Vec::new();
    for _ in 0..repeats {
        result = frames.par_iter().map_init(Scratch::default, |scratch, f| keyer.matte(f, scratch)).collect();
    }
    if matte == MatteMode::Soft {
        let count = (repeats * frames.len()) as f64;
        let (wall, cpu) = (start.elapsed().as_secs_f64() / count, (cpu_seconds() - cpu) / count);
        eprintln!("{} light: {}", light.name, keyer.evidence);
        eprintln!(
            "    {:.1} CPU ms a frame; {:.0} frames a second on {} threads",
            1e3 * cpu,
            1.0 / wall,
            rayon::current_num_threads()
        );
    }
    result
}

fn chromakey(video: &Path, frames: &[RgbImage], light: Light, similarity: f64) -> Vec<(GrayImage, RgbImage)> {
    let colour: Vec<String> =
        SCREEN.iter().map(|c| format!("{:02x}", screen::to_srgb(c * light.gain))).collect();
    let filter = format!("chromakey=0x{}:{similarity}:0.06,format=rgba", colour.concat());
    let output = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(video)
        .args(["-vf", &filter, "-f", "rawvideo", "-"])
        .output()
        .expect("ffmpeg");
    let bytes = (4 * WIDTH * HEIGHT) as usize;
    let matte = |frame: &[u8]| {
        GrayImage::from_raw(WIDTH, HEIGHT, frame.chunks_exact(4).map(|p| p[3]).collect()).expect("size")
    };
    output.stdout.chunks_exact(bytes).zip(frames).map(|(f, original)| (matte(f), original.clone())).collect()
}

/// User and system time of this process (Linux: clock ticks of 10 ms).
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat
        .rsplit_once(')')
        .map(|(_, rest)| rest.split_whitespace().collect::<Vec<_>>())
        .unwrap_or_default();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}
