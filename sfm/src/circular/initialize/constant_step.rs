//! One motion for a whole ring of photos: where the images go round evenly in the order of their files, every two neighbours show
//! the same turn, and the matches of all of them together find it where those of one pair are too few or too often wrong.

use super::seed::{KEYS, KeyPair, Seed, at_steps, seeds};
use crate::SfmError;
use crate::circular::MotionInput;
use crate::circular::model::AxisModel;
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::circular::{orbit, ring};
use crate::incremental::resection::FOCAL_FACTORS;
use crate::incremental::state::{MapState, MappingInput};
use crate::matching::PairMatches;
use crate::model_selection::camera::FreeIntrinsics;
use crate::solvers::sampson_sq;
use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Pose};
use std::f64::consts::TAU;

/// Fewest images of a ring.
const LEAST_IMAGES: usize = 12;
/// Neighbours up to so many places on are looked at.
const NEIGHBOURS: usize = 3;
/// Steps from an image to the next that are tried, degrees, in both senses.
const STEPS_DEG: [f64; 9] = [3.0, 4.5, 6.0, 8.0, 10.0, 12.5, 15.0, 20.0, 30.0];
/// Matches with which the turn is looked for, at most, and in how many portions.
const MATCHES: usize = 2400;
const PORTIONS: usize = 30;
/// A match agrees with the turn to so many pixels: a camera that goes round has motions of its own.
const NEAR_PX: f64 = 6.0;
/// Share of the matches that agree with the turn, over the share of wrong ones that do.
const LEAST_GAIN: f64 = 0.25;
/// The ring is closed if of the matches of its last images with its first so large a share of what the neighbours show agrees.
const CLOSING: f64 = 0.5;

/// What cameras that go round by hand or on a gantry are off their circle, as long as it is not known: radians, radii.
const OWN_MOTIONS: [f64; 2] = [0.015, 0.01];
/// Adjustments of a model that begins with all images on the circle, and how many times farther than at the end observations may be
/// from their places at first.
const ROUNDS: usize = 5;
const WIDE: f64 = 3.0;
/// Adjustments near the circle afterwards.
const HELD_ROUNDS: usize = 2;
/// Observations of a track that tell the angles between its images, and the share of such observations that a ring keeps: 0.72 to 0.89 of
/// ten orbits that were rings (0.60 and 0.65 of a turntable in the deepest dark), 0.25 and 0.51 of two sets that were none.
const LASTING: usize = 3;
const KEPT: f64 = 0.62;
/// Fewest observations that hold an image in its place.
const FEWEST: usize = 8;
/// A pose that is farther from its place than this is not on the ring: radians, radii.
const ASTRAY: [f64; 2] = [0.06, 0.06];

/// The turn from an image to the next one.
pub(crate) struct ConstantStepMotion {
    seed: Seed,
    /// Radians.
    step: f64,
    images: usize,
    /// After the last image comes the first.
    pub closed: bool,
    centre: DVec2,
    /// Shares of the matches of neighbours that agree with it, and of matches that cannot be right.
    pub agreeing: [f64; 2],
}

