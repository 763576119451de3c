//! Pictures of wide lenses as perspective views, before anything is made of them: a camera of the
//! reconstruction sees what lies before it, a panorama or a fisheye also what lies beside it.

mod lens;

use crate::film::FILM;
use crate::output::{Staging, write_png};
use crate::{FrameConfig, PreprocessError};
use image::{ExtendedColorType, ImageBuffer, Pixel, RgbImage};
use lens::{WideView, is_circular, side_of_panorama};
use rayon::prelude::*;
use scene::io::{load_mask, load_rgb, resize_area};
use scene::{Frame, FrameSet, Progress, WideLens};
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

/// Cuts the frames in `out` into views, which take their places there, at the resolution of the
/// picture's middle or with `--max-size` pixels at most.
///
/// Panoramas (twice as wide as high, the horizon in the middle) become square views round the
/// horizon, which have no order of time any more; the view `_0` has the pose of the panorama. Of a
/// fisheye, taken for equidistant (r = f θ), one view along its axis is left.
///
/// # Errors
/// If a picture is no panorama or cannot be read or written, or the user asked to stop.
pub(crate) fn cut(
    frames: FrameSet,
    lens: WideLens,
    out: &Path,
    config: &FrameConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    let odd = frames.frames.iter().find(|f| f.width != 2 * f.height);
    if let Some(odd) = odd.filter(|_| lens == WideLens::Panorama) {
        return Err(PreprocessError::Config(format!(
            "{} has {}×{} pixels, and a panorama of all directions is twice as wide as high; \
             say --lens perspective if it is an ordinary picture",
            odd.name, odd.width, odd.height
        )));
    }
    let circular = if lens == WideLens::Fisheye { all_circular(&frames)? } else { false };
    let staging = Staging::new(out)?;
    staging.make("masks")?;
    progress.begin("views of wide pictures", frames.len());
    let cutter = ViewCutter { lens, circular, config, staging: &staging };
    let views: Result<Vec<Vec<Frame>>, PreprocessError> = frames
        .frames
        .par_iter()
        .map(|frame| {
            progress.tick()?;
            cutter.views(frame)
        })
        .collect();
    let views: Vec<Frame> = views?.into_iter().flatten().collect();
    let (kinds, stale) = if views.iter().any(|f| f.mask.is_some()) {
        (&["images", "masks"][..], &[FILM][..])
    } else {
        (&["images"][..], &["masks", FILM][..])
    };
    let note = match lens {
        WideLens::Panorama => {
            format!("{} panoramas were cut into {} views", frames.frames.len(), views.len())
        }
        WideLens::Fisheye => cutter.sentence(&frames.frames),
    };
    staging.publish(kinds, stale)?;
    let notes = [frames.notes, vec![note]].concat();
    let is_video = frames.is_video && lens == WideLens::Fisheye;
    // The film shows what the lens showed, not the views.
    Ok(FrameSet { frames: views, is_video, notes, film: None, wide_lens: Some(lens), ..frames })
}

/// Whether the corners of the first picture, of that in the middle and of the last are dark.
fn all_circular(frames: &FrameSet) -> Result<bool, PreprocessError> {
    let last = frames.len().saturating_sub(1);
    for path in [0, last / 2, last].into_iter().filter_map(|i| frames.frames.get(i)).map(|f| &f.path) {
        if !is_circular(&load_rgb(path).map_err(PreprocessError::image(path))?) {
            return Ok(false);
        }
    }
    Ok(true)
}

struct ViewCutter<'a> {
    lens: WideLens,
    circular: bool,
    config: &'a FrameConfig,
    staging: &'a Staging,
}

