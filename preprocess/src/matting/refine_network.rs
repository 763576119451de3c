//! The outline, solved once more by what was learnt from simulated shots: a small network sees 7 × 7 pixels
//! (`tools/train_outline.py`; decision 0027).

use crate::matting::colour::{Key, dot, srgb8};
use crate::matting::morphology::{Rect, box_sum_running, components, dilate, erode, set_pixels};
use crate::matting::pool::Mask;
use crate::matting::solve::Workspace;
use std::sync::LazyLock;

/// The network sees as far, pixels.
const REACH: usize = 3;
const SIDE: usize = 2 * REACH + 1;
/// Of each pixel around: luma, colour difference, chroma across it, alpha.
const PLANES: usize = 4;
const PATCH: usize = SIDE * SIDE * PLANES;
/// And of the middle: luma of the screen, luma, colour difference and chroma across of the object around, and how much of it is solid.
const LIGHTS: usize = 5;
/// Numbers the network sees of a pixel.
pub(crate) const INPUTS: usize = PATCH + LIGHTS;
/// Alpha of pixels that are asked about.
const SOFT: std::ops::Range<f32> = 0.02..0.98;
/// Slits of a pixel or two keep at least this share of the key's hue (coded colour along its chroma), and less than this of the luma around.
const SLIT_SHARE: f32 = 0.1;
const SLIT_LUMA: f32 = 0.95;
/// Luma is measured in so many 8-bit levels.
const LEVELS: f32 = 64.0;
/// Least colour difference of the screen, 8-bit levels.
const LEAST_DIFFERENCE: f32 = 4.0;

/// Units of the two hidden layers.
const HIDDEN: (usize, usize) = (96, 32);
/// Units of a layer that are summed at a time: what the processor's registers hold.
const UNITS: usize = 32;
/// The key's alpha is this far from 0 and 1 where the network's word is added to its logit.
const LEAST_ALPHA: f32 = 0.02;
/// Fewer open pixels than this are no slit.
const SLIT_PIXELS: usize = 10;
/// What is nearer to 0 or 1 is 0 or 1.
const CLEAR: f32 = 0.03;

/// An input is at most so many standard deviations off the mean.
const FARTHEST: f32 = 4.0;

/// Two layers of rectified units and a sum.
struct Network {
    mean: Box<[f32; INPUTS]>,
    scale: Box<[f32; INPUTS]>,
    first: Vec<Block>,
    second: Vec<Block>,
    third: ([f32; HIDDEN.1], f32),
}

/// Some units of a layer: weights by input, and offsets.
struct Block {
    weights: Vec<[f32; UNITS]>,
    offsets: [f32; UNITS],
}

/// Little-endian f32: mean and scale of the inputs; matrices [inputs, units] and offsets, layer by layer.
static NETWORK: LazyLock<Network> = LazyLock::new(|| {
    let bytes = include_bytes!("refine_network.f32");
    let mut numbers = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
    fn row<const N: usize>(numbers: &mut impl Iterator<Item = f32>) -> [f32; N] {
        std::array::from_fn(|_| numbers.next().unwrap_or(0.0))
    }
    fn blocks<const N: usize>(numbers: &mut impl Iterator<Item = f32>, inputs: usize) -> Vec<Block> {
        let rows: Vec<[f32; N]> = (0..=inputs).map(|_| row(numbers)).collect();
        let part = |k: usize, r: &[f32; N]| std::array::from_fn(|u| r[k * UNITS + u]);
        (0..N / UNITS)
            .map(|k| Block {
                weights: rows[..inputs].iter().map(|r| part(k, r)).collect(),
                offsets: part(k, &rows[inputs]),
            })
            .collect()
    }
    let [mean, scale] = [0; 2].map(|_| Box::new(row(&mut numbers)));
    let first = blocks::<{ HIDDEN.0 }>(&mut numbers, INPUTS);
    let second = blocks::<{ HIDDEN.1 }>(&mut numbers, HIDDEN.0);
    let third = row(&mut numbers);
    Network { mean, scale, first, second, third: (third, numbers.next().unwrap_or(0.0)) }
});

