//! What real cameras are like, before an image has been looked at: a wide prior on focal lengths
//! and on distortion.

use scene::Camera;

/// Median focal length, longer image sides (a field of view of 45°).
/// Source: full-frame equivalents of 24 to 28 mm (phones, 0.67 to 0.78 long sides; Apple and Google
/// data sheets, 2016 to 2024), 35 to 50 mm (kits' middle, 0.97 to 1.39), 70 to 105 mm (portrait and
/// macro lenses, 1.9 to 2.9): their geometric mean is 1.2.
const FOCAL_MEDIAN: f64 = 1.2;
/// Standard deviation of the logarithm of a focal length.
/// Source: two of them reach from 16 mm (0.44) to 120 mm (3.3 long sides), and three to 200 mm: all
/// lenses that are sold in numbers (CIPA lens shipments by mount, 2015 to 2023).
pub(crate) const FOCAL_LOG_SIGMA: f64 = 0.5;
/// Standard deviation of the displacement by distortion at the corner of an image, as a share of
/// its distance from the centre.
/// Source: lens tests by DxOMark give 0 to 3 % to most lenses and phones, up to 10 % to action
/// cameras.
const DISTORTION_SIGMA: f64 = 0.05;

/// The median focal length for images of this size, pixels.
pub(crate) fn usual_focal_px(width: u32, height: u32) -> f64 {
    FOCAL_MEDIAN * f64::from(width.max(height))
}

/// How many standard deviations a focal length is from what is known beforehand: `mean` in pixels
/// and the standard deviation of its logarithm, where a file states it.
pub(crate) fn focal_sigmas(camera: &Camera, stated: Option<(f64, f64)>) -> f64 {
    let (mean, sigma) = stated.unwrap_or((usual_focal_px(camera.width, camera.height), FOCAL_LOG_SIGMA));
    ((camera.mean_focal() / mean).ln() / sigma).abs()
}

/// The same of the distortion at the corner of the image.
pub(crate) fn distortion_sigmas(camera: &Camera) -> f64 {
    let corner = glam::DVec2::new(f64::from(camera.width), f64::from(camera.height)) / 2.0 / camera.focal();
    let moved = camera.distort(corner).length() / corner.length() - 1.0;
    (moved / DISTORTION_SIGMA).abs()
}
