//! The colour of the foreground alone.

use super::colour::{Key, srgb8};
use super::screen::Screen;
use super::solve::Matte;
use glam::Vec3;

/// Foreground colour, 8-bit sRGB, of every pixel with alpha above 0 (black elsewhere): the screen's
/// part is taken out (`F = (I − (1 − α) B) / α`), at thin alpha the neighbourhood's colour steps
/// in, and what is left of the key's colour difference is removed.
pub(crate) fn foreground(screen: &Screen, matte: &Matte, key: &Key) -> Vec<u8> {
    let mut out = vec![0_u8; 3 * matte.alpha.len()];
    for (i, target) in out.chunks_exact_mut(3).enumerate() {
        let alpha = matte.alpha[i];
        if alpha <= 0.0 {
            continue;
        }
        let mut colour = screen.image[i];
        if alpha < 1.0 {
            let trust = ((alpha - 0.25) / 0.5).clamp(0.0, 1.0);
            let own = ((colour - (1.0 - alpha) * screen.light[i]) / alpha).max(Vec3::ZERO);
            colour = trust * own + (1.0 - trust) * matte.foreground[i];
        }
        target.copy_from_slice(&without_spill(colour, key).to_array().map(srgb8));
    }
    out
}

/// Takes the colour difference out along the key's chroma; the mean of the channels stays.
#[inline(always)]
fn without_spill(colour: Vec3, key: &Key) -> Vec3 {
    let excess = key.difference(colour);
    if excess <= 0.0 { colour } else { (colour - excess * key.along).max(Vec3::ZERO) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn despilling_greys_the_key_and_leaves_other_colours() {
        let key = Key::new(Vec3::new(0.02, 0.5, 0.05)).unwrap();
        for colour in [[0.5, 0.5, 0.5], [0.8, 0.3, 0.1], [0.2, 0.2, 0.9]].map(Vec3::from) {
            assert_eq!(without_spill(colour, &key), colour);
        }
        let grey = without_spill(Vec3::new(0.3, 0.36, 0.3), &key);
        assert!(key.difference(grey).abs() < 1e-6, "{grey:?}");
        assert!((grey.element_sum() - 0.96).abs() < 1e-5);
    }
}
