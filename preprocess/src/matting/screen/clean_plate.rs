//! What stands still in front of a camera that does not move: texture of the screen, things beside
//! it, the pole.

use super::grid::CellSums;
use crate::matting::colour::{Key, levels, linear};
use crate::matting::morphology::{Rect, Regions, hull};
use crate::matting::pool::Pool;
use glam::Vec3;
use image::RgbImage;

/// What stands still, and what of it is a pole.
struct PlateCriteria {
    /// A pixel is still where at least this share of the samples agrees, and the camera stands
    /// where this share of what is beside the screen is still. Source: for the second `key_table`
    /// is the same at 0.3; the first was chosen by hand, never measured.
    still_share: f32,
    /// Difference up to which samples agree, 8-bit levels of the largest channel.
    /// Source: chosen by hand, never measured.
    still_levels: u8,
    /// Departure from a still thing, 8-bit levels, from which something else stands before it.
    /// Source: `key_table` is the same where it is a ramp from 12 to 28.
    before_levels: u8,
    /// A pole hides the screen in at least this share of the samples.
    /// Source: `key_table`: at 0.6 the IoU of case 3 falls by 0.0005.
    always_share: f32,
    /// A pole is at most this wide, share of the longer side. Source: chosen by hand, never
    /// measured.
    pole_width: f32,
    /// Still things cover less than this share of what is seen before the screen, else the object
    /// itself stands still. Source: chosen by hand, never measured.
    pole_share: f32,
    /// Change of light on a still thing, as a factor on 8-bit values.
    /// Source: without it the mean IoU of the sample's mattes falls from 0.9897 to 0.9875; from
    /// 0.55 to 1.5 it is 0.9613.
    light: (f32, f32),
}

/// The values in force.
const CRITERIA: PlateCriteria = PlateCriteria {
    still_share: 0.6,
    still_levels: 9,
    before_levels: 20,
    always_share: 0.7,
    pole_width: 0.03,
    pole_share: 0.4,
    light: (0.75, 1.25),
};

/// Learnt from samples of a video.
#[derive(Clone, Debug, Default)]
pub(crate) struct CleanPlate {
    /// Width of the planes.
    pub width: usize,
    /// Mean linear light of the empty screen; spread to where the screen is never seen.
    pub light: Vec<Vec3>,
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
    /// Whether still things before the screen are few beside what moves there: a pole, not the
    /// object itself.
    pub has_pole: bool,
}

impl CleanPlate {
    /// `None` where the camera moves (what is beside the screen is not still; or, where nothing is
    /// beside it, nothing still reaches in from the border) or the frames differ in size.
    pub(crate) fn learn(frames: &[RgbImage], key: &Key) -> Option<Self> {
        let (width, height) = frames.first()?.dimensions();
        if frames.len() < 6 || frames.iter().any(|f| f.dimensions() != (width, height)) {
            return None;
        }
        let (width, n) = (width as usize, (width * height) as usize);
        let mut plate = Self {
            width,
            light: vec![Vec3::ZERO; n],
            things: vec![None; n],
            outside: vec![true; n],
            ..Self::default()
        };
        let other_counts = plate.gather(frames, key);
        let pool = Pool::default();
        plate.before_screen = hull(&pool.plane(width, plate.outside.iter().map(|o| u8::from(!o))));
        // The object's core hides the screen in all samples, too, but lies before it.
        let beside = plate.stillness(|plate, i| !plate.before_screen[i]);
        if beside.tells(n) && !beside.is_still() {
            return None;
        }
        let hidden = plate.stillness(|plate, i| plate.outside[i]);
        plate.spread_light()?;
        plate.forget_islands(&pool);
        let moves = hidden.tells(n) && !hidden.is_still();
        if moves && !beside.tells(n) && plate.things.iter().all(Option::is_none) {
            return None;
        }
        plate.find_pole(&pool, &other_counts, frames.len());
        plate.others = (0..n as u32).filter(|i| plate.is_other(*i as usize)).collect();
        let (mut still_inside, mut others_inside) = (0, 0);
        for i in (0..n).filter(|i| plate.before_screen[*i]) {
            still_inside += usize::from(plate.things[i].is_some());
            others_inside += other_counts[i] as usize;
        }
        plate.has_pole = (still_inside * frames.len()) as f32 <= CRITERIA.pole_share * others_inside as f32;
        plate.share = plate.things.iter().filter(|t| t.is_some()).count() as f32 / n as f32;
        Some(plate)
    }

