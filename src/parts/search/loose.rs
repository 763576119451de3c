//! Training with a motion of its own for each piece.
//!
//! A piece's motion is a twist about its centre, linear between knots that are spread evenly over
//! the time; its light is a factor of its colours, likewise: shadows that wander over a body must
//! not look like motions. Each step moves the Gaussians of all pieces to where they stand in its
//! view, and turns what pulls at them into a step of Adam (Kingma and Ba 2015) for the two knots
//! beside it.

use super::pieces::Pieces;
use anyhow::Result;
use glam::{DQuat, DVec3, Quat, Vec3};
use rand::seq::SliceRandom as _;
use scene::gaussians::SH_C0;
use scene::rng::rng;
use scene::{Pose, Progress};
use sfm::{LooseJoint, LoosePiece};
use splat::backend::{StepInput, Target};
use splat::model::{Model, Planes};
use splat::moved::MovedGaussians;
use splat::{AlphaMode, Dataset, MovingParts, Pixels, RenderOptions};

/// How pieces are let loose.
struct LooseSettings {
    /// Steps, the first part of a schedule of so many. Source: that of `--quality fast`.
    steps: [u32; 2],
    /// Position from which on photos have half their resolution; before it, a quarter.
    /// Source: as in training.
    half_from: f64,
    /// Stretches of the time between knots. Source: chosen by hand on one film: with twice as many
    /// the motions of all pieces are noisier.
    stretches: usize,
    /// Steps of the rotations at the schedule's start and end, degrees; of places, by so much times
    /// the piece's extent. Source: chosen by hand on one film: three times those of joints from
    /// tracks, since these begin at rest.
    steps_deg: [f64; 2],
    /// Steps of the light. Source: chosen by hand: it falls to nothing in a shadow.
    steps_light: [f64; 2],
    /// Weight of D-SSIM. Source: Kerbl et al. 2023.
    lambda_dssim: f32,
    /// Degree of the spherical harmonics: highlights are no motion. Source: Kerbl et al. 2023.
    sh_degree: u32,
    /// Views on which gains are measured. Source: chosen by hand.
    gain_views: usize,
    /// Halvings of photos on which errors are measured. Source: chosen by hand.
    judged_level: usize,
    /// Points of a piece whose motion is told. Source: chosen by hand.
    told: usize,
    /// Decays of Adam's moments. Source: as for joints from tracks.
    betas: [f64; 2],
}

/// The values in force.
const LOOSE: LooseSettings = LooseSettings {
    steps: [750, 1500],
    half_from: 0.4,
    stretches: 10,
    steps_deg: [0.9, 0.06],
    steps_light: [0.05, 0.003],
    lambda_dssim: 0.2,
    sh_degree: 3,
    gain_views: 24,
    judged_level: 1,
    told: 60,
    betas: [0.9, 0.99],
};

/// First planes of means and quaternions (w, x, y, z) in [`Planes`]. Source: the type's order.
const PLACES: [usize; 2] = [0, 6];

/// A twist about a piece's centre: translation, normalised units, and rotation vector, radians; and
/// how much more light there is, as a share.
type Knot = [f64; 7];
/// The place of the light in it. Source: the type.
const LIGHT: usize = 6;

/// A piece in motion.
struct MovingPiece {
    centre: DVec3,
    extent: f64,
    knots: Vec<Knot>,
    /// Whether it may move.
    loose: bool,
    /// First and second moment and number of steps, by knot.
    moments: Vec<[[f64; 3]; 7]>,
}

/// A training under way.
pub(super) struct LooseTraining<'a> {
    dataset: &'a Dataset,
    /// Training views.
    views: Vec<usize>,
    /// When each view was taken, in stretches between knots.
    times: Vec<f64>,
    gaussians: MovedGaussians,
    pieces: Vec<MovingPiece>,
    told: Vec<Vec<DVec3>>,
    pixel: f32,
    seed: u64,
}

