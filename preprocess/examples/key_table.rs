//! Prints how well mattes of a simulated green screen are recovered, beside simpler ways.
//!
//! `cargo run --release -p preprocess --example key_table [-- CASE...]`: the named cases of the
//! test bed (folders with `video.mp4` and `mattes/`), or cut-outs of `../shared/data` (or
//! SAT_RECON_SHARED) before a simulated screen. `--no-head` first: rows only. KEY_TABLE_BRIEF: only
//! ours. KEY_TABLE_DUMP: a folder for pictures of the worst frame and for a case with all mattes.

#[path = "../tests/common/screen.rs"]
mod screen;

use image::{GrayImage, RgbImage};
use preprocess::matting::{KeyConfig, Keyer, Scratch, THUMBNAIL_SIDE};
use preprocess::{FrameConfig, video_frames};
use rayon::prelude::*;
use scene::Progress;
use scene::io::{load_rgb, resize_area};
use screen::{CLOTHS, Cloth, HEIGHT, LIGHTS, Light, Score, Shot, WIDTH, cut_outs, encode, film, score};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

fn main() {
    let root = std::env::var_os("SAT_RECON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let mut cases: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if cases.first().is_some_and(|c| c.as_os_str() == "--no-head") {
        cases.remove(0);
    } else {
        println!(
            "| capture | light | way | IoU | mean alpha error | boundary F, 1 px | spill, levels of 255 | rods kept | inside lost | kept beside | CPU ms a frame |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|---|");
    }
    for case in &cases {
        rows(&filmed_case(case));
    }
    if !cases.is_empty() {
        return;
    }
    for (name, step) in [("lego400", 8), ("temple_ring", 6)] {
        let cut_outs = cut_outs(&root.join("data").join(name), step);
        for (light, cloth) in LIGHTS.into_iter().flat_map(|l| CLOTHS.map(|c| (l, c))) {
            rows(&composited(name, light, cloth, &cut_outs));
        }
    }
}

/// A video with true mattes of some of its frames.
struct Capture {
    name: String,
    light: &'static str,
    video: PathBuf,
    frames: Vec<RgbImage>,
    /// Frames of which the truth is known, with it.
    shots: Vec<(usize, Shot)>,
    /// Colour of the screen for ffmpeg, 8-bit sRGB.
    screen: [u8; 3],
    /// The camera stands still, so the screen may be learnt over time.
    stands: bool,
    folder: PathBuf,
}

fn decoded(video: &Path, folder: &Path) -> Vec<RgbImage> {
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, ..FrameConfig::default() };
    let set = video_frames(video, &folder.join("out"), &all, &Progress::silent()).expect("frames");
    set.frames.par_iter().map(|f| load_rgb(&f.path).expect("frame")).collect()
}

