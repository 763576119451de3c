//! What a matte looks like as a whole: the screen's outline, garbage beside it, still things, holes, specks.

use super::morphology::{Rect, Regions, ends};
use super::pool::{Mask, Plane};
use super::screen::Screen;
use super::screen::clean_plate::CleanPlate;
use super::solve::Matte;
use super::trimap::Trimap;
use glam::Vec3;

/// Objects smaller than this share of the largest are specks.
const SPECK_SHARE: f32 = 0.01;
/// Specks are also smaller than this, pixels.
const SPECK_PIXELS: usize = 24;
/// Others so near to a large one are parts of it, pixels.
const PART_GAP: usize = 8;
/// Enclosed holes larger than this share of the picture are never closed.
const HOLE_SHARE: f32 = 0.01;
/// A hole is one if its mean colour is the screen's up to this share of it: where the screen is seen in other
/// frames at the same place, where nothing is known, and where it is never seen otherwise.
const HOLE_TOLERANCE: (f32, f32, f32) = (0.10, 0.08, 0.025);
/// Pixels of pure screen colour that a hole needs for this to be said.
const HOLE_PIXELS: f32 = 9.0;
/// A hole of which less than this share is three pixels and more from its rim is a slit: the blur of both sides colours it, and
/// nothing but the hue can be asked of it, up to this tolerance.
const SLIT_SHARE: f32 = 0.15;
const SLIT_TOLERANCE: f32 = 0.35;
/// Both sides only take away from the colour difference of a slit: one that keeps this share of the screen's and is this slender
/// (crinkles of foil are round) is open.
const SLIT_SCREEN: f32 = 0.5;
const SLENDER: f32 = 6.0;
/// Light in a hole, as a share of the screen's around: the object shades it and throws light on it. Only the colour tells.
const HOLE_LIGHT: std::ops::Range<f32> = 0.8..1.25;
/// Steps across an upright pole.
const ACROSS: [(i64, i64); 5] = [(1, 0), (2, 1), (2, -1), (4, 1), (4, -1)];
/// Share of an object that is seen before the screen, at least.
const BEFORE_SHARE: f32 = 0.2;

/// Cleans the matte in place; all that is done is done in the rectangle around what is not 0.
pub(crate) fn clean(
    matte: &mut Matte,
    screen: &Screen,
    trimap: &Trimap,
    plate: Option<&CleanPlate>,
    keep_pole: bool,
) {
    let own;
    let inside = match plate {
        Some(plate) => &plate.before_screen,
        None => {
            own = hull(&trimap.not_screen.mask(|v| v == 0));
            &own
        }
    };
    let rect = Rect::around(&matte.alpha.mask(|a| a > 0.0), 1);
    if rect.y.is_empty() {
        return;
    }
    for i in rect.rows(matte.alpha.width).flatten() {
        // Beside the screen only what is learnt can tell the object from the room.
        if !inside[i] && plate.is_none_or(|p| p.things[i].is_none()) {
            matte.alpha[i] = 0.0;
        }
    }
    if let Some(plate) = plate.filter(|p| p.cuts_pole(keep_pole)) {
        restore_before_pole(&mut matte.alpha, plate);
    }
    remove_what_lies_beside(&mut matte.alpha, &rect, inside);
    close_reflections(&mut matte.alpha, screen, &rect, plate);
    remove_specks(&mut matte.alpha, &rect);
}

/// What is seen on both sides of the pole, in some direction across it, is seen before it too.
fn restore_before_pole(alpha: &mut [f32], plate: &CleanPlate) {
    let is_before = |i: &usize| {
        let mut across = ACROSS.iter().map(|&(u, v)| if plate.pole_lies { (v, u) } else { (u, v) });
        plate.pole[*i]
            && alpha[*i] <= 0.5
            && across.any(|(dx, dy)| {
                meets_object(alpha, plate, *i, (dx, dy)) && meets_object(alpha, plate, *i, (-dx, -dy))
            })
    };
    let restored: Vec<usize> = plate.others.iter().map(|i| *i as usize).filter(is_before).collect();
    restored.into_iter().for_each(|i| alpha[i] = 1.0);
}

