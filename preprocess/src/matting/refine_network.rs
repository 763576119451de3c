//! The outline, solved once more by what was learnt from simulated shots: a small network sees 7 ×
//! 7 pixels (`tools/train_outline.py`; docs/decisions/04).

use super::colour::{Key, coded, levels};
use super::morphology::{Rect, set_pixels};
use super::pool::Raster;
use super::screen::Screen;
use super::solve::{CLEAR, Matte, without_haze};
use super::trimap::Trimap;
use glam::Vec3;
use std::sync::LazyLock;

/// The network sees as far, pixels. Source: docs/decisions/04: 277 wrong pixels a frame with 9 × 9
/// instead of 280 with 7 × 7.
const REACH: usize = 3;
/// Side of its window, pixels. Source: derivation.
const SIDE: usize = 2 * REACH + 1;
/// Numbers the network sees of a pixel: of each pixel around luma, colour difference, chroma across
/// it and alpha; of the middle luma of the screen, luma, colour difference and chroma across of the
/// object around, and how much of that is solid. Source: docs/decisions/04.
pub(crate) const INPUTS: usize = 4 * SIDE * SIDE + 5;
/// Units of the two hidden layers. Source: docs/decisions/04: 160 and 48 units take 7 of 280 wrong
/// pixels a frame away.
const HIDDEN: (usize, usize) = (96, 32);
/// Units of a layer that are summed at a time: what the processor's registers hold.
/// Source: derivation: two pixels by 32 units are four AVX-512 or eight AVX2 registers.
const UNITS: usize = 32;
/// Luma is measured in so many 8-bit levels. Source: the scale with which the network was trained.
const LEVELS: f32 = 64.0;
/// An input is at most so many standard deviations off the mean.
/// Source: `tools/train_outline.py`, with which the network was trained.
const FARTHEST: f32 = 4.0;

/// Two layers of rectified units and a sum.
struct Network {
    mean: Box<[f32; INPUTS]>,
    scale: Box<[f32; INPUTS]>,
    first: Vec<UnitBlock>,
    second: Vec<UnitBlock>,
    third: ([f32; HIDDEN.1], f32),
}

/// Some units of a layer: weights by input, and offsets.
struct UnitBlock {
    weights: Vec<[f32; UNITS]>,
    offsets: [f32; UNITS],
}

