//! Closing a turn by photometric similarity. Camera and lamp stand still, so a whole turn later every pixel is what it was: of all that a video
//! shows, the first frames alone are as like the last ones as their neighbours are. How unlike pictures are grows with the angle between
//! them; the angle across the loop closure is the one at which the pairs across it lie on the same curve as the pairs on either side. Nothing
//! is followed or matched, so it works on thin and shiny objects too. At other places of the same video, where nothing is missing, the
//! same search says how exact it is.

use crate::solvers::linalg::solve_spd;
use crate::statistics::median;
use scene::Film;

/// Pictures up to so far from the loop closure are compared, and pairs up to so far apart (radians, but at least so many steps).
const SIDE: (f64, f64) = (0.23, 7.0);
const PAIR: (f64, f64) = (0.175, 6.0);
/// Pairs farther apart than this are not compared, however few frames there are, radians.
const FARTHEST: f64 = 0.5;
/// Most pictures on either side.
const MOST: usize = 14;
/// How far the angles may miss a whole turn, radians.
const SPAN: f64 = 0.26;
/// Places at which the search is tried where nothing is missing.
const TRIALS: usize = 24;
/// Largest share of them that may go astray (by more than this many deviations), and the largest deviation, in steps.
const ASTRAY: (f64, f64) = (0.25, 6.0);
const LARGEST: f64 = 0.3;
/// A loop closure fits at most so many times worse than the median of these places.
const WORSE: f64 = 4.0;
/// Least deviation that is believed, steps.
const LEAST: f64 = 0.03;
/// Fewest pairs across the loop closure; a sixth of those beside it at least, or what hardly overlaps would fit best.
const FEWEST: usize = 6;
/// Terms of the curve: noise, slope, bend, turn.
const TERMS: usize = 4;

/// What a whole turn of the film says of the angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhotometricClosure {
    /// By how much the angles say too much of a turn, radians.
    pub excess: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Compares the two ends of a whole turn. `angle`: what the model says for a time, radians, rising. `None` where there is no whole
/// turn, where photometric similarity does not tell places of this film apart, or where something else changed between its ends.
pub(crate) fn excess(film: &Film, angle: impl Fn(f64) -> Option<f64>) -> Option<PhotometricClosure> {
    let strip = Strip::read(film, angle)?;
    let (first, last) = (*strip.angles.first()?, *strip.angles.last()?);
    // Of more frames than are compared only some are taken.
    let step = ((last - first) / (strip.angles.len() - 1) as f64).max(SIDE.0 / MOST as f64);
    let pair = PAIR.0.max(PAIR.1 * step);
    if pair > FARTHEST || last - first < std::f64::consts::TAU - pair {
        return None;
    }
    let search = GapSearch { strip: &strip, side: SIDE.0.max(SIDE.1 * step), pair, step };
    let ends = (first + 2.0 * search.side, last - 2.0 * search.side);
    let places = (0..TRIALS).map(|k| ends.0 + (ends.1 - ends.0) * k as f64 / (TRIALS - 1) as f64);
    let trials: Vec<GapEstimate> = places.filter_map(|a| search.at(a, a, 0.0)).collect();
    let deviation = 1.4826 * median(trials.iter().map(|t| t.excess.abs()).collect());
    let sigma = deviation.max(LEAST * step);
    let astray = trials.iter().filter(|t| t.excess.abs() > ASTRAY.1 * sigma).count();
    if 2 * trials.len() < TRIALS || astray as f64 > ASTRAY.0 * trials.len() as f64 || sigma > LARGEST * step {
        return None;
    }
    let turn = std::f64::consts::TAU;
    let rough = search.at(last, first.max(last - turn), turn)?.excess;
    // Again, with the frames that are found to be the neighbours.
    let found = search.at(last, first.max(last - turn - rough), turn)?;
    let usual = median(trials.iter().map(|t| t.misfit).collect());
    let fits = found.misfit < WORSE * usual && found.excess.abs() < 0.95 * SPAN && !found.rim;
    fits.then_some(PhotometricClosure { excess: found.excess, sigma })
}

/// Slightly blurred pictures of all frames that have an angle, rising.
struct Strip {
    pictures: Vec<u8>,
    size: (usize, usize),
    angles: Vec<f64>,
}

impl Strip {
    fn read(film: &Film, angle: impl Fn(f64) -> Option<f64>) -> Option<Self> {
        let picture = image::open(&film.path).ok()?.into_luma8();
        let (width, frames) = (film.width as usize, film.times_s.len());
        let height = film.height as usize;
        let bytes = width * height;
        if bytes == 0 || picture.width() as usize != width || picture.height() as usize != height * frames {
            return None;
        }
        let all = picture.into_raw();
        let mut strip = Self { pictures: Vec::new(), size: (width, height), angles: Vec::new() };
        for (picture, time) in all.chunks_exact(bytes).zip(&film.times_s) {
            let Some(a) = angle(*time).filter(|a| strip.angles.last().is_none_or(|l| a > l)) else {
                continue;
            };
            strip.pictures.extend_from_slice(picture);
            strip.angles.push(a);
        }
        (strip.angles.len() > 2).then_some(strip)
    }

