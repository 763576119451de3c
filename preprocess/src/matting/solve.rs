//! The soft matte of one frame, given the light of the empty screen.

use crate::matting::colour::{Key, LINEAR, dot, luminance, srgb8};
use crate::matting::morphology::{
    Rect, box_sum, box_sum_running, components, dilate, erode, set_pixels, smooth, smooth_within,
};
use crate::matting::pool::Mask;
use crate::matting::screen::clean_plate::Still;
use crate::matting::screen::illumination::Field;
use crate::matting::screen::shadows::without_glare;

/// Radius of the neighbourhood from which the colour of the foreground is learnt, pixels.
const REACH: usize = 3;
/// Least departure from the screen (share of its colour difference) that counts.
const MIN_DEPARTURE: f32 = 0.06;
/// A region that nowhere departs by this much is a shadow or noise.
const MIN_PEAK: f32 = 0.30;
/// Weight of a mixed pixel beside a solid one when the foreground's colour is learnt.
const MIXED_WEIGHT: f32 = 0.05;
/// Chroma of 4:2:0 video is blurred: standard deviation of alpha from chroma at an edge, and how its square grows with the
/// pixel's light over the screen's (chroma is coded after gamma).
const CHROMA_ERROR: f32 = 0.12;
const CHROMA_GLARE: f32 = 0.6;
/// The lens mixes over about a pixel in linear light before chroma is coded and spread over two or three: how much of what a half
/// covered pixel shows too much of the brighter side is taken off.
const OPTICAL: f32 = 1.5;
/// The same for luma: of itself, and by how well the light of object and screen is known (share of their sum).
const LUMA_ERROR: f32 = 0.05;
const LIGHT_ERROR: f32 = 0.06;
/// Uncertain light of the object weighs with the object's part of the pixel: about half at an edge, squared.
const HALF: f32 = 0.25;
/// The object's rim is lit by the screen and mixes with its blur: alpha from chroma falls short by this factor there.
const RIM_GAIN: f32 = 1.06;
/// What the rim's light is asked of: pixels around, summed twice (5 × 5, weighed to the middle), and how firmly it is held to the
/// neighbourhood's, as a share of as many pixels that are object alone.
const RIM_REACH: usize = 1;
const RIM_HOLD: f32 = 0.01;
/// Light of the rim as a factor on the neighbourhood's.
const RIM_LIGHT: (f32, f32) = (0.2, 2.0);
/// Smoothing has made the edge this much too soft.
const EDGE_CONTRAST: f32 = 1.2;
/// Radius in which the light of the screen beside the object is measured, pixels, and the pixels it takes.
const BESIDE: usize = 5;
const BESIDE_PIXELS: f32 = 8.0;

/// Inside of solid parts, what keeps this share of the screen's coded colour difference is a slit, and as far around it is solved anew.
const SLIT_SHARE: f32 = 0.6;
const SLIT_RIM: usize = 2;

/// Where nothing around is solid (rods), chroma is spread over more than the object is wide: alpha from it falls short
/// by this factor, and the colour is not taken out of more than this share of the screen.
const THIN_GAIN: f32 = 1.2;
const THIN_FLOOR: f32 = 0.7;
/// Weight of colours around from which on something solid is near.
const SOLID_WEIGHT: f32 = 0.5;

/// Planes of one frame and scratch, kept between frames.
#[derive(Default)]
pub(crate) struct Workspace {
    /// Linear red, green, blue.
    pub image: [Vec<f32>; 3],
    /// The same of the empty screen.
    pub screen: [Vec<f32>; 3],
    /// Share of the screen's colour difference: 1 on the screen, 0 on the object.
    pub share: Vec<f32>,
    pub smoothed: Vec<f32>,
    /// Light of all channels as a share of the screen's.
    pub total: Vec<f32>,
    /// What always stands there, other than the screen.
    pub still: Vec<u8>,
    /// Screen in whatever light: far enough from the object that it cannot be mixed with it.
    pub shaded: Mask,
    /// Foreground colour of the neighbourhood.
    pub around: [Vec<f32>; 3],
    weights: Vec<f32>,
    spread: Vec<f32>,
    /// Light of the rim as a factor on `around`, and what it is told by.
    rim: [Vec<f32>; 2],
    rows: Vec<f32>,
    pub mean: Vec<f32>,
    not_screen: Mask,
    /// The matte, 0 to 1.
    pub alpha: Vec<f32>,
    /// Pixels that are neither surely screen nor surely object.
    pub band: Vec<u8>,
    /// Their indices.
    in_band: Vec<u32>,
}

