//! The soft matte of one frame: alpha in the band between what is surely screen and what is surely
//! object.

use super::colour::{Key, chroma, coded, luminance};
use super::morphology::{Rect, box_sum, set_pixels, smooth_within};
use super::pool::Raster;
use super::screen::Screen;
use super::trimap::Trimap;
use glam::Vec3;

/// Radius of the neighbourhood from which the colours of foreground and screen are learnt, pixels.
/// Source: `key_table`: for the screen 3 and 5 differ by less than 0.0004 of IoU; for the
/// foreground chosen by hand, never measured.
const REACH: usize = 3;
/// Alpha nearer to 0 or 1 than this is 0 or 1.
/// Source: `key_table`: at 0.02 mean errors of alpha of the composites grow by 0.00003.
pub(crate) const CLEAR: f32 = 0.03;

/// What a lens, 4:2:0 coding and the light of screen and object do to an edge.
struct EdgeModel {
    /// Weight of a mixed pixel beside a solid one when the foreground's colour is learnt.
    /// Source: `key_table` is the same from 0.02 to 0.1.
    mixed_weight: f32,
    /// Chroma of 4:2:0 video is blurred: standard deviation of alpha from chroma at an edge.
    /// Source: `key_table`: at 0.06 the IoU of case 3 falls by 0.0003.
    chroma_error: f32,
    /// The lens mixes over about a pixel in linear light before chroma is coded and spread over two
    /// or three: how much of what a half covered pixel shows too much of the brighter side is taken
    /// off. Source: `key_table`: without it the IoU of case 3 falls by 0.0003.
    optical: f32,
    /// How well the light of object and screen is known, share of their sum. Source: `key_table`:
    /// without it the IoU of the temple falls by 0.0007 and more, at 0.12 that of case 3 by 0.0003.
    light_error: f32,
    /// The object's rim is lit by the screen and mixes with its blur: alpha from chroma falls short
    /// by this factor there. Source: `key_table`: without it the IoU of the composites falls by
    /// 0.0004 to 0.0027.
    rim_gain: f32,
    /// How firmly the rim's light is held to the neighbourhood's: weight, in pixels that are object
    /// alone. Source: `key_table` is the same from 0.1 to 0.8; at 8 the IoU of the temple before
    /// blue falls by 0.0015.
    rim_hold: f32,
    /// Smoothing has made the edge this much too soft.
    /// Source: `key_table`: without it the IoU of case 3 falls by 0.0009.
    edge_contrast: f32,
    /// Where less than half a pixel around is solid (rods), chroma is spread over more than the
    /// object is wide: alpha from it falls short by this factor. Source: `key_table`: without it
    /// the IoU of case 3 falls by 0.0002.
    thin_gain: f32,
}

/// The values in force.
const EDGE: EdgeModel = EdgeModel {
    mixed_weight: 0.05,
    chroma_error: 0.12,
    optical: 1.5,
    light_error: 0.06,
    rim_gain: 1.06,
    rim_hold: 0.1,
    edge_contrast: 1.2,
    thin_gain: 1.2,
};

/// The screen's light in the band, from the screen beside it: shadows have edges that coarse cells
/// cannot follow.
pub(super) fn measure_light_beside(screen: &mut Screen, trimap: &Trimap, key: &Key) {
    let rect = Rect::around(&trimap.not_screen, REACH);
    let mut weights = screen.share.map(|_| 0.0);
    let mut sums = screen.light.map(|_| Vec3::ZERO);
    for i in rect.rows(weights.width).flatten() {
        weights[i] = f32::from((trimap.not_screen[i] | screen.fixed[i]) ^ 1);
        sums[i] = weights[i] * screen.image[i];
    }
    box_sum(&mut weights, &rect, REACH);
    box_sum(&mut sums, &rect, REACH);
    for i in set_pixels(&trimap.band) {
        if screen.fixed[i] == 0 && weights[i] >= (2 * REACH + 1) as f32 {
            screen.light[i] = sums[i] / weights[i];
            screen.share[i] = key.difference(screen.image[i]) / (key.difference(screen.light[i]) + 1e-6);
        }
    }
}

