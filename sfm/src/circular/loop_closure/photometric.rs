//! Closing a turn by photometric similarity. Camera and lamp stand still, so a whole turn later
//! every pixel is what it was: of all that a video shows, the first frames alone are as like the
//! last ones as their neighbours are. How unlike pictures are grows with the angle between them;
//! the angle across the loop closure is the one at which the pairs across it lie on the same curve
//! as the pairs on either side. Nothing is followed or matched, so it works on thin and shiny
//! objects too. At other places of the same video, where nothing is missing, the same search says
//! how exact it is (docs/decisions/10).

use crate::circular::limits::{COMPARABLE, LEAST_OBSERVATIONS, NEARBY};
use crate::limits::OUTLIER_SIGMAS;
use crate::solvers::linalg::solve_spd;
use crate::statistics::{MEDIAN_DEVIATION, median};
use scene::Film;
use std::f64::consts::TAU;

/// And at least so many steps; twice as many pictures at most.
/// Source: derived; a step or two less are twice as many pairs as the curve has terms.
const SIDE_STEPS: usize = 7;
/// Terms of the curve: noise, slope, bend, turn.
/// Source: derived; a cubic in the angle.
const TERMS: usize = 4;
/// Places at which the search is tried where nothing is missing.
/// Source: docs/decisions/10.
const TRIALS: usize = 24;
/// Largest deviation of the search that is of use, steps; the least that is believed is a tenth.
/// Source: docs/decisions/10, 0.05 to 0.15 degrees at steps of 1.7.
const LARGEST: f64 = 0.3;
/// A loop closure fits at most so many times worse than the median of these places.
/// Source: docs/decisions/10.
const WORSE: f64 = 4.0;

/// What a whole turn of the film says of the angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhotometricClosure {
    /// By how much the angles say too much of a turn, radians.
    pub excess: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Compares the two ends of a whole turn. `angle`: what the model says for a time, radians, rising.
/// `None` where there is no whole turn, where photometric similarity does not tell places of this
/// film apart, or where something else changed between its ends.
pub(crate) fn excess(film: &Film, angle: impl Fn(f64) -> Option<f64>) -> Option<PhotometricClosure> {
    let strip = Strip::read(film, angle)?;
    let (first, last) = (*strip.angles.first()?, *strip.angles.last()?);
    // Of more frames than are compared only some are taken.
    let step = ((last - first) / (strip.angles.len() - 1) as f64).max(NEARBY / (2 * SIDE_STEPS) as f64);
    let pair = (0.75 * NEARBY).max((SIDE_STEPS - 1) as f64 * step);
    if pair > COMPARABLE || last - first < TAU - pair {
        return None;
    }
    let search = GapSearch { strip: &strip, side: NEARBY.max(SIDE_STEPS as f64 * step), pair, step };
    let (sigma, usual) = search.accuracy(first, last)?;
    let rough = search.at(last, first.max(last - TAU), TAU)?.excess;
    // Again, with the frames that are found to be the neighbours.
    let found = search.at(last, first.max(last - TAU - rough), TAU)?;
    let fits = found.misfit < WORSE * usual && found.excess.abs() < 0.95 * NEARBY && !found.rim;
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
        let picture = &self.pictures[i * w * h..(i + 1) * w * h];
        let mut across = Vec::with_capacity(w * h);
        for row in picture.chunks_exact(w) {
            for x in 0..w {
                let [a, b, c] = [x.saturating_sub(1), x, (x + 1).min(w - 1)].map(|x| f32::from(row[x]));
                across.push(a + 2.0 * b + c);
            }
        }
        let mut both = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let [a, b, c] = [y.saturating_sub(1), y, (y + 1).min(h - 1)].map(|y| across[y * w + x]);
                both.push((a + 2.0 * b + c) / 16.0);
            }
        }
        both
    }

    /// Some frames with angles in a range, evenly chosen.
    fn within(&self, from: f64, to: f64) -> Vec<usize> {
        let a = self.angles.partition_point(|v| *v < from - 1e-9);
        let b = self.angles.partition_point(|v| *v <= to + 1e-9);
        (a..b).step_by((b - a).div_ceil(2 * SIDE_STEPS).max(1)).collect()
    }
}

/// Root mean square difference of two pictures, levels.
fn unlike(a: &[f32], b: &[f32]) -> f64 {
    let mut sum = 0.0;
    for (a, b) in a.chunks(256).zip(b.chunks(256)) {
        sum += f64::from(a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>());
    }
    (sum / a.len().max(1) as f64).sqrt()
}

/// What a search found: by how much the angles say too much, how badly that fits, and whether
/// frames farther on cannot be compared.
struct GapEstimate {
    excess: f64,
    misfit: f64,
    rim: bool,
}

/// Two pictures: the angle between them, and how unlike they are.
type PicturePair = (f64, f64);

/// How the ends of a turn are compared: over which side, pairs and steps, radians.
struct GapSearch<'a> {
    strip: &'a Strip,
    side: f64,
    pair: f64,
    step: f64,
}

