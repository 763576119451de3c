//! Where a perspective view of a wide picture finds its pixels.

use glam::{DMat3, DVec2, DVec3};
use image::{ImageBuffer, Pixel, RgbImage};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Views round the horizon, of 90° each: neighbours share half of what they see. Source: chosen by
/// hand, never measured.
const VIEWS: u32 = 8;
/// Degrees that the view of a fisheye covers along each side at most: beyond, perspective stretches
/// more than twice what the lens shows. Source: derived, 1 / cos² 50° = 2.4.
const FISHEYE_VIEW_DEG: f64 = 100.0;
/// Mean 8-bit level of a dark corner at most. Source: chosen by hand, never measured.
const DARK: f64 = 16.0;

/// How the wide picture shows directions.
#[derive(Clone, Copy, Debug, PartialEq)]
enum WideProjection {
    /// Longitude and latitude along x and y.
    Equirectangular,
    /// So many pixels a radian from the middle.
    Equidistant(f64),
}

/// A perspective view that is cut from a wide picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WideView {
    pub width: u32,
    pub height: u32,
    /// Its focal length, pixels; the principal point is the middle.
    pub focal_px: f64,
    /// Factor on the sides of the wide picture from which it is cut.
    pub scale: f64,
    projection: WideProjection,
    /// From the view's axes to the picture's (x right, y down, z forward: the middle).
    picture_from_view: DMat3,
}

/// Side of a view of 90° with as many pixels a radian as the panorama has at the horizon.
pub(super) fn side_of_panorama(width: u32) -> u32 {
    (2.0 * f64::from(width) / TAU).round().max(1.0) as u32
}

impl WideView {
    /// The views round the horizon; the first looks ahead, the others follow to the right.
    pub(super) fn of_panorama(side: u32) -> Vec<Self> {
        let turns = (0..VIEWS).map(|number| TAU * f64::from(number) / f64::from(VIEWS));
        turns
            .map(|turn| Self {
                width: side,
                height: side,
                focal_px: f64::from(side) / 2.0,
                scale: 1.0,
                projection: WideProjection::Equirectangular,
                picture_from_view: DMat3::from_rotation_y(turn),
            })
            .collect()
    }

    /// The view along the axis of a fisheye with so many pixels a radian, which shows directions up
    /// to `half` radians from its axis.
    pub(super) fn of_fisheye(width: u32, height: u32, focal_px: f64, half: f64) -> Self {
        let most = (FISHEYE_VIEW_DEG / 2.0).to_radians();
        let sides = DVec2::new(f64::from(width), f64::from(height)) / 2.0 / focal_px;
        let mut reach = sides.min(DVec2::splat(most)).map(f64::tan);
        if half < FRAC_PI_2 {
            reach *= (half.tan() / reach.length()).min(1.0); // its corners lie in the lens's circle
        }
        let size = (2.0 * focal_px * reach).round().max(DVec2::ONE);
        let projection = WideProjection::Equidistant(focal_px);
        let (width, height, picture_from_view) = (size.x as u32, size.y as u32, DMat3::IDENTITY);
        Self { width, height, focal_px, scale: 1.0, projection, picture_from_view }
    }

    /// The same with no side longer than so many pixels (0: as it is).
    pub(super) fn within(self, max_size: u32) -> Self {
        let longer = self.width.max(self.height);
        if max_size == 0 || longer <= max_size {
            return self;
        }
        let scale = f64::from(max_size) / f64::from(longer);
        let [width, height] =
            [self.width, self.height].map(|v| (f64::from(v) * scale).round().max(1.0) as u32);
        let projection = match self.projection {
            WideProjection::Equidistant(focal) => WideProjection::Equidistant(focal * scale),
            other => other,
        };
        Self { width, height, focal_px: self.focal_px * scale, scale: self.scale * scale, projection, ..self }
    }

    /// A direction of the wide picture in the view.
    pub(super) fn turned(&self, direction: [f64; 3]) -> [f64; 3] {
        (self.picture_from_view.transpose() * DVec3::from_array(direction)).to_array()
    }

    /// The view of a picture, whose sides `scale` has been applied to; bilinear.
    pub(super) fn of<P>(&self, picture: &ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>>
    where
        P: Pixel<Subpixel = u8>,
    {
        let middle = DVec2::new(f64::from(self.width), f64::from(self.height)) / 2.0;
        ImageBuffer::from_fn(self.width, self.height, |x, y| {
            let u = (DVec2::new(f64::from(x), f64::from(y)) + 0.5 - middle) / self.focal_px;
            bilinear(picture, self.place(picture.dimensions(), self.picture_from_view * u.extend(1.0)))
        })
    }

    /// Where a direction lies in a wide picture of this size, pixels.
    fn place(&self, (width, height): (u32, u32), ahead: DVec3) -> DVec2 {
        let size = DVec2::new(f64::from(width), f64::from(height));
        let across = ahead.truncate().length();
        match self.projection {
            WideProjection::Equirectangular => {
                let longitude = ahead.x.atan2(ahead.z);
                let latitude = ahead.y.atan2(ahead.x.hypot(ahead.z));
                size * DVec2::new(longitude / TAU + 0.5, latitude / PI + 0.5)
            }
            WideProjection::Equidistant(_) if across == 0.0 => size / 2.0,
            WideProjection::Equidistant(focal) => {
                size / 2.0 + ahead.truncate() / across * (focal * across.atan2(ahead.z))
            }
        }
    }
}

/// Mixes the four pixels about a place. What lies beyond the left side is the right one's.
fn bilinear<P: Pixel<Subpixel = u8>>(picture: &ImageBuffer<P, Vec<u8>>, place: DVec2) -> P {
    let corner = (place - 0.5).floor();
    let share = place - 0.5 - corner;
    let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| {
        let column = (corner.x as i64 + dx).rem_euclid(i64::from(picture.width())) as u32;
        let row = (corner.y as i64 + dy).clamp(0, i64::from(picture.height()) - 1) as u32;
        *picture.get_pixel(column, row)
    });
    let (rest, low) = (1.0 - share.x, 1.0 - share.y);
    let shares = [rest * low, share.x * low, rest * share.y, share.x * share.y];
    let mut mixed = corners[0];
    for (channel, value) in mixed.channels_mut().iter_mut().enumerate() {
        let sum: f64 = corners.iter().zip(shares).map(|(c, s)| s * f64::from(c.channels()[channel])).sum();
        *value = sum.round() as u8;
    }
    mixed
}