    /// Light of the screen, what stands still and where the screen is never seen; returns how many
    /// samples show something else than the screen.
    fn gather(&mut self, frames: &[RgbImage], key: &Key) -> Vec<u32> {
        let mut others = Vec::new();
        (0..self.light.len())
            .map(|i| {
                others.clear();
                let (mut sum, mut count) = (Vec3::ZERO, 0.0);
                for p in frames.iter().map(|frame| &frame.as_raw()[3 * i..3 * i + 3]) {
                    let light = linear(p);
                    if key.is_like(light) {
                        sum += light;
                        count += 1.0;
                    } else {
                        others.push([p[0], p[1], p[2]]);
                    }
                }
                self.things[i] = agreed(&mut others, frames.len());
                // One sample may be an error.
                if count >= 2.0 {
                    self.outside[i] = false;
                    self.light[i] = sum / count;
                }
                others.len() as u32
            })
            .collect()
    }

    /// How much of some pixels is still.
    fn stillness(&self, of: impl Fn(&Self, usize) -> bool) -> Stillness {
        let pixels = (0..self.things.len()).filter(|i| of(self, *i));
        pixels.fold(Stillness::default(), |sum, i| Stillness {
            all: sum.all + 1,
            still: sum.still + usize::from(self.things[i].is_some()),
        })
    }

    /// Fills the light where the screen is never seen; `None` if it is seen nowhere.
    fn spread_light(&mut self) -> Option<()> {
        let (width, height) = (self.width, self.outside.len() / self.width);
        let mut cells = CellSums::new(width, height);
        for y in 0..height {
            cells.add_row(y, 1, |x| (!self.outside[y * width + x]).then(|| self.light[y * width + x]));
        }
        let grid = cells.fill()?;
        let mut row = Vec::new();
        for y in 0..height {
            grid.row(y, width, &mut row);
            for (i, light) in (y * width..).zip(&row).filter(|(i, _)| self.outside[*i]) {
                self.light[i] = *light;
            }
        }
        Some(())
    }

    /// What hides the screen in nearly all samples, is narrow, and joins the still things below or
    /// beside it.
    fn find_pole(&mut self, pool: &Pool, other_counts: &[u32], frames: usize) {
        let least = CRITERIA.always_share * frames as f32;
        let always = pool.plane(self.width, other_counts.iter().map(|c| u8::from(*c as f32 >= least)));
        let radius = self.pole_radius();
        let wide = always.erode(radius).dilate(radius);
        let narrow = (0..always.len()).map(|i| {
            let is_narrow = always[i] != 0 && wide[i] == 0 && self.before_screen[i];
            u8::from(self.things[i].is_some() || is_narrow)
        });
        let regions = Regions::of(&pool.plane(self.width, narrow));
        let is_joined = regions.any(|i| self.things[i].is_some());
        self.pole = (0..always.len())
            .map(|i| is_joined[regions.labels[i] as usize] && wide[i] == 0 && self.before_screen[i])
            .collect();
        let pole = pool.plane(self.width, self.pole.iter().map(|p| u8::from(*p)));
        self.near_pole = pole.dilate(1).iter().map(|p| *p != 0).collect();
        let extent = Rect::around(&pole, 0);
        self.pole_lies = extent.x.len() > extent.y.len();
    }

    fn is_other(&self, i: usize) -> bool {
        self.things[i].is_some() || self.pole[i] || !self.before_screen[i]
    }

    /// Half the width that a pole can have, pixels.
    pub(crate) fn pole_radius(&self) -> usize {
        ((CRITERIA.pole_width * self.width.max(self.outside.len() / self.width) as f32) as usize / 2).max(2)
    }

    /// Whether the pole is to be cut off.
    pub(crate) fn cuts_pole(&self, keep_pole: bool) -> bool {
        self.has_pole && !keep_pole
    }

    /// Whether the pixel shows what always stands there and is to be cut.
    pub(crate) fn shows_still(&self, i: usize, rgb: [u8; 3], keep_pole: bool) -> bool {
        match self.things[i] {
            _ if self.before_screen[i] && !self.cuts_pole(keep_pole) => false,
            Some(thing) if !self.pole[i] => departure(rgb, thing) < CRITERIA.before_levels,
            // Beside the screen only what is learnt can tell the object from the room.
            _ => self.pole[i] || !self.before_screen[i],
        }
    }

