//! A first turn from a few frames of a video, without poses: axis, focal length and rate that
//! explain the motion of the tracks between key frames. A coarse search over all directions, then
//! adjustment of the epipolar error (no points).

use crate::circular::limits::RATE_CHANGE;
use crate::circular::motion::wrap_angle;
use crate::incremental::resection::FOCAL_FACTORS;
use crate::knowledge::Knowledge;
use crate::plausibility::camera_prior::FOCAL_LOG_SIGMA;
use crate::solvers::levenberg::{Normal, cauchy, minimise};
use crate::solvers::linalg::skew;
use crate::solvers::sampson_sq;
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::Camera;

/// Most key frames of a seed.
/// Source: chosen by hand, never measured.
pub(crate) const KEYS: usize = 7;
/// Unknowns: rotation of (axis, place), focal length, angles after the first.
/// Source: derivation, 3 + 1 + (KEYS - 1).
const UNKNOWNS: usize = 3 + KEYS;
/// Directions on the half sphere that are tried: about 11 degrees apart.
/// Source: chosen by hand, never measured.
const DIRECTIONS: usize = 160;
/// Width of the robust loss in the search and as the adjustment begins, and as it ends, pixels.
/// Source: chosen by hand, never measured.
const WIDTHS_PX: [f64; 2] = [2.0, 0.7];
/// Seeds that are adjusted; a fifth of them may share a focal length, a quarter of them is
/// returned.
/// Source: chosen by hand, never measured.
const ADJUSTED: usize = 16;
/// Seeds are alike if their axes, with the same sense of rotation, are closer than this (cosine).
/// Source: chosen by hand, never measured.
const ALIKE: f64 = 0.97;
/// Step of the forward differences, radians or of the logarithm of the focal length.
/// Source: chosen by hand, never measured.
const H: f64 = 1e-6;

/// Angles of key frames that are tried.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AnglePattern {
    /// Key frames of a video at a constant rate.
    Video,
    /// Neighbouring photos of a ring at a constant step.
    Ring,
    /// Three photos whose order is not known.
    Triple,
}

impl AnglePattern {
    /// Angles by key frame, radians, in both senses. Source of the steps: chosen by hand, never
    /// measured.
    pub(crate) fn angles(self) -> Vec<[f64; KEYS]> {
        let steps_deg: &[f64] = match self {
            Self::Video => &[1.5, 2.5, 4.0, 5.5, 7.5, 10.0, 13.5, 18.0],
            Self::Ring => &[3.0, 4.5, 6.0, 8.0, 10.0, 12.5, 15.0, 20.0, 30.0],
            Self::Triple => &[4.5, 8.0, 12.0, 17.0, 24.0, 34.0],
        };
        let steps: Vec<f64> = steps_deg.iter().flat_map(|s| [s.to_radians(), -s.to_radians()]).collect();
        match self {
            Self::Triple => {
                let both = steps.iter().flat_map(|a| steps.iter().map(move |b| [*a, *b]));
                let apart = both.filter(|[a, b]| (a + b).abs() > 0.02);
                apart.map(|[a, b]| [0.0, a, a + b, 0.0, 0.0, 0.0, 0.0]).collect()
            }
            _ => steps.iter().map(|s| std::array::from_fn(|k| s * k as f64)).collect(),
        }
    }
}

/// Focal lengths that a search for a turn begins with.
pub(crate) struct FocalSearch {
    /// Lengths that are tried, pixels.
    pub tried: Vec<f64>,
    /// The one to be near to, pixels.
    pub guess: f64,
    /// It is known and stays as it is.
    pub is_known: bool,
}

impl FocalSearch {
    /// About the focal length of a camera, as far as it is not known.
    pub(crate) fn new(camera: &Camera, known: &Knowledge) -> Self {
        Self::about(camera.mean_focal(), known.fixed || known.focal_sigma.is_some())
    }

