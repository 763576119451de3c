//! Scale-invariant features: SIFT (Lowe, "Distinctive Image Features from Scale-Invariant
//! Keypoints", IJCV 2004) with RootSIFT descriptors (Arandjelović and Zisserman, CVPR 2012) and
//! thresholds that follow each image's own range and noise, so that a dark image is not an empty
//! one.
//!
//! ```
//! let mut image = scene::FloatImage::zeros(64, 64, 1);
//! for (i, v) in image.data.iter_mut().enumerate() {
//!     let (x, y) = ((i % 64) as f32 - 31.5, (i / 64) as f32 - 31.5);
//!     *v = (-(x * x + y * y) / 50.0).exp(); // a spot of 5 pixels
//! }
//! let features = sfm::sift::extract(&image, None, &sfm::sift::SiftConfig::default());
//! assert!(features.keypoints.iter().any(|k| (k.x - 32.0).hypot(k.y - 32.0) < 0.1));
//! ```

mod blur;
mod candidate;
mod config;
mod describe;
mod detect;
mod noise;
mod pyramid;
mod spread;
#[cfg(test)]
mod tests;
mod window;

pub(crate) use blur::{LANES, dispatch};
pub use config::{Doubling, SiftConfig};

use crate::error::SfmError;
use blur::LumaPlane;
use candidate::Candidate;
use describe::DescriptorTables;
use image::GrayImage;
use noise::ImageStatistics;
use pyramid::Octave;
use rayon::prelude::*;
use scene::io::load::{load_mask, load_rgb};
use scene::{Features, FloatImage, Frame, FrameSet, Keypoint, Progress};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use window::Window;

/// Features of a one-channel image with values in [0, 1] (samples that are not finite count as 0).
///
/// `mask` (white = keep; any size, stretched over the image) drops keypoints that lie in black;
/// what is near its white keeps its pixels, so it makes no edges there. Positions and scales are in
/// input pixels, the first pixel's centre at 0.5.
pub fn extract(image: &FloatImage, mask: Option<&GrayImage>, config: &SiftConfig) -> Features {
    extract_with(&mut Vec::new(), image, mask, config)
}

/// [`extract`] in memory that the next image uses again.
fn extract_with(
    octaves: &mut Vec<Octave>,
    image: &FloatImage,
    mask: Option<&GrayImage>,
    config: &SiftConfig,
) -> Features {
    let work = working_image(image, config.max_feature_size);
    // Working pixels to input pixels.
    let ratio = [image.width as f32 / work.width as f32, image.height as f32 / work.height as f32];
    let keep = |x: f32, y: f32| match mask {
        None => true,
        Some(mask) if mask.width() == 0 || mask.height() == 0 => true,
        Some(mask) => {
            let column = (x / work.width as f32 * mask.width() as f32).max(0.0) as u32;
            let row = (y / work.height as f32 * mask.height() as f32).max(0.0) as u32;
            mask.get_pixel(column.min(mask.width() - 1), row.min(mask.height() - 1)).0[0] >= 128
        }
    };
    let mut statistics = ImageStatistics::measure(&work, |x, y| keep(x as f32 + 0.5, y as f32 + 0.5));
    let mut blurred = LumaPlane::default();
    let source = if config.pre_blur > 0.0 {
        blur::gaussian_blur(&work, config.pre_blur, &mut blurred);
        statistics.pre_blur = config.pre_blur;
        &blurred
    } else {
        &work
    };
    let doubled = config.doubles(work.width, work.height);
    let window = Window::around(&work, keep);
    let mut part = LumaPlane::default();
    let octaves = scale_space(octaves, window.part_of(source, &mut part), doubled, config);
    let mut candidates = Vec::new();
    for (index, octave) in octaves.iter().enumerate() {
        candidates.extend(octave_candidates(octave, index, window.first, &statistics, config, keep));
    }
    let size = [work.width as f32, work.height as f32];
    // Directions cost more than places: only what may stay gets them.
    let most = config.max_features;
    let likely = spread::strongest_everywhere(&candidates, spread::with_margin(most), size);
    let oriented: Vec<Candidate> = likely.iter().flat_map(|c| orient(octaves, c, config)).collect();
    let chosen = spread::strongest_everywhere(&oriented, most, size);
    describe_all(octaves, &chosen, ratio, config.pre_blur.max(0.0))
}

/// The image as a finite plane, reduced where its longer side is above `max_side`.
fn working_image(image: &FloatImage, max_side: usize) -> LumaPlane {
    let channels = image.channels.max(1);
    let data = image.data.chunks_exact(channels).map(|p| if p[0].is_finite() { p[0] } else { 0.0 }).collect();
    let plane = LumaPlane { width: image.width, height: image.height, data };
    let longest = image.width.max(image.height);
    if longest <= max_side.max(1) {
        return plane;
    }
    let scale = max_side.max(1) as f64 / longest as f64;
    let [width, height] = [image.width, image.height].map(|n| ((n as f64 * scale).round() as usize).max(1));
    blur::reduce(&plane, width, height)
}

/// The scale space of an image, built in `octaves`; the part of them that is in use.
fn scale_space<'a>(
    octaves: &'a mut Vec<Octave>,
    work: &LumaPlane,
    doubled: bool,
    config: &SiftConfig,
) -> &'a [Octave] {
    octaves.resize_with(config.octaves.max(1), Octave::default);
    let mut used = 0;
    while used < octaves.len() {
        let (finer, rest) = octaves.split_at_mut(used);
        match finer.last() {
            None => rest[0].first(work, doubled, config.scales_per_octave, 1.0),
            Some(finer) => rest[0].next_of(finer),
        }
        if rest[0].levels[0].width.min(rest[0].levels[0].height) <= 2 * detect::BORDER {
            break;
        }
        used += 1;
    }
    &octaves[..used]
}