/// What the screen of this frame was like.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Noise {
    share: f32,
    luma: f32,
    chroma: f32,
}

impl Workspace {
    /// Solves the matte of the loaded frame into `self.alpha`.
    pub fn solve(&mut self, rgb: &[u8], width: usize, key: &Key) {
        smooth(&self.share, width, &mut self.smoothed);
        self.take_out_shadows(width);
        let noise = self.noise();
        let threshold = 1.0 - MIN_DEPARTURE.max(5.0 * noise.share);
        let departs = |s: &f32| (*s < threshold) | (*s > 2.0 - threshold + 0.1);
        let seeds: Mask = self
            .smoothed
            .iter()
            .zip(&self.shaded)
            .map(|(s, shaded)| u8::from((*shaded == 0) & departs(s)))
            .collect();
        let mut not_screen = dilate(&seeds, width, 2);
        self.drop_faint_regions(&mut not_screen, width);
        let mut solid: Mask = self.smoothed.iter().map(|s| u8::from(*s < 0.5)).collect();
        let mut core = erode(&solid, width, 2);
        self.open_slits(&mut solid, &mut core, rgb, width, key);
        self.band.clear();
        self.band.extend(not_screen.iter().zip(&core).map(|(n, c)| n & (1 - c)));
        self.in_band.clear();
        self.in_band.extend(set_pixels(&self.band).map(|i| i as u32));
        let interior = erode(&solid, width, 1);
        self.measure_screen_beside(&not_screen, width, key);
        let rect = Rect::around(&not_screen, width, REACH);
        self.learn_foreground(&not_screen, &interior, width, &rect);
        self.average_foreground(width, &rect);
        self.alpha.clear();
        self.alpha.extend(core.iter().map(|c| f32::from(*c)));
        self.solve_band(noise, width, &rect);
        self.not_screen = not_screen;
    }

    /// Slits of one or two pixels between bright parts: 4:2:0 averages coded chroma, and in linear light what is left of the screen's
    /// looks like a tint of the bright parts. What keeps [`SLIT_SHARE`] of the screen's colour difference in coded values is solved, not solid.
    fn open_slits(&self, solid: &mut [u8], core: &mut [u8], rgb: &[u8], width: usize, key: &Key) {
        let coded = |light: [f32; 3]| key.difference(light.map(|v| f32::from(srgb8(v))));
        let mut slits = Mask::filled(0, core.len());
        for i in set_pixels(core) {
            let kept = key.difference([0, 1, 2].map(|c| f32::from(rgb[3 * i + c])));
            // Most of the object keeps nothing, whatever the screen's light.
            if kept > SLIT_SHARE && kept > SLIT_SHARE * coded(self.light(i)) {
                (slits[i], solid[i]) = (1, 0);
            }
        }
        core.iter_mut().zip(&dilate(&slits, width, SLIT_RIM)).for_each(|(c, near)| *c &= 1 - near);
    }

    /// Pixels far from everything that departs from the screen.
    pub fn surely_screen(&self) -> Mask {
        self.not_screen.iter().map(|v| u8::from(*v == 0)).collect()
    }

    /// Loads a frame and the light of the empty screen of its own.
    pub fn load_before_field(&mut self, rgb: &[u8], width: usize, key: &Key, field: &Field) {
        self.make_room(rgb.len() / 3);
        let mut row = Vec::new();
        for (y, line) in rgb.chunks_exact(3 * width).enumerate() {
            field.row(y, width, &mut row);
            let pixels = y * width..(y + 1) * width;
            for (c, plane) in self.screen.iter_mut().enumerate() {
                plane[pixels.clone()].iter_mut().zip(&row).for_each(|(v, light)| *v = light[c]);
            }
            self.load(line, pixels, key);
        }
    }

