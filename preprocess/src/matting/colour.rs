//! Linear light, hue, and the colour difference that tells screen from object.

use crate::hdr::srgb_from_linear;
use glam::Vec3;
use std::sync::LazyLock;

/// Linear light in [0, 1] of 8-bit sRGB (IEC 61966-2-1).
static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = i as f32 / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
});

/// Steps of linear light in the table of [`srgb8`].
/// Source: a power of two at which every 8-bit value comes back from linear light (test).
const SRGB_STEPS: usize = 8192;
static SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=SRGB_STEPS).map(|i| (srgb_from_linear(i as f32 / SRGB_STEPS as f32) * 255.0).round() as u8).collect()
});

/// Linear light of the first pixel of 8-bit sRGB.
#[inline(always)]
pub(crate) fn linear(rgb: &[u8]) -> Vec3 {
    let table = &*LINEAR;
    Vec3::new(table[usize::from(rgb[0])], table[usize::from(rgb[1])], table[usize::from(rgb[2])])
}

/// The first pixel of 8-bit sRGB as coded, 0 to 255.
#[inline(always)]
pub(crate) fn levels(rgb: &[u8]) -> Vec3 {
    Vec3::new(f32::from(rgb[0]), f32::from(rgb[1]), f32::from(rgb[2]))
}

/// 8-bit sRGB of linear light; clamped.
pub(crate) fn srgb8(v: f32) -> u8 {
    SRGB[(v.clamp(0.0, 1.0) * SRGB_STEPS as f32 + 0.5) as usize]
}

/// Linear light as coded in 8-bit sRGB, 0 to 255.
#[inline(always)]
pub(crate) fn coded(light: Vec3) -> Vec3 {
    light.map(|v| f32::from(srgb8(v)))
}

/// Hue in degrees [0, 360), saturation and value in [0, 1] (Smith 1978).
pub(crate) fn hue_saturation_value(rgb: [u8; 3]) -> (f32, f32, f32) {
    let [r, g, b] = rgb.map(f32::from);
    let (max, min) = (r.max(g).max(b), r.min(g).min(b));
    let span = max - min;
    if span <= 0.0 {
        return (0.0, 0.0, max / 255.0);
    }
    let sixth = if max == r {
        ((g - b) / span).rem_euclid(6.0)
    } else if max == g {
        (b - r) / span + 2.0
    } else {
        (r - g) / span + 4.0
    };
    (60.0 * sixth, span / max, max / 255.0)
}

/// Smallest angle between two hues, degrees.
pub(crate) fn hue_distance(a: f32, b: f32) -> f32 {
    let d = (a - b).rem_euclid(360.0);
    d.min(360.0 - d)
}

/// 1 / √3: tangent of the angle within which hues keep a colour difference.
/// Source: Vlahos, US patent 4,100,569.
const TAN_30: f32 = 0.577_350_26;

/// The screen's colour as a direction in the plane of chroma (what remains of linear RGB without
/// its mean).
///
/// The colour difference of a pixel is `d = c·k − |c·k⊥| / √3`: for a green key it is Vlahos' `G −
/// max(R, B)` up to scale (US patent 4,100,569), and it turns with the hue of the key.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Key {
    /// Unit vector along the key's chroma.
    pub along: Vec3,
    /// Unit vector across it, in the plane of chroma.
    pub across: Vec3,
    /// Colour difference of the screen.
    pub reference: f32,
    /// The same by the screen's light.
    purity: f32,
}

impl Key {
    /// From the linear colour of the screen; `None` for a grey one.
    pub(super) fn new(colour: Vec3) -> Option<Self> {
        let chroma = chroma(colour);
        let norm = chroma.length();
        if norm < 1e-5 {
            return None;
        }
        let along = chroma / norm;
        let across = TAN_30 * Vec3::ONE.cross(along);
        let mut key = Self { along, across, reference: 0.0, purity: 0.0 };
        key.reference = key.difference(colour);
        key.purity = key.reference / colour.element_sum();
        Some(key)
    }

    /// The colour difference; for the screen itself its chroma, at most 0 for neutral and other
    /// colours.
    #[inline(always)]
    pub(super) fn difference(&self, rgb: Vec3) -> f32 {
        self.along.dot(rgb) - TAN_30 * self.across.dot(rgb).abs()
    }

    /// Whether linear light looks like the screen: enough of its colour difference and, for its own
    /// light, of its purity.
    #[inline(always)]
    pub(super) fn is_like(&self, rgb: Vec3) -> bool {
        let own = self.difference(rgb);
        own > 0.08 * self.reference && own > 0.7 * self.purity * rgb.element_sum()
    }
}

/// What remains of a colour without its mean.
#[inline(always)]
pub(crate) fn chroma(rgb: Vec3) -> Vec3 {
    rgb - rgb.element_sum() / 3.0
}

/// Relative luminance (Rec. 709).
#[inline(always)]
pub(crate) fn luminance(rgb: Vec3) -> f32 {
    Vec3::new(0.2126, 0.7152, 0.0722).dot(rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_difference_of_a_green_key_is_that_of_vlahos() {
        let key = Key::new(Vec3::new(0.0, 0.6, 0.0)).unwrap();
        let scale = key.difference(Vec3::Y);
        for rgb in [[0.2_f32, 0.7, 0.1], [0.5, 0.4, 0.9], [0.3, 0.3, 0.3], [0.0, 0.5, 0.45]] {
            let vlahos = rgb[1] - rgb[0].max(rgb[2]);
            assert!((key.difference(rgb.into()) / scale - vlahos).abs() < 1e-6, "{rgb:?}");
        }
        assert!(Key::new(Vec3::splat(0.4)).is_none());
    }

    #[test]
    fn srgb_survives_linear_light() {
        assert!((0..=255).all(|v| srgb8(linear(&[v, 0, 0]).x) == v));
        assert_eq!((srgb8(-1.0), srgb8(f32::NAN), srgb8(9.0)), (0, 0, 255));
    }
}