impl Network {
    /// What is added to the logit of alpha of two pixels.
    #[inline(always)]
    fn words(&self, inputs: &[[f32; INPUTS]; 2]) -> [f32; 2] {
        let mut scaled = *inputs;
        for x in &mut scaled {
            for ((x, mean), scale) in x.iter_mut().zip(&*self.mean).zip(&*self.scale) {
                *x = ((*x - mean) * scale).clamp(-FARTHEST, FARTHEST);
            }
        }
        let a: [[f32; HIDDEN.0]; 2] = layer(&scaled, &self.first);
        let b: [[f32; HIDDEN.1]; 2] = layer(&a, &self.second);
        b.map(|b| self.third.1 + b.iter().zip(&self.third.0).map(|(v, w)| v * w).sum::<f32>())
    }
}

/// `max(0, W x + b)` of two pixels: the weights are more than the first cache holds, so that each is fetched for both.
#[inline(always)]
fn layer<const M: usize, const N: usize>(inputs: &[[f32; M]; 2], blocks: &[Block]) -> [[f32; N]; 2] {
    let mut out = [[0.0; N]; 2];
    let [out_a, out_b] = &mut out;
    let outs = out_a.as_chunks_mut::<UNITS>().0.iter_mut().zip(out_b.as_chunks_mut::<UNITS>().0);
    for ((out_a, out_b), block) in outs.zip(blocks) {
        let (mut a, mut b) = (block.offsets, block.offsets);
        for ((x, y), row) in inputs[0].iter().zip(&inputs[1]).zip(&block.weights) {
            a.iter_mut().zip(row).for_each(|(sum, w)| *sum += x * w);
            b.iter_mut().zip(row).for_each(|(sum, w)| *sum += y * w);
        }
        *out_a = a.map(|s| if s > 0.0 { s } else { 0.0 });
        *out_b = b.map(|s| if s > 0.0 { s } else { 0.0 });
    }
    out
}

/// Coded luma, colour difference and chroma across it.
#[inline(always)]
fn seen(rgb: [f32; 3], key: &Key) -> [f32; 3] {
    let across = dot(key.across, rgb);
    [0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2], key.difference(rgb), across]
}

#[inline(always)]
fn byte_rgb(rgb: &[u8], i: usize) -> [f32; 3] {
    let p = &rgb[3 * i..3 * i + 3];
    [f32::from(p[0]), f32::from(p[1]), f32::from(p[2])]
}

/// What the network sees, of one frame.
#[derive(Default)]
pub(crate) struct Outline {
    planes: [Vec<f32>; PLANES],
    /// The pixels that are asked about.
    pixels: Vec<u32>,
    /// Where the pixels of a window lie, seen in each of eight ways.
    ways: Vec<[u32; SIDE * SIDE]>,
    /// Sums of luma over a window, and scratch for them.
    sums: Vec<f32>,
    rows: Vec<f32>,
}

impl Outline {
    /// Gathers the pixels of a solved and cleaned frame that are asked about: those whose alpha is not clear and so many beside them,
    /// those on either side of a half, and dark ones of solid parts that keep some of the screen's hue: slits.
    pub fn load(&mut self, work: &Workspace, rgb: &[u8], width: usize, key: &Key, beside: usize) {
        let solid: Mask = work.alpha.iter().map(|a| u8::from(*a >= 0.5)).collect();
        let soft: Mask = work.alpha.iter().map(|a| u8::from((*a > SOFT.start) & (*a < SOFT.end))).collect();
        let (grown, shrunk) = (dilate(&solid, width, 1), erode(&solid, width, 1));
        let mut near = dilate(&soft, width, beside);
        near.iter_mut().zip(grown.iter().zip(&shrunk)).for_each(|(near, (g, s))| *near |= g & (1 - s));
        let rect = Rect::around(&near, width, REACH);
        self.see(rgb, key, &rect, width);
        self.planes[3].copy_from_slice(&work.alpha);
        let hue = |rgb: [f32; 3]| dot(key.along, rgb);
        let least = SLIT_SHARE * hue(key.colour.map(|v| f32::from(srgb8(v))));
        for i in rect.rows(width).flatten().filter(|i| work.alpha[*i] >= SOFT.end) {
            let dark = self.planes[0][i] * ((SIDE * SIDE) as f32) < SLIT_LUMA * self.sums[i];
            near[i] |= u8::from(dark && hue(byte_rgb(rgb, i)) > least);
        }
        let height = work.alpha.len() / width;
        let inner = |i: usize| {
            let (x, y) = (i % width, i / width);
            x >= REACH && y >= REACH && x + REACH < width && y + REACH < height
        };
        let asked = |i: &usize| work.still[*i] == 0 && inner(*i);
        self.pixels.clear();
        self.pixels.extend(set_pixels(&near).filter(asked).map(|i| i as u32));
        self.ways.clear();
        self.ways.extend((0..8).map(|way| offsets(way, width)));
    }