    /// One picture, smoothed by (1, 2, 1) / 4 in both directions.
    fn smooth(&self, i: usize) -> Vec<f32> {
        let (w, h) = self.size;
        let p = &self.pictures[i * w * h..(i + 1) * w * h];
        let at = |x: usize, y: usize| f32::from(p[y * w + x]);
        let row =
            |x: usize, y: usize| at(x.saturating_sub(1), y) + 2.0 * at(x, y) + at((x + 1).min(w - 1), y);
        let both = |k: usize| {
            let (x, y) = (k % w, k / w);
            (row(x, y.saturating_sub(1)) + 2.0 * row(x, y) + row(x, (y + 1).min(h - 1))) / 16.0
        };
        (0..w * h).map(both).collect()
    }

    /// At most [`MOST`] frames with angles in a range, evenly chosen.
    fn within(&self, from: f64, to: f64) -> Vec<usize> {
        let a = self.angles.partition_point(|v| *v < from - 1e-9);
        let b = self.angles.partition_point(|v| *v <= to + 1e-9);
        (a..b).step_by((b - a).div_ceil(MOST).max(1)).collect()
    }
}

/// Root mean square difference of two pictures, levels.
fn unlike(a: &[f32], b: &[f32]) -> f64 {
    let part = |(a, b): (&[f32], &[f32])| -> f64 {
        f64::from(a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>())
    };
    (a.chunks(256).zip(b.chunks(256)).map(part).sum::<f64>() / a.len().max(1) as f64).sqrt()
}

/// What a search found: by how much the angles say too much, how badly that fits, and whether frames farther on cannot be compared.
struct GapEstimate {
    excess: f64,
    misfit: f64,
    rim: bool,
}

/// Pairs are (angle between, how unlike).
struct GapSearch<'a> {
    strip: &'a Strip,
    side: f64,
    pair: f64,
    step: f64,
}

impl GapSearch<'_> {
    /// The frames up to `end` and those from `start` on, which by the model follow `turn` later: by how much their angles say too much,
    /// and how badly the best fits.
    fn at(&self, end: f64, start: f64, turn: f64) -> Option<GapEstimate> {
        let before = self.strip.within(end - self.side, end);
        let from = if turn > 0.0 { start } else { start + 1e-6 };
        let after: Vec<usize> = self
            .strip
            .within(from, start + self.side)
            .into_iter()
            .filter(|i| turn > 0.0 || !before.contains(i))
            .collect();
        let pictures = |of: &[usize]| -> Vec<Vec<f32>> { of.iter().map(|&i| self.strip.smooth(i)).collect() };
        let (a, b) = (pictures(&before), pictures(&after));
        let angle = |i: &usize| self.strip.angles[*i];
        let mut near: Vec<(f64, f64)> = Vec::new();
        for (of, images) in [(&before, &a), (&after, &b)] {
            for i in 0..of.len() {
                for k in i + 1..of.len() {
                    near.push((angle(&of[k]) - angle(&of[i]), unlike(&images[i], &images[k])));
                }
            }
        }
        near.retain(|p| p.0 <= self.pair);
        let mut across = Vec::new();
        for (i, x) in before.iter().zip(&a) {
            across.extend(after.iter().zip(&b).map(|(k, y)| (angle(k) + turn - angle(i), unlike(x, y))));
        }
        let cost = |s: f64| self.misfit(&near, across.iter().map(|(x, y)| ((x + s).abs(), *y)));
        let mut best = least(-SPAN, SPAN, self.step / 16.0, cost)?;
        best = least(best.0 - self.step / 10.0, best.0 + self.step / 10.0, self.step / 200.0, cost)?;
        // At the rim of what can be compared the best lies beyond it.
        let rim = cost(best.0 + 0.5 * self.step).is_none();
        Some(GapEstimate { excess: best.0, misfit: best.1, rim })
    }

    /// Mean square of the relative distances from the curve that fits best, over the slope of the curve.
    fn misfit(&self, near: &[(f64, f64)], across: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
        let mut all = near.to_vec();
        all.extend(across.filter(|p| p.0 <= self.pair));
        if all.len() < near.len() + FEWEST.max(near.len() / 6) || near.len() < 2 * TERMS {
            return None;
        }
        let soft = 0.2 * self.step / self.pair;
        let terms = |x: f64| [1.0, x, x * x, x * x * x];
        let (mut normal, mut right) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for (x, y) in &mut all {
            *x /= self.pair;
            let (t, w) = (terms(*x), (*x + soft).powi(-2));
            for i in 0..TERMS {
                right[i] += w * t[i] * *y;
                (0..TERMS).for_each(|k| normal[i][k] += w * t[i] * t[k]);
            }
        }
        (0..TERMS).for_each(|i| normal[i][i] *= 1.0 + 1e-9);
        let curve = solve_spd(&normal, &right)?;
        let off = |(x, y): &(f64, f64)| {
            let t = terms(*x);
            let value: f64 = (0..TERMS).map(|i| curve[i] * t[i]).sum();
            ((y - value) / (x + soft)).powi(2)
        };
        (curve[1] > 0.0).then(|| all.iter().map(off).sum::<f64>() / (all.len() as f64 * curve[1] * curve[1]))
    }
}

