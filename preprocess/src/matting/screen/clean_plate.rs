//! What stands still in front of a camera that does not move: texture of the screen, things beside it, the pole.

use crate::matting::colour::{Key, LINEAR};
use crate::matting::morphology::{Rect, components, dilate, erode};
use crate::matting::screen::grid::Sums;
use image::RgbImage;

/// A pixel is screen where at least this share of the samples shows it.
const SCREEN_SHARE: f32 = 0.08;
/// Least purity (colour difference by light, of that of the key) and least colour difference (of the key's) of screen.
const SCREEN_LIKE: (f32, f32) = (0.75, 0.06);
/// The plate is the mean of the samples around this quantile of light: the screen out of the object's shadow.
const LIT_QUANTILE: f32 = 0.7;
/// Samples that count for the plate, by their light as a share of that quantile.
const LIT_RANGE: std::ops::Range<f32> = 0.86..1.18;
/// Cells from which the plate is spread to where the screen is never seen, pixels.
const PLATE_CELL: usize = 8;
/// A pixel is still where at least this share of the samples agrees.
const STILL_SHARE: f32 = 0.6;
/// Difference up to which samples agree, 8-bit levels of the largest channel.
const STILL_LEVELS: i32 = 9;
/// Change of light between most samples of a still thing, as a factor on 8-bit values.
const STILL_LIGHT: (f32, f32) = (0.75, 1.25);
/// Change of light on a still thing in any frame.
const ANY_LIGHT: (f32, f32) = (0.55, 1.5);
/// Departure from a still thing, 8-bit levels, at which something else surely stands before it.
const BEFORE_LEVELS: (i32, i32) = (12, 28);
/// A pole hides the screen in at least this share of the samples and is at most this wide (share of the longer side).
const ALWAYS_SHARE: f32 = 0.7;
const POLE_WIDTH: f32 = 0.03;
/// Pixels beside the pole that are a mixture of it and of what is beside it.
const POLE_RIM: usize = 2;
/// Still things cover less than this share of what is seen before the screen, else the object itself stands still.
const POLE_SHARE: f32 = 0.4;
/// Share of the picture beside the screen that must be still for the camera to count as standing.
const STANDING_SHARE: f32 = 0.3;

