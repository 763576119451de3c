//! Frames and mattes of one capture, with a contact sheet to look at.
//!
//! `cargo run --release -p preprocess --example matte -- VIDEO_OR_FOLDER OUT [KEY]`

use preprocess::{FrameConfig, KeyConfig, contact_sheet, matte_frames, photo_frames, video_frames};
use scene::Progress;
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), preprocess::PreprocessError> {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(input), Some(out)) = (args.next(), args.next()) else {
        eprintln!("usage: matte VIDEO_OR_FOLDER OUT [KEY]");
        std::process::exit(1);
    };
    let key = args.next().map_or_else(KeyConfig::default, |k| KeyConfig {
        key: k.to_string_lossy().into_owned(),
        ..KeyConfig::default()
    });
    let (progress, start) = (Progress::silent(), Instant::now());
    let (frames, folder) = (FrameConfig::default(), out.join("frames"));
    let set = if input.is_dir() {
        photo_frames(&input, &folder, &frames, &progress)?
    } else {
        video_frames(&input, &folder, &frames, &progress)?
    };
    let decoded = start.elapsed().as_secs_f64();
    let mattes = matte_frames(&set, &out, &key, &progress)?;
    contact_sheet(&mattes, &out.join("sheet.png"))?;
    mattes.notes.iter().for_each(|note| println!("{note}"));
    println!(
        "{} frames; {decoded:.2} s for frames, {:.2} s for mattes",
        mattes.len(),
        start.elapsed().as_secs_f64() - decoded
    );
    Ok(())
}