/// Where a cost is least on a grid, and that cost.
fn least(from: f64, to: f64, spacing: f64, cost: impl Fn(f64) -> Option<f64>) -> Option<(f64, f64)> {
    let steps = ((to - from) / spacing).round() as usize;
    let values = (0..=steps).filter_map(|k| {
        let s = from + spacing * k as f64;
        Some((s, cost(s)?))
    });
    values.min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const SIZE: (usize, usize) = (64, 40);

    /// `frames` pictures of bright spots on a drum, `step` apart, `lamp` by frame; in a file of the test's own.
    fn film(name: &str, frames: usize, step: f64, lamp: impl Fn(usize) -> f64) -> Film {
        use rand::Rng;
        let mut r = scene::rng::rng(1, name, 0);
        let spots: Vec<[f64; 4]> =
            (0..60).map(|_| std::array::from_fn(|_| r.random_range(0.0..1.0))).collect();
        let mut pixels = Vec::new();
        for frame in 0..frames {
            let mut sum = vec![20.0; SIZE.0 * SIZE.1];
            for [phase, height, radius, bright] in &spots {
                let a = TAU * phase + step * frame as f64;
                let (x, y) = (32.0 + (10.0 + 16.0 * radius) * a.sin(), 4.0 + 32.0 * height);
                for (k, v) in sum.iter_mut().enumerate() {
                    let (dx, dy) = ((k % SIZE.0) as f64 - x, (k / SIZE.0) as f64 - y);
                    *v += 90.0 * bright * a.cos().max(0.0) * (-(dx * dx + dy * dy) / 6.0).exp();
                }
            }
            pixels.extend(
                sum.iter().map(|v| (lamp(frame) * v + r.random_range(-2.0..2.0)).clamp(0.0, 255.0) as u8),
            );
        }
        let path = std::env::temp_dir().join(format!("sat-recon-{name}-{}.png", std::process::id()));
        let (width, height) = (SIZE.0 as u32, SIZE.1 as u32);
        image::GrayImage::from_raw(width, height * frames as u32, pixels).unwrap().save(&path).unwrap();
        let times_s = (0..frames).map(|i| i as f64).collect();
        Film { path, width, height, times_s }
    }

    #[test]
    fn what_the_angles_say_too_much_of_a_turn_is_seen_and_how_well() {
        let step = TAU / 200.0;
        for (frames, share) in [(200, 0.98), (200, 1.0), (200, 1.015), (230, 1.01), (199, 1.0)] {
            let film = film(&format!("film-{frames}"), frames, step, |_| 1.0);
            let found = excess(&film, |t| Some(share * step * t)).unwrap();
            let truth = TAU * (share - 1.0);
            assert!(
                (found.excess - truth).abs() < 4.0 * found.sigma,
                "{frames} {share}: {found:?} for {truth}"
            );
            assert!(found.sigma < 0.2 * step, "{found:?}");
            std::fs::remove_file(&film.path).unwrap();
        }
    }

    #[test]
    fn a_gap_too_wide_to_compare_across_is_no_smaller_one() {
        let step = TAU / 200.0;
        for frames in [194, 195, 196, 197] {
            let film = film(&format!("film-gap-{frames}"), frames, step, |_| 1.0);
            let found = excess(&film, |t| Some(step * t));
            assert!(found.is_none_or(|f| f.excess.abs() < 4.0 * f.sigma), "{frames}: {found:?}");
            std::fs::remove_file(&film.path).unwrap();
        }
    }

    #[test]
    fn it_says_nothing_where_nothing_is_to_be_seen() {
        let step = TAU / 200.0;
        let angle = |t: f64| Some(step * t);
        let whole = film("film-lamp", 200, step, |i| if i > 150 { 0.6 } else { 1.0 });
        assert_eq!(excess(&whole, angle), None, "the lamp was turned down");
        let part = film("film-part", 170, step, |_| 1.0);
        assert_eq!(excess(&part, angle), None, "not a whole turn");
        let dark = film("film-dark", 200, step, |_| 0.0);
        assert_eq!(excess(&dark, angle), None, "black");
        assert_eq!(excess(&whole, |_| None), None, "no angles");
        assert_eq!(excess(&whole, |_| Some(0.3)), None, "no motion");
        assert_eq!(excess(&whole, |t| Some(f64::NAN * t)), None, "not a number");
        assert_eq!(excess(&Film { height: 41, ..whole.clone() }, angle), None, "another size");
        std::fs::write(&part.path, b"no picture").unwrap();
        assert_eq!(excess(&part, angle), None, "not a picture");
        for film in [&whole, &part, &dark] {
            std::fs::remove_file(&film.path).unwrap();
        }
        assert_eq!(excess(&whole, angle), None, "no file");
    }
}