fn scratch(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("key_table_{name}_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    folder
}

fn composited(name: &str, light: Light, cloth: Cloth, cut_outs: &[image::RgbaImage]) -> Capture {
    let name = format!("{name}, {}", cloth.name);
    let folder = scratch(&name);
    let shots: Vec<Shot> =
        cut_outs.iter().enumerate().map(|(i, c)| film(c, light, cloth, i as u64)).collect();
    let video = folder.join("video.mp4");
    encode(&shots, &video);
    let frames = decoded(&video, &folder);
    assert_eq!(frames.len(), shots.len());
    let screen = cloth.linear.map(|c| screen::to_srgb(c * light.gain));
    let shots = shots.into_iter().enumerate().collect();
    Capture { name, light: light.name, video, frames, shots, screen, stands: false, folder }
}

/// A case of the test bed: `video.mp4` and `mattes/frame_NNNNNN.png`. Its foreground has no green
/// of its own, so all that is left counts as spill.
fn filmed_case(case: &Path) -> Capture {
    let name = case.file_name().expect("a folder").to_string_lossy().into_owned();
    let folder = scratch(&name);
    let frames = decoded(&case.join("video.mp4"), &folder);
    let screen = *frames[0].get_pixel(WIDTH / 5, HEIGHT / 4);
    let channel = (0..3).max_by_key(|c| screen.0[*c]).expect("three");
    let shots = (0..frames.len())
        .filter_map(|i| {
            let alpha = image::open(case.join(format!("mattes/frame_{i:06}.png"))).ok()?.to_luma8();
            let clean = RgbImage::new(WIDTH, HEIGHT);
            Some((i, Shot { filmed: frames[i].clone(), alpha, clean, channel }))
        })
        .collect();
    let light = if name.starts_with("case3") { "10 %" } else { "100 %" };
    Capture {
        name: format!("{name}, {}", ["red", "green", "blue"][channel]),
        light,
        video: case.join("video.mp4"),
        frames,
        shots,
        screen: screen.0,
        stands: true,
        folder,
    }
}

type Mattes = Vec<(GrayImage, RgbImage)>;

fn rows(capture: &Capture) {
    let scores = |mattes: &Mattes| {
        Score::mean(
            &capture.shots.iter().map(|(i, s)| score(&mattes[*i].0, &mattes[*i].1, s)).collect::<Vec<_>>(),
        )
    };
    let print = |way: &str, mattes: &Mattes, cost: Option<f64>| {
        let s = scores(mattes);
        println!(
            "| {} | {} | {way} | {:.4} | {:.4} | {:.4} | {:.2} | {:.3} | {:.4} | {:.4} | {} |",
            capture.name,
            capture.light,
            s.iou,
            s.alpha_error,
            s.boundary_f,
            s.spill,
            s.thin,
            s.holes,
            s.garbage,
            cost.map_or(String::new(), |ms| format!("{ms:.1}"))
        );
    };
    let (ours, cost) = keyed(capture);
    print("ours", &ours, Some(cost));
    dump(capture, &ours);
    if std::env::var_os("KEY_TABLE_BRIEF").is_none() {
        print("green to black", &plain(capture), None);
        let best = [0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.16]
            .map(|similarity| chromakey(capture, similarity))
            .into_iter()
            .max_by(|a, b| scores(a).iou.total_cmp(&scores(b).iou));
        print("ffmpeg chromakey (best of 7)", &best.expect("seven"), None);
    }
    std::fs::remove_dir_all(&capture.folder).expect("clean up");
}

/// Into the folder KEY_TABLE_DUMP: pictures of the worst frame, and a folder like a case of the
/// test bed, with our mattes beside.
fn dump(capture: &Capture, mattes: &Mattes) {
    let Some(folder) = std::env::var_os("KEY_TABLE_DUMP").map(PathBuf::from) else { return };
    let iou = |(i, s): &&(usize, Shot)| score(&mattes[*i].0, &mattes[*i].1, s).iou;
    let Some((i, shot)) = capture.shots.iter().min_by(|a, b| iou(a).total_cmp(&iou(b))) else { return };
    let stem = format!("{}_{}", capture.name, capture.light.replace(" %", ""));
    println!("worst of {stem}: frame {i}");
    let save = |what: &str| folder.join(format!("{stem}_{what}.png"));
    capture.frames[*i].save(save("frame")).expect("dump");
    mattes[*i].0.save(save("matte")).expect("dump");
    mattes[*i].1.save(save("colours")).expect("dump");
    shot.alpha.save(save("true")).expect("dump");
    let case = folder.join(&stem);
    for what in ["mattes", "ours"] {
        std::fs::create_dir_all(case.join(what)).expect("dump");
    }
    std::fs::copy(&capture.video, case.join("video.mp4")).expect("dump");
    for (i, shot) in &capture.shots {
        let name = format!("frame_{i:06}.png");
        mattes[*i].0.save(case.join("ours").join(&name)).expect("dump");
        shot.alpha.save(case.join("mattes").join(&name)).expect("dump");
    }
}

/// Mattes of all frames and what one cost, CPU ms.
fn keyed(capture: &Capture) -> (Mattes, f64) {
    let frames = &capture.frames;
    let thumbnails: Vec<RgbImage> =
        frames.iter().map(|f| resize_area(f, THUMBNAIL_SIDE, THUMBNAIL_SIDE * HEIGHT / WIDTH)).collect();
    let mut keyer =
        Keyer::find(&thumbnails, &KeyConfig::with_key("auto")).expect("config").expect("a screen");
    if capture.stands {
        let samples: Vec<RgbImage> = frames.iter().step_by(frames.len().div_ceil(24)).cloned().collect();
        let cpu = cpu_seconds();
        let found = keyer.learn(&samples);
        eprintln!("learnt in {:.2} CPU s: {}", cpu_seconds() - cpu, found.unwrap_or_default());
    }
    let (start, cpu) = (Instant::now(), cpu_seconds());
    let brief = std::env::var_os("KEY_TABLE_BRIEF").is_some();
    let repeats = if !brief { 200_usize.div_ceil(frames.len()) } else { 1 };
    let mut result = Vec::new();
    for _ in 0..repeats {
        result = frames.par_iter().map_init(Scratch::default, |scratch, f| keyer.matte(f, scratch)).collect();
    }
    let count = (repeats * frames.len()) as f64;
    let (wall, cpu) = (start.elapsed().as_secs_f64() / count, (cpu_seconds() - cpu) / count);
    let why = keyer.decision.sentences().evidence.join("; ");
    eprintln!("{} at {} light: {why}", capture.name, capture.light);
    let threads = rayon::current_num_threads();
    eprintln!("    {:.1} CPU ms a frame; {:.0} frames a second on {threads} threads", 1e3 * cpu, 1.0 / wall);
    (result, 1e3 * cpu)
}

/// The usual rule: what has the screen's hue and some saturation is background.
fn plain(capture: &Capture) -> Mattes {
    let hue = hue_saturation_value(capture.screen).0;
    let cover = |rgb: [u8; 3]| {
        let (own, saturation, value) = hue_saturation_value(rgb);
        let apart = (own - hue).rem_euclid(360.0);
        if saturation > 0.3 && value > 0.1 && apart.min(360.0 - apart) < 35.0 { 0 } else { 255 }
    };
    let matte = |f: &RgbImage| {
        let alpha = f.pixels().map(|p| cover(p.0)).collect();
        (GrayImage::from_raw(WIDTH, HEIGHT, alpha).expect("size"), f.clone())
    };
    capture.frames.iter().map(matte).collect()
}

/// Hue in degrees, saturation and value in [0, 1] (Smith 1978).
fn hue_saturation_value(rgb: [u8; 3]) -> (f32, f32, f32) {
    let [r, g, b] = rgb.map(f32::from);
    let (max, span) = (r.max(g).max(b), r.max(g).max(b) - r.min(g).min(b));
    let sixth = match max {
        _ if span <= 0.0 => 0.0,
        m if m == r => (g - b) / span,
        m if m == g => (b - r) / span + 2.0,
        _ => (r - g) / span + 4.0,
    };
    ((60.0 * sixth).rem_euclid(360.0), span / max.max(1.0), max / 255.0)
}

fn chromakey(capture: &Capture, similarity: f64) -> Mattes {
    let colour: Vec<String> = capture.screen.iter().map(|c| format!("{c:02x}")).collect();
    let filter = format!("chromakey=0x{}:{similarity}:0.06,format=rgba", colour.concat());
    let output = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(&capture.video)
        .args(["-vf", &filter, "-f", "rawvideo", "-"])
        .output()
        .expect("ffmpeg");
    let bytes = (4 * WIDTH * HEIGHT) as usize;
    let matte = |frame: &[u8]| {
        GrayImage::from_raw(WIDTH, HEIGHT, frame.chunks_exact(4).map(|p| p[3]).collect()).expect("size")
    };
    let frames = output.stdout.chunks_exact(bytes).zip(&capture.frames);
    frames.map(|(f, original)| (matte(f), original.clone())).collect()
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