/// Whether a line from a pixel of the pole meets the object on one side. Straight across, the object may end on the pole's rim;
/// aslant it has to reach beyond: there are specks of shadow on the rim, and a line through two of them runs far along the pole.
fn meets_object(alpha: &[f32], plate: &CleanPlate, i: usize, (dx, dy): (i64, i64)) -> bool {
    let (width, height) = (plate.width as i64, (alpha.len() / plate.width) as i64);
    let (x, y) = (i as i64 % width, i as i64 / width);
    (1..=2 * plate.pole_radius() as i64)
        .map(|k| (x + k * dx, y + k * dy))
        .take_while(|(x, y)| (0..width).contains(x) && (0..height).contains(y))
        .map(|(x, y)| (y * width + x) as usize)
        .find(|j| !plate.near_pole[*j] || (dx * dy == 0 && !plate.pole[*j] && alpha[*j] > 0.5))
        .is_some_and(|j| alpha[j] > 0.5)
}

/// What hardly reaches before the screen is no part of the object.
fn remove_what_lies_beside(alpha: &mut Plane<f32>, rect: &Rect, inside: &[bool]) {
    let regions = Regions::of(&rect.mask(alpha, |a| a > 0.02));
    let mut before = vec![0_usize; regions.sizes.len()];
    for (i, label) in rect.rows(alpha.width).flatten().zip(regions.labels.iter()) {
        before[*label as usize] += usize::from(inside[i]);
    }
    let sizes = before.iter().zip(&regions.sizes);
    let beside: Vec<bool> = sizes.map(|(b, size)| (*b as f32) < BEFORE_SHARE * *size as f32).collect();
    set(alpha, rect, &regions, &beside, 0.0);
}

/// Gives all pixels of some regions of the rectangle this alpha.
fn set(alpha: &mut Plane<f32>, rect: &Rect, regions: &Regions, chosen: &[bool], value: f32) {
    if !chosen[1..].contains(&true) {
        return;
    }
    for (i, label) in rect.rows(alpha.width).flatten().zip(regions.labels.iter()) {
        if *label != 0 && chosen[*label as usize] {
            alpha[i] = value;
        }
    }
}

/// Convex hull of the pixels that are surely screen (all of the picture where there are hardly any).
pub(crate) fn hull(screen: &Mask) -> Vec<bool> {
    let (width, solid) = (screen.width, screen.erode(3));
    let rows = solid.chunks_exact(width).enumerate();
    let points: Vec<(i64, i64)> = rows
        .filter_map(|(y, row)| ends(row).map(|(a, b)| [(y as i64, a as i64), (y as i64, b as i64)]))
        .flatten()
        .collect();
    if points.len() < 8 {
        return vec![true; screen.len()];
    }
    let (left, right) = (chain(&points, -1), chain(&points, 1));
    let mut inside = vec![false; screen.len()];
    for (y, row) in inside.chunks_exact_mut(width).enumerate() {
        if let (Some(a), Some(b)) = (crossing(&left, y as i64), crossing(&right, y as i64)) {
            let (a, b) = (a.min(b).floor().max(0.0) as usize, a.max(b).ceil() as usize);
            row[a..=b.min(width - 1)].fill(true);
        }
    }
    inside
}

/// The points, sorted by row, on one side of their convex hull (Andrew 1979).
fn chain(points: &[(i64, i64)], side: i64) -> Vec<(i64, i64)> {
    let mut chain: Vec<(i64, i64)> = Vec::new();
    for &p in points {
        // Of the two points of a row only the one on this side can lie on the chain.
        while let [.., o, a] = chain[..]
            && side * ((a.0 - o.0) * (p.1 - o.1) - (a.1 - o.1) * (p.0 - o.0)) >= 0
        {
            chain.pop();
        }
        chain.push(p);
    }
    chain
}

/// Where a chain of points with rising rows crosses row `y`.
fn crossing(chain: &[(i64, i64)], y: i64) -> Option<f64> {
    let i = chain.windows(2).position(|w| w[0].0 <= y && y <= w[1].0)?;
    let (a, b) = (chain[i], chain[i + 1]);
    let t = if b.0 > a.0 { (y - a.0) as f64 / (b.0 - a.0) as f64 } else { 0.0 };
    Some(a.1 as f64 + t * (b.1 - a.1) as f64)
}

