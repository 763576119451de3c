//! The colour of the foreground alone.

use crate::matting::colour::{Key, srgb8};
use crate::matting::solve::Workspace;

/// Foreground colour, 8-bit sRGB, of every pixel with alpha above 0 (black elsewhere): the screen's part is taken out
/// (`F = (I − (1 − α) B) / α`), at thin alpha the neighbourhood's colour steps in, and what is left of the
/// key's colour difference is removed.
pub(crate) fn foreground(work: &Workspace, key: &Key) -> Vec<u8> {
    let mut out = vec![0_u8; 3 * work.alpha.len()];
    for (i, target) in out.chunks_exact_mut(3).enumerate() {
        let alpha = work.alpha[i];
        if alpha <= 0.0 {
            continue;
        }
        let pixel = |c: usize| work.image[c][i];
        let mut colour = [pixel(0), pixel(1), pixel(2)];
        if alpha < 1.0 {
            let trust = ((alpha - 0.25) / 0.5).clamp(0.0, 1.0);
            for (c, v) in colour.iter_mut().enumerate() {
                let own = ((*v - (1.0 - alpha) * work.screen[c][i]) / alpha).max(0.0);
                *v = trust * own + (1.0 - trust) * work.around[c][i];
            }
        }
        target.copy_from_slice(&despilled(colour, key).map(srgb8));
    }
    out
}

/// Takes the colour difference out along the key's chroma; the mean of the channels stays.
#[inline(always)]
pub(crate) fn despilled(colour: [f32; 3], key: &Key) -> [f32; 3] {
    let excess = key.difference(colour);
    if excess <= 0.0 {
        return colour;
    }
    [0, 1, 2].map(|c| (colour[c] - excess * key.along[c]).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn despilling_greys_the_key_and_leaves_other_colours() {
        let key = Key::new([0.02, 0.5, 0.05], 1.0 / 3f32.sqrt()).unwrap();
        for colour in [[0.5, 0.5, 0.5], [0.8, 0.3, 0.1], [0.2, 0.2, 0.9]] {
            assert_eq!(despilled(colour, &key), colour);
        }
        let grey = despilled([0.3, 0.36, 0.3], &key);
        assert!(key.difference(grey).abs() < 1e-6, "{grey:?}");
        assert!((grey.iter().sum::<f32>() - 0.96).abs() < 1e-5);
    }
}