/// The matte of one frame, and what it was solved with.
pub(crate) struct Matte<'p> {
    /// The object's part of every pixel, 0 to 1.
    pub alpha: Raster<'p, f32>,
    /// Foreground colour of the neighbourhood, linear; in the band a mean, elsewhere a sum.
    pub foreground: Raster<'p, Vec3>,
    /// Of how many solid pixels.
    pub weight: Raster<'p, f32>,
}

impl<'p> Matte<'p> {
    /// Solves the matte of a frame.
    pub(super) fn solve(screen: &Screen<'p>, trimap: &Trimap<'p>) -> Self {
        let rect = Rect::around(&trimap.not_screen, REACH);
        let alpha = trimap.core.map(|v| f32::from(*v));
        let band = screen.share.pool.plane(alpha.width, set_pixels(&trimap.band).map(|i| i as u32));
        let (matte, spread) = learn_foreground(screen, trimap, alpha, &rect);
        let rim = screen.share.map(|_| 1.0);
        let mut solver = BandSolver { screen, band, rect, matte, spread, rim };
        solver.solve();
        solver.matte
    }

    /// Foreground colour of the neighbourhood of any pixel.
    pub(super) fn object_around(&self, i: usize, in_band: bool) -> Vec3 {
        // Outside of the band the sums have not been divided.
        if in_band { self.foreground[i] } else { 1.0 / self.weight[i].max(1e-5) * self.foreground[i] }
    }

    /// How much of what is around a pixel is solid, 0 to 1.
    pub(super) fn solid_around(&self, i: usize) -> f32 {
        (self.weight[i] / ((2 * REACH + 1) * (2 * REACH + 1)) as f32).min(1.0)
    }
}

/// Mean foreground colour around every pixel of the band and the variance of its luma. Solid pixels
/// count as they are, with the screen's light that falls on them, for so does the object's part of
/// a mixed pixel; where there are none (rods) the screen's share is taken out of the mixed ones.
fn learn_foreground<'p>(
    screen: &Screen<'p>,
    trimap: &Trimap,
    alpha: Raster<'p, f32>,
    rect: &Rect,
) -> (Matte<'p>, Raster<'p, f32>) {
    let mut foreground = screen.image.map(|_| Vec3::ZERO);
    let (mut weight, mut spread) = (alpha.map(|_| 0.0), alpha.map(|_| 0.0));
    for i in rect.rows(alpha.width).flatten().filter(|i| trimap.not_screen[*i] != 0) {
        let is_solid = trimap.interior[i] != 0;
        let s = if is_solid { 0.0 } else { screen.smoothed[i].max(screen.share[i]).clamp(0.0, 1.0) };
        let t = 1.0 - s;
        let own = if is_solid { 1.0 } else { EDGE.mixed_weight * t * t * t };
        // t · (un-premultiplied colour) = I − s B
        let value = (screen.image[i] - s * screen.light[i]).max(Vec3::ZERO);
        foreground[i] = own * value;
        let y = luminance(if t > 1e-3 { value / t } else { Vec3::ZERO });
        weight[i] = own * t;
        spread[i] = own * t * y * y;
    }
    box_sum(&mut foreground, rect, REACH);
    box_sum(&mut weight, rect, REACH);
    box_sum(&mut spread, rect, REACH);
    for i in set_pixels(&trimap.band) {
        let scale = if weight[i] > 1e-5 { 1.0 / weight[i] } else { 0.0 };
        foreground[i] *= scale;
        let y = luminance(foreground[i]);
        spread[i] = (spread[i] * scale - y * y).max(0.0);
    }
    (Matte { alpha, foreground, weight }, spread)
}