    /// About a guess, pixels.
    pub(crate) fn about(guess: f64, is_known: bool) -> Self {
        let tried = if is_known { vec![guess] } else { FOCAL_FACTORS.iter().map(|f| f * guess).collect() };
        Self { tried, guess, is_known }
    }
}

/// Matches of two key frames: ideal pixels from the principal point.
#[derive(Clone, Debug)]
pub(crate) struct KeyPair {
    /// Which key frames, from 0.
    pub keys: [usize; 2],
    /// The same points in both.
    pub points: Vec<[DVec2; 2]>,
}

impl KeyPair {
    /// Every so many-th match, so that at most `most` are left.
    fn thin(&self, most: usize) -> Self {
        let step = self.points.len().div_ceil(most).max(1);
        Self { keys: self.keys, points: self.points.iter().step_by(step).copied().collect() }
    }

    /// Robust epipolar error of a seed, pixels².
    fn cost(&self, seed: &Seed) -> f64 {
        let f = seed.between(self.keys);
        self.points.iter().map(|[u, v]| cauchy(sampson_sq(&f, *u, *v), WIDTHS_PX[0]).0).sum::<f64>()
    }
}

/// A hypothesis.
#[derive(Clone, Debug)]
pub(crate) struct Seed {
    /// Takes z to the axis and x to the direction of the axis' point nearest to the camera, camera
    /// frame.
    frame: DQuat,
    /// Focal length, pixels.
    pub focal: f64,
    /// Angle of each key frame, radians; the first is 0.
    pub angles: [f64; KEYS],
    /// Robust cost.
    pub cost: f64,
}

impl Seed {
    /// Direction of the axis.
    pub(crate) fn direction(&self) -> DVec3 {
        self.frame * DVec3::Z
    }

    /// Direction of its point nearest to the camera.
    pub(crate) fn place(&self) -> DVec3 {
        self.frame * DVec3::X
    }

    /// The cameras with the seed's focal length in the first one, where that is not known.
    pub(crate) fn cameras(&self, cameras: &[Camera], known: &Knowledge) -> Vec<Camera> {
        let mut cameras = cameras.to_vec();
        if !known.fixed {
            let focals = cameras[0].model.num_focals();
            cameras[0].params[..focals].fill(self.focal);
        }
        cameras
    }

    /// `F` of ideal pixels for a turn by `angle` (radians): `t = (I − R) t₀ ∝ sin(θ/2) t₀ −
    /// cos(θ/2) a × t₀`, which stays finite as the angle vanishes.
    pub(crate) fn fundamental(&self, angle: f64) -> DMat3 {
        let (a, t0) = (self.direction(), self.place());
        let (s, c) = (0.5 * angle).sin_cos();
        let e = skew(t0 * s - a.cross(t0) * c) * DMat3::from_axis_angle(a, angle);
        let inverse = DMat3::from_diagonal(DVec3::new(1.0 / self.focal, 1.0 / self.focal, 1.0));
        inverse * e * inverse
    }

    /// The same between two key frames.
    fn between(&self, keys: [usize; 2]) -> DMat3 {
        self.fundamental(self.angles[keys[1]] - self.angles[keys[0]])
    }

    /// Direction of the axis with the sense of rotation.
    fn sense(&self) -> DVec3 {
        self.direction() * wrap_angle(self.angles[1]).signum()
    }

    fn is_sane(&self) -> bool {
        self.cost.is_finite() && self.place().z > 0.0 && self.angles.iter().all(|a| a.abs() < 4.0)
    }

    /// The seed after a step of the adjustment.
    fn step(&self, step: &[f64; UNKNOWNS]) -> Self {
        let mut next = self.clone();
        let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
        next.frame = (turn * self.frame).normalize();
        next.focal = self.focal * step[3].clamp(-1.0, 1.0).exp();
        for (angle, d) in next.angles[1..].iter_mut().zip(&step[4..]) {
            *angle += d;
        }
        next
    }
}

