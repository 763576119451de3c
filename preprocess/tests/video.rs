//! Videos of all kinds become right frames or clear errors.

mod common;

use common::{Scratch, shared};
use preprocess::{FrameConfig, PreprocessError, video_frames};
use scene::progress::{Progress, ProgressSink};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

fn config(frames: usize) -> FrameConfig {
    FrameConfig { frames: Some(frames), ..FrameConfig::default() }
}

fn ffmpeg(args: &[&str], output: &Path) {
    let run = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y"])
        .args(args)
        .arg(output)
        .status()
        .unwrap();
    assert!(run.success(), "ffmpeg {args:?}");
}

fn rgb(path: &Path) -> image::RgbImage {
    image::open(path).unwrap().to_rgb8()
}

/// PSNR of two images of one size, dB.
fn psnr(a: &image::RgbImage, b: &image::RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: f64 =
        a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (255.0_f64.powi(2) * a.as_raw().len() as f64 / sum.max(1e-9)).log10()
}

#[test]
fn a_rotated_phone_video_comes_out_upright_with_the_times_of_its_frames() {
    let Some(video) = shared("phone_video/checkerboard_rotated.mp4") else { return };
    let out = Scratch::new("rotated");
    let every = FrameConfig {
        every: Some(1),
        duplicate_levels: 0.0,
        end: Some(2.0),
        max_size: 640,
        ..FrameConfig::default()
    };
    let set = video_frames(&video, &out.0, &every, &Progress::silent()).unwrap();
    let probe = Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-select_streams",
            "v:0",
            "-show_entries",
            "frame=pts_time",
            "-of",
            "csv=p=0",
            "-read_intervals",
            "%+3",
        ])
        .arg(&video)
        .output()
        .unwrap();
    let times: Vec<f64> = String::from_utf8(probe.stdout)
        .unwrap()
        .lines()
        .filter_map(|l| l.trim_end_matches(',').parse().ok())
        .collect();
    assert!(set.len() > 50);
    for frame in &set.frames {
        let time = frame.time_s.unwrap();
        assert!(
            (time - times[frame.source_index]).abs() < 1e-6,
            "{} {time} {}",
            frame.name,
            times[frame.source_index]
        );
        assert_eq!((frame.width, frame.height), (360, 640), "portrait");
    }
    // ffmpeg turns by the display matrix and gets it right.
    let reference = out.0.join("reference.png");
    ffmpeg(
        &[
            "-i",
            video.to_str().unwrap(),
            "-vf",
            "select=eq(n\\,20),scale=360:640:flags=area",
            "-frames:v",
            "1",
        ],
        &reference,
    );
    let ours = set.frames.iter().find(|f| f.source_index == 20).unwrap();
    let value = psnr(&rgb(&ours.path), &rgb(&reference));
    assert!(value > 32.0, "{value} dB");
}

#[test]
fn time_stamps_are_right_across_the_gap_and_to_the_last_frame() {
    let Some(video) = shared("phone_video/checkerboard_rotated.mp4") else { return };
    let out = Scratch::new("gap");
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, max_size: 64, ..FrameConfig::default() };
    let set = video_frames(&video, &out.0, &all, &Progress::silent()).unwrap();
    assert_eq!(set.len(), 415);
    let times: Vec<f64> = set.frames.iter().map(|f| f.time_s.unwrap()).collect();
    let gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    assert_eq!(gaps.iter().filter(|g| (**g - 1.0 / 15.0).abs() < 1e-4).count(), 1, "one gap of 66.7 ms");
    assert_eq!(gaps.iter().filter(|g| (**g - 1.0 / 30.0).abs() < 1e-4).count(), 413);
    assert!(
        (times[0] - 0.066_667).abs() < 1e-5 && (times[414] - 13.9).abs() < 0.05,
        "{} {}",
        times[0],
        times[414]
    );
    assert!(set.notes.iter().any(|n| n.contains("66.7 ms")), "{:?}", set.notes);
}

