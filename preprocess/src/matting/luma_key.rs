//! Luma key: a lit object in a dark room.

use crate::matting::morphology::{components, dilate, smooth};
use crate::matting::screen::detect::quantile;
use image::RgbImage;

/// The object is brighter than the room by this many spreads of the room's light, and by as many 8-bit levels.
const SPREADS: f32 = 6.0;
const LEVELS: f32 = 8.0;
/// Parts smaller than this share of the largest are lamps and reflections.
const PART_SHARE: f32 = 0.02;

/// Least share of what is lit that is one thing, and least share of the picture that is lit, in the median frame.
const LIT: (f32, f32) = (0.95, 0.002);
/// Most pixels that are neither room nor lit, as a share of the lit ones: rims, dark sides.
const UNDECIDED: f32 = 1.0;

/// Light of every pixel, smoothed, and between which levels a pixel passes from room to object. The room's level is the lower
/// part of the picture's values.
fn levels(rgb: &[u8], width: usize) -> (Vec<f32>, f32, f32) {
    let light: Vec<f32> = rgb.chunks_exact(3).map(|p| f32::from(p[0].max(p[1]).max(p[2]))).collect();
    let mut smoothed = Vec::new();
    smooth(&light, width, &mut smoothed);
    let mut sample: Vec<f32> = smoothed.iter().step_by(5).copied().collect();
    let level = quantile(&mut sample, 0.3);
    let spread = 1.5 * (level - quantile(&mut sample, 0.05));
    let low = level + (SPREADS * spread).max(LEVELS);
    (smoothed, low, 1.5 * low + LEVELS)
}

/// Why light cannot tell the object from the room in these (small) frames, if it cannot: nothing is lit, the lamp lights clutter
/// too, or most of the object is as dark as the room. A key would then keep the clutter or cut the object to pieces.
pub(crate) fn doubt(frames: &[RgbImage]) -> Option<String> {
    let (mut lit, mut largest, mut undecided) = (Vec::new(), Vec::new(), Vec::new());
    for frame in frames.iter().filter(|f| !f.is_empty()) {
        let (smoothed, low, high) = levels(frame.as_raw(), frame.width() as usize);
        let bright: Vec<u8> = smoothed.iter().map(|v| u8::from(*v > 0.5 * (low + high))).collect();
        let (_, sizes) = components(&bright, frame.width() as usize);
        let count = sizes.iter().sum::<usize>() as f32;
        let between = smoothed.iter().filter(|v| (low..high).contains(*v)).count() as f32;
        lit.push(count / bright.len() as f32);
        largest.push(sizes.iter().copied().max().unwrap_or(0) as f32 / count.max(1.0));
        undecided.push(between / count.max(1.0));
    }
    let [lit, largest, undecided] = [&mut lit, &mut largest, &mut undecided].map(|v| quantile(v, 0.5));
    (lit < LIT.1 || largest < LIT.0 || undecided > UNDECIDED).then(|| {
        format!(
            "the room cannot be keyed by light: {:.1} % of the median frame is lit, {:.0} % of this is one thing, and {undecided:.1} \
             times as many pixels are between room and object; the mattes would not be those of the object (give masks, or --key off)",
            100.0 * lit,
            100.0 * largest
        )
    })
}

/// Matte of 8-bit sRGB by light; dark parts that the object encloses belong to it.
pub(crate) fn matte(rgb: &[u8], width: usize) -> Vec<u8> {
    let (smoothed, low, high) = levels(rgb, width);
    let bright: Vec<u8> = smoothed.iter().map(|v| u8::from(*v > 0.5 * (low + high))).collect();
    let mut keep = largest(&bright, width);
    close_enclosed(&mut keep, width);
    let near = dilate(&keep, width, 2);
    let soft = |i: usize| (255.0 * ((smoothed[i] - low) / (high - low)).clamp(0.0, 1.0)) as u8;
    (0..smoothed.len())
        .map(|i| {
            if keep[i] != 0 {
                255
            } else if near[i] != 0 {
                soft(i)
            } else {
                0
            }
        })
        .collect()
}

fn largest(mask: &[u8], width: usize) -> Vec<u8> {
    let (labels, sizes) = components(mask, width);
    let least = (PART_SHARE * sizes.iter().copied().max().unwrap_or(0) as f32) as usize;
    labels.iter().map(|l| u8::from(*l != 0 && sizes[*l as usize] > least)).collect()
}

fn close_enclosed(mask: &mut [u8], width: usize) {
    let open: Vec<u8> = mask.iter().map(|v| u8::from(*v == 0)).collect();
    let (labels, sizes) = components(&open, width);
    let height = mask.len() / width;
    let mut outside = vec![false; sizes.len()];
    for i in (0..mask.len())
        .filter(|i| i % width == 0 || i % width == width - 1 || *i < width || i / width == height - 1)
    {
        outside[labels[i] as usize] = true;
    }
    // Large openings are gaps between parts, not dark surfaces.
    let most = mask.len() / 500;
    for (m, label) in mask.iter_mut().zip(&labels) {
        if *label != 0 && !outside[*label as usize] && sizes[*label as usize] < most {
            *m = 1;
        }
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
        let matte = matte(&rgb, width);
        assert_eq!((matte[45 * width + 60], matte[41 * width + 51], matte[5 * width + 5]), (255, 255, 0));
        assert!(super::matte(&vec![0; 300], 10).iter().all(|v| *v == 0));
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
        assert!(doubt(&[room(140, 130)]).unwrap().contains("is one thing"));
        assert!(doubt(&[room(9, 3)]).is_some() && doubt(&[RgbImage::new(20, 20)]).is_some());
    }
}
