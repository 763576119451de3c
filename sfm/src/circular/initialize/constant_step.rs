//! One motion for a whole ring of photos: where the images go round evenly in the order of their
//! files, every two neighbours show the same turn, and the matches of all of them together find it
//! where those of one pair are too few or too often wrong (docs/decisions/09).

use super::seed::{AnglePattern, FocalSearch, KeyPair, Seed, at_steps, seeds};
use crate::circular::job::MotionInput;
use crate::circular::limits::{FINAL_ROUNDS, LEAST_OBSERVATIONS, TIGHT};
use crate::circular::model::AxisModel;
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::circular::{orbit, ring};
use crate::error::SfmError;
use crate::incremental::MapperConfig;
use crate::incremental::state::{MapState, MappingInput};
use crate::matching::PairMatches;
use crate::model_selection::camera::FreeIntrinsics;
use crate::solvers::sampson_sq;
use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Pose};
use std::f64::consts::TAU;

/// Neighbours up to so many places on are looked at.
/// Source: docs/decisions/09.
const NEIGHBOURS: usize = 3;
/// Matches with which the turn is looked for, at most.
/// Source: chosen by hand, never measured.
const MATCHES: usize = 2400;
/// They are thinned in so many portions, each on its own.
/// Source: chosen by hand, never measured.
const PORTIONS: usize = 30;
/// A match agrees with the turn to so many pixels: a camera that goes round has motions of its own.
/// Source: docs/decisions/09, 87 to 96 % of the neighbours' matches agree, 9 to 13 % of wrong ones.
const NEAR_PX: f64 = 6.0;
/// Share of the matches that agree with the turn, over the share of wrong ones that do.
/// Source: chosen by hand between the shares of docs/decisions/09, never measured.
const LEAST_GAIN: f64 = 0.25;
/// Share of the observations in tracks of three and more that a ring keeps: two views of a point do
/// not tell the angle between them, three do.
/// Source: docs/decisions/09: 0.72 to 0.89 of ten rings (0.60 and 0.65 of a turntable in the
/// deepest dark), 0.25 and 0.51 of two sets that were none.
const KEPT: f64 = 0.62;
/// A pose that is farther from its place than this is not on the ring: radians, radii.
/// Source: chosen by hand, never measured.
const ASTRAY: f64 = 0.06;

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
    /// From matches before verification, of which most may be wrong. `positions`: by image, where
    /// its features are; `known`: the focal length is. `None` where the images do not go round
    /// evenly, as far as the matches say.
    pub(crate) fn of(
        camera: &Camera,
        known: bool,
        positions: &[Vec<DVec2>],
        matches: &[PairMatches],
    ) -> Option<Self> {
        if positions.len() < LEAST_OBSERVATIONS {
            return None;
        }
        let matches = NeighbourMatches::new(camera, positions, matches);
        let pairs = matches.portions();
        let focal = FocalSearch::about(camera.mean_focal(), known);
        let seed = seeds(&pairs, NEIGHBOURS + 1, &AnglePattern::Ring.angles(), &focal).into_iter().next()?;
        let step = seed.angles[NEIGHBOURS] / NEIGHBOURS as f64;
        let (images, centre) = (positions.len(), camera.principal_point());
        let mut turn = Self { seed, step, images, closed: false, centre, agreeing: [0.0; 2] };
        let next = &matches.by_gap[0];
        turn.agreeing = [0, 1].map(|shifted| turn.agreement(next, shifted * next.len() / 2));
        let gain = turn.agreeing[0] - turn.agreeing[1];
        // Closed if of the last images' matches with the first half as large a share agrees.
        turn.closed = turn.agreement(&matches.closing, 0) - turn.agreeing[1] >= 0.5 * gain;
        if gain < LEAST_GAIN {
            return None;
        }
        if turn.closed {
            // A whole turn tells focal length and angle apart.
            let whole = (TAU / images as f64).copysign(step);
            let exact = at_steps(&pairs, NEIGHBOURS + 1, &turn.seed, whole, &focal)?;
            (turn.seed, turn.step) = (exact, whole);
        }
        Some(turn)
    }

    /// Share of the matches of neighbours that agree, each first point with the second one
    /// `shifted` places on.
    fn agreement(&self, matches: &[[DVec2; 2]], shifted: usize) -> f64 {
        let f = self.seed.fundamental(self.step);
        let n = matches.len();
        let mut near = 0;
        for (i, pair) in matches.iter().enumerate() {
            near += usize::from(sampson_sq(&f, pair[0], matches[(i + shifted) % n][1]) < NEAR_PX * NEAR_PX);
        }
        near as f64 / n.max(1) as f64
    }

    /// How many images on `b` is from `a`, the short way round.
    pub(crate) fn places(&self, a: usize, b: usize) -> f64 {
        let (on, n) = (b as f64 - a as f64, self.images as f64);
        if self.closed { on - n * (on / n).round() } else { on }
    }

    /// The turn between them, radians.
    pub(crate) fn between(&self, a: usize, b: usize) -> f64 {
        self.places(a, b) * self.step
    }

    /// `F` in pixels from image `a` to image `b`.
    pub(crate) fn fundamental(&self, a: usize, b: usize) -> DMat3 {
        let shift = DMat3::from_cols(DVec3::X, DVec3::Y, (-self.centre).extend(1.0));
        shift.transpose() * self.seed.fundamental(self.between(a, b)) * shift
    }

    /// Degrees from an image to the next one.
    pub(crate) fn step_deg(&self) -> f64 {
        self.step.to_degrees()
    }

    fn turn(&self) -> Option<CircularMotion> {
        let angles = (0..self.images).map(|i| Some(self.step * i as f64)).collect();
        CircularMotion::new(self.seed.direction(), self.seed.place(), angles)
    }

    /// The images whose poses are not where the motion has them, from the place where most of them
    /// say the ring is.
    pub(crate) fn astray(&self, poses: &[Option<Pose>]) -> usize {
        let known = poses.iter().flatten().count();
        match CircularMotion::of_poses(poses) {
            Some((found, misfit)) if misfit.tilt <= ASTRAY && misfit.slip <= ASTRAY => {
                self.astray_from(&found, 1.0).min(self.astray_from(&found, -1.0)).min(known)
            }
            _ => known,
        }
    }

    /// The same for angles of one sense or the other; usize::MAX of none.
    fn astray_from(&self, found: &CircularMotion, sense: f64) -> usize {
        let mut late = Vec::new();
        for (i, angle) in found.angles.iter().enumerate() {
            late.extend(angle.map(|a| wrap_angle(a * sense - self.step * i as f64)));
        }
        let off = late.iter().map(|l| late.iter().filter(|k| wrap_angle(l - **k).abs() > ASTRAY).count());
        off.min().unwrap_or(usize::MAX)
    }

    /// A model that begins with all images in their places and is adjusted with motions of their
    /// own, and the share of the observations in lasting tracks that it keeps. `None` where those
    /// say that the images go round otherwise: the lines of a turn about a vertical axis look much
    /// the same whatever its angle.
    pub(crate) fn model(
        &self,
        job: &MotionInput<'_>,
        intrinsics: FreeIntrinsics,
    ) -> Result<Option<(MapState, f64)>, SfmError> {
        let Some(turn) = self.turn() else { return Ok(None) };
        let cameras = self.seed.cameras(job.cameras, &job.known[0]);
        let limit = job.input.config.max_reprojection_px;
        let wide = MapperConfig { max_reprojection_px: 3.0 * limit, ..job.input.config.clone() };
        let loose = MappingInput { config: &wide, ..*job.input };
        let mut state = AxisModel::new(&loose, cameras.clone(), turn).state;
        for round in 0..2 * FINAL_ROUNDS {
            let input = if round < FINAL_ROUNDS { &loose } else { job.input };
            let job = MotionInput { input, starts: &cameras, ..*job };
            let Some(next) = orbit::adjust(&state, &job.context(&[]), intrinsics, [TIGHT; 2])? else {
                return Ok(None);
            };
            state = next;
            state.filter(input, input.config.max_reprojection_px);
            state.grow_all(input);
        }
        let weak: Vec<usize> =
            (0..self.images).filter(|&i| state.observations(i) < LEAST_OBSERVATIONS).collect();
        weak.iter().for_each(|&i| state.unregister(i));
        let kept: usize = state.live().map(|(_, p)| p.views.len()).filter(|n| *n >= 3).sum();
        let all: usize = job.input.tracks.views.iter().map(Vec::len).filter(|n| *n >= 3).sum();
        let holds = kept as f64 >= KEPT * all as f64 && state.registered_count() >= LEAST_OBSERVATIONS;
        Ok(holds.then_some((state, kept as f64 / all.max(1) as f64)))
    }
}