    /// Loads the planes of a picture but the last, and sums luma around.
    fn see(&mut self, rgb: &[u8], key: &Key, rect: &Rect, width: usize) {
        for plane in self.planes.iter_mut().chain([&mut self.sums]) {
            plane.resize(rgb.len() / 3, 0.0);
        }
        for i in rect.rows(width).flatten() {
            let [luma, along, across] = seen(byte_rgb(rgb, i), key);
            self.planes[0][i] = luma;
            self.planes[1][i] = along;
            self.planes[2][i] = across;
        }
        for row in rect.rows(width) {
            self.sums[row.clone()].copy_from_slice(&self.planes[0][row]);
        }
        box_sum_running(&mut self.sums, width, rect, REACH, &mut self.rows);
    }

    /// The pixels that are asked about.
    pub fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// What the network sees of pixel `i`: 7 × 7 of luma less the screen's, colour difference and chroma across as shares of the screen's
    /// difference, and alpha, turned and mirrored so that alpha grows to the right and, less so, downwards; then the lights.
    #[inline(always)]
    pub fn inputs(&self, work: &Workspace, i: usize, width: usize, key: &Key) -> [f32; INPUTS] {
        let coded = |v: [f32; 3]| seen(v.map(|v| f32::from(srgb8(v))), key);
        let screen = coded([work.screen[0][i], work.screen[1][i], work.screen[2][i]]);
        let object = coded(work.object_around(i));
        let scale = 1.0 / screen[1].max(LEAST_DIFFERENCE);
        let corner = i - REACH * width - REACH;
        let window = |p: usize| &self.planes[p][corner..corner + (SIDE - 1) * width + SIDE];
        let way = &self.ways[way(window(3), width)];
        let mut out = [0.0; INPUTS];
        for (p, target) in out[..PATCH].chunks_exact_mut(SIDE * SIDE).enumerate() {
            let window = window(p);
            target.iter_mut().zip(way).for_each(|(v, at)| *v = window[*at as usize]);
        }
        let [luma, along, across, _] = [0, 1, 2, 3].map(|p| p * SIDE * SIDE..(p + 1) * SIDE * SIDE);
        out[luma].iter_mut().for_each(|v| *v = (*v - screen[0]) / LEVELS);
        out[along].iter_mut().for_each(|v| *v = (*v * scale).clamp(-1.0, 2.0));
        out[across].iter_mut().for_each(|v| *v = ((*v - screen[2]) * scale).clamp(-2.0, 2.0));
        out[PATCH] = screen[0] / LEVELS;
        out[PATCH + 1] = (object[0] - screen[0]) / LEVELS;
        out[PATCH + 2] = (object[1] * scale).clamp(-1.0, 2.0);
        out[PATCH + 3] = ((object[2] - screen[2]) * scale).clamp(-2.0, 2.0);
        out[PATCH + 4] = work.solid_around(i);
        out
    }
}

/// Of the eight ways to turn and mirror a window, the one after which alpha grows to the right and, less so, downwards.
#[inline(always)]
fn way(window: &[f32], width: usize) -> usize {
    let (mut right, mut down) = (0.0, 0.0);
    for y in 0..SIDE {
        for (x, a) in window[y * width..][..SIDE].iter().enumerate() {
            right += a * (x as f32 - REACH as f32);
            down += a * (y as f32 - REACH as f32);
        }
    }
    let turned = right.abs() < down.abs();
    let (along, across) = if turned { (down, right) } else { (right, down) };
    usize::from(turned) + 2 * usize::from(along < 0.0) + 4 * usize::from(across < 0.0)
}