/// Solves alpha in the band.
struct BandSolver<'a, 'p> {
    screen: &'a Screen<'p>,
    /// Pixels of the band.
    band: Raster<'p, u32>,
    /// Around what is not screen.
    rect: Rect,
    matte: Matte<'p>,
    /// Variance of the luma of the foreground around.
    spread: Raster<'p, f32>,
    /// Light of the rim as a factor on the foreground's.
    rim: Raster<'p, f32>,
}

impl<'p> BandSolver<'_, 'p> {
    /// Alpha as the place of the pixel between screen and foreground, from chroma and from luma,
    /// each weighed by how well it can tell (inverse variance).
    fn solve(&mut self) {
        let mean = self.ask_chroma();
        self.rim = self.light_rim(&mean);
        let mean = self.ask_chroma();
        for &i in self.band.iter() {
            let i = i as usize;
            let alpha = rim_alpha(mean[i]);
            let alpha = if self.matte.weight[i] < 1e-5 { alpha } else { self.with_luma(i, alpha) };
            self.matte.alpha[i] = without_haze((alpha - 0.5) * EDGE.edge_contrast + 0.5);
        }
    }

    /// Colour of the object's part of a pixel.
    fn object(&self, i: usize) -> Vec3 {
        self.rim[i] * self.matte.foreground[i]
    }

    /// Alpha from chroma alone. Chroma is sampled at every other pixel: smoothing over 3 × 3 costs
    /// no detail and removes the steps.
    fn ask_chroma(&mut self) -> Raster<'p, f32> {
        for &i in self.band.iter() {
            let i = i as usize;
            let weight = self.matte.weight[i];
            let alpha = if weight < 1e-5 { 1.0 - self.screen.share[i] } else { self.alpha_from_chroma(i) };
            let alpha = if weight < 0.5 { EDGE.thin_gain * alpha } else { alpha };
            self.matte.alpha[i] = alpha.clamp(-0.2, 1.2);
        }
        smooth_within(&self.matte.alpha, &self.rect)
    }

    /// An object's rim is darker than what lies behind it where it turns away from the lamp, and
    /// brighter where it shines. Of the light alpha from chroma knows little, so that luma Y tells
    /// it: the factor k on the neighbourhood's light F with the least `Σ (Y − (1 − α) B − α k F)² /
    /// F² + λ (k − 1)²`, B the screen's.
    fn light_rim(&self, mean: &[f32]) -> Raster<'p, f32> {
        let (mut lit, mut told) = (self.rim.map(|_| 0.0), self.rim.map(|_| 0.0));
        for i in self.band.iter().map(|i| *i as usize).filter(|i| self.matte.weight[*i] >= 1e-5) {
            let alpha = rim_alpha(mean[i]);
            let own = luminance(self.screen.image[i]) - (1.0 - alpha) * luminance(self.screen.light[i]);
            lit[i] = alpha * own / luminance(self.matte.foreground[i]).max(1e-5);
            told[i] = alpha * alpha;
        }
        for plane in [&mut lit, &mut told] {
            // Twice 3 × 3: 5 × 5 pixels, weighed to the middle.
            box_sum(plane, &self.rect, 1);
            box_sum(plane, &self.rect, 1);
        }
        for &i in self.band.iter() {
            let i = i as usize;
            lit[i] = ((lit[i] + EDGE.rim_hold) / (told[i] + EDGE.rim_hold)).max(0.0);
        }
        lit
    }

    /// From chroma as it is coded: there the averaging of 4:2:0 is linear and an edge keeps its
    /// place. In linear light the chroma that spreads over it weighs by the light of the pixel that
    /// it spreads to.
    fn alpha_from_chroma(&self, i: usize) -> f32 {
        let (screen, object) = (self.screen.light[i], self.object(i));
        let (b, f) = (coded_chroma(screen), coded_chroma(object));
        let fb = f - b;
        let norm = fb.length_squared() + 1e-9;
        let alpha = (coded_chroma(self.screen.image[i]) - b).dot(fb) / norm;
        // The lens mixes light before it is coded: of a half covered pixel the brighter side shows
        // more.
        let half = (coded_chroma(0.5 * (screen + object)) - b).dot(fb) / norm;
        let a = alpha.clamp(0.0, 1.0);
        alpha - EDGE.optical * (half - 0.5) * a * (1.0 - a)
    }

    fn with_luma(&self, i: usize, alpha_c: f32) -> f32 {
        let (p, b) = (self.screen.image[i], self.screen.light[i]);
        let fd = self.object(i) - b;
        let (c2, fy) = (chroma(fd).length_squared(), luminance(fd));
        let (y2, screen) = (fy * fy, luminance(b));
        let weight_c = c2 / (EDGE.chroma_error * EDGE.chroma_error * c2 + 1e-9);
        let light = EDGE.light_error * (screen + screen + fy);
        let weight_y = y2 / (self.spread[i] + light * light + 1e-9);
        let alpha_y = (luminance(p - b) * fy / (y2 + 1e-9)).clamp(0.0, 1.0);
        (weight_c * alpha_c + weight_y * alpha_y) / (weight_c + weight_y + 1e-9)
    }
}

