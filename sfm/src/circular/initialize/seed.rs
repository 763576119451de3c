//! A first turn from a few frames of a video, without poses: axis, focal length and rate that explain the motion of the
//! tracks between key frames. A coarse search over all directions, then adjustment of the epipolar error (no points).

use crate::circular::motion::wrap_angle;
use crate::solvers::levenberg::{Normal, cauchy, minimise};
use crate::solvers::linalg::skew;
use crate::solvers::sampson_sq;
use glam::{DMat3, DQuat, DVec2, DVec3};

/// Most key frames of a seed.
pub(crate) const KEYS: usize = 7;
/// Unknowns: rotation of (axis, place), focal length, angles after the first.
const UNKNOWNS: usize = 3 + 1 + (KEYS - 1);
/// Directions on the half sphere that are tried.
const DIRECTIONS: usize = 160;
/// Turns between two key frames that are tried, degrees.
const STEPS_DEG: [f64; 8] = [1.5, 2.5, 4.0, 5.5, 7.5, 10.0, 13.5, 18.0];
/// Turns between two photos that are tried, degrees.
const TRIPLE_DEG: [f64; 6] = [4.5, 8.0, 12.0, 17.0, 24.0, 34.0];
/// Width of the robust loss in the search and in the adjustment, pixels.
const WIDTHS_PX: [f64; 2] = [2.0, 0.7];
/// Standard deviation of the logarithm of the focal length about the guess.
const FOCAL_SIGMA: f64 = 0.5;
/// Standard deviation of second differences of the angles, as a share of the step.
const RATE_SIGMA: f64 = 0.15;
/// Seeds that are adjusted, and how many of them may share a focal length.
const ADJUSTED: (usize, usize) = (16, 3);
/// Seeds that are alike: axes closer than this (cosine) with the same sense of rotation.
const ALIKE: f64 = 0.97;

/// Matches of two key frames: ideal pixels from the principal point.
#[derive(Clone, Debug)]
pub(crate) struct KeyPair {
    /// Which key frames, from 0.
    pub keys: [usize; 2],
    /// The same points in both.
    pub points: Vec<[DVec2; 2]>,
}

/// A hypothesis.
#[derive(Clone, Debug)]
pub(crate) struct Seed {
    /// Takes z to the axis and x to the direction of the axis' point nearest to the camera, camera frame.
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
    pub fn direction(&self) -> DVec3 {
        self.frame * DVec3::Z
    }

    /// `F` of ideal pixels for a turn by `angle` (radians).
    pub fn fundamental(&self, angle: f64) -> DMat3 {
        fundamental(self.frame, self.focal, angle)
    }

    /// Direction of its point nearest to the camera.
    pub fn place(&self) -> DVec3 {
        self.frame * DVec3::X
    }
}

/// `F` of ideal pixels for a turn by `angle`: `t = (I − R) t₀ ∝ sin(θ/2) t₀ − cos(θ/2) a × t₀`, which stays finite as
/// the angle vanishes.
fn fundamental(frame: DQuat, focal: f64, angle: f64) -> DMat3 {
    let (a, t0) = (frame * DVec3::Z, frame * DVec3::X);
    let (s, c) = (0.5 * angle).sin_cos();
    let e = skew(t0 * s - a.cross(t0) * c) * DMat3::from_axis_angle(a, angle);
    let inverse = DMat3::from_diagonal(DVec3::new(1.0 / focal, 1.0 / focal, 1.0));
    inverse * e * inverse
}

/// Share of the matches that the seed explains to two pixels.
pub(crate) fn explained_share(pairs: &[KeyPair], seed: &Seed) -> f64 {
    let (mut good, mut all) = (0usize, 0usize);
    for pair in pairs {
        let f = fundamental(seed.frame, seed.focal, seed.angles[pair.keys[1]] - seed.angles[pair.keys[0]]);
        good += pair.points.iter().filter(|[u, v]| sampson_sq(&f, *u, *v) < 4.0).count();
        all += pair.points.len();
    }
    good as f64 / all.max(1) as f64
}

/// Angles of key frames at a constant rate.
pub(crate) fn steady() -> Vec<[f64; KEYS]> {
    let steps = STEPS_DEG.iter().flat_map(|s| [*s, -*s]);
    steps.map(|s| std::array::from_fn(|k| s.to_radians() * k as f64)).collect()
}

/// Angles of three images whose order is not known.
pub(crate) fn triples() -> Vec<[f64; KEYS]> {
    let signed = || TRIPLE_DEG.iter().flat_map(|s| [s.to_radians(), -s.to_radians()]);
    let both = signed().flat_map(|a| signed().map(move |b| (a, b))).filter(|(a, b)| (a + b).abs() > 0.02);
    both.map(|(a, b)| std::array::from_fn(|k| [0.0, a, a + b, 0.0, 0.0, 0.0, 0.0][k])).collect()
}