impl ViewCutter<'_> {
    /// Pixels a radian of a fisheye, and half of its field, radians.
    fn fisheye(&self, frame: &Frame) -> (f64, f64) {
        let (width, height) = (f64::from(frame.width), f64::from(frame.height));
        let radius = if self.circular { width.min(height) } else { width.hypot(height) } / 2.0;
        let focal = match (self.config.fisheye_field, frame.focal_prior_px) {
            (Some(degrees), _) => radius / (degrees / 2.0).to_radians(),
            (None, Some(focal)) => focal,
            // As most makers of fisheye lenses say of theirs: half of all directions.
            (None, None) => radius / FRAC_PI_2,
        };
        (focal, radius / focal)
    }

    fn sentence(&self, frames: &[Frame]) -> String {
        let Some(first) = frames.first() else { return String::new() };
        let (focal, half) = self.fisheye(first);
        let source = match (self.config.fisheye_field, first.focal_prior_px) {
            (Some(_), _) => "as given",
            (None, Some(_)) => "by EXIF",
            (None, None) => "assumed: --fisheye-field says it",
        };
        let across = if self.circular { "its circle" } else { "the diagonal" };
        format!(
            "a view was cut from each fisheye picture: {focal:.0} pixels a radian, {:.0}° across {across} ({source})",
            2.0 * half.to_degrees()
        )
    }

    fn cut(&self, frame: &Frame) -> Vec<WideView> {
        let cut = match self.lens {
            WideLens::Panorama => WideView::of_panorama(side_of_panorama(frame.width)),
            WideLens::Fisheye => {
                let (focal, half) = self.fisheye(frame);
                vec![WideView::of_fisheye(frame.width, frame.height, focal, half)]
            }
        };
        cut.into_iter().map(|view| view.within(self.config.max_size)).collect()
    }

    fn views(&self, frame: &Frame) -> Result<Vec<Frame>, PreprocessError> {
        let picture = load_rgb(&frame.path).map_err(PreprocessError::image(&frame.path))?;
        let mask = match &frame.mask {
            Some(path) => Some(load_mask(path).map_err(PreprocessError::image(path))?),
            None => None,
        };
        let views = self.cut(frame);
        let smaller = views.first().map_or(1.0, |view| view.scale);
        let (picture, mask) = (fitted(&picture, smaller), mask.map(|m| fitted(&m, smaller)));
        let stem = frame.name.rsplit_once('.').map_or(frame.name.as_str(), |(stem, _)| stem);
        let mut written = Vec::new();
        for (number, view) in views.iter().enumerate() {
            let suffix = if views.len() > 1 { format!("_{number}") } else { String::new() };
            let name = format!("{stem}{suffix}.png");
            let image: RgbImage = view.of(&picture);
            let path = self.staging.path("images", &name);
            write_png(&path, image.as_raw(), view.width, view.height, ExtendedColorType::Rgb8)?;
            if let Some(mask) = &mask {
                let path = self.staging.path("masks", &name);
                write_png(&path, view.of(mask).as_raw(), view.width, view.height, ExtendedColorType::L8)?;
            }
            written.push(Frame {
                path: self.staging.final_path("images", &name),
                mask: mask.as_ref().map(|_| self.staging.final_path("masks", &name)),
                name,
                width: view.width,
                height: view.height,
                source_index: frame.source_index * views.len() + number,
                focal_prior_px: Some(view.focal_px),
                up: frame.up.map(|up| view.turned(up)),
                ..frame.clone()
            });
        }
        Ok(written)
    }
}

fn fitted<P: Pixel<Subpixel = u8>>(image: &ImageBuffer<P, Vec<u8>>, scale: f64) -> ImageBuffer<P, Vec<u8>> {
    let [width, height] =
        [image.width(), image.height()].map(|side| (f64::from(side) * scale).round() as u32);
    resize_area(image, width, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_of_another_shape_is_refused_by_name() {
        let frame = Frame { name: "a.png".into(), width: 300, height: 200, ..Frame::default() };
        let frames = FrameSet { frames: vec![frame], ..FrameSet::default() };
        let config = FrameConfig::default();
        let refused =
            cut(frames, WideLens::Panorama, Path::new("nowhere"), &config, &Progress::silent()).unwrap_err();
        let said = refused.to_string();
        assert!(said.contains("a.png") && said.contains("twice as wide"), "{said}");
    }
}