/// Share of the matches that the seed explains to the wider loss.
pub(crate) fn explained_share(pairs: &[KeyPair], seed: &Seed) -> f64 {
    let (mut good, mut all) = (0usize, 0usize);
    for pair in pairs {
        let f = seed.between(pair.keys);
        good += pair.points.iter().filter(|[u, v]| sampson_sq(&f, *u, *v) < WIDTHS_PX[0].powi(2)).count();
        all += pair.points.len();
    }
    good as f64 / all.max(1) as f64
}

/// The best hypotheses that differ, best first, over `keys` key frames. `patterns`: angles to try,
/// radians.
pub(crate) fn seeds(
    pairs: &[KeyPair],
    keys: usize,
    patterns: &[[f64; KEYS]],
    focal: &FocalSearch,
) -> Vec<Seed> {
    let count = 2 * pairs.iter().map(|p| p.points.len()).sum::<usize>();
    if count < 40 || keys < 3 {
        return Vec::new();
    }
    let centre = pairs.iter().flat_map(|p| p.points.iter().flatten()).sum::<DVec2>() / count as f64;
    let sampled: Vec<KeyPair> = pairs.iter().map(|p| p.thin(40)).collect();
    let of_focals = focal.tried.iter().map(|f| search(&sampled, patterns, *f, centre));
    let mut found: Vec<Seed> = of_focals.flat_map(|seeds| different(seeds, ADJUSTED / 5)).collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found.truncate(ADJUSTED);
    let pairs: Vec<KeyPair> = pairs.iter().map(|p| p.thin(120)).collect();
    let problem = SeedProblem { pairs: &pairs, keys, focal, holds_angles: false };
    different(found.into_iter().map(|s| problem.adjust(&s)).filter(Seed::is_sane).collect(), ADJUSTED / 4)
}

/// All directions of the axis with all angles at one focal length. `centre`: mean of the points.
fn search(pairs: &[KeyPair], patterns: &[[f64; KEYS]], focal: f64, centre: DVec2) -> Vec<Seed> {
    let ray = (centre / focal).extend(1.0).normalize();
    let mut found = Vec::new();
    for direction in half_sphere(DIRECTIONS) {
        let across = ray - direction * direction.dot(ray);
        if across.length() < 0.15 {
            continue; // seen end on: nothing says where the axis is
        }
        let x = across.normalize();
        let frame = DQuat::from_mat3(&DMat3::from_cols(x, direction.cross(x), direction));
        for angles in patterns {
            let mut seed = Seed { frame, focal, angles: *angles, cost: 0.0 };
            seed.cost = pairs.iter().map(|p| p.cost(&seed)).sum();
            found.push(seed);
        }
    }
    found
}

/// The best motion near a seed with known angles, `step` (radians) between neighbours.
pub(crate) fn at_steps(
    pairs: &[KeyPair],
    keys: usize,
    seed: &Seed,
    step: f64,
    focal: &FocalSearch,
) -> Option<Seed> {
    let angles = std::array::from_fn(|k| step * k as f64);
    let problem = SeedProblem { pairs, keys, focal, holds_angles: true };
    let starts = focal.tried.iter().map(|&focal| Seed { focal, angles, ..seed.clone() });
    let adjusted = starts.map(|s| problem.adjust(&s)).filter(Seed::is_sane);
    adjusted.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The cheapest seeds that are not like a cheaper one; axis and sense of rotation count together.
fn different(mut seeds: Vec<Seed>, most: usize) -> Vec<Seed> {
    seeds.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Seed> = Vec::new();
    for seed in seeds {
        if kept.len() < most && kept.iter().all(|k| k.sense().dot(seed.sense()) < ALIKE) {
            kept.push(seed);
        }
    }
    kept
}

/// Evenly spread directions with z ≥ 0 (spiral of Fibonacci).
fn half_sphere(n: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..n).map(move |i| {
        let z = 1.0 - (i as f64 + 0.5) / n as f64;
        let (s, c) = (golden * i as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * c, r * s, z)
    })
}

/// Robust epipolar error of all pairs as a function of axis, focal length and angles.
struct SeedProblem<'a> {
    pairs: &'a [KeyPair],
    keys: usize,
    focal: &'a FocalSearch,
    /// The angles stay as they are.
    holds_angles: bool,
}

