//! How a camera was held and what kind of picture it took, by the metadata of its photo.

use glam::DVec3;
use image::metadata::Orientation;
use roxmltree::Document;

/// Google's names for what panoramas say. Source: Photo Sphere XMP Metadata.
const GPANO: &str = "http://ns.google.com/photos/1.0/panorama/";
/// DJI's names for what their cameras say. Source: the files of their drones.
const DJI: &str = "http://www.dji.com/drone-dji/1.0/";
/// How an Apple maker note begins; the byte order and the entries of a TIFF directory follow.
/// Source: ExifTool, Apple tags.
const APPLE: &[u8; 12] = b"Apple iOS\0\0\x01";
/// The maker note's entry of what the accelerometer measured, its type (pairs of signed 32-bit
/// integers) and count. Source: ExifTool, Apple tags; TIFF 6.0, section 2.
const ACCELERATION: (u16, u16, u32) = (8, 10, 3);
/// The least and most that an accelerometer at rest shows, units of gravity: one that is shaken
/// does not say what is up. Source: chosen by hand, never measured.
const AT_REST: [f64; 2] = [0.8, 1.2];

/// What the XMP packet of a photo says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct XmpCamera {
    /// Whether the picture is an equirectangular panorama of all directions.
    pub is_panorama: bool,
    /// The direction that is up: x right, y down, z forward, unit.
    pub up: Option<DVec3>,
}

impl XmpCamera {
    /// From a packet. What is damaged counts as absent.
    pub fn parse(packet: &[u8]) -> Self {
        let text = String::from_utf8_lossy(packet);
        let text = text.trim_matches(|c: char| c == '\0' || c == '\u{feff}' || c.is_whitespace());
        let Ok(document) = Document::parse(text) else { return Self::default() };
        let [of, width, whole_width, height, whole_height, pitch, roll] = [
            "ProjectionType",
            "CroppedAreaImageWidthPixels",
            "FullPanoWidthPixels",
            "CroppedAreaImageHeightPixels",
            "FullPanoHeightPixels",
            "PosePitchDegrees",
            "PoseRollDegrees",
        ]
        .map(|name| property(&document, GPANO, name));
        let is_whole = (width, height) == (whole_width, whole_height);
        let gimbal = ["GimbalPitchDegree", "GimbalRollDegree"].map(|name| property(&document, DJI, name));
        let up = held(pitch, roll).or_else(|| held(gimbal[0], gimbal[1]));
        Self { is_panorama: of == Some("equirectangular") && is_whole, up }
    }
}

/// The direction that is up by a pitch and, where it is said, a roll.
fn held(pitch: Option<&str>, roll: Option<&str>) -> Option<DVec3> {
    Some(up_of(degrees(pitch?)?, roll.map_or(Some(0.0), degrees)?))
}

/// What is up in the picture of a camera that looks so far above the horizon and is then rolled
/// clockwise, degrees.
fn up_of(pitch: f64, roll: f64) -> DVec3 {
    let ((sin, cos), (roll_sin, roll_cos)) = (pitch.to_radians().sin_cos(), roll.to_radians().sin_cos());
    DVec3::new(-roll_sin * cos, -roll_cos * cos, sin)
}

/// A value, which XMP writes as an attribute or as an element.
fn property<'a>(document: &'a Document, space: &str, name: &str) -> Option<&'a str> {
    let found = document.descendants().find_map(|node| {
        let is_it = node.has_tag_name((space, name));
        node.attribute((space, name)).or(if is_it { node.text() } else { None })
    });
    found.map(str::trim)
}

fn degrees(text: &str) -> Option<f64> {
    text.parse().ok().filter(|v: &f64| v.abs() <= 360.0)
}

/// What is up in the stored picture of the back camera of an iPhone or iPad (x right, y down, z
/// forward; unit), by the acceleration in its maker note; `None` where the note is another's or the
/// phone was shaken.
///
/// The note holds gravity along the device's axes: x to the right and y to the top of the screen, z
/// out of it (Core Motion). The stored picture is upright when the right side of the device is up:
/// its x axis is −y, its y axis −x, and the camera looks along −z.
pub(super) fn apple_up(note: &[u8]) -> Option<DVec3> {
    let is_big = match note.strip_prefix(APPLE)?.get(..2)? {
        b"MM" => true,
        b"II" => false,
        _ => return None,
    };
    let note = MakerNote { bytes: note, is_big };
    let start = APPLE.len() + 2;
    let mut entries = (0..usize::from(note.short(start)?)).map(|i| start + 2 + 12 * i);
    let at = entries.find(|&at| note.short(at) == Some(ACCELERATION.0))?;
    if note.short(at + 2)? != ACCELERATION.1 || note.long(at + 4)? != ACCELERATION.2 {
        return None;
    }
    let values = note.long(at + 8)? as usize;
    let gravity = DVec3::new(note.rational(values)?, note.rational(values + 8)?, note.rational(values + 16)?);
    let is_at_rest = (AT_REST[0]..AT_REST[1]).contains(&gravity.length());
    is_at_rest.then(|| DVec3::new(gravity.y, gravity.x, gravity.z).normalize())
}

/// Numbers in a maker note; `None` beyond its end.
struct MakerNote<'a> {
    bytes: &'a [u8],
    is_big: bool,
}