/// Where the pixels of a window lie, row by row as it is seen that way.
fn offsets(way: usize, width: usize) -> [u32; SIDE * SIDE] {
    std::array::from_fn(|k| {
        let mirrored = |v: usize, flag: usize| if way & flag != 0 { SIDE - 1 - v } else { v };
        let (x, y) = (mirrored(k % SIDE, 2), mirrored(k / SIDE, 4));
        (if way & 1 != 0 { x * width + y } else { y * width + x }) as u32
    })
}

scene::dispatch! {
    /// Solves alpha of the frame that `outline` has loaded once more.
    pub(crate) fn solve(outline: &Outline, work: &mut Workspace, width: usize, key: &Key) {
        let network = &*NETWORK;
        let mut inputs = [[0.0; INPUTS]; 2];
        for pair in outline.pixels.chunks(2) {
            for (inputs, i) in inputs.iter_mut().zip(pair) {
                *inputs = outline.inputs(work, *i as usize, width, key);
            }
            // The second of the last pair may be left from before.
            for (word, i) in network.words(&inputs).into_iter().zip(pair) {
                let alpha = &mut work.alpha[*i as usize];
                *alpha = told(*alpha, word);
            }
        }
    }
}

/// Alpha after the network's word.
#[inline(always)]
fn told(alpha: f32, word: f32) -> f32 {
    let alpha = alpha.clamp(LEAST_ALPHA, 1.0 - LEAST_ALPHA);
    let logit = (alpha / (1.0 - alpha)).ln() + word;
    // No number in a weight or a pixel can make a matte that is none.
    match 1.0 / (1.0 + (-logit).exp()) {
        a if a > 1.0 - CLEAR => 1.0,
        a if a >= CLEAR => a,
        _ => 0.0,
    }
}