impl GapSearch<'_> {
    /// Standard deviation of what is found where nothing is missing, and the median misfit there;
    /// `None` where the search goes astray.
    fn accuracy(&self, first: f64, last: f64) -> Option<(f64, f64)> {
        let ends = (first + 2.0 * self.side, last - 2.0 * self.side);
        let places = (0..TRIALS).map(|k| ends.0 + (ends.1 - ends.0) * k as f64 / (TRIALS - 1) as f64);
        let trials: Vec<GapEstimate> = places.filter_map(|a| self.at(a, a, 0.0)).collect();
        let deviation = median(trials.iter().map(|t| t.excess.abs()).collect()) / MEDIAN_DEVIATION;
        let sigma = deviation.max(LARGEST / 10.0 * self.step);
        let astray = trials.iter().filter(|t| t.excess.abs() > OUTLIER_SIGMAS * sigma).count();
        let is_of_use = 2 * trials.len() >= TRIALS && 4 * astray <= trials.len();
        (is_of_use && !(sigma > LARGEST * self.step))
            .then(|| (sigma, median(trials.iter().map(|t| t.misfit).collect())))
    }

    /// The frames up to `end` and those from `start` on, which by the model follow `turn` later: by
    /// how much their angles say too much, and how badly the best fits.
    fn at(&self, end: f64, start: f64, turn: f64) -> Option<GapEstimate> {
        let before = self.strip.within(end - self.side, end);
        let from = if turn > 0.0 { start } else { start + 1e-6 };
        let mut after = self.strip.within(from, start + self.side);
        after.retain(|i| turn > 0.0 || !before.contains(i));
        let [a, b] = [&before, &after].map(|of| self.pictures(of));
        let mut near = pairs_within(&a);
        near.extend(pairs_within(&b));
        near.retain(|p| p.0 <= self.pair);
        let mut across = Vec::new();
        for (x, image) in &a {
            across.extend(b.iter().map(|(y, other)| (y + turn - x, unlike(image, other))));
        }
        let mut best = self.least(-NEARBY, NEARBY, self.step / 16.0, &near, &across)?;
        let around = self.step / 10.0;
        best = self.least(best.0 - around, best.0 + around, self.step / 200.0, &near, &across)?;
        // At the rim of what can be compared the best lies beyond it.
        let rim = self.misfit(&near, &across, best.0 + 0.5 * self.step).is_none();
        Some(GapEstimate { excess: best.0, misfit: best.1, rim })
    }

    /// Angles and smoothed pictures of some frames.
    fn pictures(&self, frames: &[usize]) -> Vec<(f64, Vec<f32>)> {
        frames.iter().map(|&i| (self.strip.angles[i], self.strip.smooth(i))).collect()
    }

    /// The shift of the angles across at which the misfit is least on a grid, and that misfit.
    fn least(
        &self,
        from: f64,
        to: f64,
        spacing: f64,
        near: &[PicturePair],
        across: &[PicturePair],
    ) -> Option<(f64, f64)> {
        let steps = ((to - from) / spacing).round() as usize;
        let shifts = (0..=steps).map(|k| from + spacing * k as f64);
        let values = shifts.filter_map(|s| Some((s, self.misfit(near, across, s)?)));
        values.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Mean square of the relative distances from the curve that fits best, over the slope of the
    /// curve, with the angles across shifted.
    fn misfit(&self, near: &[PicturePair], across: &[PicturePair], shift: f64) -> Option<f64> {
        let shifted = across.iter().map(|(x, y)| ((x + shift).abs(), *y)).filter(|p| p.0 <= self.pair);
        let mut all: Vec<PicturePair> = near.iter().copied().chain(shifted).collect();
        // What hardly overlaps would fit best.
        if all.len() < near.len() + LEAST_OBSERVATIONS.max(near.len() / 6) || near.len() < 2 * TERMS {
            return None;
        }
        let soft = 0.2 * self.step / self.pair;
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
        let mut sum = 0.0;
        for (x, y) in &all {
            let t = terms(*x);
            let value: f64 = (0..TERMS).map(|i| curve[i] * t[i]).sum();
            sum += ((y - value) / (x + soft)).powi(2);
        }
        (curve[1] > 0.0).then(|| sum / (all.len() as f64 * curve[1] * curve[1]))
    }
}

/// Powers of an angle.
fn terms(x: f64) -> [f64; TERMS] {
    [1.0, x, x * x, x * x * x]
}

/// All pairs of some pictures.
fn pairs_within(pictures: &[(f64, Vec<f32>)]) -> Vec<PicturePair> {
    let mut pairs = Vec::new();
    for (i, (a, image)) in pictures.iter().enumerate() {
        pairs.extend(pictures[i + 1..].iter().map(|(b, other)| (b - a, unlike(image, other))));
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const SIZE: (usize, usize) = (64, 40);

    /// `frames` pictures of bright spots on a drum, `step` apart, `lamp` by frame; in a file of the
    /// test's own.
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