impl SeedProblem<'_> {
    fn adjust(&self, start: &Seed) -> Seed {
        let mut seed = start.clone();
        for width in WIDTHS_PX {
            seed = minimise(seed, 30, |s| Some(self.normal(s, width).0), Seed::step);
        }
        seed.cost = self.normal(&seed, WIDTHS_PX[1]).1;
        seed
    }

    /// Normal equations and cost of the Sampson errors and of what is expected of focal length and
    /// rate.
    fn normal(&self, seed: &Seed, width: f64) -> (Normal<UNKNOWNS>, f64) {
        let mut normal = Normal::new();
        let mut total = 0.0;
        for pair in self.pairs {
            self.add_pair(pair, seed, width, &mut normal, &mut total);
        }
        for (residual, gradient) in self.expectations(seed) {
            normal.add_cost(residual * residual);
            total += residual * residual;
            normal.add(residual, &gradient, 1.0);
        }
        (normal, total)
    }

    fn add_pair(
        &self,
        pair: &KeyPair,
        seed: &Seed,
        width: f64,
        normal: &mut Normal<UNKNOWNS>,
        total: &mut f64,
    ) {
        let [i, k] = pair.keys;
        let angle = seed.angles[k] - seed.angles[i];
        let f = seed.fundamental(angle);
        let tilts = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
            let frame = DQuat::from_scaled_axis(axis * H) * seed.frame;
            Seed { frame, ..seed.clone() }.fundamental(angle)
        });
        let longer = Seed { focal: seed.focal * H.exp(), ..seed.clone() };
        let tangents = [tilts[0], tilts[1], tilts[2], longer.fundamental(angle), seed.fundamental(angle + H)];
        for &[u, v] in &pair.points {
            let r = sampson_error(&f, u, v);
            let slope = tangents.map(|t| (sampson_error(&t, u, v) - r) / H);
            let mut gradient = [0.0; UNKNOWNS];
            gradient[..3].copy_from_slice(&slope[..3]);
            gradient[3] = if self.focal.is_known { 0.0 } else { slope[3] };
            for (key, sign) in [(i, -1.0), (k, 1.0)] {
                if key > 0 && !self.holds_angles {
                    gradient[3 + key] += sign * slope[4];
                }
            }
            let (cost, weight) = cauchy(r * r, width);
            normal.add_cost(cost);
            *total += cost;
            normal.add(r, &gradient, weight);
        }
    }

    /// Residuals in standard deviations with their gradients: the focal length near the guess, a
    /// steady rate.
    fn expectations(&self, seed: &Seed) -> Vec<(f64, [f64; UNKNOWNS])> {
        let mut by_focal = [0.0; UNKNOWNS];
        by_focal[3] = 1.0 / FOCAL_LOG_SIGMA;
        let off = (seed.focal / self.focal.guess).ln() / FOCAL_LOG_SIGMA;
        let mut expected = vec![(if self.focal.is_known { 0.0 } else { off }, by_focal)];
        let keys = self.keys;
        if keys <= 3 || self.holds_angles {
            return expected;
        }
        let step = (seed.angles[keys - 1] / (keys - 1) as f64).abs().max(1e-3);
        let w = 1.0 / (RATE_CHANGE * step);
        for k in 1..keys - 1 {
            let mut gradient = [0.0; UNKNOWNS];
            gradient[3 + k] = -2.0 * w;
            gradient[4 + k] = w;
            if k > 1 {
                gradient[2 + k] = w;
            }
            let change = seed.angles[k + 1] - 2.0 * seed.angles[k] + seed.angles[k - 1];
            expected.push((change * w, gradient));
        }
        expected
    }
}

