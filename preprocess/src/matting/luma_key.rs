//! Luma key: a lit object in a dark room.

use super::cleanup::SPECKS;
use super::morphology::{Regions, smooth};
use super::pool::{BinaryMask, Pool, Raster};
use super::screen::detect::quantile;
use crate::matting::screen::detect::no_matte;
use image::RgbImage;
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule};

/// What is lit, and when light alone tells the object from the room.
struct LitCriteria {
    /// The object is brighter than the room by this many spreads of the room's light.
    /// Source: chosen by hand, never measured.
    spreads: f32,
    /// And by as many 8-bit levels. Source: chosen by hand, never measured.
    levels: f32,
    /// Least share of what is lit that is one thing, and least share of the picture that is lit, in
    /// the median frame. Source: docs/decisions/04 for the first; the second was chosen by hand,
    /// never measured.
    lit: (f32, f32),
}

/// The values in force.
const LIT_OBJECT: LitCriteria = LitCriteria { spreads: 6.0, levels: 8.0, lit: (0.95, 0.002) };

/// Light of every pixel, smoothed, and between which levels a pixel passes from room to object.
struct Lit<'p> {
    light: Raster<'p, f32>,
    low: f32,
    high: f32,
}

impl<'p> Lit<'p> {
    /// The room's level is the lower part of the picture's values.
    fn of(pool: &'p Pool, rgb: &[u8], width: usize) -> Self {
        let brightest = rgb.chunks_exact(3).map(|p| f32::from(p[0].max(p[1]).max(p[2])));
        let light = smooth(&pool.plane(width, brightest));
        let mut sample: Vec<f32> = light.iter().step_by(5).copied().collect();
        let level = quantile(&mut sample, 0.3);
        let spread = 1.5 * (level - quantile(&mut sample, 0.05));
        let low = level + (LIT_OBJECT.spreads * spread).max(LIT_OBJECT.levels);
        Self { light, low, high: 1.5 * low + LIT_OBJECT.levels }
    }

    /// What is rather object than room.
    fn bright(&self) -> BinaryMask<'p> {
        self.light.mask(|v| v > 0.5 * (self.low + self.high))
    }
}

/// Why light cannot tell the object from the room in these (small) frames, if it cannot: nothing is
/// lit, the lamp lights clutter too, or most of the object is as dark as the room. A key would then
/// keep the clutter or cut the object to pieces.
pub(crate) fn doubt(frames: &[RgbImage]) -> Option<Decision> {
    let (mut lit, mut largest, mut undecided) = (Vec::new(), Vec::new(), Vec::new());
    for frame in frames.iter().filter(|f| !f.is_empty()) {
        let pool = Pool::default();
        let scene = Lit::of(&pool, frame.as_raw(), frame.width() as usize);
        let regions = Regions::of(&scene.bright());
        let count = regions.sizes.iter().sum::<usize>() as f32;
        let between = scene.light.iter().filter(|v| (scene.low..scene.high).contains(*v)).count() as f32;
        lit.push(count / scene.light.len() as f32);
        largest.push(regions.largest() as f32 / count.max(1.0));
        undecided.push(between / count.max(1.0));
    }
    let [lit, largest, undecided] = [&mut lit, &mut largest, &mut undecided].map(|v| quantile(v, 0.5));
    (lit < LIT_OBJECT.lit.1 || largest < LIT_OBJECT.lit.0 || undecided > 1.0).then(|| {
        let figures = [
            (Quantity::LitShare, lit),
            (Quantity::LargestLitPart, largest),
            (Quantity::UndecidedPixels, undecided),
        ]
        .map(|(quantity, value)| Measurement::new(quantity, f64::from(value)));
        no_matte(Rule::Contradicted).remarked(Remark::NotKeyableByLight).with_all(figures)
    })
}

/// Matte of 8-bit sRGB by light; dark parts that the object encloses belong to it.
pub(crate) fn matte(pool: &Pool, rgb: &[u8], width: usize) -> Vec<u8> {
    let scene = Lit::of(pool, rgb, width);
    let mut keep = large_parts(&scene.bright());
    close_enclosed(&mut keep);
    let near = keep.dilate(2);
    let alpha = scene.light.iter().map(|v| ((v - scene.low) / (scene.high - scene.low)).clamp(0.0, 1.0));
    alpha
        .zip(keep.iter().zip(near.iter()))
        .map(|(alpha, (keep, near))| if *keep != 0 { 255 } else { near * (255.0 * alpha) as u8 })
        .collect()
}

/// Smaller parts are lamps and reflections.
fn large_parts<'p>(mask: &BinaryMask<'p>) -> BinaryMask<'p> {
    let regions = Regions::of(mask);
    let least = (SPECKS.share * regions.largest() as f32) as usize;
    regions.labels.mask(|l| l != 0 && regions.sizes[l as usize] > least)
}

/// Large openings are gaps between parts, not dark surfaces.
fn close_enclosed(mask: &mut BinaryMask) {
    let regions = Regions::of(&mask.mask(|v| v == 0));
    let (at_border, most) = (regions.at_border(), mask.len() / 500);
    for (m, label) in mask.iter_mut().zip(regions.labels.iter()) {
        let label = *label as usize;
        *m |= u8::from(label != 0 && !at_border[label] && regions.sizes[label] < most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lit_object_is_cut_from_a_dark_room_and_keeps_its_dark_spots() {
        let (width, height) = (120, 90);
        let rgb: Vec<u8> = (0..width * height)
            .flat_map(|i| {
                let (x, y) = (i % width, i / width);
                let inside = (30..90).contains(&x) && (20..70).contains(&y);
                let spot = (50..52).contains(&x) && (40..42).contains(&y);
                let v = if spot {
                    6
                } else if inside {
                    120
                } else {
                    4 + (i * 7 % 3) as u8
                };
                [v, v, v / 2]
            })
            .collect();
        let pool = Pool::default();
        let matte = matte(&pool, &rgb, width);
        assert_eq!((matte[45 * width + 60], matte[41 * width + 51], matte[5 * width + 5]), (255, 255, 0));
        assert!(super::matte(&pool, &vec![0; 300], 10).iter().all(|v| *v == 0));
    }

    #[test]
    fn a_lit_thing_in_the_dark_raises_no_doubt_and_clutter_or_a_dim_thing_does() {
        let room = |lit: u8, clutter: u8| {
            RgbImage::from_fn(160, 120, |x, y| {
                let inside = (50..110).contains(&x) && (30..90).contains(&y);
                let aside = (125..150).contains(&x) && (80..110).contains(&y);
                let noise = ((x * 73 + y * 151) % 4) as u8;
                image::Rgb(
                    [if inside {
                        lit
                    } else if aside {
                        clutter
                    } else {
                        3
                    } + noise; 3],
                )
            })
        };
        assert!(doubt(&[room(140, 3)]).is_none());
        assert!(doubt(&[room(140, 130)]).unwrap().remarks == [Remark::NotKeyableByLight]);
        assert!(doubt(&[room(9, 3)]).is_some() && doubt(&[RgbImage::new(20, 20)]).is_some());
    }
}