/// A model whose images were put in their places on a ring, adjusted near the circle that most of
/// them say it is.
pub(crate) fn hold_on_ring(
    state: &MapState,
    job: &MotionInput<'_>,
    intrinsics: FreeIntrinsics,
) -> Result<MapState, SfmError> {
    let sigma = ring::own_motions(&state.poses).unwrap_or([TIGHT; 2]);
    Ok(orbit::hold(state, &job.context(&[]), intrinsics, sigma)?.unwrap_or_else(|| state.clone()))
}

/// Matches of images near each other in their order, ideal pixels from the principal point.
struct NeighbourMatches {
    /// By how many places on less one.
    by_gap: Vec<Vec<[DVec2; 2]>>,
    /// Of the last image with the first.
    closing: Vec<[DVec2; 2]>,
}

impl NeighbourMatches {
    fn new(camera: &Camera, positions: &[Vec<DVec2>], matches: &[PairMatches]) -> Self {
        let mut found = Self { by_gap: vec![Vec::new(); NEIGHBOURS], closing: Vec::new() };
        for (a, b, pairs) in matches {
            let (low, high) = (*a.min(b), *a.max(b));
            let gap = high - low;
            if !(1..=NEIGHBOURS).contains(&gap) && gap + 1 != positions.len() {
                continue;
            }
            for m in pairs {
                let features = if a < b { *m } else { [m[1], m[0]] };
                let pixels =
                    [positions[low].get(features[0] as usize), positions[high].get(features[1] as usize)];
                let [Some(p), Some(q)] = pixels else { continue };
                let [p, q] = [p, q].map(|p| camera.unproject(*p) * camera.mean_focal());
                match found.by_gap.get_mut(gap - 1) {
                    _ if !(p.is_finite() && q.is_finite()) => {}
                    Some(of_gap) => of_gap.push([p, q]),
                    None => found.closing.push([q, p]),
                }
            }
        }
        found
    }

    /// Evenly thinned, in small portions (each of which is thinned on its own where all cannot be
    /// looked at).
    fn portions(&self) -> Vec<KeyPair> {
        let all: usize = self.by_gap.iter().map(Vec::len).sum();
        let every = all.div_ceil(MATCHES).max(1);
        let size = all.min(MATCHES).div_ceil(PORTIONS).max(1);
        let mut portions = Vec::new();
        for (k, matches) in self.by_gap.iter().enumerate() {
            let kept: Vec<[DVec2; 2]> = matches.iter().step_by(every).copied().collect();
            portions.extend(kept.chunks(size).map(|c| KeyPair { keys: [0, k + 1], points: c.to_vec() }));
        }
        portions
    }
}