/// Closes what was opened inside of solid parts and is too small for a slit.
pub(crate) fn close_specks(outline: &Outline, work: &mut Workspace, width: usize) {
    let opened = |i: &usize| work.band[*i] == 0 && work.alpha[*i] < 0.5;
    let opened: Vec<usize> = outline.pixels.iter().map(|i| *i as usize).filter(opened).collect();
    if opened.is_empty() {
        return;
    }
    let open: Mask = work.alpha.iter().map(|a| u8::from(*a < 0.5)).collect();
    let (labels, sizes) = components(&open, width);
    for i in opened {
        if sizes[labels[i] as usize] < SLIT_PIXELS {
            work.alpha[i] = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{KeyConfig, Keyer, Scratch};
    use super::*;
    use image::{GrayImage, Rgb, RgbImage, imageops};

    /// A grey disc and a rod before a green screen, both mixed with it at their rims.
    fn filmed(scale: f32) -> RgbImage {
        RgbImage::from_fn(120, 96, |x, y| {
            let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
            let disc = (22.3 - ((x - 52.0).powi(2) + (y - 41.0).powi(2)).sqrt()).clamp(0.0, 1.0);
            let rod = if (70.0..110.0).contains(&x) {
                (2.1 - (y - 0.3 * x - 20.0).abs()).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let alpha = disc.max(rod);
            let grain = ((x as u32 * 7 + y as u32 * 13) % 5) as f32;
            let mix = |object: f32, screen: f32| scale * (alpha * object + (1.0 - alpha) * screen) + grain;
            Rgb([mix(150.0, 30.0) as u8, mix(140.0, 160.0) as u8, mix(120.0, 50.0) as u8])
        })
    }

    fn matte(image: &RgbImage) -> GrayImage {
        let keyer = Keyer::find(std::slice::from_ref(image), &KeyConfig::with_key("green")).unwrap().unwrap();
        keyer.matte(image, &mut Scratch::default()).0
    }

    #[test]
    fn a_mirrored_or_turned_picture_has_the_mirrored_or_turned_matte() {
        let image = filmed(1.0);
        let straight = matte(&image);
        assert!(straight.pixels().any(|p| (20..235).contains(&p[0])), "some pixels are mixed");
        for (name, other) in [
            ("mirrored", imageops::flip_horizontal(&matte(&imageops::flip_horizontal(&image)))),
            ("upside down", imageops::flip_vertical(&matte(&imageops::flip_vertical(&image)))),
            ("turned", imageops::rotate270(&matte(&imageops::rotate90(&image)))),
        ] {
            // Where alpha hardly grows to either side, rounding decides which way the network looks: a few pixels differ.
            let apart =
                straight.pixels().zip(other.pixels()).filter(|(a, b)| a[0].abs_diff(b[0]) > 8).count();
            assert!(apart <= 12, "{name}: {apart} pixels differ");
        }
    }

    #[test]
    fn slits_of_solid_parts_are_asked_about_and_other_dark_lines_are_not() {
        let (width, height) = (60, 40);
        let key = Key::new([0.02, 0.4, 0.05], 1.0 / 3f32.sqrt()).unwrap();
        let panel = |i: usize| (10..50).contains(&(i % width)) && (8..32).contains(&(i / width));
        let rgb: Vec<u8> = (0..width * height)
            .flat_map(|i| match i % width {
                _ if !panel(i) => [40, 170, 60],
                30 => [90, 125, 80],
                20 => [90, 90, 90],
                _ => [210, 205, 200],
            })
            .collect();
        let (mut work, mut outline) = (Workspace::default(), Outline::default());
        work.alpha = (0..width * height).map(|i| f32::from(u8::from(panel(i)))).collect();
        work.still = vec![0; width * height];
        outline.load(&work, &rgb, width, &key, 0);
        let asked = |x: usize| outline.pixels().contains(&((20 * width + x) as u32));
        assert!(asked(30) && !asked(20) && !asked(40), "slit, grey line, panel");
        assert!(asked(9) && asked(10) && !asked(7), "both sides of the outline, screen");
    }

    #[test]
    fn a_slit_that_was_opened_stays_and_single_pixels_are_closed() {
        let width = 40;
        let slit = |i: usize| i % width == 20 && (5..30).contains(&(i / width));
        let (mut work, mut outline) = (Workspace::default(), Outline::default());
        work.band = vec![0; 40 * width];
        let gap = |i: usize| i % width == 30 && (10..14).contains(&(i / width));
        work.alpha = (0..40 * width).map(|i| if slit(i) || gap(i) { 0.1 } else { 1.0 }).collect();
        outline.pixels = (0..work.alpha.len() as u32).collect();
        close_specks(&outline, &mut work, width);
        for i in 0..work.alpha.len() {
            assert_eq!(work.alpha[i], if slit(i) { 0.1 } else { 1.0 }, "pixel {i}");
        }
    }

    #[test]
    fn the_weights_are_as_many_as_the_layers_need_and_finite() {
        let count = 2 * INPUTS + (INPUTS + 1) * HIDDEN.0 + (HIDDEN.0 + 1) * HIDDEN.1 + HIDDEN.1 + 1;
        let bytes = include_bytes!("refine_network.f32");
        assert_eq!(bytes.len(), 4 * count);
        assert!(bytes.as_chunks::<4>().0.iter().all(|b| f32::from_le_bytes(*b).is_finite()));
    }

    #[test]
    fn extremes_of_light_give_a_matte() {
        for scale in [0.02, 0.2, 3.0] {
            let image = filmed(scale);
            let keyer = Keyer::find(std::slice::from_ref(&image), &KeyConfig::with_key("green")).unwrap();
            if let Ok(keyer) = keyer {
                assert_eq!(keyer.matte(&image, &mut Scratch::default()).0.dimensions(), (120, 96));
            }
        }
        // Smaller than what the network sees.
        let keyer = Keyer::find(&[filmed(1.0)], &KeyConfig::with_key("green")).unwrap().unwrap();
        let small = imageops::crop_imm(&filmed(1.0), 30, 20, 5, 4).to_image();
        assert_eq!(keyer.matte(&small, &mut Scratch::default()).0.dimensions(), (5, 4));
    }
}