#[test]
fn a_phone_orbit_gives_as_many_frames_as_asked_for() {
    let Some(video) = shared("phone_video/can_orbit.mp4") else { return };
    let out = Scratch::new("can");
    let set = video_frames(&video, &out.0, &config(48), &Progress::silent()).unwrap();
    assert!(set.is_video && (46..=48).contains(&set.len()), "{} {:?}", set.len(), set.notes);
    assert!(set.frames.iter().all(|f| (f.width, f.height) == (720, 1280) && f.path.is_file()));
    assert_eq!(out.list("images").len(), set.len());
    assert_eq!(out.list(""), [".film.png", "images"], "nothing temporary is left");
    // OpenCV ignores the Rec. 709 matrix of the stream; ffmpeg does not.
    let (ours, reference) = (&set.frames[20], out.0.join("reference.png"));
    let select = format!("select=eq(n\\,{})", ours.source_index);
    ffmpeg(&["-i", video.to_str().unwrap(), "-vf", &select, "-frames:v", "1"], &reference);
    let (ours, reference) = (rgb(&ours.path), rgb(&reference));
    let mean = |i: &image::RgbImage, c: usize| {
        i.pixels().map(|p| f64::from(p[c])).sum::<f64>() / f64::from(i.width() * i.height())
    };
    for c in 0..3 {
        assert!(
            (mean(&ours, c) - mean(&reference, c)).abs() < 1.0,
            "channel {c}: {} {}",
            mean(&ours, c),
            mean(&reference, c)
        );
    }
    assert!(psnr(&ours, &reference) > 38.0, "{}", psnr(&ours, &reference));
}

#[test]
fn green_screen_clips_decode_whole() {
    for name in ["plane", "shark", "lion_olive_key"] {
        let Some(video) = shared(&format!("greenscreen/{name}.mp4")) else { return };
        let out = Scratch::new(name);
        let set = video_frames(&video, &out.0, &config(12), &Progress::silent()).unwrap();
        assert!(set.len() >= 10, "{name}: {} {:?}", set.len(), set.notes);
        assert!(!set.notes.iter().any(|n| n.contains("damage")), "{name}: {:?}", set.notes);
    }
}

#[test]
fn every_bad_file_ends_in_frames_or_in_an_error_that_names_it() {
    let Some(folder) = shared("bad_media") else { return };
    let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    for path in names {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let out = Scratch::new("bad");
        let start = std::time::Instant::now();
        let result = video_frames(&path, &out.0, &config(5), &Progress::silent());
        println!(
            "{name} ({:.2} s): {}",
            start.elapsed().as_secs_f64(),
            match &result {
                Ok(set) => format!("{} frames {:?}", set.len(), set.notes),
                Err(e) => e.to_string(),
            }
        );
        match result {
            Ok(set) => assert!(!set.is_empty() && out.list("images").len() == set.len()),
            Err(e) => {
                assert!(e.to_string().contains(&name), "{e}");
                assert!(out.list("").is_empty(), "{name} left {:?}", out.list(""));
            }
        }
    }
}

#[test]
fn what_is_no_video_is_refused_by_kind() {
    let out = Scratch::new("kinds");
    let try_path =
        |path: &Path| video_frames(path, &out.0.join("out"), &config(5), &Progress::silent()).unwrap_err();
    assert!(matches!(try_path(&out.0), PreprocessError::WrongKind { .. }));
    assert!(matches!(try_path(&out.0.join("none.mp4")), PreprocessError::NotFound { .. }));
    assert!(matches!(try_path(Path::new("/dev/null")), PreprocessError::WrongKind { .. }));
    let empty = out.0.join("empty.mp4");
    std::fs::write(&empty, b"").unwrap();
    assert!(matches!(try_path(&empty), PreprocessError::EmptyFile { .. }));
    let text = out.0.join("-i text.mp4");
    std::fs::write(&text, b"this is a letter, not a film").unwrap();
    assert!(matches!(try_path(&text), PreprocessError::NotAVideo { .. }));
    if let Some(bad) = shared("bad_media") {
        let kind = |name: &str| try_path(&bad.join(name));
        assert!(matches!(kind("mp4parse_afconvert-aac-0.5s.mp4"), PreprocessError::NoVideoStream { .. }));
        assert!(matches!(kind("mp4parse_short-cenc.mp4"), PreprocessError::Encrypted { .. }));
        assert!(matches!(kind("mp4parse_test_case_1185230.mp4"), PreprocessError::NothingDecodes { .. }));
    }
}

