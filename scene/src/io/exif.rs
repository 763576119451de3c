//! The few EXIF tags that say something about the camera (EXIF 2.3, TIFF 6.0 structure).

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
}

const MAKE: u16 = 0x010f;
const MODEL: u16 = 0x0110;
const EXIF_IFD: u16 = 0x8769;
const FOCAL_LENGTH: u16 = 0x920a;
const PIXEL_X: u16 = 0xa002;
const PIXEL_Y: u16 = 0xa003;
const FOCAL_PLANE_X_RESOLUTION: u16 = 0xa20e;
const FOCAL_PLANE_UNIT: u16 = 0xa210;
const FOCAL_LENGTH_35MM: u16 = 0xa405;

impl ExifCamera {
    /// From the TIFF structure of an EXIF chunk (without the `Exif\0\0` before it). What is damaged counts as absent.
    pub fn parse(chunk: &[u8]) -> Self {
        let mut exif = Self::default();
        let Some(tiff) = Tiff::new(chunk) else { return exif };
        let mut unit_mm = 25.4; // the default unit is the inch
        let mut resolution = None;
        let mut size = (None, None);
        let mut todo = vec![tiff.u32(4)];
        for _ in 0..2 {
            let Some(Some(ifd)) = todo.pop() else { break };
            for entry in tiff.entries(ifd as usize) {
                match entry.tag {
                    MAKE => exif.make = tiff.text(&entry),
                    MODEL => exif.model = tiff.text(&entry),
                    EXIF_IFD => todo.push(tiff.integer(&entry)),
                    FOCAL_LENGTH => exif.focal_mm = tiff.rational(&entry),
                    FOCAL_LENGTH_35MM => {
                        exif.focal_35mm = tiff.integer(&entry).map(f64::from).filter(|&f| f > 0.0)
                    }
                    FOCAL_PLANE_X_RESOLUTION => resolution = tiff.rational(&entry),
                    FOCAL_PLANE_UNIT if tiff.integer(&entry) == Some(3) => unit_mm = 10.0,
                    PIXEL_X => size.0 = tiff.integer(&entry),
                    PIXEL_Y => size.1 = tiff.integer(&entry),
                    _ => {}
                }
            }
        }
        exif.sensor_px_per_mm = resolution.map(|r| r / unit_mm);
        exif.original_size = size.0.zip(size.1).filter(|s| s.0 > 0 && s.1 > 0);
        exif
    }

    /// Focal length in pixels of an image of this size; `None` where EXIF does not say.
    ///
    /// The 35 mm equivalent is defined by the angle of view over the diagonal (CIPA DCG-001):
    /// `f_px = f₃₅ · diagonal_px / 43.267 mm`. Else `f_px = f_mm · px/mm`, scaled if the image was resized since.
    pub fn focal_px(&self, width: u32, height: u32) -> Option<f64> {
        let diagonal = f64::from(width).hypot(f64::from(height));
        let from_35mm = self.focal_35mm.map(|f| f * diagonal / 36f64.hypot(24.0));
        let from_sensor = || {
            let original = self.original_size.map_or(diagonal, |(w, h)| f64::from(w).hypot(f64::from(h)));
            Some(self.focal_mm? * self.sensor_px_per_mm? * diagonal / original)
        };
        from_35mm.or_else(from_sensor).filter(|f| (0.1 * diagonal..100.0 * diagonal).contains(f))
    }
}

struct Entry {
    tag: u16,
    kind: u16,
    count: usize,
    /// Where the four value bytes (or the offset of the value) lie.
    at: usize,
}

struct Tiff<'a> {
    data: &'a [u8],
    big_endian: bool,
}

impl<'a> Tiff<'a> {
    fn new(data: &'a [u8]) -> Option<Self> {
        let big_endian = match data.get(..4)? {
            b"II*\0" => false,
            b"MM\0*" => true,
            _ => return None,
        };
        Some(Self { data, big_endian })
    }

    fn u16(&self, at: usize) -> Option<u16> {
        let b: [u8; 2] = self.data.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if self.big_endian { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) })
    }

    fn u32(&self, at: usize) -> Option<u32> {
        let b: [u8; 4] = self.data.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if self.big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) })
    }

    fn entries(&self, ifd: usize) -> Vec<Entry> {
        let n = self.u16(ifd).unwrap_or(0) as usize;
        let entry = |i: usize| {
            let at = ifd + 2 + 12 * i;
            let count = self.u32(at + 4)? as usize;
            Some(Entry { tag: self.u16(at)?, kind: self.u16(at + 2)?, count, at: at + 8 })
        };
        (0..n).map_while(entry).collect()
    }

    fn integer(&self, e: &Entry) -> Option<u32> {
        match e.kind {
            3 => self.u16(e.at).map(u32::from),
            4 => self.u32(e.at),
            _ => None,
        }
    }

    fn rational(&self, e: &Entry) -> Option<f64> {
        let at = self.u32(e.at)? as usize;
        let value = f64::from(self.u32(at)?) / f64::from(self.u32(at.checked_add(4)?)?);
        (e.kind == 5 && value.is_finite() && value > 0.0).then_some(value)
    }

    fn text(&self, e: &Entry) -> Option<String> {
        let at = if e.count > 4 { self.u32(e.at)? as usize } else { e.at };
        let bytes = self.data.get(at..at.checked_add(e.count.min(200))?)?;
        let text = String::from_utf8_lossy(bytes.split(|&b| b == 0).next()?).trim().to_string();
        (e.kind == 2 && !text.is_empty()).then_some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A little-endian TIFF whose IFD0 points to an EXIF IFD with focal length 50/10 mm, resolution 5000 px/cm.
    fn chunk() -> Vec<u8> {
        let mut c = b"II*\0\x08\0\0\0".to_vec();
        let entry = |c: &mut Vec<u8>, tag: u16, kind: u16, count: u32, value: u32| {
            c.extend(tag.to_le_bytes());
            c.extend(kind.to_le_bytes());
            c.extend(count.to_le_bytes());
            c.extend(value.to_le_bytes());
        };
        c.extend(2u16.to_le_bytes());
        entry(&mut c, MAKE, 2, 4, u32::from_le_bytes(*b"Cam\0"));
        entry(&mut c, EXIF_IFD, 4, 1, 38);
        c.extend([0; 4]);
        assert_eq!(c.len(), 38);
        c.extend(5u16.to_le_bytes());
        entry(&mut c, FOCAL_LENGTH, 5, 1, 104);
        entry(&mut c, FOCAL_PLANE_X_RESOLUTION, 5, 1, 112);
        entry(&mut c, FOCAL_PLANE_UNIT, 3, 1, 3);
        entry(&mut c, PIXEL_X, 4, 1, 4000);
        entry(&mut c, PIXEL_Y, 4, 1, 3000);
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
        assert_eq!(exif.focal_px(4000, 3000), Some(2500.0));
        assert_eq!(exif.focal_px(1500, 2000), Some(1250.0), "half the size, turned");
        let exif = ExifCamera { focal_35mm: Some(36.0), ..Default::default() };
        assert!((exif.focal_px(3600, 2400).unwrap() - 3600.0).abs() < 1e-9);
        assert_eq!(ExifCamera::default().focal_px(100, 100), None);
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