/// Foil mirrors the screen: an enclosed patch that looks like screen but not exactly like the screen at this place
/// is a part of the object.
fn close_reflections(alpha: &mut Plane<f32>, screen: &Screen, rect: &Rect, plate: Option<&CleanPlate>) {
    let (width, largest) = (alpha.width, HOLE_SHARE * alpha.len() as f32);
    let open = rect.mask(alpha, |a| a < 0.5);
    let regions = Regions::of(&open);
    let mut closed = regions.at_border();
    for (closed, size) in closed.iter_mut().zip(&regions.sizes) {
        *closed = !*closed && *size > 0 && (*size as f32) < largest;
    }
    if !closed.contains(&true) {
        return;
    }
    let (mut patches, deep) = (vec![Patch::default(); closed.len()], open.erode(2));
    for (i, (label, deep)) in rect.rows(width).flatten().zip(regions.labels.iter().zip(deep.iter())) {
        if closed[*label as usize] {
            let patch = &mut patches[*label as usize];
            patch.add(i % width, i / width, *deep != 0, screen.share[i]);
            patch.seen += plate.map_or(0.0, |p| if p.outside[i] { 0.0 } else { 1.0 });
            // The rim is mixed with the object and says nothing.
            if alpha[i] <= 0.02 {
                patch.image += screen.image[i];
                patch.screen += screen.light[i];
                patch.pure += 1.0;
            }
        }
    }
    closed
        .iter_mut()
        .zip(&patches)
        .for_each(|(closed, p)| *closed = *closed && p.is_reflection(plate.is_some()));
    set(alpha, rect, &regions, &closed, 1.0);
}

/// Sums over an enclosed patch that looks like screen.
#[derive(Clone, Debug, Default)]
struct Patch {
    size: f32,
    /// Pixels three and more from the rim.
    deep: f32,
    /// Pixels where the screen is seen in other frames.
    seen: f32,
    /// Pixels without any of the object, and the light of the picture and of the screen there.
    pure: f32,
    image: Vec3,
    screen: Vec3,
    /// Share of the screen's colour difference.
    share: f32,
    /// First and last column and row.
    bounds: Option<[usize; 4]>,
}

impl Patch {
    fn add(&mut self, x: usize, y: usize, deep: bool, share: f32) {
        self.size += 1.0;
        self.deep += f32::from(u8::from(deep));
        self.share += share.clamp(0.0, 1.5);
        let b = self.bounds.unwrap_or([x, x, y, y]);
        self.bounds = Some([b[0].min(x), b[1].max(x), b[2].min(y), b[3].max(y)]);
    }

    /// Square of the length by the area: about 2 for a round patch, the ratio of length and width for a straight slit.
    fn slenderness(&self) -> f32 {
        let [x0, x1, y0, y1] = self.bounds.unwrap_or_default();
        ((x1 - x0 + 1).pow(2) + (y1 - y0 + 1).pow(2)) as f32 / self.size.max(1.0)
    }

    fn is_reflection(&self, has_plate: bool) -> bool {
        if self.deep < SLIT_SHARE * self.size {
            let open = self.slenderness() > SLENDER && self.share > SLIT_SCREEN * self.size;
            return !open && self.pure >= HOLE_PIXELS && self.departure(0.0..f32::MAX) > SLIT_TOLERANCE;
        }
        let tolerance = match has_plate {
            false => HOLE_TOLERANCE.1,
            true if self.seen > 0.5 * self.pure => HOLE_TOLERANCE.0,
            true => HOLE_TOLERANCE.2,
        };
        self.pure >= HOLE_PIXELS && self.departure(HOLE_LIGHT) > tolerance
    }

    /// Departure from the screen in the light, within limits, that fits best; share of its light.
    fn departure(&self, limits: std::ops::Range<f32>) -> f32 {
        let (image, screen) = (self.image.element_sum().max(1e-9), self.screen.element_sum().max(1e-9));
        let level = (image / screen).clamp(limits.start, limits.end);
        (self.image - level * self.screen).abs().element_sum() / (level * screen)
    }
}