/// Whether all four corners are dark: the lens's circle lies inside the picture.
pub(super) fn is_circular(picture: &RgbImage) -> bool {
    let (width, height) = picture.dimensions();
    // A circle leaves squares of (1 − 1/√2) / 2 = 1/6.8 of the shorter side free.
    let side = (width.min(height) / 12).max(1);
    [(0, 0), (width - side, 0), (0, height - side), (width - side, height - side)].iter().all(|&(x, y)| {
        let corner = image::imageops::crop_imm(picture, x, y, side, side).to_image();
        let sum: f64 = corner.as_raw().iter().map(|v| f64::from(*v)).sum();
        sum / corner.as_raw().len() as f64 <= DARK
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn colour(ahead: DVec3) -> Rgb<u8> {
        Rgb(ahead.normalize().to_array().map(|v| (127.5 + 127.5 * v).round() as u8))
    }

    /// A panorama whose colours say the direction.
    fn panorama(width: u32) -> RgbImage {
        RgbImage::from_fn(width, width / 2, |x, y| {
            let longitude = ((f64::from(x) + 0.5) / f64::from(width) - 0.5) * TAU;
            let latitude = ((f64::from(y) + 0.5) / f64::from(width / 2) - 0.5) * PI;
            let (sin, cos) = longitude.sin_cos();
            colour(DVec3::new(latitude.cos() * sin, latitude.sin(), latitude.cos() * cos))
        })
    }

    fn shows(view: &WideView, picture: &RgbImage, pixel: (u32, u32), ahead: DVec3) {
        let found = view.of(picture).get_pixel(pixel.0, pixel.1).0;
        for (found, wanted) in found.into_iter().zip(colour(ahead).0) {
            assert!(found.abs_diff(wanted) < 4, "{view:?} {pixel:?}: {found} {wanted}");
        }
    }

    #[test]
    fn a_view_of_a_panorama_looks_where_its_number_says_and_sees_ninety_degrees() {
        let (picture, views) = (panorama(1024), WideView::of_panorama(200));
        shows(&views[0], &picture, (100, 100), DVec3::Z);
        shows(&views[2], &picture, (100, 100), DVec3::X);
        shows(&views[4], &picture, (100, 100), DVec3::NEG_Z);
        shows(&views[0], &picture, (199, 100), DVec3::new(1.0, 0.0, 1.0));
        shows(&views[0], &picture, (100, 199), DVec3::new(0.0, 1.0, 1.0));
        shows(&views[1], &picture, (100, 0), DVec3::new(1.0, -(2.0_f64.sqrt()), 1.0));
        let up = DVec3::new(0.3, -0.9, 0.1).normalize();
        let there = views[3].picture_from_view * DVec3::from_array(views[3].turned(up.to_array()));
        assert!(there.distance(up) < 1e-12);
    }

    #[test]
    fn a_view_of_a_fisheye_is_a_perspective_one() {
        let (width, height, focal) = (900, 600, 300.0);
        let picture = RgbImage::from_fn(width, height, |x, y| {
            let place = DVec2::new(f64::from(x) + 0.5 - 450.0, f64::from(y) + 0.5 - 300.0);
            let theta = place.length() / focal;
            colour((place.normalize_or_zero() * theta.sin()).extend(theta.cos()))
        });
        let view = WideView::of_fisheye(width, height, focal, 1.8);
        let tan = 50_f64.to_radians().tan();
        assert_eq!((view.width, view.height), ((600.0 * tan).round() as u32, (600.0 * tan).round() as u32));
        let (w, h) = (view.width, view.height);
        shows(&view, &picture, (w / 2, h / 2), DVec3::Z);
        shows(&view, &picture, (w - 1, h / 2), DVec3::new(tan, 0.0, 1.0));
        shows(&view, &picture, (0, 0), DVec3::new(-tan, -tan, 1.0));
        let small = view.within(200);
        assert_eq!((small.width, small.height), (200, 200));
        shows(&small, &image::imageops::thumbnail(&picture, 252, 168), (199, 100), DVec3::new(tan, 0.0, 1.0));
    }

    #[test]
    fn a_narrow_fisheye_gives_no_view_beyond_its_circle() {
        let view = WideView::of_fisheye(600, 600, 300.0 / 0.7, 0.7);
        let corner = DVec2::new(f64::from(view.width), f64::from(view.height)) / 2.0 / view.focal_px;
        assert!((corner.length().atan() - 0.7).abs() < 0.01, "{view:?}");
    }

    #[test]
    fn only_dark_corners_make_a_fisheye_circular() {
        let circle = |dark: u8| {
            RgbImage::from_fn(300, 200, |x, y| {
                let place = DVec2::new(f64::from(x) - 150.0, f64::from(y) - 100.0);
                Rgb([if place.length() < 100.0 { 200 } else { dark }; 3])
            })
        };
        assert!(is_circular(&circle(4)) && !is_circular(&circle(90)));
    }
}