    /// A pole stands on something: what is still before the screen and not connected to anything
    /// still beside it or to the border of the picture is a part of the object that happens to look
    /// alike in most frames.
    fn forget_islands(&mut self, pool: &Pool) {
        let still = pool.plane(self.width, self.things.iter().map(|t| u8::from(t.is_some())));
        let regions = Regions::of(&still);
        let (at_border, beside) = (regions.at_border(), regions.any(|i| !self.before_screen[i]));
        for (thing, label) in self.things.iter_mut().zip(regions.labels.iter()) {
            if !at_border[*label as usize] && !beside[*label as usize] {
                *thing = None;
            }
        }
    }
}

/// Pixels, and how many of them show the same in most samples.
#[derive(Clone, Copy, Default)]
struct Stillness {
    all: usize,
    still: usize,
}

impl Stillness {
    /// Whether they are enough of a picture of `n` pixels to tell whether the camera stands.
    fn tells(self, n: usize) -> bool {
        self.all * 50 >= n
    }

    /// Whether most of them are still.
    fn is_still(self) -> bool {
        self.still as f32 >= CRITERIA.still_share * self.all as f32
    }
}

/// The colour that most samples share.
fn agreed(samples: &mut [[u8; 3]], frames: usize) -> Option<[u8; 3]> {
    let needed = (CRITERIA.still_share * frames as f32) as usize;
    if samples.len() < needed.max(3) {
        return None;
    }
    let median = [0, 1, 2].map(|c| {
        let mid = samples.len() / 2;
        samples.select_nth_unstable_by_key(mid, |s| s[c]).1[c]
    });
    let agreeing = samples.iter().filter(|s| departure(**s, median) <= CRITERIA.still_levels).count();
    (agreeing >= needed).then_some(median)
}

/// Largest difference of a channel, 8-bit levels, from a still thing under the light that fits
/// best: the object throws shadows and light on it.
fn departure(seen: [u8; 3], thing: [u8; 3]) -> u8 {
    let (seen, thing) = (levels(&seen), levels(&thing));
    let (darkest, brightest) = CRITERIA.light;
    let light = (seen.dot(thing) / thing.length_squared().max(1.0)).clamp(darkest, brightest);
    (seen - light * thing).abs().max_element() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A box that swings before a green screen, with a dark spot that is always covered, on a pole
    /// down to the floor.
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
        let key = Key::new([0.013, 0.36, 0.045].into()).unwrap();
        let plate = CleanPlate::learn(&frames, &key).unwrap();
        let thing = |x: usize, y: usize| plate.things[y * 160 + x];
        assert!(thing(90, 95).is_some() && thing(30, 115).is_some(), "pole and floor");
        assert!(thing(94, 63).is_none() && thing(94, 50).is_none() && thing(20, 20).is_none());
        assert!(plate.has_pole && plate.outside[63 * 160 + 94] && !plate.outside[20 * 160 + 20]);
        assert!(CleanPlate::learn(&frames[..3], &key).is_none(), "too few frames to say");
    }

    /// A box whose texture moves hides the middle of a screen that fills the picture, on a pole
    /// that moves by `drift` pixels a frame.
    fn before_wide_screen(i: u32, drift: u32) -> RgbImage {
        RgbImage::from_fn(160, 120, |x, y| {
            let pole = 78 + drift * i;
            if (50..110).contains(&x) && (40..80).contains(&y) {
                Rgb([(90 + 13 * ((x + 7 * i) % 11)) as u8, 60 + ((y + 5 * i) % 7) as u8 * 9, 140])
            } else if (pole..pole + 4).contains(&x) && y >= 80 {
                Rgb([50, 48, 46])
            } else {
                Rgb([30, 160 + (x / 40) as u8, 60])
            }
        })
    }

    #[test]
    fn a_pole_is_found_where_the_screen_fills_the_picture_unless_the_camera_moves() {
        let key = Key::new([0.013, 0.36, 0.045].into()).unwrap();
        let frames: Vec<RgbImage> = (0..16).map(|i| before_wide_screen(i, 0)).collect();
        let plate = CleanPlate::learn(&frames, &key).unwrap();
        assert!(plate.has_pole && plate.pole[100 * 160 + 80] && !plate.pole[60 * 160 + 80]);
        let frames: Vec<RgbImage> = (0..16).map(|i| before_wide_screen(i, 3)).collect();
        assert!(CleanPlate::learn(&frames, &key).is_none(), "nothing is still");
    }
}