#[test]
fn damage_in_the_middle_is_told_and_what_can_be_read_is_kept() {
    let out = Scratch::new("damage");
    let whole = out.0.join("whole.mp4");
    ffmpeg(
        &[
            "-f",
            "lavfi",
            "-i",
            "testsrc2=size=320x240:rate=30:duration=3",
            "-g",
            "15",
            "-movflags",
            "+faststart",
        ],
        &whole,
    );
    let mut bytes = std::fs::read(&whole).unwrap();
    let truncated = out.0.join("truncated.mp4");
    std::fs::write(&truncated, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let set = video_frames(&truncated, &out.0.join("a"), &config(30), &Progress::silent()).unwrap();
    assert!(set.notes.iter().any(|n| n.contains("damage")), "{:?}", set.notes);
    assert!(
        set.len() > 10 && set.frames.last().unwrap().time_s.unwrap() < 2.0,
        "{} {:?}",
        set.len(),
        set.notes
    );
    let length = bytes.len();
    bytes[length / 2..length / 2 + 3000].iter_mut().enumerate().for_each(|(i, b)| *b = (i * 97 % 251) as u8);
    let scratched = out.0.join("scratched.mp4");
    std::fs::write(&scratched, &bytes).unwrap();
    let set = video_frames(&scratched, &out.0.join("b"), &config(30), &Progress::silent()).unwrap();
    assert!(set.notes.iter().any(|n| n.contains("damage")), "{:?}", set.notes);
    assert!(set.frames.last().unwrap().time_s.unwrap() > 2.5, "goes on behind the damage: {:?}", set.notes);
}

#[test]
fn hdr_video_is_brought_down_and_stretched_pixels_are_made_square() {
    let out = Scratch::new("hdr");
    let hlg = out.0.join("hlg.mp4");
    let colours = ["-color_primaries", "bt2020", "-color_trc", "arib-std-b67", "-colorspace", "bt2020nc"];
    let source = [
        "-f",
        "lavfi",
        "-i",
        "testsrc2=size=160x120:rate=10:duration=1",
        "-c:v",
        "libx265",
        "-x265-params",
        "log-level=none",
        "-pix_fmt",
        "yuv420p10le",
    ];
    ffmpeg(&[&source[..], &colours[..]].concat(), &hlg);
    let set = video_frames(&hlg, &out.0.join("a"), &config(5), &Progress::silent()).unwrap();
    assert!(set.notes.iter().any(|n| n.contains("HLG")), "{:?}", set.notes);
    assert_eq!(set.len(), 5);
    let wide = out.0.join("wide.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc2=size=160x120:rate=10:duration=1", "-vf", "setsar=3/2"], &wide);
    let set = video_frames(&wide, &out.0.join("b"), &config(5), &Progress::silent()).unwrap();
    assert_eq!((set.frames[0].width, set.frames[0].height), (240, 120), "{:?}", set.notes);
}

#[test]
fn a_still_picture_is_one_frame_and_the_sharp_frame_of_each_stretch_wins() {
    let out = Scratch::new("still");
    let still = out.0.join("still.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "color=c=gray:size=64x48:rate=10:duration=3"], &still);
    let set = video_frames(&still, &out.0.join("a"), &config(10), &Progress::silent()).unwrap();
    assert_eq!(set.len(), 1);
    assert!(set.notes.iter().any(|n| n.contains("same as the one before")), "{:?}", set.notes);
    // Blurred except for every seventh frame.
    let blurred = out.0.join("blurred.mp4");
    ffmpeg(
        &[
            "-f",
            "lavfi",
            "-i",
            "testsrc2=size=320x240:rate=30:duration=2",
            "-vf",
            "boxblur=4:enable='mod(n\\,7)'",
            "-crf",
            "12",
        ],
        &blurred,
    );
    let set = video_frames(
        &blurred,
        &out.0.join("b"),
        &FrameConfig { every: Some(7), ..FrameConfig::default() },
        &Progress::silent(),
    )
    .unwrap();
    let sharp = set.frames.iter().filter(|f| f.source_index % 7 == 0).count();
    assert!(sharp >= set.len() - 1 && set.len() >= 8, "{sharp} of {}", set.len());
}

struct StopAt(u64, &'static AtomicBool);

impl ProgressSink for StopAt {
    fn begin(&self, _: &str, _: u64) {}
    fn update(&self, done: u64, _: &str) {
        if done >= self.0 {
            self.1.store(true, Ordering::Relaxed);
        }
    }
    fn note(&self, _: &str) {}
}

#[test]
fn a_cancelled_run_leaves_the_older_result_alone() {
    static STOP: AtomicBool = AtomicBool::new(false);
    let out = Scratch::new("cancel");
    let video = out.0.join("video.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc2=size=160x120:rate=30:duration=2"], &video);
    let result = out.0.join("result");
    let first = video_frames(&video, &result, &config(4), &Progress::silent()).unwrap();
    let progress = Progress::new(Box::new(StopAt(40, &STOP)), &STOP);
    let second = video_frames(&video, &result, &config(40), &progress);
    assert!(matches!(second, Err(PreprocessError::Cancelled(_))));
    assert_eq!(out.list("result"), [".film.png", "images"]);
    assert_eq!(out.list("result/images").len(), first.len());
}