/// Little-endian f32: mean and scale of the inputs; matrices [inputs, units] and offsets, layer by
/// layer.
static NETWORK: LazyLock<Network> = LazyLock::new(|| {
    let bytes = include_bytes!("refine_network.f32");
    let mut numbers = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
    fn row<const N: usize>(numbers: &mut impl Iterator<Item = f32>) -> [f32; N] {
        std::array::from_fn(|_| numbers.next().unwrap_or(0.0))
    }
    fn blocks<const N: usize>(numbers: &mut impl Iterator<Item = f32>, inputs: usize) -> Vec<UnitBlock> {
        let rows: Vec<[f32; N]> = (0..=inputs).map(|_| row(numbers)).collect();
        (0..N / UNITS)
            .map(|k| UnitBlock {
                weights: rows[..inputs].iter().map(|r| r.as_chunks().0[k]).collect(),
                offsets: rows[inputs].as_chunks().0[k],
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

/// `max(0, W x + b)` of two pixels: the weights are more than the first cache holds, so that each
/// is fetched for both.
#[inline(always)]
fn layer<const M: usize, const N: usize>(inputs: &[[f32; M]; 2], blocks: &[UnitBlock]) -> [[f32; N]; 2] {
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

/// Coded luma (Rec. 601), colour difference and chroma across it.
#[inline(always)]
fn describe(coded: Vec3, key: &Key) -> Vec3 {
    Vec3::new(Vec3::new(0.299, 0.587, 0.114).dot(coded), key.difference(coded), key.across.dot(coded))
}

/// The pixels of a frame that the network is asked about, and what it sees of them.
pub(crate) struct OutlineInputs<'a, 'p> {
    screen: &'a Screen<'p>,
    trimap: &'a Trimap<'p>,
    key: &'a Key,
    planes: [Raster<'p, f32>; 4],
    /// The pixels that are asked about.
    pub pixels: Raster<'p, u32>,
    /// Where the pixels of a window lie, seen in each of eight ways.
    ways: [[u32; SIDE * SIDE]; 8],
}

impl<'a, 'p> OutlineInputs<'a, 'p> {
    /// Gathers the pixels of a solved and cleaned frame that are asked about: those whose alpha is
    /// soft and so many beside them, and those on either side of a half.
    pub(super) fn new(
        screen: &'a Screen<'p>,
        trimap: &'a Trimap<'p>,
        alpha: &Raster<'p, f32>,
        rgb: &[u8],
        key: &'a Key,
        beside: usize,
    ) -> Self {
        let (width, height) = (alpha.width, alpha.height());
        let solid = alpha.mask(|a| a >= 0.5);
        let mut near = alpha.mask(|a| (a > 0.0) & (a < 1.0)).dilate(beside);
        let outline = solid.dilate(1);
        near.iter_mut()
            .zip(outline.iter().zip(solid.erode(1).iter()))
            .for_each(|(n, (g, s))| *n |= g & (1 - s));
        let planes = see(alpha, rgb, key, &Rect::around(&near, REACH));
        let inner = Rect { x: REACH..width.saturating_sub(REACH), y: REACH..height.saturating_sub(REACH) };
        let pixels = set_pixels(&near).filter(|i| {
            screen.fixed[*i] == 0 && inner.x.contains(&(i % width)) && inner.y.contains(&(i / width))
        });
        let pixels = alpha.pool.plane(width, pixels.map(|i| i as u32));
        Self { screen, trimap, key, planes, pixels, ways: std::array::from_fn(|way| offsets(way, width)) }
    }

    /// What the network sees of pixel `i`: 7 × 7 of luma less the screen's, colour difference and
    /// chroma across as shares of the screen's difference, and alpha, turned and mirrored so that
    /// alpha grows to the right and, less so, downwards; then the lights.
    #[inline(always)]
    pub(super) fn inputs(&self, matte: &Matte, i: usize) -> [f32; INPUTS] {
        let width = matte.alpha.width;
        let screen = describe(coded(self.screen.light[i]), self.key);
        let object = describe(coded(matte.object_around(i, self.trimap.band[i] != 0)), self.key);
        let scale = 1.0 / screen.y.max(1.0);
        let corner = i - REACH * width - REACH;
        let window = corner..corner + (SIDE - 1) * width + SIDE;
        let way = &self.ways[way(&self.planes[3][window.clone()], width)];
        let mut out = [0.0; INPUTS];
        for (target, plane) in out[..4 * SIDE * SIDE].chunks_exact_mut(SIDE * SIDE).zip(&self.planes) {
            let window = &plane[window.clone()];
            target.iter_mut().zip(way).for_each(|(v, at)| *v = window[*at as usize]);
        }
        let [luma, along, across, _] = [0, 1, 2, 3].map(|p| p * SIDE * SIDE..(p + 1) * SIDE * SIDE);
        out[luma].iter_mut().for_each(|v| *v = (*v - screen.x) / LEVELS);
        out[along].iter_mut().for_each(|v| *v = (*v * scale).clamp(-1.0, 2.0));
        out[across].iter_mut().for_each(|v| *v = ((*v - screen.z) * scale).clamp(-2.0, 2.0));
        out[4 * SIDE * SIDE..].copy_from_slice(&[
            screen.x / LEVELS,
            (object.x - screen.x) / LEVELS,
            (object.y * scale).clamp(-1.0, 2.0),
            ((object.z - screen.z) * scale).clamp(-2.0, 2.0),
            matte.solid_around(i),
        ]);
        out
    }
}

/// Planes of what the network sees in a rectangle of a frame: luma, colour difference, chroma
/// across, alpha.
fn see<'p>(alpha: &Raster<'p, f32>, rgb: &[u8], key: &Key, rect: &Rect) -> [Raster<'p, f32>; 4] {
    let [mut luma, mut along, mut across] = [(); 3].map(|()| alpha.map(|_| 0.0));
    for i in rect.rows(alpha.width).flatten() {
        [luma[i], along[i], across[i]] = describe(levels(&rgb[3 * i..]), key).to_array();
    }
    [luma, along, across, alpha.map(|a| *a)]
}

/// Of the eight ways to turn and mirror a window, the one after which alpha grows to the right and,
/// less so, downwards.
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
    /// Solves alpha of the pixels of the outline once more.
    fn ask(outline: &OutlineInputs, matte: &mut Matte) {
        let network = &*NETWORK;
        let mut inputs = [[0.0; INPUTS]; 2];
        for pair in outline.pixels.chunks(2) {
            for (inputs, i) in inputs.iter_mut().zip(pair) {
                *inputs = outline.inputs(matte, *i as usize);
            }
            // The second of the last pair may be left from before.
            for (word, i) in network.words(&inputs).into_iter().zip(pair) {
                let alpha = &mut matte.alpha[*i as usize];
                *alpha = told(*alpha, word);
            }
        }
    }
}

/// Alpha after the network's word.
#[inline(always)]
fn told(alpha: f32, word: f32) -> f32 {
    let alpha = alpha.clamp(CLEAR, 1.0 - CLEAR);
    let logit = (alpha / (1.0 - alpha)).ln() + word;
    // No number in a weight or a pixel can make a matte that is none.
    without_haze(1.0 / (1.0 + (-logit).exp()))
}

/// Solves the outline of a cleaned matte once more.
pub(crate) fn refine<'p>(
    screen: &Screen<'p>,
    trimap: &Trimap<'p>,
    matte: &mut Matte<'p>,
    rgb: &[u8],
    key: &Key,
) {
    let outline = OutlineInputs::new(screen, trimap, &matte.alpha, rgb, key, 0);
    ask(&outline, matte);
}

#[cfg(test)]
mod tests {
    use super::super::{KeyConfig, Keyer, Scratch};
    use super::*;
    use crate::matting::pool::Pool;
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
            // Where alpha hardly grows to either side, rounding decides which way the network
            // looks: a few pixels differ.
            let apart =
                straight.pixels().zip(other.pixels()).filter(|(a, b)| a[0].abs_diff(b[0]) > 8).count();
            assert!(apart <= 12, "{name}: {apart} pixels differ");
        }
    }

    #[test]
    fn both_sides_of_the_outline_are_asked_about_and_no_solid_part() {
        let (width, height) = (60, 40);
        let key = Key::new([0.02, 0.4, 0.05].into()).unwrap();
        let panel = |i: usize| (10..50).contains(&(i % width)) && (8..32).contains(&(i / width));
        let rgb: Vec<u8> = (0..width * height)
            .flat_map(|i| if panel(i) { [210, 205, 200] } else { [40, 170, 60] })
            .collect();
        let pool = Pool::default();
        let image = RgbImage::from_raw(width as u32, height as u32, rgb.clone()).unwrap();
        let screen = Screen::before_field(&pool, &image, &key).unwrap();
        let trimap = Trimap::new(&screen, 0.0, &rgb, &key);
        let alpha = pool.plane(width, (0..width * height).map(|i| f32::from(u8::from(panel(i)))));
        let outline = OutlineInputs::new(&screen, &trimap, &alpha, &rgb, &key, 0);
        let asked = |x: usize| outline.pixels.contains(&((20 * width + x) as u32));
        assert!(asked(9) && asked(10) && !asked(7) && !asked(30));
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
