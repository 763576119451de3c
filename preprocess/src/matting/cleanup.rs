//! What a matte looks like as a whole: the screen's outline, garbage beside it, still things, holes, specks.

use crate::matting::morphology::{Rect, components, dilate, erode};
use crate::matting::pool::Mask;
use crate::matting::screen::clean_plate::Still;
use crate::matting::solve::Workspace;

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

/// Cleans `work.alpha` in place; all that is done is done in the rectangle around what is not 0.
pub(crate) fn clean(work: &mut Workspace, width: usize, still: Option<&Still>, keep_pole: bool) {
    let own;
    let inside = match still {
        Some(still) => &still.before_screen,
        None => {
            own = hull(&work.surely_screen(), width);
            &own
        }
    };
    let seen: Mask = work.alpha.iter().map(|a| u8::from(*a > 0.0)).collect();
    let rect = Rect::around(&seen, width, 1);
    if rect.y.is_empty() {
        return;
    }
    for i in rect.rows(width).flatten() {
        // Beside the screen only what is learnt can tell the object from the room.
        if !inside[i] && still.is_none_or(|s| s.things[i].is_none()) {
            work.alpha[i] = 0.0;
        }
    }
    if let Some(still) = still.filter(|s| s.cuts_pole(keep_pole)) {
        restore_before_pole(work, width, still);
    }
    remove_what_lies_beside(work, width, &rect, inside);
    close_reflections(work, width, &rect, still);
    remove_specks(work, width, &rect);
}

/// What is seen on both sides of the pole, in some direction across it, is seen before it too. Straight across, the object may end on the
/// pole's rim; aslant it has to reach beyond: there are specks of shadow on the rim, and a line through two of them runs far along the pole.
fn restore_before_pole(work: &mut Workspace, width: usize, still: &Still) {
    let (reach, height) = (2 * still.pole_radius() as i64, (work.alpha.len() / width) as i64);
    let is_solid = |i: usize| work.alpha[i] > 0.5;
    let meets = |i: usize, (dx, dy): (i64, i64)| {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        let mut seen = (1..=reach)
            .map(|k| (x + k * dx, y + k * dy))
            .take_while(|(x, y)| (0..width as i64).contains(x) && (0..height).contains(y))
            .map(|(x, y)| y as usize * width + x as usize);
        let aslant = dx * dy != 0;
        seen.find(|j| !still.near_pole[*j] || (!aslant && !still.pole[*j] && is_solid(*j)))
            .is_some_and(is_solid)
    };
    let across = ACROSS.map(|(u, v)| if still.pole_lies { (v, u) } else { (u, v) });
    let is_before = |i: &usize| {
        let mut lines = across.iter().map(|&(dx, dy)| ((dx, dy), (-dx, -dy)));
        still.pole[*i] && !is_solid(*i) && lines.any(|(one, other)| meets(*i, one) && meets(*i, other))
    };
    let restored: Vec<usize> = still.others.iter().map(|i| *i as usize).filter(is_before).collect();
    restored.into_iter().for_each(|i| work.alpha[i] = 1.0);
}

/// What hardly reaches before the screen is no part of the object.
fn remove_what_lies_beside(work: &mut Workspace, width: usize, rect: &Rect, inside: &[bool]) {
    let solid = rect.mask(width, |i| work.alpha[i] > 0.02);
    let (labels, sizes) = components(&solid, rect.x.len());
    let mut before = vec![0_usize; sizes.len()];
    for (i, label) in rect.rows(width).flatten().zip(&labels) {
        before[*label as usize] += usize::from(inside[i]);
    }
    let is_beside = |(before, size): (&usize, &usize)| (*before as f32) < BEFORE_SHARE * *size as f32;
    let beside: Vec<bool> = before.iter().zip(&sizes).map(is_beside).collect();
    clear(work, width, rect, &labels, &beside);
}

/// Takes out what has these labels.
fn clear(work: &mut Workspace, width: usize, rect: &Rect, labels: &[u32], gone: &[bool]) {
    if !gone.contains(&true) {
        return;
    }
    for (i, label) in rect.rows(width).flatten().zip(labels) {
        if gone[*label as usize] {
            work.alpha[i] = 0.0;
        }
    }
}

