//! Mattes and cleaned images for a whole capture.

use crate::PreprocessError;
use crate::matting::{Background, KeyConfig, Keyer, Scratch, THUMBNAIL_SIDE};
use crate::output::{Staging, write_png};
use crate::pixels::fitted;
use image::{ExtendedColorType, GrayImage, Rgb, RgbImage};
use rayon::prelude::*;
use scene::decision::{Decision, MatteKind, Measurement, Quantity, Remark};
use scene::io::{load_mask, load_rgb, resize_area};
use scene::{Frame, FrameSet, Progress};
use std::path::Path;

/// Frames from which screen, light and still parts are learnt. Source: chosen by hand, never
/// measured.
const SAMPLES: usize = 24;
/// A frame of which less is kept shows no object; share of its pixels. Source: chosen by hand,
/// never measured.
const EMPTY_SHARE: f32 = 1e-4;
/// Frames on a contact sheet at most, and the longest side of each, pixels. Source: chosen by hand,
/// never measured.
const SHEET: (usize, u32) = (48, 200);

/// Cuts the object out of its screen: soft 8-bit mattes in `out/masks` (white = keep), images
/// without spill in `out/images`, both whole or not at all. Where no screen is found (or `--key
/// off`) the frames come back as they are, with a decision that says why. Masks that the frames
/// already have are kept: a pixel stays as far as both allow.
pub fn matte_frames(
    frames: &FrameSet,
    out: &Path,
    config: &KeyConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    let mut result = frames.clone();
    if frames.is_empty() {
        return Ok(result);
    }
    progress.begin("screen", SAMPLES.min(frames.len()));
    let samples = samples(frames, progress)?;
    let thumbnails: Vec<RgbImage> = samples.iter().map(thumbnail).collect();
    let mut keyer = match Keyer::find(&thumbnails, config)? {
        Ok(keyer) => keyer,
        Err(decision) => {
            result.decisions.push(decision);
            return Ok(result);
        }
    };
    if frames.is_video {
        result.notes.extend(keyer.learn(&samples));
    }
    drop(samples);
    let staging = Staging::new(out)?;
    staging.make("masks")?;
    progress.begin("mattes", frames.len());
    let writer = MatteWriter { keyer: &keyer, staging: &staging, background: config.background };
    let done: Result<Vec<(Frame, f32)>, PreprocessError> = frames
        .frames
        .par_iter()
        .map_init(Scratch::default, |scratch, frame| {
            progress.tick()?;
            writer.one(frame, scratch)
        })
        .collect();
    let done = done?;
    progress.check()?;
    let empty: Vec<&str> =
        done.iter().filter(|(_, share)| *share < EMPTY_SHARE).map(|(f, _)| f.name.as_str()).collect();
    if config.key == "auto" && 2 * empty.len() > done.len() {
        let decision = Decision { choice: MatteKind::Nothing.into(), ..keyer.decision.clone() };
        let empty = Measurement::count(Quantity::EmptyFrames, empty.len());
        result.decisions.push(decision.remarked(Remark::EmptyFrames).with(empty));
        return Ok(result);
    }
    staging.publish(&["images", "masks"], &[])?;
    if !empty.is_empty() {
        result.notes.push(format!(
            "{} mattes are empty: {}",
            empty.len(),
            empty[..empty.len().min(5)].join(", ")
        ));
    }
    let share = done.iter().map(|(_, share)| share).sum::<f32>() / done.len() as f32;
    result.decisions.push(keyer.decision.clone().measured(Quantity::ObjectShare, f64::from(share)));
    result.frames = done.into_iter().map(|(frame, _)| frame).collect();
    Ok(result)
}

/// Some frames spread evenly; of videos all have one size, of photos those that have the size of
/// the first.
fn samples(frames: &FrameSet, progress: &Progress) -> Result<Vec<RgbImage>, PreprocessError> {
    let count = SAMPLES.min(frames.len());
    let chosen: Vec<&Frame> = (0..count).map(|i| &frames.frames[i * frames.len() / count]).collect();
    chosen
        .par_iter()
        .map(|frame| {
            progress.tick()?;
            load_rgb(&frame.path).map_err(PreprocessError::image(&frame.path))
        })
        .collect()
}

fn thumbnail(image: &RgbImage) -> RgbImage {
    let (w, h) = fitted(image.width(), image.height(), THUMBNAIL_SIDE);
    resize_area(image, w, h)
}

struct MatteWriter<'a> {
    keyer: &'a Keyer,
    staging: &'a Staging,
    background: Background,
}

