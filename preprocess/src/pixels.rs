//! From a decoded frame to an upright one with square pixels and the right colours; sharpness and
//! similarity.

use crate::PreprocessError;
use crate::matting::THUMBNAIL_SIDE;
use crate::probe::{DisplayTurn, VideoInfo};
use image::RgbImage;
use opencv::core::{self, Mat, Size};
use opencv::imgproc;
use opencv::prelude::*;

/// Longest side at which sharpness is measured, pixels: sensor noise is averaged away, blur is not.
/// Source: chosen by hand, never measured.
const SHARPNESS_SIDE: i32 = 640;

/// Width and height that fit into `max_size` (0: as they are), at least one pixel each.
pub(crate) fn fitted(width: u32, height: u32, max_size: u32) -> (u32, u32) {
    let longest = width.max(height);
    if max_size == 0 || longest <= max_size {
        return (width, height);
    }
    let [width, height] = [width, height]
        .map(|v| (f64::from(v) * f64::from(max_size) / f64::from(longest)).round().max(1.0) as u32);
    (width, height)
}

/// Area average where it shrinks, cubic where it grows.
pub(crate) fn resized(image: &Mat, width: u32, height: u32) -> Result<Mat, PreprocessError> {
    let size = Size::new(width as i32, height as i32);
    if image.size()? == size {
        return Ok(image.clone());
    }
    let shrinks = size.width <= image.cols() && size.height <= image.rows();
    let method = if shrinks { imgproc::INTER_AREA } else { imgproc::INTER_CUBIC };
    let mut out = Mat::default();
    imgproc::resize(image, &mut out, size, 0.0, 0.0, method)?;
    Ok(out)
}

/// The picture as it is to be seen.
pub(crate) fn turned(image: &Mat, turn: DisplayTurn) -> Result<Mat, PreprocessError> {
    let mut out = image.clone();
    if turn.mirror {
        let mut flipped = Mat::default();
        core::flip(&out, &mut flipped, 1)?;
        out = flipped;
    }
    let code = match turn.quarters % 4 {
        1 => core::ROTATE_90_CLOCKWISE,
        2 => core::ROTATE_180,
        3 => core::ROTATE_90_COUNTERCLOCKWISE,
        _ => return Ok(out),
    };
    let mut rotated = Mat::default();
    core::rotate(&out, &mut rotated, code)?;
    Ok(rotated)
}

/// Upright sRGB of a decoded frame: colour matrix, square pixels, size, turn. `correct_matrix`: the
/// frame was converted by the Rec. 601 matrix although it is coded by Rec. 709 (OpenCV ignores the
/// stream's matrix).
pub(crate) fn finished(
    bgr: &Mat,
    info: &VideoInfo,
    max_size: u32,
    correct_matrix: bool,
) -> Result<RgbImage, PreprocessError> {
    let (w, h) = (bgr.cols() as u32, bgr.rows() as u32);
    let square = if (info.pixel_aspect - 1.0).abs() < 0.005 {
        (w, h)
    } else if info.pixel_aspect > 1.0 {
        ((f64::from(w) * info.pixel_aspect).round() as u32, h)
    } else {
        (w, (f64::from(h) / info.pixel_aspect).round() as u32)
    };
    let size = fitted(square.0, square.1, max_size);
    let upright = turned(&resized(bgr, size.0, size.1)?, info.turn)?;
    let (width, height) = (upright.cols() as usize, upright.rows() as usize);
    let mut rgb = Vec::with_capacity(width * height * 3);
    for row in 0..height {
        let line = upright.at_row::<core::Vec3b>(row as i32)?;
        if correct_matrix {
            rgb.extend(line.iter().flat_map(|p| rec709_from_rec601([p[2], p[1], p[0]])));
        } else {
            rgb.extend(line.iter().flat_map(|p| [p[2], p[1], p[0]]));
        }
    }
    RgbImage::from_raw(width as u32, height as u32, rgb)
        .ok_or_else(|| PreprocessError::Config(format!("a frame of {width} x {height} pixels is too large")))
}

fn deviation(image: &Mat) -> Result<f64, PreprocessError> {
    let (mut mean, mut sigma) = (Mat::default(), Mat::default());
    core::mean_std_dev_def(image, &mut mean, &mut sigma)?;
    Ok(*sigma.at::<f64>(0)?)
}

/// Undoes the Rec. 601 decoding matrix and applies that of Rec. 709 (ITU-R BT.601, BT.709: Y, Cb,
/// Cr from Kr, Kb); limited-range scaling is the same for both and cancels.
fn rec709_from_rec601([r, g, b]: [u8; 3]) -> [u8; 3] {
    let (r, g, b) = (f32::from(r), f32::from(g), f32::from(b));
    let y = 0.299 * r + 0.587 * g + 0.114 * b;
    let (cb, cr) = ((b - y) / 1.772, (r - y) / 1.402);
    [y + 1.5748 * cr, y - 0.187_32 * cb - 0.468_12 * cr, y + 1.8556 * cb]
        .map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)
}