impl MovingPiece {
    /// At rest.
    fn new(pieces: &Pieces, piece: usize, loose: bool) -> Self {
        Self {
            centre: pieces.centres[piece].as_dvec3(),
            extent: pieces.extent(piece),
            knots: vec![Knot::default(); LOOSE.stretches + 1],
            loose,
            moments: vec![[[0.0; 3]; 7]; LOOSE.stretches + 1],
        }
    }

    /// Where it stands: the two knots beside a time, and what they count.
    fn knots_at(&self, time: f64) -> [(usize, f64); 2] {
        let first = (time.floor() as usize).min(self.knots.len() - 2);
        let share = time - first as f64;
        [(first, 1.0 - share), (first + 1, share)]
    }

    fn knot(&self, time: f64) -> Knot {
        let [(a, u), (b, v)] = self.knots_at(time);
        std::array::from_fn(|k| u * self.knots[a][k] + v * self.knots[b][k])
    }

    /// The same, where it rests at its mean place in the light of that time.
    fn seen(&self, time: f64, rests: bool) -> Knot {
        let mut out = self.knot(time);
        for (k, value) in out[..LIGHT].iter_mut().enumerate().filter(|_| rests) {
            *value = self.knots.iter().map(|t| t[k]).sum::<f64>() / self.knots.len() as f64;
        }
        out
    }

    /// `x_moved = R (x − c) + c + t`.
    fn pose(&self, knot: &Knot) -> Pose {
        let [x, y, z, a, b, c, _] = *knot;
        let rotation = DQuat::from_scaled_axis(DVec3::new(a, b, c));
        Pose::new(rotation, self.centre - rotation * self.centre + DVec3::new(x, y, z))
    }

    /// Moves as a joint does; `times`: of the views, in stretches.
    fn follow(&mut self, joint: &LooseJoint, times: &[f64]) {
        let mut known: Vec<(f64, f64)> = times.iter().copied().zip(joint.angles.iter().copied()).collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let arm = self.centre - joint.place;
        for (time, knot) in self.knots.iter_mut().enumerate() {
            let turn = joint.axis * between(&known, time as f64);
            let moved = DQuat::from_scaled_axis(turn) * arm - arm;
            *knot = [moved.x, moved.y, moved.z, turn.x, turn.y, turn.z, 0.0];
        }
    }

    /// A step against what pulls at it, of so large a turn and change of light.
    fn step(&mut self, time: f64, pull: &Knot, [turn, light]: [f64; 2]) {
        let sizes: Knot = std::array::from_fn(|k| match k {
            LIGHT => light,
            _ if !self.loose => 0.0,
            0..3 => turn * self.extent,
            _ => turn,
        });
        for (knot, weight) in self.knots_at(time) {
            for (k, pull) in pull.iter().enumerate() {
                let slope = weight * pull;
                if slope != 0.0 && slope.is_finite() {
                    self.knots[knot][k] -= weight * adam(&mut self.moments[knot][k], slope, sizes[k]);
                }
            }
        }
    }
}

/// A step of Adam: moments and steps so far, slope, size of a step.
fn adam([first, second, steps]: &mut [f64; 3], slope: f64, rate: f64) -> f64 {
    let [one, two] = LOOSE.betas;
    *steps += 1.0;
    *first += (1.0 - one) * (slope - *first);
    *second += (1.0 - two) * (slope * slope - *second);
    let (mean, square) = (*first / (1.0 - one.powf(*steps)), *second / (1.0 - two.powf(*steps)));
    rate * mean / square.sqrt().max(f64::MIN_POSITIVE)
}

/// What pieces may do.
#[derive(Clone, Copy)]
pub(super) enum Freedom<'a> {
    /// Each moves by itself.
    Loose,
    /// All rest.
    Rest,
    /// The last one moves as a joint lets it, the others rest.
    Last(&'a LooseJoint),
}

/// What all trainings of a search see.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) pieces: &'a Pieces,
    /// When all views were taken.
    pub(super) times: &'a [f64],
    /// Views to train on.
    pub(super) views: &'a [usize],
    pub(super) seed: u64,
}

