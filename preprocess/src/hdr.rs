//! HDR video (HLG, PQ) brought down to an ordinary screen.

use crate::probe::Transfer;
use rayon::prelude::*;

/// Light of diffuse white in HDR video, cd/m². Source: ITU-R BT.2408, 2.1.
const REFERENCE_WHITE: f32 = 203.0;
/// Below this share of white the picture is kept as it is; above, highlights roll off. Source:
/// chosen by hand, never measured.
const KNEE: f32 = 0.6;

/// A tone-mapping from 16-bit HDR values to 8-bit sRGB.
pub(crate) struct ToneMap {
    linear: Vec<f32>,
    srgb: Vec<u8>,
    is_hlg: bool,
    wide_gamut: bool,
}

impl ToneMap {
    /// `wide_gamut`: primaries are Rec. 2020.
    pub(crate) fn new(transfer: Transfer, wide_gamut: bool) -> Self {
        let coded = (0..=u16::MAX).map(|i| f32::from(i) / f32::from(u16::MAX));
        let linear = match transfer {
            Transfer::Pq => coded.map(|v| pq_to_nits(v) / REFERENCE_WHITE).collect(),
            _ => coded.map(hlg_to_scene).collect(),
        };
        Self {
            linear,
            srgb: (0..=4095).map(|i| (srgb_from_linear(i as f32 / 4095.0) * 255.0).round() as u8).collect(),
            is_hlg: transfer == Transfer::Hlg,
            wide_gamut,
        }
    }

    /// `rgb48`: little-endian 16-bit red, green, blue. Returns as many 8-bit pixels.
    pub(crate) fn apply(&self, rgb48: &[u8]) -> Vec<u8> {
        let mut rgb = vec![0; rgb48.len() / 2];
        let rows = rgb48.par_chunks(6 * 4096).zip(rgb.par_chunks_mut(3 * 4096));
        rows.for_each(|(source, target)| {
            for (s, t) in source.chunks_exact(6).zip(target.chunks_exact_mut(3)) {
                let coded = [[s[0], s[1]], [s[2], s[3]], [s[4], s[5]]].map(u16::from_le_bytes);
                t.copy_from_slice(&self.pixel(coded.map(|v| self.linear[usize::from(v)])));
            }
        });
        rgb
    }

    fn pixel(&self, mut rgb: [f32; 3]) -> [u8; 3] {
        if self.is_hlg {
            // System gamma 1.2 of a 1000 cd/m² screen (BT.2100, table 5), on luminance so that hue
            // stays.
            let luminance = 0.2627 * rgb[0] + 0.6780 * rgb[1] + 0.0593 * rgb[2];
            let gain = 1000.0 / REFERENCE_WHITE * luminance.max(1e-6).powf(0.2);
            rgb = rgb.map(|v| v * gain);
        }
        if self.wide_gamut {
            // Rec. 2020 to Rec. 709 primaries (ITU-R BT.2087, annex 2, inverse).
            let [r, g, b] = rgb;
            rgb = [
                1.6605 * r - 0.5876 * g - 0.0728 * b,
                -0.1246 * r + 1.1329 * g - 0.0083 * b,
                -0.0182 * r - 0.1006 * g + 1.1187 * b,
            ];
        }
        let peak = rgb[0].max(rgb[1]).max(rgb[2]);
        let gain = if peak > KNEE { roll_off(peak) / peak } else { 1.0 };
        rgb.map(|v| self.srgb[((v * gain).clamp(0.0, 1.0) * 4095.0 + 0.5) as usize])
    }
}

/// Identity below [`KNEE`], then an exponential that approaches 1 with the same slope.
fn roll_off(v: f32) -> f32 {
    KNEE + (1.0 - KNEE) * (1.0 - (-(v - KNEE) / (1.0 - KNEE)).exp())
}

/// SMPTE ST 2084 EOTF: coded value in [0, 1] to cd/m².
fn pq_to_nits(v: f32) -> f32 {
    let p = v.powf(1.0 / 78.84375);
    10_000.0 * ((p - 0.8359375).max(0.0) / (18.851_562 - 18.6875 * p)).powf(1.0 / 0.159_301_76)
}

/// Inverse of the HLG OETF (BT.2100, table 5): coded value in [0, 1] to scene light in [0, 1].
fn hlg_to_scene(v: f32) -> f32 {
    let (a, b, c) = (0.178_832_77_f32, 0.284_668_92, 0.559_910_7);
    if v <= 0.5 { v * v / 3.0 } else { (((v - c) / a).exp() + b) / 12.0 }
}

/// IEC 61966-2-1.
pub(crate) fn srgb_from_linear(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(map: &ToneMap, value: f32) -> u8 {
        let v = ((value * 65535.0) as u16).to_le_bytes();
        let out = map.apply(&[v[0], v[1], v[0], v[1], v[0], v[1]]);
        assert!(out.iter().all(|c| c.abs_diff(out[0]) <= 1), "grey stays grey: {out:?}");
        out[0]
    }

    #[test]
    fn diffuse_white_of_both_systems_becomes_a_bright_unclipped_value() {
        // BT.2408: 203 cd/m² is 58 % PQ and 75 % HLG.
        let (pq, hlg) = (ToneMap::new(Transfer::Pq, true), ToneMap::new(Transfer::Hlg, true));
        let (a, b) = (grey(&pq, 0.58), grey(&hlg, 0.75));
        assert!((215..250).contains(&a) && a.abs_diff(b) <= 3, "{a} {b}");
        assert_eq!(grey(&pq, 0.0), 0);
        assert!(grey(&pq, 1.0) >= 254 && grey(&hlg, 1.0) >= 250);
    }

    #[test]
    fn brighter_stays_brighter() {
        for transfer in [Transfer::Pq, Transfer::Hlg] {
            let map = ToneMap::new(transfer, true);
            let levels: Vec<u8> = (0..=50).map(|i| grey(&map, i as f32 / 50.0)).collect();
            assert!(levels.windows(2).all(|w| w[0] <= w[1]), "{transfer:?} {levels:?}");
        }
    }
}