    /// Loads a frame of a camera that stands still; what always stands there counts as screen.
    pub fn load_before_plate(&mut self, rgb: &[u8], key: &Key, still: &Still, keep_pole: bool) {
        self.make_room(rgb.len() / 3);
        self.screen.iter_mut().zip(&still.plate).for_each(|(plane, light)| plane.copy_from_slice(light));
        self.load(rgb, 0..rgb.len() / 3, key);
        for &i in &still.others {
            let i = i as usize;
            let likeness = still.likeness(i, [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]], keep_pole);
            if likeness > 0.0 {
                (0..3).for_each(|c| self.screen[c][i] += likeness * (self.image[c][i] - self.screen[c][i]));
                self.share[i] += likeness * (1.0 - self.share[i]);
                self.total[i] += likeness * (1.0 - self.total[i]);
                self.still[i] = 1;
            }
        }
    }

    fn make_room(&mut self, n: usize) {
        let planes = self.image.iter_mut().chain(&mut self.screen).chain(&mut self.around);
        let others = [&mut self.share, &mut self.total, &mut self.weights, &mut self.spread];
        for plane in planes.chain(others).chain(&mut self.rim) {
            plane.resize(n, 0.0);
        }
        self.still.clear();
        self.still.resize(n, 0);
    }

    /// Loads some pixels and measures them by the screen's light, which is there already.
    fn load(&mut self, rgb: &[u8], pixels: std::ops::Range<usize>, key: &Key) {
        let table = &*LINEAR;
        for (c, plane) in self.image.iter_mut().enumerate() {
            let values = plane[pixels.clone()].iter_mut().zip(rgb.chunks_exact(3));
            values.for_each(|(v, p)| *v = table[usize::from(p[c])]);
        }
        let [r, g, b] = self.image.each_ref().map(|plane| &plane[pixels.clone()]);
        let [screen_r, screen_g, screen_b] = self.screen.each_ref().map(|plane| &plane[pixels.clone()]);
        let image = r.iter().zip(g).zip(b).map(|((r, g), b)| [*r, *g, *b]);
        let screen = screen_r.iter().zip(screen_g).zip(screen_b).map(|((r, g), b)| [*r, *g, *b]);
        let told = self.share[pixels.clone()].iter_mut().zip(&mut self.total[pixels]);
        for ((share, total), (seen, light)) in told.zip(image.zip(screen)) {
            *share = key.difference(seen) / (key.difference(light) + 1e-6);
            *total = (seen[0] + seen[1] + seen[2]) / (light[0] + light[1] + light[2] + 1e-6);
        }
    }

    /// Foreground colour of the neighbourhood of any pixel.
    pub fn object_around(&self, i: usize) -> [f32; 3] {
        // Outside of the band the sums have not been divided.
        let scale = if self.band[i] != 0 { 1.0 } else { 1.0 / self.weights[i].max(1e-5) };
        [0, 1, 2].map(|c| scale * self.around[c][i])
    }

    /// How much of what is around a pixel of the band is solid, 0 to 1.
    pub fn solid_around(&self, i: usize) -> f32 {
        (self.weights[i] / ((2 * REACH + 1) * (2 * REACH + 1)) as f32).min(1.0)
    }

    fn pixel(&self, i: usize) -> [f32; 3] {
        [self.image[0][i], self.image[1][i], self.image[2][i]]
    }

    fn light(&self, i: usize) -> [f32; 3] {
        [self.screen[0][i], self.screen[1][i], self.screen[2][i]]
    }

    fn object(&self, i: usize) -> [f32; 3] {
        let light = self.rim[0][i];
        [light * self.around[0][i], light * self.around[1][i], light * self.around[2][i]]
    }

    /// Spread of the empty screen: of the smoothed share by its lower half-width, of luma and chroma by mean square.
    fn noise(&self) -> Noise {
        let mut samples: Vec<f32> = self
            .smoothed
            .iter()
            .step_by(7)
            .filter(|s| (0.8..1.2).contains(*s))
            .map(|s| (s - 1.0).abs())
            .collect();
        let share = 1.4826 * crate::matting::screen::detect::quantile(&mut samples, 0.5);
        let (mut luma, mut chroma, mut n) = (0.0, 0.0, 1e-6);
        for i in
            (0..self.share.len()).step_by(7).filter(|i| (self.smoothed[*i] - 1.0).abs() < 3.0 * share + 0.01)
        {
            let (p, b) = (self.pixel(i), self.light(i));
            let delta = [p[0] - b[0], p[1] - b[1], p[2] - b[2]];
            luma += luminance(delta).powi(2);
            chroma += squared(chroma_of(delta));
            n += 1.0;
        }
        Noise { share, luma: luma / n, chroma: chroma / n }
    }

    fn drop_faint_regions(&self, mask: &mut [u8], width: usize) {
        let (labels, sizes) = components(mask, width);
        let mut peak = vec![0.0_f32; sizes.len()];
        for i in set_pixels(mask) {
            let (departure, peak) = (1.0 - self.smoothed[i], &mut peak[labels[i] as usize]);
            if departure > *peak {
                *peak = departure;
            }
        }
        if peak[1..].iter().any(|p| *p < MIN_PEAK) {
            mask.iter_mut()
                .zip(&labels)
                .for_each(|(m, label)| *m &= u8::from(peak[*label as usize] >= MIN_PEAK));
        }
    }

    /// The screen's light in the band, from the screen beside it: shadows have edges that coarse cells cannot follow.
    fn measure_screen_beside(&mut self, not_screen: &[u8], width: usize, key: &Key) {
        let rect = Rect::around(not_screen, width, BESIDE);
        for row in rect.rows(width) {
            let weights = &mut self.weights[row.clone()];
            for ((weight, object), still) in
                weights.iter_mut().zip(&not_screen[row.clone()]).zip(&self.still[row.clone()])
            {
                *weight = f32::from((object | still) ^ 1);
            }
            for (sums, image) in self.around.iter_mut().zip(&self.image) {
                let values = sums[row.clone()].iter_mut().zip(&image[row.clone()]);
                values.zip(&*weights).for_each(|((sum, v), weight)| *sum = weight * v);
            }
        }
        for plane in self.around.iter_mut().chain([&mut self.weights]) {
            box_sum_running(plane, width, &rect, BESIDE, &mut self.rows);
        }
        for &i in &self.in_band {
            let i = i as usize;
            if self.still[i] == 0 && self.weights[i] >= BESIDE_PIXELS {
                (0..3).for_each(|c| self.screen[c][i] = self.around[c][i] / self.weights[i]);
                let brighter = luminance(self.pixel(i)) / (luminance(self.light(i)) + 1e-6);
                let share = key.difference(self.pixel(i)) / (key.difference(self.light(i)) + 1e-6);
                self.share[i] = without_glare(share, brighter);
            }
        }
    }

    /// Mean foreground colour around every pixel and the variance of its luma. Solid pixels count as they are, with
    /// the screen's light that falls on them, for so does the object's part of a mixed pixel; where there are none
    /// (rods) the screen's share is taken out of the mixed ones.
    fn learn_foreground(&mut self, not_screen: &[u8], solid: &[u8], width: usize, rect: &Rect) {
        for row in rect.rows(width) {
            for plane in self.around.iter_mut().chain([&mut self.weights, &mut self.spread]) {
                plane[row.clone()].fill(0.0);
            }
        }
        for i in rect.rows(width).flatten().filter(|i| not_screen[*i] != 0) {
            let s = if solid[i] != 0 { 0.0 } else { self.smoothed[i].max(self.share[i]).clamp(0.0, 1.0) };
            let t = 1.0 - s;
            let weight = if solid[i] != 0 { 1.0 } else { MIXED_WEIGHT * t * t * t };
            let mut colour = [0.0; 3];
            for (c, v) in colour.iter_mut().enumerate() {
                // t · (un-premultiplied colour) = I − s B
                let value = self.image[c][i] - s * self.screen[c][i];
                let value = if value > 0.0 { value } else { 0.0 };
                self.around[c][i] = weight * value;
                *v = if t > 1e-3 { value / t } else { 0.0 };
            }
            let t = if solid[i] != 0 || t > THIN_FLOOR { t } else { THIN_FLOOR };
            self.weights[i] = weight * t;
            let y = luminance(colour);
            self.spread[i] = weight * t * y * y;
        }
    }

    /// Turns the weighted sums of [`Self::learn_foreground`] into means over the neighbourhood, in the band.
    fn average_foreground(&mut self, width: usize, rect: &Rect) {
        for plane in self.around.iter_mut().chain([&mut self.weights, &mut self.spread]) {
            box_sum(plane, width, rect, REACH, &mut self.rows);
        }
        for &i in &self.in_band {
            let i = i as usize;
            let w = self.weights[i];
            let scale = if w > 1e-5 { 1.0 / w } else { 0.0 };
            let colour = [0, 1, 2].map(|c| self.around[c][i] * scale);
            let y = luminance(colour);
            self.spread[i] = (self.spread[i] * scale - y * y).max(0.0);
            (0..3).for_each(|c| self.around[c][i] = colour[c]);
        }
    }

    /// Alpha as the place of the pixel between screen and foreground, from chroma and from luma, each weighed by
    /// how well it can tell (inverse variance).
    fn solve_band(&mut self, noise: Noise, width: usize, rect: &Rect) {
        self.rim[0].fill(1.0);
        self.ask_chroma(width, rect);
        self.light_rim(width, rect);
        self.ask_chroma(width, rect);
        for &i in &self.in_band {
            let i = i as usize;
            let alpha = self.rim_alpha(i);
            let alpha = if self.weights[i] < 1e-5 { alpha } else { self.with_luma(i, alpha, noise) };
            let alpha = (alpha - 0.5) * EDGE_CONTRAST + 0.5;
            self.alpha[i] = if alpha < 0.03 {
                0.0
            } else if alpha > 0.97 {
                1.0
            } else {
                alpha
            };
        }
    }

    /// Alpha from chroma alone, into `mean`. Chroma is sampled at every other pixel: smoothing over 3 × 3 costs no detail and removes
    /// the steps.
    fn ask_chroma(&mut self, width: usize, rect: &Rect) {
        for &i in &self.in_band {
            let i = i as usize;
            self.alpha[i] = self.first_alpha(i).clamp(-0.2, 1.2);
        }
        smooth_within(&self.alpha, width, rect, &mut self.mean);
    }

    fn rim_alpha(&self, i: usize) -> f32 {
        (RIM_GAIN * self.mean[i]).clamp(0.0, 1.0)
    }

    /// An object's rim is darker than what lies behind it where it turns away from the lamp, and brighter where it shines. Of the light
    /// alpha from chroma knows little, so that luma Y tells it: the factor k on the neighbourhood's light F with the least
    /// `Σ (Y − (1 − α) B − α k F)² / F² + λ (k − 1)²`, B the screen's. Leaves k in `rim[0]`.
    fn light_rim(&mut self, width: usize, rect: &Rect) {
        let [mut lit, mut told] = std::mem::take(&mut self.rim);
        for row in rect.rows(width) {
            lit[row.clone()].fill(0.0);
            told[row].fill(0.0);
        }
        for i in self.in_band.iter().map(|i| *i as usize).filter(|i| self.weights[*i] >= 1e-5) {
            let alpha = self.rim_alpha(i);
            let own = luminance(self.pixel(i)) - (1.0 - alpha) * luminance(self.light(i));
            let around = [self.around[0][i], self.around[1][i], self.around[2][i]];
            lit[i] = alpha * own / luminance(around).max(1e-5);
            told[i] = alpha * alpha;
        }
        for plane in [&mut lit, &mut told] {
            box_sum(plane, width, rect, RIM_REACH, &mut self.rows);
            box_sum(plane, width, rect, RIM_REACH, &mut self.rows);
        }
        let hold = RIM_HOLD * ((2 * RIM_REACH + 1) as f32).powi(4);
        for &i in &self.in_band {
            let i = i as usize;
            let factor = (lit[i] + hold) / (told[i] + hold);
            lit[i] = if self.weights[i] >= 1e-5 { factor.clamp(RIM_LIGHT.0, RIM_LIGHT.1) } else { 1.0 };
        }
        self.rim = [lit, told];
    }

    fn first_alpha(&self, i: usize) -> f32 {
        let weight = self.weights[i];
        let alpha = if weight < 1e-5 { 1.0 - self.share[i] } else { self.alpha_from_chroma(i) };
        if weight < SOLID_WEIGHT { THIN_GAIN * alpha } else { alpha }
    }

    /// From chroma as it is coded: there the averaging of 4:2:0 is linear and an edge keeps its place. In linear light the
    /// chroma that spreads over it weighs by the light of the pixel that it spreads to.
    fn alpha_from_chroma(&self, i: usize) -> f32 {
        let code = |v: f32| f32::from(srgb8(v)) / 255.0;
        let coded = |rgb: [f32; 3]| chroma_of([code(rgb[0]), code(rgb[1]), code(rgb[2])]);
        let (screen, object) = (self.light(i), self.object(i));
        let (b, f) = (coded(screen), coded(object));
        let fb = [f[0] - b[0], f[1] - b[1], f[2] - b[2]];
        let norm = squared(fb) + 1e-9;
        let place = |c: [f32; 3]| dot([c[0] - b[0], c[1] - b[1], c[2] - b[2]], fb) / norm;
        let alpha = place(coded(self.pixel(i)));
        // The lens mixes light before it is coded: of a half covered pixel the brighter side shows more.
        let half = |c: usize| 0.5 * (screen[c] + object[c]);
        let half = [half(0), half(1), half(2)];
        let a = alpha.clamp(0.0, 1.0);
        alpha - OPTICAL * (place(coded(half)) - 0.5) * a * (1.0 - a)
    }

    fn with_luma(&self, i: usize, alpha_c: f32, noise: Noise) -> f32 {
        let (p, b) = (self.pixel(i), self.light(i));
        let f = self.object(i);
        let fd = [f[0] - b[0], f[1] - b[1], f[2] - b[2]];
        let (c2, fy) = (squared(chroma_of(fd)), luminance(fd));
        let (y2, screen) = (fy * fy, luminance(b));
        let brighter = luminance(p) / (screen + 1e-6);
        let glare = if brighter > 1.0 { brighter.powf(CHROMA_GLARE) } else { 1.0 };
        let weight_c = c2 / (noise.chroma + CHROMA_ERROR * CHROMA_ERROR * c2 * glare + 1e-9);
        let light = LIGHT_ERROR * (screen + screen + fy);
        let luma = noise.luma + HALF * self.spread[i] + light * light + LUMA_ERROR * LUMA_ERROR * y2;
        let weight_y = y2 / (luma + 1e-9);
        let py = luminance([p[0] - b[0], p[1] - b[1], p[2] - b[2]]);
        let alpha_y = (py * fy / (y2 + 1e-9)).clamp(0.0, 1.0);
        (weight_c * alpha_c + weight_y * alpha_y) / (weight_c + weight_y + 1e-9)
    }
}

#[inline(always)]
fn chroma_of(rgb: [f32; 3]) -> [f32; 3] {
    let mean = (rgb[0] + rgb[1] + rgb[2]) / 3.0;
    [rgb[0] - mean, rgb[1] - mean, rgb[2] - mean]
}

#[inline(always)]
fn squared(v: [f32; 3]) -> f32 {
    dot(v, v)
}