impl<'a> LooseTraining<'a> {
    /// Grey Gaussians at the points of the pieces.
    pub(super) fn new(seen: Seen<'a>, freedom: Freedom) -> Result<Self> {
        let Seen { dataset, pieces, times, views, seed } = seen;
        let start = Dataset {
            views: dataset.views.iter().map(|v| splat::View { levels: Vec::new(), ..v.clone() }).collect(),
            points: pieces.points.iter().map(|&p| (p, [128; 3])).collect(),
            articulation: Some(MovingParts { of_points: pieces.labels.clone(), ..MovingParts::default() }),
            ..*dataset
        };
        let mut gaussians = MovedGaussians::of(&start, pieces.points.len().max(1), seed)?;
        gaussians.set_sh_degree(LOOSE.sh_degree)?;
        let times = in_stretches(times);
        let all = 0..pieces.centres.len();
        let loose = matches!(freedom, Freedom::Loose);
        let mut moving: Vec<MovingPiece> = all.clone().map(|k| MovingPiece::new(pieces, k, loose)).collect();
        if let (Freedom::Last(joint), Some(last)) = (freedom, moving.last_mut()) {
            last.follow(joint, &times);
        }
        Ok(Self {
            dataset,
            views: views.to_vec(),
            times,
            gaussians,
            pieces: moving,
            told: all.map(|k| pieces.own(k).take(LOOSE.told).map(|p| p.as_dvec3()).collect()).collect(),
            pixel: MovedGaussians::pixel(dataset),
            seed,
        })
    }

    /// Takes all steps.
    pub(super) fn run(&mut self, progress: &Progress) -> Result<()> {
        let [steps, schedule] = LOOSE.steps;
        progress.begin("look for parts", steps as usize);
        let mut order = Vec::new();
        for step in 0..steps {
            if order.is_empty() {
                order.clone_from(&self.views);
                order.shuffle(&mut rng(self.seed, "loose", u64::from(step)));
            }
            let view = order.pop().unwrap_or_default();
            let position = f64::from(step) / f64::from(schedule);
            self.step(view, position)?;
            progress.tick()?;
        }
        Ok(())
    }

    fn step(&mut self, view: usize, position: f64) -> Result<()> {
        let level = if position < LOOSE.half_from { 2 } else { 1 };
        let (pixels, camera) = photo(self.dataset, view, level);
        let steps = f64::from(LOOSE.steps[1]);
        let input = StepInput {
            view: &camera,
            target: Target {
                rgb: &pixels.rgb,
                mask: pixels.mask.as_deref(),
                transparent: self.dataset.alpha == AlphaMode::Transparent,
                photo: None,
            },
            options: RenderOptions::default(),
            rates: MovedGaussians::rates(self.pixel, position, steps),
            lambda_dssim: LOOSE.lambda_dssim,
        };
        let time = self.times[view];
        let knots: Vec<Knot> = self.pieces.iter().map(|p| p.knot(time)).collect();
        let poses: Vec<Pose> = self.pieces.iter().zip(&knots).map(|(p, k)| p.pose(k)).collect();
        let moved = self.moved(&poses);
        let (mut gradient, mut tint) = (moved.clone(), self.lit(&knots));
        self.gaussians.step(&input, &mut gradient, &mut tint)?;
        let pulls = self.pulls(&moved, &gradient, &tint, &poses);
        let sizes = [fall(LOOSE.steps_deg, position).to_radians(), fall(LOOSE.steps_light, position)];
        for (piece, pull) in self.pieces.iter_mut().zip(&pulls) {
            piece.step(time, pull, sizes);
        }
        Ok(())
    }

    /// What the light of the pieces adds to the constant terms of the harmonics, [N × 3].
    fn lit(&self, knots: &[Knot]) -> Vec<f32> {
        let model = self.gaussians.model();
        let each = model.part.iter().enumerate();
        each.flat_map(|(i, &piece)| colour(model, i).map(|c| knots[usize::from(piece)][LIGHT] as f32 * c))
            .collect()
    }

