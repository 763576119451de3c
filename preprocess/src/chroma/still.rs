//! What stands still in front of a camera that does not move: texture of the screen, things beside it, the pole.

use super::colour::Key;
use super::detect::quantile;
use super::field::Field;
use super::filters::components;
use image::RgbImage;

/// A pixel is screen where at least this share of the samples shows it.
const SCREEN_SHARE: f32 = 0.08;
/// A pixel is still where at least this share of the samples agrees.
const STILL_SHARE: f32 = 0.7;
/// Difference up to which samples agree, 8-bit levels of the largest channel.
const STILL_LEVELS: i32 = 9;
/// Still things cover less than this share of what is seen before the screen, else the object itself stands still.
const POLE_SHARE: f32 = 0.4;
/// Share of the picture beside the screen that must be still for the camera to count as standing.
const STANDING_SHARE: f32 = 0.6;

/// Learnt from samples of a video.
#[derive(Clone, Debug, Default)]
pub(crate) struct Still {
    /// Width of the planes.
    pub width: usize,
    /// Factor on the smooth light of the screen (folds, seams); 1 where the screen is never seen.
    pub texture: Vec<f32>,
    /// Colour of what stands still and is no screen; `None` elsewhere.
    pub things: Vec<Option<[u8; 3]>>,
    /// Pixels where the screen is never seen and nothing is still, that lie outside of it.
    pub outside: Vec<bool>,
    /// Share of the picture where something stands still.
    pub share: f32,
    /// Whether still things before the screen are few beside what moves there: a pole, not the object itself.
    pub has_pole: bool,
}

impl Still {
    /// `None` where the camera moves (what is no screen is not still) or the frames differ in size.
    pub fn learn(frames: &[RgbImage], key: &Key) -> Option<Self> {
        let (width, height) = frames.first()?.dimensions();
        if frames.len() < 6 || frames.iter().any(|f| f.dimensions() != (width, height)) {
            return None;
        }
        let (width, n) = (width as usize, (width * height) as usize);
        let fields: Vec<Option<Field>> = frames.iter().map(|f| Field::fit(f.as_raw(), width, key)).collect();
        let mut still = Self {
            width,
            texture: vec![1.0; n],
            things: vec![None; n],
            outside: vec![true; n],
            share: 0.0,
            has_pole: false,
        };
        let (mut rows, mut ratios, mut others) = (vec![Vec::new(); frames.len()], Vec::new(), Vec::new());
        let (mut still_count, mut other_count) = (0_usize, 0_usize);
        for y in 0..n / width {
            for (row, field) in rows.iter_mut().zip(&fields) {
                row.clear();
                if let Some(field) = field {
                    field.row(y, width, row);
                }
            }
            for x in 0..width {
                let i = y * width + x;
                ratios.clear();
                others.clear();
                for (frame, row) in frames.iter().zip(&rows) {
                    let p = &frame.as_raw()[3 * i..3 * i + 3];
                    let Some(light) = row.get(x) else { continue };
                    let share = key.difference_of([p[0], p[1], p[2]]) / (light[3] + 1e-6);
                    if (0.8..1.25).contains(&share) {
                        ratios.push(share);
                    } else {
                        others.push([p[0], p[1], p[2]]);
                    }
                }
                let seen = ratios.len() as f32 >= (SCREEN_SHARE * frames.len() as f32).max(2.0);
                still.outside[i] = !seen;
                if seen {
                    still.texture[i] = quantile(&mut ratios, 0.5).clamp(0.85, 1.15);
                } else {
                    other_count += 1;
                    still.things[i] = agreed(&mut others, frames.len());
                    still_count += usize::from(still.things[i].is_some());
                }
            }
        }
        let is_standing =
            other_count * 50 < n || still_count as f32 >= STANDING_SHARE * 0.5 * other_count as f32;
        let seen: Vec<u8> = still.outside.iter().map(|o| u8::from(!o)).collect();
        let before_screen = super::regions::hull(&seen, width);
        still.forget_islands(&before_screen);
        let still_inside =
            still.things.iter().zip(&before_screen).filter(|(t, b)| t.is_some() && **b).count();
        still.has_pole =
            (still_inside as f32) < POLE_SHARE * others_inside(frames, &fields, key, &before_screen, width);
        still.share = still.things.iter().filter(|t| t.is_some()).count() as f32 / n as f32;
        is_standing.then_some(still)
    }
}

