//! Linear light, hue, and the colour difference that tells screen from object.

use crate::hdr::srgb_from_linear;
use std::sync::LazyLock;

/// Linear light in [0, 1] of 8-bit sRGB (IEC 61966-2-1).
pub(crate) static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = i as f32 / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
});

const SRGB_STEPS: usize = 8192;
static SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=SRGB_STEPS).map(|i| (srgb_from_linear(i as f32 / SRGB_STEPS as f32) * 255.0).round() as u8).collect()
});

/// 8-bit sRGB of linear light; clamped.
pub(crate) fn srgb8(v: f32) -> u8 {
    SRGB[(v.clamp(0.0, 1.0) * SRGB_STEPS as f32 + 0.5) as usize]
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

/// The screen's colour as a direction in the plane of chroma (what remains of linear RGB without its mean).
///
/// The colour difference of a pixel is `d = c·k − w |c·k⊥|`: for a green key and `w = 1/√3` it is Vlahos'
/// `G − max(R, B)` up to scale (US patent 4,100,569), and it turns with the hue of the key.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Key {
    /// Unit vector along the key's chroma.
    pub along: [f32; 3],
    /// Unit vector across it, in the plane of chroma.
    pub across: [f32; 3],
    /// How much of the chroma across is taken off, at least `1/√3`.
    pub wedge: f32,
    /// Linear colour of the screen.
    pub colour: [f32; 3],
    /// Hue, degrees.
    pub hue: f32,
}

impl Key {
    /// From the linear colour of the screen; `None` for a grey one.
    pub fn new(colour: [f32; 3], wedge: f32) -> Option<Self> {
        let mean = (colour[0] + colour[1] + colour[2]) / 3.0;
        let chroma = colour.map(|v| v - mean);
        let norm = dot(chroma, chroma).sqrt();
        if norm < 1e-5 {
            return None;
        }
        let along = chroma.map(|v| v / norm);
        let n = 1.0 / 3f32.sqrt();
        let across = [n * (along[2] - along[1]), n * (along[0] - along[2]), n * (along[1] - along[0])];
        let (hue, _, _) = hue_saturation_value(colour.map(srgb8));
        Some(Self { along, across, wedge, colour, hue })
    }

    /// The colour difference; for the screen itself its chroma, at most 0 for neutral and other colours.
    #[inline(always)]
    pub fn difference(&self, rgb: [f32; 3]) -> f32 {
        dot(self.along, rgb) - self.wedge * dot(self.across, rgb).abs()
    }
}

/// Scalar product.
#[inline(always)]
pub(crate) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Relative luminance (Rec. 709).
#[inline(always)]
pub(crate) fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_difference_of_a_green_key_is_that_of_vlahos() {
        let key = Key::new([0.0, 0.6, 0.0], 1.0 / 3f32.sqrt()).unwrap();
        let scale = key.difference([0.0, 1.0, 0.0]);
        for rgb in [[0.2_f32, 0.7, 0.1], [0.5, 0.4, 0.9], [0.3, 0.3, 0.3], [0.0, 0.5, 0.45]] {
            let vlahos = rgb[1] - rgb[0].max(rgb[2]);
            assert!((key.difference(rgb) / scale - vlahos).abs() < 1e-6, "{rgb:?}");
        }
        assert!(Key::new([0.4; 3], 0.6).is_none());
    }

    #[test]
    fn srgb_survives_linear_light() {
        assert!((0..=255).all(|v| srgb8(LINEAR[v]) == v as u8));
        assert_eq!((srgb8(-1.0), srgb8(f32::NAN), srgb8(9.0)), (0, 0, 255));
    }
}