/// Signed Sampson error, pixels (Hartley & Zisserman 2004, section 11.4.3).
fn sampson_error(f: &DMat3, u: DVec2, v: DVec2) -> f64 {
    let (fu, fv) = (*f * u.extend(1.0), f.transpose() * v.extend(1.0));
    let d = fu.truncate().length_squared() + fv.truncate().length_squared();
    v.extend(1.0).dot(fu) / d.sqrt().max(1e-300)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal as gaussian;
    use rand::Rng as _;
    use scene::rng::rng;

    /// Points about an axis, seen by a camera of focal length 700 that looks down on them; some
    /// stand still or are wrong.
    fn example(seed: u64, noise: f64, wrong: usize) -> (Vec<KeyPair>, DVec3, f64) {
        let mut r = rng(seed, "turn", 0);
        let direction = DVec3::new(r.random_range(-0.2..0.2), -1.0, r.random_range(-0.6..0.1)).normalize();
        let place = DVec3::new(0.1, 0.05, 4.0);
        let step: f64 = r.random_range(3.0f64..12.0).to_radians();
        let points: Vec<DVec3> =
            (0..80).map(|_| DVec3::from_array(std::array::from_fn(|_| r.random_range(-0.8..0.8)))).collect();
        let see = |x: DVec3, key: usize| {
            let p = DMat3::from_axis_angle(direction, step * key as f64) * x + place;
            p.truncate() / p.z * 700.0
        };
        let mut pairs = Vec::new();
        for i in 0..KEYS {
            for k in i + 1..KEYS.min(i + 4) {
                let mut some: Vec<[DVec2; 2]> = points.iter().map(|x| [see(*x, i), see(*x, k)]).collect();
                for p in some.iter_mut().flatten() {
                    *p += DVec2::new(gaussian(&mut r), gaussian(&mut r)) * noise;
                }
                for p in some.iter_mut().take(wrong) {
                    p[1] += DVec2::new(r.random_range(-30.0..30.0), r.random_range(-30.0..30.0));
                }
                pairs.push(KeyPair { keys: [i, k], points: some });
            }
        }
        (pairs, direction, step)
    }

    #[test]
    fn the_axis_of_an_exact_turn_is_found_with_its_focal_length() {
        for s in 0..10 {
            let (pairs, direction, step) = example(s, 0.0, 0);
            let focal = FocalSearch { tried: vec![500.0, 760.0, 1100.0], guess: 760.0, is_known: false };
            let best = &seeds(&pairs, KEYS, &AnglePattern::Video.angles(), &focal)[0];
            let sense = best.direction() * best.angles[1].signum();
            assert!(sense.dot(direction) > 0.9995, "seed {s}: {sense} instead of {direction}");
            let off = best.angles[1].abs() / step - 1.0;
            assert!(off.abs() < 0.1, "seed {s}: step {off}, focal length {}", best.focal);
            assert!((best.focal / 700.0 - 1.0).abs() < 0.1, "seed {s}: {}", best.focal);
            assert!(explained_share(&pairs, best) > 0.99);
        }
    }

    #[test]
    fn noise_and_a_third_of_wrong_matches_leave_it_near() {
        for s in 0..10 {
            let (pairs, direction, step) = example(s, 0.3, 25);
            let focal = FocalSearch { tried: vec![500.0, 760.0, 1100.0], guess: 760.0, is_known: false };
            let best = &seeds(&pairs, KEYS, &AnglePattern::Video.angles(), &focal)[0];
            let sense = best.direction() * best.angles[1].signum();
            assert!(sense.dot(direction) > 0.97, "seed {s}: {sense} instead of {direction}");
            assert!((best.angles[1].abs() / step - 1.0).abs() < 0.3, "seed {s}");
        }
    }

    #[test]
    fn too_little_gives_nothing() {
        assert!(
            seeds(&[], KEYS, &AnglePattern::Video.angles(), &FocalSearch::about(700.0, false)).is_empty()
        );
        let pair = KeyPair { keys: [0, 1], points: vec![[DVec2::ZERO; 2]; 10] };
        assert!(
            seeds(&[pair], KEYS, &AnglePattern::Video.angles(), &FocalSearch::about(700.0, false)).is_empty()
        );
    }
}