impl MatteWriter<'_> {
    /// Writes matte and image of one frame; returns its new entry and the share of the picture that
    /// is kept.
    fn one(&self, frame: &Frame, scratch: &mut Scratch) -> Result<(Frame, f32), PreprocessError> {
        let image = load_rgb(&frame.path).map_err(PreprocessError::image(&frame.path))?;
        let (width, height) = image.dimensions();
        let (mut matte, colours) = self.keyer.matte(&image, scratch);
        if let Some(path) = &frame.mask {
            let mask = load_mask(path).map_err(PreprocessError::image(path))?;
            if mask.dimensions() == matte.dimensions() {
                matte.iter_mut().zip(mask.iter()).for_each(|(m, k)| *m = (*m).min(*k));
            }
        }
        let stem = frame.name.rsplit_once('.').map_or(frame.name.as_str(), |(stem, _)| stem);
        let name = format!("{stem}.png");
        write_png(&self.staging.path("masks", &name), matte.as_raw(), width, height, ExtendedColorType::L8)?;
        let (samples, colour) = composed(&image, &matte, &colours, self.background);
        write_png(&self.staging.path("images", &name), &samples, width, height, colour)?;
        let share = matte.iter().map(|v| f32::from(*v) / 255.0).sum::<f32>() / matte.len().max(1) as f32;
        let path = self.staging.final_path("images", &name);
        let mask = Some(self.staging.final_path("masks", &name));
        Ok((Frame { name, path, mask, ..frame.clone() }, share))
    }
}

fn composed(
    image: &RgbImage,
    matte: &GrayImage,
    colours: &RgbImage,
    background: Background,
) -> (Vec<u8>, ExtendedColorType) {
    let pixels = image.pixels().zip(matte.iter()).zip(colours.pixels());
    match background {
        Background::Transparent => {
            let rgba = pixels.flat_map(|((_, a), f)| [f[0], f[1], f[2], *a]).collect();
            (rgba, ExtendedColorType::Rgba8)
        }
        Background::Black => {
            let rgb = pixels
                .flat_map(|((_, a), f)| f.0.map(|v| ((u16::from(v) * u16::from(*a) + 127) / 255) as u8))
                .collect();
            (rgb, ExtendedColorType::Rgb8)
        }
        Background::Keep => {
            let rgb = pixels.flat_map(|((p, a), f)| if *a > 0 { f.0 } else { p.0 }).collect();
            (rgb, ExtendedColorType::Rgb8)
        }
    }
}

/// Writes a sheet of small frames, each over a checkerboard where its mask is black, so that a
/// person sees at a glance what is kept. At most 48 frames, spread evenly.
pub fn contact_sheet(frames: &FrameSet, path: &Path) -> Result<(), PreprocessError> {
    let count = frames.len().min(SHEET.0);
    if count == 0 {
        return Err(PreprocessError::Config("there is no frame to put on a contact sheet".to_owned()));
    }
    let chosen: Vec<&Frame> = (0..count).map(|i| &frames.frames[i * frames.len() / count]).collect();
    let tiles: Result<Vec<RgbImage>, PreprocessError> = chosen.par_iter().map(|frame| tile(frame)).collect();
    let tiles = tiles?;
    let (w, h) = tiles.iter().fold((1, 1), |(w, h), t| (t.width().max(w), t.height().max(h)));
    let columns = (count as f32 * 1.4 * h as f32 / w as f32).sqrt().ceil().clamp(1.0, count as f32) as u32;
    let rows = (count as u32).div_ceil(columns);
    let mut sheet = RgbImage::from_pixel(columns * (w + 4) + 4, rows * (h + 4) + 4, Rgb([24, 24, 24]));
    for (i, tile) in tiles.iter().enumerate() {
        let (column, row) = (i as u32 % columns, i as u32 / columns);
        image::imageops::replace(
            &mut sheet,
            tile,
            i64::from(4 + column * (w + 4)),
            i64::from(4 + row * (h + 4)),
        );
    }
    write_png(path, sheet.as_raw(), sheet.width(), sheet.height(), ExtendedColorType::Rgb8)
}

fn tile(frame: &Frame) -> Result<RgbImage, PreprocessError> {
    let image = load_rgb(&frame.path).map_err(PreprocessError::image(&frame.path))?;
    let (w, h) = fitted(image.width(), image.height(), SHEET.1);
    let mut small = resize_area(&image, w, h);
    if let Some(path) = &frame.mask {
        let mask = load_mask(path).map_err(PreprocessError::image(path))?;
        let mask = resize_area(&mask, w, h);
        for (x, y, p) in small.enumerate_pixels_mut() {
            let a = u32::from(mask.get_pixel(x, y)[0]);
            let board = if (x / 8 + y / 8) % 2 == 0 { 150 } else { 110 };
            p.0 = p.0.map(|v| ((u32::from(v) * a + board * (255 - a)) / 255) as u8);
        }
    }
    Ok(small)
}
