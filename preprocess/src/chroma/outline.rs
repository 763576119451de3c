//! The outline, solved once more by what was learnt from simulated shots: a small network sees 7 × 7 pixels
//! (`tools/train_outline.py`; decision 0027).

use super::alpha::Workspace;
use super::colour::{Key, srgb8};
use super::filters::{Rect, dilate};
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
/// Luma is measured in so many 8-bit levels.
const LEVELS: f32 = 64.0;
/// Least colour difference of the screen, 8-bit levels.
const LEAST_DIFFERENCE: f32 = 4.0;

/// Units of the two hidden layers.
const HIDDEN: (usize, usize) = (32, 16);
/// The key's alpha is this far from 0 and 1 where the network's word is added to its logit.
const LEAST_ALPHA: f32 = 0.02;
/// How much of the network's word is taken: the odds are the geometric mean of the formula's and the network's. It has seen simulated
/// shots only.
const TRUST: f32 = 0.5;
/// What is nearer to 0 or 1 is 0 or 1.
const CLEAR: f32 = 0.03;

/// An input is at most so many standard deviations off the mean.
const FARTHEST: f32 = 4.0;

/// Two layers of rectified units and a sum.
struct Network {
    mean: Box<[f32; INPUTS]>,
    scale: Box<[f32; INPUTS]>,
    first: [Vec<[f32; HIDDEN.0]>; 2],
    second: [Vec<[f32; HIDDEN.1]>; 2],
    third: ([f32; HIDDEN.1], f32),
}

/// Little-endian f32: mean and scale of the inputs; matrices [inputs, units] and offsets, layer by layer.
static NETWORK: LazyLock<Network> = LazyLock::new(|| {
    let bytes = include_bytes!("outline.f32");
    let mut numbers = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
    fn rows<const N: usize>(numbers: &mut impl Iterator<Item = f32>, count: usize) -> Vec<[f32; N]> {
        (0..count).map(|_| std::array::from_fn(|_| numbers.next().unwrap_or(0.0))).collect()
    }
    let [mean, scale] = [0; 2].map(|_| Box::new(rows(&mut numbers, 1)[0]));
    let first = [rows(&mut numbers, INPUTS), rows(&mut numbers, 1)];
    let second = [rows(&mut numbers, HIDDEN.0), rows(&mut numbers, 1)];
    let third = rows(&mut numbers, 1)[0];
    Network { mean, scale, first, second, third: (third, numbers.next().unwrap_or(0.0)) }
});

impl Network {
    /// What is added to the logit of alpha.
    #[inline(always)]
    fn word(&self, inputs: &[f32; INPUTS]) -> f32 {
        let scaled: [f32; INPUTS] =
            std::array::from_fn(|k| ((inputs[k] - self.mean[k]) * self.scale[k]).clamp(-FARTHEST, FARTHEST));
        let a = layer(&scaled, &self.first);
        let b = layer(&a, &self.second);
        self.third.1 + b.iter().zip(&self.third.0).map(|(v, w)| v * w).sum::<f32>()
    }
}

/// `max(0, W x + b)`.
#[inline(always)]
fn layer<const N: usize>(inputs: &[f32], [weights, offsets]: &[Vec<[f32; N]>; 2]) -> [f32; N] {
    let mut sums = offsets[0];
    for (x, row) in inputs.iter().zip(weights) {
        for (sum, w) in sums.iter_mut().zip(row) {
            *sum += x * w;
        }
    }
    sums.map(|s| if s > 0.0 { s } else { 0.0 })
}

/// Coded luma, colour difference and chroma across it.
#[inline(always)]
fn seen(rgb: [f32; 3], key: &Key) -> [f32; 3] {
    let across = super::colour::dot(key.across, rgb);
    [0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2], key.difference(rgb), across]
}

/// What the network sees, of one frame.
#[derive(Default)]
pub(crate) struct Outline {
    planes: [Vec<f32>; PLANES],
    /// The pixels that are asked about.
    pixels: Vec<u32>,
    /// Where the pixels of a window lie, seen in each of eight ways.
    ways: Vec<[u32; SIDE * SIDE]>,
}

impl Outline {
    /// Gathers the pixels of a solved and cleaned frame whose alpha is not clear, and so many pixels beside them.
    pub fn load(&mut self, work: &Workspace, rgb: &[u8], width: usize, key: &Key, beside: usize) {
        let height = work.alpha.len() / width;
        let soft: Vec<u8> = work.alpha.iter().map(|a| u8::from(SOFT.contains(a))).collect();
        let near = dilate(&soft, width, beside);
        let inner = |i: usize| {
            let (x, y) = (i % width, i / width);
            x >= REACH && y >= REACH && x + REACH < width && y + REACH < height
        };
        self.pixels.clear();
        let asked = |i: &usize| near[*i] != 0 && work.band[*i] != 0 && work.still[*i] == 0 && inner(*i);
        self.pixels.extend((0..near.len()).filter(asked).map(|i| i as u32));
        for plane in &mut self.planes {
            plane.resize(near.len(), 0.0);
        }
        for i in Rect::around(&near, width, REACH).rows(width).flatten() {
            let s = seen([0, 1, 2].map(|c| f32::from(rgb[3 * i + c])), key);
            (0..3).for_each(|c| self.planes[c][i] = s[c]);
        }
        self.planes[3].copy_from_slice(&work.alpha);
        self.ways.clear();
        self.ways.extend((0..8).map(|way| offsets(way, width)));
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
        let object = coded([work.around[0][i], work.around[1][i], work.around[2][i]]);
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
        for &i in &outline.pixels {
            let i = i as usize;
            let alpha = work.alpha[i].clamp(LEAST_ALPHA, 1.0 - LEAST_ALPHA);
            let logit = (alpha / (1.0 - alpha)).ln() + TRUST * network.word(&outline.inputs(work, i, width, key));
            let alpha = 1.0 / (1.0 + (-logit).exp());
            // No number in a weight or a pixel can make a matte that is none.
            work.alpha[i] = match alpha {
                a if a > 1.0 - CLEAR => 1.0,
                a if a >= CLEAR => a,
                _ => 0.0,
            };
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
    fn the_weights_are_as_many_as_the_layers_need_and_finite() {
        let count = 2 * INPUTS + (INPUTS + 1) * HIDDEN.0 + (HIDDEN.0 + 1) * HIDDEN.1 + HIDDEN.1 + 1;
        let bytes = include_bytes!("outline.f32");
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
