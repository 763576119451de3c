//! What EXIF says about the camera and where it stood (EXIF 2.32; parsed by `kamadak-exif`).

use super::attitude::apple_up;
use ::exif::{Exif, Field, In, Reader, Tag, Value};
use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::io::Cursor;

/// Millimetres of an inch, the default unit of FocalPlaneXResolution. Source: EXIF 2.32, 4.6.5.
const INCH_MM: f64 = 25.4;
/// Millimetres of a centimetre (FocalPlaneResolutionUnit 3). Source: EXIF 2.32, 4.6.5.
const CENTIMETRE_MM: f64 = 10.0;
/// Width and height of the 35 mm film frame, millimetres. Source: CIPA DCG-001.
const FILM_MM: [f64; 2] = [36.0, 24.0];

/// Where a photo was taken (WGS 84).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GpsPosition {
    /// Latitude, degrees, north is positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east is positive.
    pub longitude_deg: f64,
    /// Altitude above sea level, metres.
    pub altitude_m: Option<f64>,
}

/// What EXIF says about the lens and the sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExifCamera {
    /// Maker of the camera.
    pub make: Option<String>,
    /// Model of the camera.
    pub model: Option<String>,
    /// FocalLength, millimetres.
    pub focal_mm: Option<f64>,
    /// FocalLengthIn35mmFilm, millimetres.
    pub focal_35mm: Option<f64>,
    /// FocalPlaneXResolution, pixels of the original image a millimetre of the sensor.
    pub sensor_px_per_mm: Option<f64>,
    /// PixelXDimension and PixelYDimension: size of the original image.
    pub original_size: Option<(u32, u32)>,
    /// Where the photo was taken.
    pub gps: Option<GpsPosition>,
    /// The direction that is up in the stored picture, where the maker note says it: x right, y
    /// down, z forward, unit.
    pub up: Option<DVec3>,
}

impl ExifCamera {
    /// From the TIFF structure of an EXIF chunk (without the `Exif\0\0` before it). What is damaged
    /// counts as absent.
    pub fn parse(chunk: &[u8]) -> Self {
        let read = Reader::new().continue_on_error(true).read_raw(chunk.to_vec());
        let read = read.or_else(|e| e.distill_partial_result(|_damaged| {}));
        read.as_ref().map(Self::from_fields).unwrap_or_default()
    }

    /// From a whole file whose format the reader knows: HEIF, TIFF, JPEG, PNG, WebP. What is
    /// damaged counts as absent.
    pub(super) fn in_container(file: &[u8]) -> Self {
        let read = Reader::new().continue_on_error(true).read_from_container(&mut Cursor::new(file));
        let read = read.or_else(|e| e.distill_partial_result(|_damaged| {}));
        read.as_ref().map(Self::from_fields).unwrap_or_default()
    }

    fn from_fields(exif: &Exif) -> Self {
        let resolution = positive(exif, Tag::FocalPlaneXResolution);
        let centimetres = integer(exif, Tag::FocalPlaneResolutionUnit) == Some(3);
        let unit_mm = if centimetres { CENTIMETRE_MM } else { INCH_MM };
        let size = integer(exif, Tag::PixelXDimension).zip(integer(exif, Tag::PixelYDimension));
        Self {
            make: text(exif, Tag::Make),
            model: text(exif, Tag::Model),
            focal_mm: positive(exif, Tag::FocalLength),
            focal_35mm: integer(exif, Tag::FocalLengthIn35mmFilm).map(f64::from).filter(|&f| f > 0.0),
            sensor_px_per_mm: resolution.map(|r| r / unit_mm),
            original_size: size.filter(|s| s.0 > 0 && s.1 > 0),
            gps: GpsPosition::from_fields(exif),
            up: up(exif),
        }
    }

    /// Focal length in pixels of an image of this size; `None` where EXIF does not say.
    ///
    /// The 35 mm equivalent is defined by the angle of view over the diagonal (CIPA DCG-001): `f_px
    /// = f₃₅ · diagonal_px / 43.267 mm`. Else `f_px = f_mm · px/mm`, scaled if the image was
    /// resized since.
    pub(crate) fn focal_px(&self, width: u32, height: u32) -> Option<f64> {
        let diagonal = f64::from(width).hypot(f64::from(height));
        let from_35mm = self.focal_35mm.map(|f| f * diagonal / FILM_MM[0].hypot(FILM_MM[1]));
        let focal = from_35mm.or_else(|| self.focal_from_sensor(diagonal));
        focal.filter(|f| (0.1 * diagonal..100.0 * diagonal).contains(f))
    }

    fn focal_from_sensor(&self, diagonal: f64) -> Option<f64> {
        let original = self.original_size.map_or(diagonal, |(w, h)| f64::from(w).hypot(f64::from(h)));
        Some(self.focal_mm? * self.sensor_px_per_mm? * diagonal / original)
    }
}

impl GpsPosition {
    fn from_fields(exif: &Exif) -> Option<Self> {
        let latitude_deg = degrees(exif, Tag::GPSLatitude, Tag::GPSLatitudeRef, "S")?;
        let longitude_deg = degrees(exif, Tag::GPSLongitude, Tag::GPSLongitudeRef, "W")?;
        let below = field(exif, Tag::GPSAltitudeRef).and_then(|f| f.value.get_uint(0)) == Some(1);
        let altitude = rationals(exif, Tag::GPSAltitude).first().copied();
        let altitude_m = altitude.map(|a| if below { -a } else { a });
        let valid = latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0;
        valid.then_some(Self { latitude_deg, longitude_deg, altitude_m })
    }
}