    /// The geometry where the pieces stand.
    fn moved(&self, poses: &[Pose]) -> Planes {
        let model = self.gaussians.model();
        let mut out = model.geometry.clone();
        let poses: Vec<(Quat, Vec3)> =
            poses.iter().map(|p| (p.rotation.as_quat(), p.translation.as_vec3())).collect();
        for (i, &piece) in model.part.iter().enumerate() {
            let (rotation, translation) = poses[usize::from(piece)];
            let x = rotation * place(&out, i) + translation;
            let [w, a, b, c] = quaternion(&out, i).to_array();
            let turned = rotation * Quat::from_xyzw(a, b, c, w);
            (0..3).for_each(|k| out[PLACES[0] + k][i] = x[k]);
            let turned = [turned.w, turned.x, turned.y, turned.z];
            (0..4).for_each(|k| out[PLACES[1] + k][i] = turned[k]);
        }
        out
    }

    /// What pulls at each piece: the derivative by a translation, by a turn about where its centre
    /// stands, and by its light.
    fn pulls(&self, moved: &Planes, gradient: &Planes, tint: &[f32], poses: &[Pose]) -> Vec<Knot> {
        let model = self.gaussians.model();
        let mut out = vec![Knot::default(); self.pieces.len()];
        let centres: Vec<DVec3> =
            self.pieces.iter().zip(poses).map(|(piece, pose)| pose.transform(piece.centre)).collect();
        for (i, &piece) in model.part.iter().enumerate() {
            let piece = usize::from(piece);
            let force = place(gradient, i).as_dvec3();
            let arm = place(moved, i).as_dvec3() - centres[piece];
            let torque = arm.cross(force) + torque(quaternion(moved, i), quaternion(gradient, i));
            let light = colour(model, i).iter().zip(&tint[3 * i..]).map(|(c, g)| f64::from(c * g)).sum();
            let add = [force.x, force.y, force.z, torque.x, torque.y, torque.z, light];
            out[piece].iter_mut().zip(add).for_each(|(sum, v)| *sum += v);
        }
        out
    }

    /// How much larger the errors of some training views are where a piece rests at its mean place,
    /// as a share; by piece.
    pub(super) fn gains(&mut self) -> Result<Vec<f64>> {
        let count = LOOSE.gain_views.min(self.views.len());
        let views: Vec<usize> =
            (0..count).map(|k| self.views[(2 * k + 1) * self.views.len() / (2 * count)]).collect();
        let with = total(&self.errors(&views, None)?).max(f64::MIN_POSITIVE);
        (0..self.pieces.len()).map(|k| Ok(total(&self.errors(&views, Some(k))?) / with - 1.0)).collect()
    }

    /// Squared errors of views, and how many pixels count; one of the pieces at rest.
    pub(super) fn errors(&mut self, views: &[usize], rests: Option<usize>) -> Result<Vec<[f64; 2]>> {
        let mut out = Vec::new();
        for &view in views {
            let time = self.times[view];
            let pieces = self.pieces.iter().enumerate();
            let knots: Vec<Knot> = pieces.map(|(k, piece)| piece.seen(time, rests == Some(k))).collect();
            let poses: Vec<Pose> = self.pieces.iter().zip(&knots).map(|(p, k)| p.pose(k)).collect();
            let (mut moved, tint) = (self.moved(&poses), self.lit(&knots));
            let (pixels, camera) = photo(self.dataset, view, LOOSE.judged_level);
            let picture = self.gaussians.render(&mut moved, &tint, &camera, &RenderOptions::default())?;
            let [error, pixels] = square_error(&picture.rgb.data, pixels, self.dataset.alpha);
            out.push([error, pixels * 4f64.powi(LOOSE.judged_level as i32)]);
        }
        Ok(out)
    }

    /// The pieces with their motions in the views of the data set.
    pub(super) fn pieces(&self) -> Vec<LoosePiece> {
        let each = self.pieces.iter().zip(&self.told);
        each.map(|(piece, points)| LoosePiece {
            points: points.clone(),
            poses: self.times.iter().map(|&t| piece.pose(&piece.knot(t))).collect(),
        })
        .collect()
    }
}