impl ConstantStepMotion {
    /// From matches before verification, of which most may be wrong. `positions`: by image, where its features are; `known`: the
    /// focal length is. `None` where the images do not go round evenly, as far as the matches say.
    pub fn of(
        camera: &Camera,
        known: bool,
        positions: &[Vec<DVec2>],
        matches: &[PairMatches],
    ) -> Option<Self> {
        let images = positions.len();
        if images < LEAST_IMAGES {
            return None;
        }
        let guess = camera.mean_focal();
        let ideal = |image: usize, feature: u32| -> Option<DVec2> {
            Some(camera.unproject(*positions[image].get(feature as usize)?) * guess)
        };
        let mut by_gap: Vec<Vec<[DVec2; 2]>> = vec![Vec::new(); NEIGHBOURS];
        let mut closing: Vec<[DVec2; 2]> = Vec::new();
        for (a, b, pairs) in matches {
            let point = |m: &[u32; 2]| {
                let (p, q) = (ideal(*a, m[0])?, ideal(*b, m[1])?);
                (p.is_finite() && q.is_finite()).then_some(if a < b { [p, q] } else { [q, p] })
            };
            let gap = a.abs_diff(*b);
            if (1..=NEIGHBOURS).contains(&gap) {
                by_gap[gap - 1].extend(pairs.iter().filter_map(point));
            } else if gap + 1 == images {
                closing.extend(pairs.iter().filter_map(point).map(|[first, last]| [last, first]));
            }
        }
        let pairs = portions(&by_gap);
        let focals: Vec<f64> =
            if known { vec![guess] } else { FOCAL_FACTORS.iter().map(|f| f * guess).collect() };
        let found = seeds(&pairs, NEIGHBOURS + 1, &patterns(), &focals, guess, known);
        let seed = found.into_iter().next()?;
        let step = seed.angles[NEIGHBOURS] / NEIGHBOURS as f64;
        let centre = camera.principal_point();
        let mut turn = Self { seed, step, images, closed: false, centre, agreeing: [0.0; 2] };
        turn.agreeing = [0, 1].map(|shifted| turn.agreement(&by_gap[0], shifted * by_gap[0].len() / 2));
        let gain = turn.agreeing[0] - turn.agreeing[1];
        turn.closed = turn.agreement(&closing, 0) - turn.agreeing[1] >= CLOSING * gain;
        if gain < LEAST_GAIN {
            return None;
        }
        if turn.closed {
            // A whole turn tells focal length and angle apart.
            let whole = (TAU / images as f64).copysign(step);
            let exact = at_steps(&pairs, NEIGHBOURS + 1, &turn.seed, whole, (&focals, guess, known))?;
            (turn.seed, turn.step) = (exact, whole);
        }
        Some(turn)
    }

    /// Share of the matches of neighbours that agree, each first point with the second one `shifted` places on.
    fn agreement(&self, matches: &[[DVec2; 2]], shifted: usize) -> f64 {
        let f = self.seed.fundamental(self.step);
        let n = matches.len();
        let near =
            |i: &usize| sampson_sq(&f, matches[*i][0], matches[(i + shifted) % n][1]) < NEAR_PX * NEAR_PX;
        (0..n).filter(near).count() as f64 / n.max(1) as f64
    }

    /// How many images on `b` is from `a`, the short way round.
    pub fn places(&self, a: usize, b: usize) -> f64 {
        let (on, n) = (b as f64 - a as f64, self.images as f64);
        if self.closed { on - n * (on / n).round() } else { on }
    }

    /// The turn between them, radians.
    pub fn between(&self, a: usize, b: usize) -> f64 {
        self.places(a, b) * self.step
    }

    /// `F` in pixels from image `a` to image `b`.
    pub fn fundamental(&self, a: usize, b: usize) -> DMat3 {
        let shift = DMat3::from_cols(DVec3::X, DVec3::Y, (-self.centre).extend(1.0));
        shift.transpose() * self.seed.fundamental(self.between(a, b)) * shift
    }

    /// Degrees from an image to the next one.
    pub fn step_deg(&self) -> f64 {
        self.step.to_degrees()
    }

    fn turn(&self) -> Option<CircularMotion> {
        let angles = (0..self.images).map(|i| Some(self.step * i as f64)).collect();
        CircularMotion::new(self.seed.direction(), self.seed.place(), angles)
    }

    /// The images whose poses are not where the constant-step circular motion has them, from the place where most of them say the ring is.
    pub fn astray(&self, poses: &[Option<Pose>]) -> usize {
        let known = poses.iter().flatten().count();
        let Some((found, misfit)) = CircularMotion::of_poses(poses) else { return known };
        if misfit.tilt > ASTRAY[0] || misfit.slip > ASTRAY[1] {
            return known;
        }
        let astray = |sense: f64| {
            let late: Vec<(usize, f64)> = found
                .angles
                .iter()
                .enumerate()
                .filter_map(|(i, a)| Some((i, wrap_angle((*a)? * sense - self.step * i as f64))))
                .collect();
            let off =
                |l: &f64| late.iter().filter(|(_, other)| wrap_angle(l - other).abs() > ASTRAY[0]).count();
            late.iter().map(|(_, l)| off(l)).min().unwrap_or(known)
        };
        astray(1.0).min(astray(-1.0))
    }