/// By the maker note. The front camera looks the other way.
fn up(exif: &Exif) -> Option<DVec3> {
    let is_front = text(exif, Tag::LensModel).is_some_and(|lens| lens.contains("front"));
    match &field(exif, Tag::MakerNote)?.value {
        Value::Undefined(note, _) if !is_front => apple_up(note),
        _ => None,
    }
}

fn field(exif: &Exif, tag: Tag) -> Option<&Field> {
    exif.get_field(tag, In::PRIMARY)
}

fn integer(exif: &Exif, tag: Tag) -> Option<u32> {
    field(exif, tag)?.value.get_uint(0)
}

/// The finite ones of the rational numbers of a field.
fn rationals(exif: &Exif, tag: Tag) -> Vec<f64> {
    match field(exif, tag).map(|f| &f.value) {
        Some(Value::Rational(all)) => all.iter().map(|r| r.to_f64()).filter(|v| v.is_finite()).collect(),
        _ => Vec::new(),
    }
}

fn positive(exif: &Exif, tag: Tag) -> Option<f64> {
    rationals(exif, tag).first().copied().filter(|v| *v > 0.0)
}

/// Degrees, minutes and seconds as degrees, negative where the reference is `negative`.
fn degrees(exif: &Exif, tag: Tag, reference: Tag, negative: &str) -> Option<f64> {
    let [degrees, minutes, seconds] = rationals(exif, tag)[..] else { return None };
    let value = degrees + minutes / 60.0 + seconds / 3600.0;
    Some(if text(exif, reference)? == negative { -value } else { value })
}

fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &field(exif, tag)?.value else { return None };
    let text = String::from_utf8_lossy(lines.first()?).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A little-endian TIFF whose IFD0 points to an EXIF IFD with focal length 50/10 mm, resolution
    /// 5000 px/cm.
    fn chunk() -> Vec<u8> {
        let mut c = b"II*\0\x08\0\0\0".to_vec();
        let entry = |c: &mut Vec<u8>, tag: u16, kind: u16, count: u32, value: u32| {
            c.extend(tag.to_le_bytes());
            c.extend(kind.to_le_bytes());
            c.extend(count.to_le_bytes());
            c.extend(value.to_le_bytes());
        };
        c.extend(2u16.to_le_bytes());
        entry(&mut c, 0x010f, 2, 4, u32::from_le_bytes(*b"Cam\0"));
        entry(&mut c, 0x8769, 4, 1, 38);
        c.extend([0; 4]);
        assert_eq!(c.len(), 38);
        c.extend(5u16.to_le_bytes());
        entry(&mut c, 0x920a, 5, 1, 104);
        entry(&mut c, 0xa20e, 5, 1, 112);
        entry(&mut c, 0xa210, 3, 1, 3);
        entry(&mut c, 0xa002, 4, 1, 4000);
        entry(&mut c, 0xa003, 4, 1, 3000);
        c.extend([0; 4]);
        assert_eq!(c.len(), 104);
        for v in [50u32, 10, 5000, 1] {
            c.extend(v.to_le_bytes());
        }
        c
    }

    #[test]
    fn the_focal_length_follows_from_sensor_resolution_and_from_35_mm() {
        let exif = ExifCamera::parse(&chunk());
        assert_eq!(exif.make.as_deref(), Some("Cam"));
        let expect = |exif: &ExifCamera, [width, height]: [u32; 2], pixels: f64| {
            let found = exif.focal_px(width, height).unwrap();
            assert!((found - pixels).abs() < 1e-9 * pixels, "{found} {pixels}");
        };
        expect(&exif, [4000, 3000], 2500.0);
        // Half the size, turned.
        expect(&exif, [1500, 2000], 1250.0);
        let exif = ExifCamera { focal_35mm: Some(36.0), ..Default::default() };
        expect(&exif, [3600, 2400], 3600.0);
        assert_eq!(ExifCamera::default().focal_px(100, 100), None);
    }

    #[test]
    fn a_position_south_and_west_is_negative() {
        let rational = |all: &[u32]| {
            Value::Rational(all.iter().map(|&num| ::exif::Rational { num, denom: 1 }).collect())
        };
        let fields = [
            (Tag::GPSLatitudeRef, Value::Ascii(vec![b"S".to_vec()])),
            (Tag::GPSLatitude, rational(&[33, 30, 36])),
            (Tag::GPSLongitudeRef, Value::Ascii(vec![b"W".to_vec()])),
            (Tag::GPSLongitude, rational(&[70, 45, 0])),
            (Tag::GPSAltitude, rational(&[520])),
        ]
        .map(|(tag, value)| Field { tag, ifd_num: In::PRIMARY, value });
        let mut writer = ::exif::experimental::Writer::new();
        fields.iter().for_each(|f| writer.push_field(f));
        let mut chunk = std::io::Cursor::new(Vec::new());
        writer.write(&mut chunk, true).unwrap();
        let gps = ExifCamera::parse(chunk.get_ref()).gps.unwrap();
        assert!((gps.latitude_deg + 33.51).abs() < 1e-9, "{gps:?}");
        assert!((gps.longitude_deg + 70.75).abs() < 1e-9 && gps.altitude_m == Some(520.0), "{gps:?}");
    }

    #[test]
    fn damaged_chunks_say_nothing_and_do_not_panic() {
        let whole = chunk();
        for n in 0..whole.len() {
            ExifCamera::parse(&whole[..n]);
            for bit in 0..8 {
                let mut bad = whole.clone();
                bad[n] ^= 1 << bit;
                ExifCamera::parse(&bad);
            }
        }
    }
}