fn place(planes: &Planes, i: usize) -> Vec3 {
    Vec3::from([0, 1, 2].map(|k| planes[PLACES[0] + k][i]))
}

/// As (w, x, y, z).
fn quaternion(planes: &Planes, i: usize) -> glam::Vec4 {
    glam::Vec4::from([0, 1, 2, 3].map(|k| planes[PLACES[1] + k][i]))
}

/// dL/d(rotation vector) of a turn before a quaternion `q`, from dL/dq: `dq = ½ (0, ω) q`.
fn torque(q: glam::Vec4, gradient: glam::Vec4) -> DVec3 {
    let ((w, v), (gw, gv)) = (split(q), split(gradient));
    0.5 * (w * gv - gw * v + v.cross(gv))
}

/// Real and imaginary part.
fn split(v: glam::Vec4) -> (f64, DVec3) {
    (f64::from(v.x), DVec3::new(v.y.into(), v.z.into(), v.w.into()))
}

/// A size that falls over the schedule.
fn fall([first, last]: [f64; 2], position: f64) -> f64 {
    first * (last / first).powf(position)
}

/// What a factor of a Gaussian's colour counts in, constant terms of its harmonics.
fn colour(model: &Model, i: usize) -> [f32; 3] {
    let stride = model.sh.len() / model.len;
    [0, 1, 2].map(|c| model.sh[stride * i + c] + 0.5 / SH_C0)
}

/// The sum of the errors of views.
pub(super) fn total(errors: &[[f64; 2]]) -> f64 {
    errors.iter().map(|[error, _]| error).sum()
}

/// Mean squared error of a picture over the pixels of a photo that count, and how many these are.
/// A matte that lets the background through is compared over black.
fn square_error(rgb: &[f32], photo: &Pixels, alpha: AlphaMode) -> [f64; 2] {
    let (mut sum, mut pixels) = (0.0, 0.0);
    for (i, (picture, truth)) in rgb.chunks_exact(3).zip(photo.rgb.chunks_exact(3)).enumerate() {
        let kept = photo.mask.as_ref().map_or(1.0, |m| f64::from(m[i]) / 255.0);
        let (weight, cover) = if alpha == AlphaMode::Ignore { (kept, 1.0) } else { (1.0, kept) };
        let squares = picture.iter().zip(truth).map(|(p, t)| {
            let error = f64::from(*p) - cover * f64::from(*t) / 255.0;
            error * error
        });
        sum += weight * squares.sum::<f64>() / 3.0;
        pixels += kept;
    }
    [sum / pixels.max(1.0), pixels]
}

/// A view's photo at a level, or the coarsest there is.
fn photo(dataset: &Dataset, view: usize, level: usize) -> (&Pixels, splat::PinholeView) {
    let view = &dataset.views[view];
    let level = level.min(view.levels.len().saturating_sub(1));
    (&view.levels[level], view.view.at_level(level as u32))
}

/// Times as multiples of the stretches between knots, the first at 0.
fn in_stretches(times: &[f64]) -> Vec<f64> {
    let first = times.iter().copied().fold(f64::INFINITY, f64::min);
    let last = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let stretch = ((last - first) / LOOSE.stretches as f64).max(f64::MIN_POSITIVE);
    times.iter().map(|t| ((t - first) / stretch).min(LOOSE.stretches as f64)).collect()
}

/// A value between known ones, by a line; beyond the ends as there.
pub(super) fn between(known: &[(f64, f64)], at: f64) -> f64 {
    let after = known.partition_point(|(k, _)| *k < at);
    match (after.checked_sub(1).and_then(|k| known.get(k)), known.get(after)) {
        (Some(&(a, x)), Some(&(b, y))) => x + (y - x) * (at - a) / (b - a),
        (Some(&(_, x)), None) | (None, Some(&(_, x))) => x,
        (None, None) => 0.0,
    }
}