/// Convex hull of the pixels that are surely screen (all of the picture where there are hardly any).
pub(crate) fn hull(screen: &[u8], width: usize) -> Vec<bool> {
    let solid = erode(screen, width, 3);
    let mut points: Vec<(i64, i64)> = Vec::new();
    for (y, row) in solid.chunks_exact(width).enumerate() {
        if let (Some(a), Some(b)) = (row.iter().position(|v| *v != 0), row.iter().rposition(|v| *v != 0)) {
            points.extend([(y as i64, a as i64), (y as i64, b as i64)]);
        }
    }
    if points.len() < 8 {
        return vec![true; screen.len()];
    }
    let turn =
        |o: (i64, i64), a: (i64, i64), b: (i64, i64)| (a.0 - o.0) * (b.1 - o.1) - (a.1 - o.1) * (b.0 - o.0);
    let chain = |side: i64| {
        let mut chain: Vec<(i64, i64)> = Vec::new();
        for &p in &points {
            // Of the two points of a row only the one on this side can lie on the chain.
            while chain.len() >= 2 && side * turn(chain[chain.len() - 2], chain[chain.len() - 1], p) >= 0 {
                chain.pop();
            }
            chain.push(p);
        }
        chain
    };
    let (left, right) = (chain(-1), chain(1));
    let mut inside = vec![false; screen.len()];
    for (y, row) in inside.chunks_exact_mut(width).enumerate() {
        if let (Some(a), Some(b)) = (at(&left, y as i64), at(&right, y as i64)) {
            let (a, b) = (a.min(b).floor().max(0.0) as usize, a.max(b).ceil() as usize);
            row[a..=b.min(width - 1)].fill(true);
        }
    }
    inside
}

/// Where a chain of points with rising rows crosses row `y`.
fn at(chain: &[(i64, i64)], y: i64) -> Option<f64> {
    let i = chain.windows(2).position(|w| w[0].0 <= y && y <= w[1].0)?;
    let (a, b) = (chain[i], chain[i + 1]);
    let t = if b.0 > a.0 { (y - a.0) as f64 / (b.0 - a.0) as f64 } else { 0.0 };
    Some(a.1 as f64 + t * (b.1 - a.1) as f64)
}

/// Foil mirrors the screen: an enclosed patch that looks like screen but not exactly like the screen at this place
/// is a part of the object.
fn close_reflections(work: &mut Workspace, width: usize, rect: &Rect, still: Option<&Still>) {
    let open = rect.mask(width, |i| work.alpha[i] < 0.5);
    let (w, h) = (rect.x.len(), rect.y.len());
    let (labels, sizes) = components(&open, w);
    let largest = HOLE_SHARE * work.alpha.len() as f32;
    let mut enclosed: Vec<bool> = sizes.iter().map(|s| *s > 0 && (*s as f32) < largest).collect();
    let top_and_bottom = (0..w).flat_map(|x| [x, (h - 1) * w + x]);
    for k in top_and_bottom.chain((0..h).flat_map(|y| [y * w, y * w + w - 1])) {
        enclosed[labels[k] as usize] = false;
    }
    if !enclosed.contains(&true) {
        return;
    }
    let (mut patches, deep) = (vec![Patch::default(); sizes.len()], erode(&open, w, 2));
    let seen = rect.rows(width).flatten().zip(labels.iter().zip(&deep));
    for (i, (label, deep)) in seen.filter(|(_, (label, _))| enclosed[**label as usize]) {
        let patch = &mut patches[*label as usize];
        patch.add(i % width, i / width, *deep != 0, work.share[i]);
        patch.seen += still.map_or(0.0, |s| if s.outside[i] { 0.0 } else { 1.0 });
        // The rim is mixed with the object and says nothing.
        if work.alpha[i] <= 0.02 {
            (0..3).for_each(|c| patch.image[c] += work.image[c][i]);
            (0..3).for_each(|c| patch.screen[c] += work.screen[c][i]);
            patch.pure += 1.0;
        }
    }
    let closed: Vec<bool> =
        patches.iter().zip(&enclosed).map(|(p, enclosed)| *enclosed && p.is_reflection(still)).collect();
    for (i, _) in rect.rows(width).flatten().zip(&labels).filter(|(_, label)| closed[**label as usize]) {
        work.alpha[i] = 1.0;
    }
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
    image: [f32; 3],
    screen: [f32; 3],
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

    fn is_reflection(&self, still: Option<&Still>) -> bool {
        if self.deep < SLIT_SHARE * self.size {
            let open = self.slenderness() > SLENDER && self.share > SLIT_SCREEN * self.size;
            return !open && self.pure >= HOLE_PIXELS && self.departure(0.0..f32::MAX) > SLIT_TOLERANCE;
        }
        let tolerance = match still {
            None => HOLE_TOLERANCE.1,
            Some(_) if self.seen > 0.5 * self.pure => HOLE_TOLERANCE.0,
            Some(_) => HOLE_TOLERANCE.2,
        };
        self.pure >= HOLE_PIXELS && self.departure(HOLE_LIGHT) > tolerance
    }

    /// Departure from the screen in the light, within limits, that fits best; share of its light.
    fn departure(&self, limits: std::ops::Range<f32>) -> f32 {
        let sum = |v: &[f32; 3]| v.iter().sum::<f32>().max(1e-9);
        let level = (sum(&self.image) / sum(&self.screen)).clamp(limits.start, limits.end);
        let difference = |c: usize| (self.image[c] - level * self.screen[c]).abs();
        (0..3).map(difference).sum::<f32>() / (level * sum(&self.screen))
    }
}