impl MakerNote<'_> {
    fn short(&self, at: usize) -> Option<u16> {
        let bytes = self.bytes.get(at..at + 2)?.try_into().ok()?;
        Some(if self.is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn long(&self, at: usize) -> Option<u32> {
        let bytes = self.bytes.get(at..at + 4)?.try_into().ok()?;
        Some(if self.is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn rational(&self, at: usize) -> Option<f64> {
        Some(f64::from(self.long(at)? as i32) / f64::from(self.long(at + 4)? as i32))
    }
}

/// A direction of the stored picture in the upright one; `None` of one that is mirrored.
pub(super) fn turned(stored: DVec3, orientation: Orientation) -> Option<DVec3> {
    let DVec3 { x, y, z } = stored;
    match orientation {
        Orientation::NoTransforms => Some(stored),
        Orientation::Rotate90 => Some(DVec3::new(-y, x, z)),
        Orientation::Rotate180 => Some(DVec3::new(-x, -y, z)),
        Orientation::Rotate270 => Some(DVec3::new(y, -x, z)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(inner: &str) -> Vec<u8> {
        let spaces = format!("xmlns:GPano='{GPANO}' xmlns:drone-dji='{DJI}'");
        let rdf = "xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'";
        format!(
            "<?xpacket begin='\u{feff}'?><x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF {rdf}>\
             <rdf:Description {spaces} {inner}</rdf:Description></rdf:RDF></x:xmpmeta>"
        )
        .into_bytes()
    }

    #[test]
    fn a_gimbal_that_looks_down_has_up_behind_the_picture() {
        let up = |inner: &str| XmpCamera::parse(&packet(inner)).up.unwrap();
        let down = up("drone-dji:GimbalPitchDegree='-90.00' drone-dji:GimbalRollDegree='+0.00'>");
        assert!(down.distance(DVec3::NEG_Z) < 1e-12, "{down}");
        let level = up("><drone-dji:GimbalPitchDegree>+0.0</drone-dji:GimbalPitchDegree>");
        assert!(level.distance(DVec3::NEG_Y) < 1e-12, "{level}");
        // Rolled clockwise by a quarter, the left side of the picture is up.
        let rolled = up("GPano:PosePitchDegrees='0' GPano:PoseRollDegrees='90'>");
        assert!(rolled.distance(DVec3::NEG_X) < 1e-12, "{rolled}");
        let said = XmpCamera::parse(&packet("drone-dji:GimbalPitchDegree='much'>"));
        assert_eq!(said, XmpCamera::default());
    }

    #[test]
    fn only_a_whole_equirectangular_picture_is_a_panorama() {
        let is = |inner: &str| XmpCamera::parse(&packet(inner)).is_panorama;
        assert!(is("GPano:ProjectionType='equirectangular'>"));
        assert!(!is("GPano:ProjectionType='cylindrical'>"));
        let part = "GPano:ProjectionType='equirectangular' GPano:FullPanoWidthPixels='4000' \
                    GPano:CroppedAreaImageWidthPixels='2000'>";
        assert!(!is(part));
        assert!(!is(">") && !XmpCamera::parse(b"<damaged").is_panorama);
    }

    /// A maker note of this gravity, in thousandths.
    pub(crate) fn note(gravity: [i32; 3]) -> Vec<u8> {
        let mut note = [&APPLE[..], b"MM", &2u16.to_be_bytes()].concat();
        let (tag, kind, count) = ACCELERATION;
        for (tag, kind, count, value) in [(1, 9, 1, 14u32), (tag, kind, count, 44)] {
            note.extend([tag.to_be_bytes(), kind.to_be_bytes()].concat());
            note.extend([count.to_be_bytes(), value.to_be_bytes()].concat());
        }
        note.extend([0; 4]);
        assert_eq!(note.len(), 44);
        gravity.iter().for_each(|v| note.extend([v.to_be_bytes(), 1000i32.to_be_bytes()].concat()));
        note
    }

    #[test]
    fn a_phone_knows_what_is_up_however_it_is_held() {
        // Right side up: the stored picture is upright.
        let landscape = apple_up(&note([-1000, 0, 0])).unwrap();
        assert!(landscape.distance(DVec3::NEG_Y) < 1e-12, "{landscape}");
        // Upright: the stored picture is to be turned clockwise.
        let portrait = turned(apple_up(&note([0, -1000, 0])).unwrap(), Orientation::Rotate90).unwrap();
        assert!(portrait.distance(DVec3::NEG_Y) < 1e-12, "{portrait}");
        // Lying on its back, it photographs the table: up is behind the picture.
        let lying = apple_up(&note([0, 0, -1000])).unwrap();
        assert!(lying.distance(DVec3::NEG_Z) < 1e-12, "{lying}");
        // Tilted down by 30° in landscape.
        let tilted = apple_up(&note([-866, 0, -500])).unwrap();
        assert!(tilted.distance(up_of(-30.0, 0.0)) < 1e-3, "{tilted}");
        assert_eq!(apple_up(&note([-1500, 0, 0])), None, "shaken");
        assert_eq!(turned(landscape, Orientation::FlipHorizontal), None);
    }

    #[test]
    fn damaged_maker_notes_say_nothing_and_do_not_panic() {
        let whole = note([-1000, 0, 0]);
        for n in 0..whole.len() {
            apple_up(&whole[..n]);
            for bit in 0..8 {
                let mut bad = whole.clone();
                bad[n] ^= 1 << bit;
                apple_up(&bad);
            }
        }
    }
}