/// Keypoints of one octave without their directions, positions in working pixels. `first`: the
/// working pixel that the scale space begins with.
fn octave_candidates(
    octave: &Octave,
    index: usize,
    first: [usize; 2],
    statistics: &ImageStatistics,
    config: &SiftConfig,
    keep: impl Fn(f32, f32) -> bool,
) -> Vec<Candidate> {
    let threshold = |level: usize| {
        let (fine, coarse) = (octave.sigma(level as f32), octave.sigma(level as f32 + 1.0));
        let noise = statistics.dog_noise(fine * octave.step, coarse * octave.step);
        (config.contrast_threshold * statistics.range).max(config.noise_threshold * noise)
    };
    let mut candidates = Vec::new();
    for found in detect::extrema(octave, config.edge_threshold, threshold) {
        let [x, y] = [(found.x, first[0]), (found.y, first[1])]
            .map(|(place, first)| first as f32 + octave.origin + place * octave.step);
        if !keep(x, y) {
            continue;
        }
        let level = (found.level.round().max(1.0) as usize).min(octave.scales);
        let sigma = octave.sigma(found.level);
        candidates.push(Candidate {
            keypoint: Keypoint { x, y, scale: sigma * octave.step, angle: 0.0 },
            strength: found.response.abs(),
            octave: index as u32,
            level: level as u32,
            x: found.x,
            y: found.y,
            sigma,
        });
    }
    candidates
}

/// The keypoint once for each of its directions.
fn orient(octaves: &[Octave], candidate: &Candidate, config: &SiftConfig) -> Vec<Candidate> {
    let angles = if config.upright {
        vec![0.0]
    } else {
        let level = &octaves[candidate.octave as usize].levels[candidate.level as usize];
        describe::orientations(level, candidate.x, candidate.y, candidate.sigma, config.max_orientations)
    };
    let oriented = angles.into_iter().map(|angle| Keypoint { angle, ..candidate.keypoint });
    oriented.map(|keypoint| Candidate { keypoint, ..*candidate }).collect()
}

/// `pre_blur`: what the image was blurred by before, working pixels; it adds to the keypoints'
/// scales.
fn describe_all(octaves: &[Octave], chosen: &[Candidate], ratio: [f32; 2], pre_blur: f32) -> Features {
    let tables = DescriptorTables::default();
    let mut features = Features {
        keypoints: Vec::with_capacity(chosen.len()),
        descriptors: vec![0; chosen.len() * Features::DIM],
    };
    for (c, out) in chosen.iter().zip(features.descriptors.chunks_exact_mut(Features::DIM)) {
        let level = &octaves[c.octave as usize].levels[c.level as usize];
        describe::describe(&tables, level, c.x, c.y, c.sigma, c.keypoint.angle, out);
        features.keypoints.push(Keypoint {
            x: c.keypoint.x * ratio[0],
            y: c.keypoint.y * ratio[1],
            scale: c.keypoint.scale.hypot(pre_blur) * (ratio[0] * ratio[1]).sqrt(),
            angle: c.keypoint.angle,
        });
    }
    features
}

/// Features of every frame, in their order; images are read from disk here. The same for any number
/// of threads.
pub fn extract_all(
    frames: &FrameSet,
    config: &SiftConfig,
    progress: &Progress,
) -> Result<Vec<Features>, SfmError> {
    progress.begin("features", frames.len());
    // Scale spaces are handed from image to image: fresh memory is written once by the system and
    // once as zeros.
    let idle: Mutex<Vec<Vec<Octave>>> = Mutex::new(Vec::new());
    let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
    let extracted = frames.frames.par_iter().with_max_len(1).map(|frame| {
        progress.check()?;
        let luma = load_luma(frame)?;
        let mask = frame.mask.as_deref().map(|path| read_mask(path, frame)).transpose()?;
        let mut octaves = idle().pop().unwrap_or_default();
        let features = extract_with(&mut octaves, &luma, mask.as_ref(), config);
        idle().push(octaves);
        progress.tick_with(&format!("{} in {}", features.len(), frame.name))?;
        Ok(features)
    });
    extracted.collect()
}

/// Grey levels of a frame, whose size must be what it says.
pub(crate) fn load_luma(frame: &Frame) -> Result<FloatImage, SfmError> {
    let image = load_rgb(&frame.path).map_err(|e| unreadable(&frame.path, &e))?;
    check_size(&frame.path, image.dimensions(), frame)?;
    Ok(FloatImage::luma(&image))
}

/// The mask of a frame, whose size must be the frame's.
pub(crate) fn read_mask(path: &Path, frame: &Frame) -> Result<GrayImage, SfmError> {
    let mask = load_mask(path).map_err(|e| unreadable(path, &e))?;
    check_size(path, mask.dimensions(), frame)?;
    Ok(mask)
}

/// What an image that cannot be read is reported as.
pub(crate) fn unreadable(path: &Path, reason: &impl ToString) -> SfmError {
    SfmError::UnreadableImage { path: path.to_owned(), reason: reason.to_string() }
}

fn check_size(path: &Path, (found_width, found_height): (u32, u32), frame: &Frame) -> Result<(), SfmError> {
    if (found_width, found_height) == (frame.width, frame.height) {
        return Ok(());
    }
    let (width, height) = (frame.width, frame.height);
    Err(SfmError::SizeMismatch { path: path.to_owned(), found_width, found_height, width, height })
}