/// The best hypotheses that differ, best first. `patterns`: angles to try, radians; `focals`: lengths to try, pixels; `guess`: the one to be near to;
/// `known`: it stays as it is.
pub(crate) fn seeds(
    pairs: &[KeyPair],
    keys: usize,
    patterns: &[[f64; KEYS]],
    focals: &[f64],
    guess: f64,
    known: bool,
) -> Vec<Seed> {
    let all = || pairs.iter().flat_map(|p| p.points.iter().flatten());
    let count = all().count();
    if count < 40 || keys < 3 {
        return Vec::new();
    }
    let centre = all().sum::<DVec2>() / count as f64;
    let sampled: Vec<KeyPair> = pairs.iter().map(|p| thin(p, 40)).collect();
    let mut found = Vec::new();
    for &focal in focals {
        let mut of_focal = Vec::new();
        for direction in half_sphere(DIRECTIONS) {
            let ray = (centre / focal).extend(1.0).normalize();
            let across = ray - direction * direction.dot(ray);
            if across.length() < 0.15 {
                continue; // seen end on: nothing says where the axis is
            }
            let x = across.normalize();
            let frame = DQuat::from_mat3(&DMat3::from_cols(x, direction.cross(x), direction));
            for angles in patterns {
                let cost = |p: &KeyPair| {
                    let f = fundamental(frame, focal, angles[p.keys[1]] - angles[p.keys[0]]);
                    let loss = |[u, v]: &[DVec2; 2]| cauchy(sampson_sq(&f, *u, *v), WIDTHS_PX[0]).0;
                    p.points.iter().map(loss).sum::<f64>()
                };
                let cost = sampled.iter().map(cost).sum();
                of_focal.push(Seed { frame, focal, angles: *angles, cost });
            }
        }
        of_focal.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        found.extend(different(of_focal, ADJUSTED.1));
    }
    found.sort_by(|a: &Seed, b| a.cost.total_cmp(&b.cost));
    found.truncate(ADJUSTED.0);
    let pairs: Vec<KeyPair> = pairs.iter().map(|p| thin(p, 120)).collect();
    let mut adjusted: Vec<Seed> =
        found.into_iter().map(|s| adjust(&pairs, keys, &s, guess, [known, false])).filter(sane).collect();
    adjusted.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    different(adjusted, 4)
}