impl Still {
    /// A pole stands on something: what is still before the screen and not connected to anything still beside it or
    /// to the border of the picture is a part of the object that happens to look alike in most frames.
    fn forget_islands(&mut self, before_screen: &[bool]) {
        let mask: Vec<u8> = self.things.iter().map(|t| u8::from(t.is_some())).collect();
        let (labels, sizes) = components(&mask, self.width);
        let mut grounded = vec![false; sizes.len()];
        for (i, label) in labels.iter().enumerate() {
            let x = i % self.width;
            let at_border = x == 0 || x + 1 == self.width || i < self.width || i + self.width >= labels.len();
            grounded[*label as usize] |= at_border || !before_screen[i];
        }
        for (thing, label) in self.things.iter_mut().zip(&labels) {
            if !grounded[*label as usize] {
                *thing = None;
            }
        }
    }
}

/// Mean number of pixels of a frame that do not have the screen's colour difference, inside `mask`.
fn others_inside(
    frames: &[RgbImage],
    fields: &[Option<Field>],
    key: &Key,
    mask: &[bool],
    width: usize,
) -> f32 {
    let mut count = 0;
    let mut row = Vec::new();
    for (frame, field) in frames.iter().zip(fields) {
        let Some(field) = field else { continue };
        for (y, line) in frame.as_raw().chunks_exact(3 * width).enumerate() {
            field.row(y, width, &mut row);
            let is_other = |x: usize, p: &[u8]| {
                mask[y * width + x] && key.difference_of([p[0], p[1], p[2]]) < 0.5 * row[x][3]
            };
            count += line.chunks_exact(3).enumerate().filter(|(x, p)| is_other(*x, p)).count();
        }
    }
    count as f32 / frames.len() as f32
}

/// The colour that most samples share.
fn agreed(samples: &mut [[u8; 3]], frames: usize) -> Option<[u8; 3]> {
    let needed = (STILL_SHARE * frames as f32) as usize;
    if samples.len() < needed.max(3) {
        return None;
    }
    let median = [0, 1, 2].map(|c| {
        let mid = samples.len() / 2;
        samples.select_nth_unstable_by_key(mid, |s| s[c]).1[c]
    });
    let agreeing = samples.iter().filter(|s| departure(**s, median) <= STILL_LEVELS).count();
    (agreeing >= needed).then_some(median)
}

/// Largest difference of a channel, 8-bit levels.
pub(crate) fn departure(a: [u8; 3], b: [u8; 3]) -> i32 {
    (0..3).map(|c| (i32::from(a[c]) - i32::from(b[c])).abs()).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A box that swings before a green screen, with a dark spot that is always covered, on a pole down to the floor.
    fn frame(i: u32) -> RgbImage {
        RgbImage::from_fn(160, 120, |x, y| {
            let (left, right) = (40 + 3 * i, 90 + 3 * i);
            if (92..97).contains(&x) && (60..66).contains(&y) {
                Rgb([9, 9, 12])
            } else if (left..right).contains(&x) && (40..80).contains(&y) {
                Rgb([(90 + 13 * ((x + 160 - left) % 11)) as u8, 60 + (y % 7) as u8 * 9, 140])
            } else if (88..92).contains(&x) && y >= 80 {
                Rgb([50, 48, 46])
            } else if y >= 110 {
                Rgb([120, 110, 100])
            } else {
                Rgb([30, 160 + (x / 40) as u8, 60])
            }
        })
    }

    #[test]
    fn a_pole_is_still_and_a_dark_spot_of_the_object_is_not_taken_for_one() {
        let frames: Vec<RgbImage> = (0..16).map(frame).collect();
        let key = Key::new([0.013, 0.36, 0.045], 1.0 / 3f32.sqrt()).unwrap();
        let still = Still::learn(&frames, &key).unwrap();
        let thing = |x: usize, y: usize| still.things[y * 160 + x];
        assert!(thing(90, 95).is_some() && thing(30, 115).is_some(), "pole and floor");
        assert!(thing(94, 63).is_none() && thing(94, 50).is_none() && thing(20, 20).is_none());
        assert!(still.has_pole && still.outside[63 * 160 + 94] && !still.outside[20 * 160 + 20]);
        assert!(Still::learn(&frames[..3], &key).is_none(), "too few frames to say");
    }
}