fn remove_specks(alpha: &mut Plane<f32>, rect: &Rect) {
    let regions = Regions::of(&rect.mask(alpha, |a| a > 0.02));
    let (largest, sizes) = (regions.largest(), &regions.sizes);
    let least = ((SPECK_SHARE * largest as f32) as usize).max(SPECK_PIXELS.min(largest));
    let mut small: Vec<bool> = sizes.iter().map(|s| (1..least).contains(s)).collect();
    if sizes.iter().zip(&small).any(|(s, small)| *small && *s >= SPECK_PIXELS) {
        // Rods whose foot is lost in shadow or blur.
        let near_large = regions.labels.mask(|l| l != 0 && !small[l as usize]).dilate(PART_GAP);
        let is_near = regions.any(|k| near_large[k] != 0);
        for (k, small) in small.iter_mut().enumerate() {
            *small &= !is_near[k] || sizes[k] < SPECK_PIXELS;
        }
    }
    set(alpha, rect, &regions, &small, 0.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matting::pool::Pool;

    #[test]
    fn a_rod_whose_foot_is_lost_stays_and_what_lies_apart_goes() {
        let (width, height) = (120, 90);
        let pool = Pool::default();
        let mut alpha = pool.plane(
            width,
            (0..width * height).map(|i| {
                let (x, y) = (i % width, i / width);
                let body = (15..85).contains(&x) && (40..88).contains(&y);
                let (rod, far) = (x == 50 && (8..36).contains(&y), x == 110 && (8..36).contains(&y));
                let speck = x == 89 && (50..60).contains(&y);
                f32::from(u8::from(body || rod || far || speck))
            }),
        );
        remove_specks(&mut alpha, &Rect { x: 0..width, y: 0..height });
        let alpha = |x: usize, y: usize| alpha[y * width + x];
        assert_eq!([alpha(50, 20), alpha(40, 60)], [1.0; 2], "the rod four pixels above the body, the body");
        assert_eq!([alpha(110, 20), alpha(89, 55)], [0.0; 2], "a rod elsewhere, ten pixels near the body");
    }

    #[test]
    fn an_edge_aslant_goes_on_before_the_pole_and_specks_of_shadow_on_its_rim_do_not_count() {
        let (width, height) = (400, 400);
        for lies in [false, true] {
            let at = |u: usize, v: usize| if lies { u * width + v } else { v * width + u };
            let n = width * height;
            let mut plate = CleanPlate {
                width,
                pole_lies: lies,
                outside: vec![false; n],
                pole: vec![false; n],
                near_pole: vec![false; n],
                ..CleanPlate::default()
            };
            let mut alpha = vec![0.0; n];
            // The object reaches down to a slanted edge, the pole up to row 20; both are seen in the other's place.
            let edge = |u: usize| 40.0 + 0.25 * (u as f32 - 40.0);
            for (u, v) in (0..80).flat_map(|u| (0..80).map(move |v| (u, v))) {
                plate.pole[at(u, v)] = (36..43).contains(&u) && v >= 20;
                plate.near_pole[at(u, v)] = (34..45).contains(&u) && v >= 18;
                let is_speck = u == 35 && v < 60;
                let is_object = (v as f32) < edge(u) || is_speck;
                alpha[at(u, v)] = f32::from(u8::from(is_object && !plate.pole[at(u, v)]));
            }
            plate.others = (0..n as u32).filter(|i| plate.pole[*i as usize]).collect();
            restore_before_pole(&mut alpha, &plate);
            for (u, v) in (36..43).flat_map(|u| (20..80).map(move |v| (u, v))) {
                let below = v as f32 - edge(u);
                if below.abs() > 2.5 {
                    assert_eq!(alpha[at(u, v)], f32::from(u8::from(below < 0.0)), "{u}, {v}, lies: {lies}");
                }
            }
        }
    }

    #[test]
    fn the_hull_bridges_the_object_and_leaves_out_what_is_beside_the_screen() {
        let (width, height) = (80, 60);
        let screen: Vec<u8> = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                u8::from((10..70).contains(&x) && (5..55).contains(&y) && !(30..50).contains(&x))
            })
            .collect();
        let pool = Pool::default();
        let inside = hull(&pool.plane(width, screen.into_iter()));
        assert!(inside[30 * width + 40] && inside[20 * width + 20]);
        assert!(!inside[30 * width + 3] && !inside[2 * width + 40] && !inside[58 * width + 40]);
        assert!(hull(&pool.filled(width, 4800, 0)).iter().all(|v| *v));
    }
}