/// The best motion near a seed with known angles, `step` (radians) between neighbours, whatever of `focals` it begins with.
pub(crate) fn at_steps(
    pairs: &[KeyPair],
    keys: usize,
    seed: &Seed,
    step: f64,
    (focals, guess, known): (&[f64], f64, bool),
) -> Option<Seed> {
    let angles = std::array::from_fn(|k| step * k as f64);
    let tried = focals
        .iter()
        .map(|&focal| adjust(pairs, keys, &Seed { focal, angles, ..seed.clone() }, guess, [known, true]));
    tried.filter(sane).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

fn sane(seed: &Seed) -> bool {
    seed.cost.is_finite() && seed.place().z > 0.0 && seed.angles.iter().all(|a| a.abs() < 4.0)
}

fn thin(pair: &KeyPair, most: usize) -> KeyPair {
    let step = pair.points.len().div_ceil(most).max(1);
    KeyPair { keys: pair.keys, points: pair.points.iter().step_by(step).copied().collect() }
}

/// The first ones that are not like an earlier one; axis and sense of rotation count together.
fn different(seeds: Vec<Seed>, most: usize) -> Vec<Seed> {
    let sense = |s: &Seed| s.direction() * wrap_angle(s.angles[1]).signum();
    let mut kept: Vec<Seed> = Vec::new();
    for seed in seeds {
        if kept.len() < most && kept.iter().all(|k| sense(k).dot(sense(&seed)) < ALIKE) {
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

/// Robust epipolar error of all pairs, minimised over axis, focal length and angles; `known`: whether the focal length and the
/// angles stay as they are.
fn adjust(pairs: &[KeyPair], keys: usize, start: &Seed, guess: f64, known: [bool; 2]) -> Seed {
    let mut seed = start.clone();
    for width in WIDTHS_PX {
        let evaluate = |s: &Seed| Some(normal(pairs, keys, s, guess, known, width).0);
        seed = minimise(seed, 30, evaluate, step_from);
    }
    seed.cost = normal(pairs, keys, &seed, guess, known, WIDTHS_PX[1]).1;
    seed
}

fn step_from(seed: &Seed, step: &[f64; UNKNOWNS]) -> Seed {
    let mut next = seed.clone();
    let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
    next.frame = (turn * seed.frame).normalize();
    next.focal = seed.focal * step[3].clamp(-1.0, 1.0).exp();
    for (angle, d) in next.angles[1..].iter_mut().zip(&step[4..]) {
        *angle += d;
    }
    next
}

/// Normal equations and cost of the Sampson errors and of what is expected of focal length and rate.
fn normal(
    pairs: &[KeyPair],
    keys: usize,
    seed: &Seed,
    guess: f64,
    [known, steady]: [bool; 2],
    width: f64,
) -> (Normal<UNKNOWNS>, f64) {
    const H: f64 = 1e-6;
    let mut normal = Normal::new();
    let mut total = 0.0;
    for pair in pairs {
        let [i, k] = pair.keys;
        let angle = seed.angles[k] - seed.angles[i];
        let f = fundamental(seed.frame, seed.focal, angle);
        let tilted =
            |axis: DVec3| fundamental(DQuat::from_scaled_axis(axis * H) * seed.frame, seed.focal, angle);
        let tangents = [
            tilted(DVec3::X),
            tilted(DVec3::Y),
            tilted(DVec3::Z),
            fundamental(seed.frame, seed.focal * H.exp(), angle),
            fundamental(seed.frame, seed.focal, angle + H),
        ];
        let residual = |f: &DMat3, u: DVec2, v: DVec2| {
            let (fu, fv) = (*f * u.extend(1.0), f.transpose() * v.extend(1.0));
            let d = fu.truncate().length_squared() + fv.truncate().length_squared();
            v.extend(1.0).dot(fu) / d.sqrt().max(1e-300)
        };
        for &[u, v] in &pair.points {
            let r = residual(&f, u, v);
            let slope = tangents.map(|t| (residual(&t, u, v) - r) / H);
            let mut gradient = [0.0; UNKNOWNS];
            gradient[..3].copy_from_slice(&slope[..3]);
            gradient[3] = if known { 0.0 } else { slope[3] };
            for (key, sign) in [(i, -1.0), (k, 1.0)] {
                if key > 0 && !steady {
                    gradient[3 + key] += sign * slope[4];
                }
            }
            let (cost, weight) = cauchy(r * r, width);
            normal.add_cost(cost);
            total += cost;
            normal.add(r, &gradient, weight);
        }
    }
    let mut expect = |residual: f64, gradient: [f64; UNKNOWNS]| {
        normal.add_cost(residual * residual);
        total += residual * residual;
        normal.add(residual, &gradient, 1.0);
    };
    let mut by_focal = [0.0; UNKNOWNS];
    by_focal[3] = 1.0 / FOCAL_SIGMA;
    expect(if known { 0.0 } else { (seed.focal / guess).ln() / FOCAL_SIGMA }, by_focal);
    let step = (seed.angles[keys - 1] / (keys - 1) as f64).abs().max(1e-3);
    for k in (1..keys - 1).filter(|_| keys > 3 && !steady) {
        let w = 1.0 / (RATE_SIGMA * step);
        let mut gradient = [0.0; UNKNOWNS];
        gradient[3 + k] = -2.0 * w;
        gradient[4 + k] = w;
        if k > 1 {
            gradient[2 + k] = w;
        }
        expect((seed.angles[k + 1] - 2.0 * seed.angles[k] + seed.angles[k - 1]) * w, gradient);
    }
    (normal, total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal as gaussian;
    use rand::Rng as _;
    use scene::rng::rng;

    /// Points about an axis, seen by a camera of focal length 700 that looks down on them; some stand still or are wrong.
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
            let focals = [500.0, 760.0, 1100.0];
            let best = &seeds(&pairs, KEYS, &steady(), &focals, 760.0, false)[0];
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
            let best = &seeds(&pairs, KEYS, &steady(), &[500.0, 760.0, 1100.0], 760.0, false)[0];
            let sense = best.direction() * best.angles[1].signum();
            assert!(sense.dot(direction) > 0.97, "seed {s}: {sense} instead of {direction}");
            assert!((best.angles[1].abs() / step - 1.0).abs() < 0.3, "seed {s}");
        }
    }

    #[test]
    fn too_little_gives_nothing() {
        assert!(seeds(&[], KEYS, &steady(), &[700.0], 700.0, false).is_empty());
        let pair = KeyPair { keys: [0, 1], points: vec![[DVec2::ZERO; 2]; 10] };
        assert!(seeds(&[pair], KEYS, &steady(), &[700.0], 700.0, false).is_empty());
    }
}