/// What decides between frames, from luma averaged down.
pub(crate) struct Look {
    /// Variance of the Laplacian of Gaussian over the variance of luma: the same at any exposure.
    pub sharpness: f64,
    /// Small luma picture.
    pub thumbnail: Vec<u8>,
    /// Its width and height.
    pub size: (u32, u32),
}

impl Look {
    /// Of a decoded frame.
    pub(crate) fn of(bgr: &Mat) -> Result<Self, PreprocessError> {
        let (w, h) = fitted(bgr.cols() as u32, bgr.rows() as u32, SHARPNESS_SIDE as u32);
        let small = resized(bgr, w, h)?;
        let (mut luma, mut smooth, mut edges) = (Mat::default(), Mat::default(), Mat::default());
        imgproc::cvt_color_def(&small, &mut luma, imgproc::COLOR_BGR2GRAY)?;
        imgproc::gaussian_blur_def(&luma, &mut smooth, Size::new(5, 5), 1.0)?;
        imgproc::laplacian(&smooth, &mut edges, core::CV_16S, 1, 1.0, 0.0, core::BORDER_DEFAULT)?;
        let sharpness = (deviation(&edges)? / (deviation(&smooth)? + 0.5)).powi(2);
        let (tw, th) = fitted(w, h, THUMBNAIL_SIDE);
        let thumbnail = resized(&luma, tw, th)?.data_bytes()?.to_vec();
        Ok(Self { sharpness, thumbnail, size: (tw, th) })
    }

    /// Difference that all but one pixel in 200 stay below, 8-bit levels: moving texture shows even
    /// where the object is small in the picture.
    pub(crate) fn difference(&self, other: &Self) -> f32 {
        if self.thumbnail.len() != other.thumbnail.len() {
            return f32::INFINITY;
        }
        let mut counts = [0_usize; 256];
        for (a, b) in self.thumbnail.iter().zip(&other.thumbnail) {
            counts[usize::from(a.abs_diff(*b))] += 1;
        }
        let mut rest = self.thumbnail.len() / 200;
        for (level, count) in counts.iter().enumerate().rev() {
            if *count > rest {
                return level as f32;
            }
            rest -= count;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opencv::core::{CV_8UC3, Scalar, Vec3b};

    fn chart(gain: f32, blur: i32) -> Mat {
        let mut m = Mat::new_rows_cols_with_default(240, 320, CV_8UC3, Scalar::all(0.0)).unwrap();
        for y in 0..240 {
            for x in 0..320 {
                let v = if ((x / 13) + (y / 17)) % 2 == 0 { 220.0 } else { 40.0 };
                *m.at_2d_mut::<Vec3b>(y, x).unwrap() = Vec3b::all((v * gain) as u8);
            }
        }
        if blur > 1 {
            let mut out = Mat::default();
            imgproc::blur_def(&m, &mut out, Size::new(blur, blur)).unwrap();
            return out;
        }
        m
    }

    #[test]
    fn sharpness_falls_with_blur_and_not_with_exposure() {
        let sharp = Look::of(&chart(1.0, 1)).unwrap().sharpness;
        let dark = Look::of(&chart(0.25, 1)).unwrap().sharpness;
        let blurred = Look::of(&chart(1.0, 7)).unwrap().sharpness;
        assert!((dark / sharp - 1.0).abs() < 0.1, "{dark} {sharp}");
        assert!(blurred < 0.5 * sharp && blurred < 0.5 * dark, "{blurred} {sharp}");
        let black =
            Look::of(&Mat::new_rows_cols_with_default(48, 64, CV_8UC3, Scalar::all(0.0)).unwrap()).unwrap();
        assert_eq!(black.sharpness, 0.0);
    }

    #[test]
    fn sizes_fit_and_never_vanish() {
        assert_eq!(fitted(1920, 1080, 640), (640, 360));
        assert_eq!(fitted(320, 240, 640), (320, 240));
        assert_eq!(fitted(10_000, 1, 100), (100, 1));
    }

    #[test]
    fn the_matrix_correction_undoes_the_wrong_decoding() {
        // Y, Cb, Cr of a saturated green in Rec. 709, decoded by 601, must come back.
        let (y, cb, cr) = (0.7152 * 180.0, -0.7152 * 180.0 / 1.8556, -0.7152 * 180.0 / 1.5748);
        let wrong = [y + 1.402 * cr, y - 0.344_14 * cb - 0.714_14 * cr, y + 1.772 * cb]
            .map(|v: f32| v.round().clamp(0.0, 255.0) as u8);
        let right = rec709_from_rec601(wrong);
        assert!(right[1].abs_diff(180) <= 3, "{right:?} from {wrong:?}");
        assert_eq!(rec709_from_rec601([90, 90, 90]), [90, 90, 90]);
    }
}