/// Learnt from samples of a video.
#[derive(Clone, Debug, Default)]
pub(crate) struct Still {
    /// Width of the planes.
    pub width: usize,
    /// Linear light of the empty screen, without the object's shadow; spread to where the screen is never seen.
    pub plate: [Vec<f32>; 3],
    /// Colour of what stands still and is no screen; `None` elsewhere.
    pub things: Vec<Option<[u8; 3]>>,
    /// Before the screen: narrow, always there in whatever light, joined to what stands still.
    pub pole: Vec<bool>,
    /// The pole and its rim: pixels that are a mixture of it and of what is beside it.
    pub near_pole: Vec<bool>,
    /// The pole is wider than tall.
    pub pole_lies: bool,
    /// Pixels where the screen is never seen.
    pub outside: Vec<bool>,
    /// Convex hull of the pixels where it is.
    pub before_screen: Vec<bool>,
    /// Pixels that are not plainly before the screen: things, the pole, what lies beside.
    pub others: Vec<u32>,
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
        let mut still = Self {
            width,
            plate: [0; 3].map(|_| vec![0.0; n]),
            things: vec![None; n],
            outside: vec![true; n],
            ..Self::default()
        };
        let (mut lights, mut others) = (Vec::new(), Vec::new());
        let (mut other_counts, mut still_count, mut other_count) = (vec![0_u32; n], 0_usize, 0_usize);
        let needed = (SCREEN_SHARE * frames.len() as f32).max(2.0);
        for (i, other_count_here) in other_counts.iter_mut().enumerate() {
            lights.clear();
            others.clear();
            for frame in frames {
                let p = &frame.as_raw()[3 * i..3 * i + 3];
                let p = [p[0], p[1], p[2]];
                match screen_like(p, key) {
                    Some(light) => lights.push((light, p)),
                    None => others.push(p),
                }
            }
            *other_count_here = others.len() as u32;
            still.things[i] = agreed(&mut others, frames.len());
            if lights.len() as f32 >= needed {
                still.outside[i] = false;
                let lit = lit_mean(&mut lights);
                (0..3).for_each(|c| still.plate[c][i] = lit[c]);
            } else {
                other_count += 1;
                still_count += usize::from(still.things[i].is_some());
            }
        }
        if other_count * 50 >= n && (still_count as f32) < STANDING_SHARE * other_count as f32 {
            return None;
        }
        still.spread_plate()?;
        let seen: Vec<u8> = still.outside.iter().map(|o| u8::from(!o)).collect();
        still.before_screen = crate::matting::cleanup::hull(&seen, width);
        still.forget_islands();
        still.find_pole(&other_counts, frames.len());
        let is_other = |i: &usize| still.things[*i].is_some() || still.pole[*i] || !still.before_screen[*i];
        still.others = (0..n).filter(is_other).map(|i| i as u32).collect();
        let before = |i: &usize| still.before_screen[*i];
        let still_inside = (0..n).filter(before).filter(|i| still.things[*i].is_some()).count();
        let others_inside = (0..n).filter(before).map(|i| other_counts[i] as usize).sum::<usize>();
        still.has_pole = (still_inside * frames.len()) as f32 <= POLE_SHARE * others_inside as f32;
        still.share = still.things.iter().filter(|t| t.is_some()).count() as f32 / n as f32;
        Some(still)
    }

    /// Fills the plate where the screen is never seen; `None` if it is seen nowhere.
    fn spread_plate(&mut self) -> Option<()> {
        let (width, height) = (self.width, self.outside.len() / self.width);
        let mut sums = Sums::<3>::new(width, height, PLATE_CELL);
        for i in (0..self.outside.len()).filter(|i| !self.outside[*i]) {
            sums.add(i % width, i / width, [0, 1, 2].map(|c| self.plate[c][i]));
        }
        let grid = sums.filled(PLATE_CELL as u32, 2 * (width + height) / PLATE_CELL)?;
        let mut row = Vec::new();
        for y in 0..height {
            grid.row(y, width, &mut row);
            for (x, light) in row.iter().enumerate().filter(|(x, _)| self.outside[y * width + x]) {
                (0..3).for_each(|c| self.plate[c][y * width + x] = light[c]);
            }
        }
        Some(())
    }
}

impl Still {
    /// What hides the screen in nearly all samples, is narrow, and joins the still things below or beside it.
    fn find_pole(&mut self, other_counts: &[u32], frames: usize) {
        let width = self.width;
        let always: Vec<u8> =
            other_counts.iter().map(|c| u8::from(*c as f32 >= ALWAYS_SHARE * frames as f32)).collect();
        let radius = self.pole_radius();
        let wide = dilate(&erode(&always, width, radius), width, radius);
        let narrow: Vec<u8> = (0..always.len())
            .map(|i| {
                let is_thing = self.things[i].is_some();
                u8::from(is_thing || (always[i] != 0 && wide[i] == 0 && self.before_screen[i]))
            })
            .collect();
        let (labels, sizes) = components(&narrow, width);
        let mut joined = vec![false; sizes.len()];
        for (thing, label) in self.things.iter().zip(&labels).filter(|(t, _)| t.is_some()) {
            joined[*label as usize] |= thing.is_some();
        }
        self.pole = (0..narrow.len())
            .map(|i| narrow[i] != 0 && wide[i] == 0 && self.before_screen[i] && joined[labels[i] as usize])
            .collect();
        let pole: Vec<u8> = self.pole.iter().map(|p| u8::from(*p)).collect();
        self.near_pole = dilate(&pole, width, POLE_RIM).iter().map(|p| *p != 0).collect();
        let extent = Rect::around(&pole, width, 0);
        self.pole_lies = extent.x.len() > extent.y.len();
    }

    /// Half the width that a pole can have, pixels.
    pub fn pole_radius(&self) -> usize {
        ((POLE_WIDTH * self.width.max(self.outside.len() / self.width) as f32) as usize / 2).max(2)
    }