    /// A model that begins with all images in their places and is adjusted with motions of their own, and the share of the
    /// observations in lasting tracks that it keeps. `None` where those say that the images go round otherwise: the lines of a turn
    /// about a vertical axis look much the same whatever its angle, three observations of a point do not.
    pub fn model(
        &self,
        job: &MotionInput<'_>,
        intrinsics: FreeIntrinsics,
    ) -> Result<Option<(MapState, f64)>, SfmError> {
        let Some(turn) = self.turn() else { return Ok(None) };
        let mut cameras = job.cameras.to_vec();
        if !job.known[0].fixed {
            let focals = cameras[0].model.num_focals();
            cameras[0].params[..focals].fill(self.seed.focal);
        }
        let limit = job.input.config.max_reprojection_px;
        let wide = crate::incremental::MapperConfig {
            max_reprojection_px: WIDE * limit,
            ..job.input.config.clone()
        };
        let loose = MappingInput { config: &wide, ..*job.input };
        let mut state = AxisModel::new(&loose, cameras.clone(), turn).state;
        for round in 0..ROUNDS {
            let input = if round < ROUNDS / 2 { &loose } else { job.input };
            let job = MotionInput { input, starts: &cameras, ..*job };
            let Some(next) = orbit::adjust(&state, &job.context(&[]), intrinsics, OWN_MOTIONS)? else {
                return Ok(None);
            };
            state = next;
            state.filter(input, input.config.max_reprojection_px);
            state.grow_all(input);
        }
        let weak: Vec<usize> = (0..self.images).filter(|&i| state.observations(i) < FEWEST).collect();
        weak.iter().for_each(|&i| state.unregister(i));
        let lasting =
            |lengths: &mut dyn Iterator<Item = usize>| lengths.filter(|n| *n >= LASTING).sum::<usize>();
        let kept = lasting(&mut state.live().map(|(_, p)| p.views.len()));
        let all = lasting(&mut job.input.tracks.views.iter().map(Vec::len));
        let holds = kept as f64 >= KEPT * all as f64 && state.registered_count() >= LEAST_IMAGES;
        Ok(holds.then_some((state, kept as f64 / all.max(1) as f64)))
    }
}

/// A model whose images were put in their places on a ring, adjusted near the circle that most of them say it is.
pub(crate) fn hold_on_ring(
    state: &MapState,
    job: &MotionInput<'_>,
    intrinsics: FreeIntrinsics,
) -> Result<MapState, SfmError> {
    let sigma = ring::own_motions(&state.poses).unwrap_or(OWN_MOTIONS);
    let mut held = state.clone();
    for _ in 0..HELD_ROUNDS {
        let Some(mut next) = orbit::adjust(&held, &job.context(&[]), intrinsics, sigma)? else { break };
        next.filter(job.input, job.input.config.max_reprojection_px);
        next.grow_all(job.input);
        held = next;
    }
    Ok(held)
}

/// Even steps, in both senses.
fn patterns() -> Vec<[f64; KEYS]> {
    let steps = STEPS_DEG.iter().flat_map(|s| [s.to_radians(), -s.to_radians()]);
    steps.map(|s| std::array::from_fn(|k| s * k as f64)).collect()
}

/// Matches by how many places their images are apart, evenly thinned, in small portions (each of which is thinned on its own
/// where all cannot be looked at).
fn portions(by_gap: &[Vec<[DVec2; 2]>]) -> Vec<KeyPair> {
    let all: usize = by_gap.iter().map(Vec::len).sum();
    let every = all.div_ceil(MATCHES).max(1);
    let size = all.min(MATCHES).div_ceil(PORTIONS).max(1);
    let of_gap = |(k, matches): (usize, &Vec<[DVec2; 2]>)| {
        let kept: Vec<[DVec2; 2]> = matches.iter().step_by(every).copied().collect();
        kept.chunks(size).map(|c| KeyPair { keys: [0, k + 1], points: c.to_vec() }).collect::<Vec<_>>()
    };
    by_gap.iter().enumerate().flat_map(of_gap).collect()
}
