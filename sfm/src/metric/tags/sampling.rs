//! Grey values between pixels.

use glam::DVec2;
use image::GrayImage;

/// A quadrilateral's corners, clockwise as seen in the image, pixels.
pub(super) type Corners = [DVec2; 4];

/// Bilinear grey value at a pixel position; `None` outside the image.
pub(super) fn sample(image: &GrayImage, at: DVec2) -> Option<f64> {
    let (x, y) = (at.x - 0.5, at.y - 0.5);
    let inside = x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) - 1.0;
    if !inside || !(y < f64::from(image.height()) - 1.0) {
        return None;
    }
    let (left, top) = (x as u32, y as u32);
    let (u, v) = (x.fract(), y.fract());
    let [upper, lower] = [0, 1].map(|dy| {
        let [a, b] = [0, 1].map(|dx| f64::from(image.get_pixel(left + dx, top + dy)[0]));
        a * (1.0 - u) + b * u
    });
    Some(upper * (1.0 - v) + lower * v)
}