    /// Whether the pole is to be cut off.
    pub fn cuts_pole(&self, keep_pole: bool) -> bool {
        self.has_pole && !keep_pole
    }

    /// How surely the pixel shows what always stands there, 0 to 1.
    pub fn likeness(&self, i: usize, rgb: [u8; 3], keep_pole: bool) -> f32 {
        if self.before_screen[i] && !self.cuts_pole(keep_pole) {
            return 0.0;
        }
        if self.pole[i] {
            return 1.0;
        }
        match self.things[i] {
            Some(thing) => {
                let (low, high) = BEFORE_LEVELS;
                // The light that fits best leaves no more than this: most pixels need no fit.
                let apart = |c: usize| (i32::from(rgb[c]) - i32::from(thing[c])).pow(2);
                if apart(0) + apart(1) + apart(2) <= low * low {
                    return 1.0;
                }
                (1.0 - (departure(rgb, thing) - low) as f32 / (high - low) as f32).clamp(0.0, 1.0)
            }
            // Beside the screen only what is learnt can tell the object from the room.
            None => f32::from(u8::from(!self.before_screen[i])),
        }
    }
}

/// The light (sum of linear channels) of a pixel that looks like screen in any light.
fn screen_like(rgb: [u8; 3], key: &Key) -> Option<f32> {
    let linear = rgb.map(|v| LINEAR[usize::from(v)]);
    let light = linear[0] + linear[1] + linear[2];
    let reference = key.difference(key.colour);
    let purity = reference / (key.colour[0] + key.colour[1] + key.colour[2]);
    let d = key.difference(linear);
    (d > SCREEN_LIKE.0 * purity * light && d > SCREEN_LIKE.1 * reference).then_some(light)
}

/// Mean linear colour of the samples whose light is about that of the brighter ones.
fn lit_mean(samples: &mut [(f32, [u8; 3])]) -> [f32; 3] {
    let rank = ((samples.len() - 1) as f32 * LIT_QUANTILE).round() as usize;
    let lit = samples.select_nth_unstable_by(rank, |a, b| a.0.total_cmp(&b.0)).1.0;
    let (mut sum, mut count) = ([0.0_f32; 3], 0.0);
    for (_, p) in samples.iter().filter(|(light, _)| LIT_RANGE.contains(&(light / lit))) {
        (0..3).for_each(|c| sum[c] += LINEAR[usize::from(p[c])]);
        count += 1.0;
    }
    sum.map(|s| s / count)
}

impl Still {
    /// A pole stands on something: what is still before the screen and not connected to anything still beside it or
    /// to the border of the picture is a part of the object that happens to look alike in most frames.
    fn forget_islands(&mut self) {
        let mask: Vec<u8> = self.things.iter().map(|t| u8::from(t.is_some())).collect();
        let (labels, sizes) = components(&mask, self.width);
        let mut grounded = vec![false; sizes.len()];
        for (i, label) in labels.iter().enumerate() {
            let x = i % self.width;
            let at_border = x == 0 || x + 1 == self.width || i < self.width || i + self.width >= labels.len();
            grounded[*label as usize] |= at_border || !self.before_screen[i];
        }
        for (thing, label) in self.things.iter_mut().zip(&labels) {
            if !grounded[*label as usize] {
                *thing = None;
            }
        }
    }
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
    let agreeing = samples.iter().filter(|s| departure_in(**s, median, STILL_LIGHT) <= STILL_LEVELS).count();
    (agreeing >= needed).then_some(median)
}

/// Largest difference of a channel, 8-bit levels, from a still thing under the light that fits best.
fn departure(seen: [u8; 3], thing: [u8; 3]) -> i32 {
    departure_in(seen, thing, ANY_LIGHT)
}

fn departure_in(seen: [u8; 3], thing: [u8; 3], range: (f32, f32)) -> i32 {
    let (a, b) = (seen.map(f32::from), thing.map(f32::from));
    let fit = crate::matting::colour::dot(a, b) / super::colour::dot(b, b).max(1.0);
    let light = fit.clamp(range.0, range.1);
    (0..3).map(|c| (a[c] - light * b[c]).abs() as i32).max().unwrap_or(0)
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