/// Chroma of linear light as it is coded, 1 at most.
#[inline(always)]
fn coded_chroma(light: Vec3) -> Vec3 {
    chroma(coded(light) / 255.0)
}

/// Alpha without what is hardly there or hardly missing.
#[inline(always)]
pub(crate) fn without_haze(alpha: f32) -> f32 {
    match alpha {
        a if a > 1.0 - CLEAR => 1.0,
        a if a >= CLEAR => a,
        _ => 0.0,
    }
}

fn rim_alpha(mean: f32) -> f32 {
    (EDGE.rim_gain * mean).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matting::colour::srgb8;
    use crate::matting::pool::Pool;
    use image::{Rgb, RgbImage};

    #[test]
    fn the_soft_rim_of_a_disc_has_the_alpha_with_which_it_was_mixed() {
        let (object, light) = (Vec3::new(0.25, 0.22, 0.2), Vec3::new(0.03, 0.35, 0.06));
        let truth = |x: u32, y: u32| {
            let r = ((x as f32 - 60.0).powi(2) + (y as f32 - 48.0).powi(2)).sqrt();
            ((24.0 - r) / 3.0 + 0.5).clamp(0.0, 1.0)
        };
        let frame = RgbImage::from_fn(120, 96, |x, y| {
            Rgb((truth(x, y) * object + (1.0 - truth(x, y)) * light).to_array().map(srgb8))
        });
        let (pool, key) = (Pool::default(), Key::new(light).unwrap());
        let mut screen = Screen::before_field(&pool, &frame, &key).unwrap();
        let noise = screen.noise();
        let trimap = Trimap::new(&screen, noise, frame.as_raw(), &key);
        let edge = 48 * 120 + 60 + 24;
        let beside = (edge..49 * 120).rfind(|i| trimap.band[*i] != 0).unwrap();
        let before = screen.light[beside];
        screen.light[beside] *= 0.5;
        measure_light_beside(&mut screen, &trimap, &key);
        assert!((screen.light[beside] / before - 1.0).length() < 0.05, "from the screen beside it");
        let matte = Matte::solve(&screen, &trimap);
        let apart = |i: usize| (matte.alpha[i] - truth(i as u32 % 120, i as u32 / 120)).abs();
        let worst = (0..matte.alpha.len()).map(apart).fold(0.0, f32::max);
        let mean = (0..matte.alpha.len()).map(apart).sum::<f32>() / set_pixels(&trimap.band).count() as f32;
        assert!(worst < 0.3 && mean < 0.08, "worst {worst}, mean of the band {mean}");
        assert!(
            (matte.object_around(edge, true) - object).length() < 0.06,
            "{}",
            matte.object_around(edge, true)
        );
    }
}
