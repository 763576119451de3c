//! What a matte looks like as a whole: the screen's outline, garbage beside it, still things,
//! specks.

use super::morphology::{Rect, Regions, hull};
use super::pool::Raster;
use super::screen::clean_plate::CleanPlate;
use super::solve::Matte;
use super::trimap::Trimap;

/// What counts as a speck.
pub(super) struct SpeckRules {
    /// Objects smaller than this share of the largest are specks.
    /// Source: chosen by hand, never measured.
    pub(super) share: f32,
    /// They are also smaller than this, pixels. Source: docs/decisions/04 (rods of case 4).
    pixels: usize,
    /// Others so near to a large one are parts of it, pixels.
    /// Source: docs/decisions/04: rods kept on case 4 0.984 -> 0.997.
    part_gap: usize,
}

/// See [`SpeckRules`].
pub(super) const SPECKS: SpeckRules = SpeckRules { share: 0.01, pixels: 24, part_gap: 8 };

/// Cleans the matte in place; all that is done is done in the rectangle around what is not 0.
pub(crate) fn clean(matte: &mut Matte, trimap: &Trimap, plate: Option<&CleanPlate>, keep_pole: bool) {
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
    remove_specks(&mut matte.alpha, &rect);
}

/// What is seen on both sides of the pole, in some direction across it, is seen before it too.
fn restore_before_pole(alpha: &mut [f32], plate: &CleanPlate) {
    let pole = plate.others.iter().map(|i| *i as usize).filter(|i| plate.pole[*i] && alpha[*i] <= 0.5);
    let restored: Vec<usize> = pole
        .filter(|i| {
            let mut across = [(1, 0), (2, 1), (2, -1), (4, 1), (4, -1)]
                .iter()
                .map(|&(u, v)| if plate.pole_lies { (v, u) } else { (u, v) });
            across.any(|(dx, dy)| {
                meets_object(alpha, plate, *i, (dx, dy)) && meets_object(alpha, plate, *i, (-dx, -dy))
            })
        })
        .collect();
    restored.into_iter().for_each(|i| alpha[i] = 1.0);
}

/// Whether a line from a pixel of the pole meets the object on one side. Straight across, the
/// object may end on the pole's rim; aslant it has to reach beyond: there are specks of shadow on
/// the rim, and a line through two of them runs far along the pole.
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

/// Gives all pixels of some regions of the rectangle this alpha.
fn fill(alpha: &mut Raster<f32>, rect: &Rect, regions: &Regions, chosen: &[bool], value: f32) {
    if !chosen[1..].contains(&true) {
        return;
    }
    for (i, label) in rect.rows(alpha.width).flatten().zip(regions.labels.iter()) {
        if *label != 0 && chosen[*label as usize] {
            alpha[i] = value;
        }
    }
}

fn remove_specks(alpha: &mut Raster<f32>, rect: &Rect) {
    let regions = Regions::of(&rect.mask(alpha, |a| a > 0.0));
    let (largest, sizes) = (regions.largest(), &regions.sizes);
    let least = ((SPECKS.share * largest as f32) as usize).max(SPECKS.pixels.min(largest));
    let mut small: Vec<bool> = sizes.iter().map(|s| (1..least).contains(s)).collect();
    if sizes.iter().zip(&small).any(|(s, small)| *small && *s >= SPECKS.pixels) {
        // Rods whose foot is lost in shadow or blur.
        let near_large = regions.labels.mask(|l| l != 0 && !small[l as usize]).dilate(SPECKS.part_gap);
        let is_near = regions.any(|k| near_large[k] != 0);
        for (k, small) in small.iter_mut().enumerate() {
            *small &= !is_near[k] || sizes[k] < SPECKS.pixels;
        }
    }
    fill(alpha, rect, &regions, &small, 0.0);
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
            // The object reaches down to a slanted edge, the pole up to row 20; both are seen in
            // the other's place.
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
}