fn remove_specks(work: &mut Workspace, width: usize, rect: &Rect) {
    let solid = rect.mask(width, |i| work.alpha[i] > 0.02);
    let (labels, sizes) = components(&solid, rect.x.len());
    let largest = sizes.iter().copied().max().unwrap_or(0);
    let least = ((SPECK_SHARE * largest as f32) as usize).max(SPECK_PIXELS.min(largest));
    let mut small: Vec<bool> = sizes.iter().map(|s| (1..least).contains(s)).collect();
    if sizes.iter().zip(&small).any(|(s, small)| *small && *s >= SPECK_PIXELS) {
        // Rods whose foot is lost in shadow or blur.
        let large: Mask = labels.iter().map(|l| u8::from(*l != 0 && !small[*l as usize])).collect();
        for (label, near) in labels.iter().zip(&dilate(&large, rect.x.len(), PART_GAP)) {
            small[*label as usize] &= *near == 0 || sizes[*label as usize] < SPECK_PIXELS;
        }
    }
    clear(work, width, rect, &labels, &small);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rod_whose_foot_is_lost_stays_and_what_lies_apart_goes() {
        let (width, height) = (120, 90);
        let mut work = Workspace::default();
        work.alpha = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let body = (15..85).contains(&x) && (40..88).contains(&y);
                let (rod, far) = (x == 50 && (8..36).contains(&y), x == 110 && (8..36).contains(&y));
                let speck = x == 89 && (50..60).contains(&y);
                f32::from(u8::from(body || rod || far || speck))
            })
            .collect();
        remove_specks(&mut work, width, &Rect { x: 0..width, y: 0..height });
        let alpha = |x: usize, y: usize| work.alpha[y * width + x];
        assert_eq!([alpha(50, 20), alpha(40, 60)], [1.0; 2], "the rod four pixels above the body, the body");
        assert_eq!([alpha(110, 20), alpha(89, 55)], [0.0; 2], "a rod elsewhere, ten pixels near the body");
    }

    #[test]
    fn an_edge_aslant_goes_on_before_the_pole_and_specks_of_shadow_on_its_rim_do_not_count() {
        let (width, height) = (400, 400);
        for lies in [false, true] {
            let at = |u: usize, v: usize| if lies { u * width + v } else { v * width + u };
            let (mut work, mut still) = (Workspace::default(), Still { pole_lies: lies, ..Still::default() });
            let n = width * height;
            (still.width, still.outside) = (width, vec![false; n]);
            (work.alpha, still.pole, still.near_pole) = (vec![0.0; n], vec![false; n], vec![false; n]);
            // The object reaches down to a slanted edge, the pole up to row 20; both are seen in the other's place.
            let edge = |u: usize| 40.0 + 0.25 * (u as f32 - 40.0);
            for (u, v) in (0..80).flat_map(|u| (0..80).map(move |v| (u, v))) {
                still.pole[at(u, v)] = (36..43).contains(&u) && v >= 20;
                still.near_pole[at(u, v)] = (34..45).contains(&u) && v >= 18;
                let is_speck = u == 35 && v < 60;
                let is_object = (v as f32) < edge(u) || is_speck;
                work.alpha[at(u, v)] = f32::from(u8::from(is_object && !still.pole[at(u, v)]));
            }
            still.others = (0..n as u32).filter(|i| still.pole[*i as usize]).collect();
            restore_before_pole(&mut work, width, &still);
            for (u, v) in (36..43).flat_map(|u| (20..80).map(move |v| (u, v))) {
                let below = v as f32 - edge(u);
                if below.abs() > 2.5 {
                    assert_eq!(
                        work.alpha[at(u, v)],
                        f32::from(u8::from(below < 0.0)),
                        "{u}, {v}, lies: {lies}"
                    );
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
        let inside = hull(&screen, width);
        assert!(inside[30 * width + 40] && inside[20 * width + 20]);
        assert!(!inside[30 * width + 3] && !inside[2 * width + 40] && !inside[58 * width + 40]);
        assert!(hull(&vec![0; 4800], width).iter().all(|v| *v));
    }
}
