//! A plane that many images see much of: the ground or the table below an object.

use crate::incremental::state::{MapPoint, MapState, MappingInput};
use crate::limits::{FEW_OBSERVATIONS, FEWEST_VIEWS};
use crate::solvers::linalg::{moments, solve_spd, symmetric_eigen};
use crate::statistics::median;
use glam::{DQuat, DVec2, DVec3};
use rand::Rng as _;
use rayon::prelude::*;
use scene::Pose;
use scene::rng::rng;
use std::collections::HashMap;

/// Triples of points that are tried.
/// Source: chosen by hand, never measured.
const TRIALS: usize = 1000;
/// Points and images count by how much of the images they cover, in squares of this share of the
/// longer side.
/// Source: chosen by hand, never measured.
const SQUARE: f64 = 0.05;
/// Share of the images that have to see some of them.
/// Source: chosen by hand, never measured.
const SEEN_BY: f64 = 0.6;
/// Cameras are level if they leave their plane by less than this share of their extent. What they
/// look at stands on ground that is level too, more often than not.
/// Source: chosen by hand, never measured; planes through any three points were worse (decision
/// 0028).
const FLAT: f64 = 0.03;
/// They go round something if their plane has this share of their extent in both directions.
/// Source: chosen by hand, never measured.
const ROUND: f64 = 0.4;
/// What is seen of a plane is counted in so many squares each way, along as many rays of an image.
/// Source: chosen by hand, never measured.
const SQUARES: usize = 64;
/// They reach up to so many typical distances of a camera from the plane.
/// Source: chosen by hand, never measured.
const FARTHEST: f64 = 2.0;
/// What this share of the images shows is looked at.
/// Source: chosen by hand, never measured.
const SHARED: f64 = 0.33;

/// A plane with a frame of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScenePlane {
    /// In the middle of what is seen of it.
    pub origin: DVec3,
    /// Unit vectors in the plane, at right angles.
    pub axes: [DVec3; 2],
    /// What is seen lies within this of the origin, in both directions of both axes.
    pub reach: f64,
}

impl ScenePlane {
    /// Unit normal.
    pub(crate) fn normal(&self) -> DVec3 {
        self.axes[0].cross(self.axes[1])
    }

    /// The one through a point with a normal.
    fn across(normal: DVec3, origin: DVec3) -> Self {
        let (u, v) = normal.any_orthonormal_pair();
        Self { origin, axes: [u, v], reach: 0.0 }
    }

    fn through(points: [DVec3; 3]) -> Option<Self> {
        let (a, b) = (points[1] - points[0], points[2] - points[0]);
        let normal = a.cross(b);
        let thin = 0.05 * a.length_squared().max(b.length_squared()).max(a.distance_squared(b));
        let u = a.try_normalize()?;
        let v = normal.try_normalize()?.cross(u);
        (normal.length() > thin).then_some(Self { origin: points[0], axes: [u, v], reach: 0.0 })
    }

    /// The plane that places of this one lie in when they are known better: least squares, without
    /// those far from it.
    pub(crate) fn closer(&self, places: &[DVec3]) -> Option<Self> {
        let mut kept = places.to_vec();
        let mut plane = *self;
        for _ in 0..3 {
            if kept.len() < 3 {
                return None;
            }
            let (middle, _, normal) = spread_of(&kept);
            let normal = if normal.dot(self.normal()) < 0.0 { -normal } else { normal };
            let turn = DQuat::from_rotation_arc(plane.normal(), normal);
            let origin = plane.origin + normal * normal.dot(middle - plane.origin);
            plane = Self { origin, axes: plane.axes.map(|a| turn * a), ..plane };
            let far: Vec<f64> = places.iter().map(|x| normal.dot(*x - origin).abs()).collect();
            let usual = median(far.clone());
            kept = places.iter().zip(&far).filter(|(_, f)| **f <= 3.0 * usual).map(|(x, _)| *x).collect();
        }
        Some(plane)
    }

    /// The part of it about some places.
    pub(crate) fn about(&self, places: &[DVec3], margin: f64) -> Self {
        let [u, v] = self.axes.map(|axis| {
            let at = places.iter().map(|x| axis.dot(*x - self.origin));
            at.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), a| (low.min(a), high.max(a)))
        });
        let reach = 0.5 * (u.1 - u.0).max(v.1 - v.0) + margin;
        if !(reach < self.reach) {
            return *self;
        }
        let origin = self.origin + self.axes[0] * 0.5 * (u.0 + u.1) + self.axes[1] * 0.5 * (v.0 + v.1);
        Self { origin, reach, ..*self }
    }

    /// Turned by two small angles about its axes and shifted along its normal.
    fn perturb(&self, by: [f64; 3]) -> Self {
        let q = DQuat::from_scaled_axis(self.axes[0] * by[0] + self.axes[1] * by[1]);
        Self { origin: self.origin + self.normal() * by[2], axes: self.axes.map(|a| q * a), ..*self }
    }

    /// Where a ray meets it.
    fn intersect(&self, from: DVec3, along: DVec3) -> Option<DVec3> {
        let n = self.normal();
        let far = n.dot(self.origin - from) / n.dot(along);
        (far.is_finite() && far > 0.0).then(|| from + along * far)
    }
}

/// A point of the model with the ray of its first observation.
struct PointRay<'a> {
    point: &'a MapPoint,
    centre: DVec3,
    ray: DVec3,
    /// How much of the images it covers beside others.
    weight: f64,
}

/// What is asked about planes.
struct PlanePoints<'a> {
    all: Vec<PointRay<'a>>,
    state: &'a MapState,
    input: &'a MappingInput<'a>,
}

/// The plane that covers most of the images; `None` where none covers much.
pub(crate) fn widest(state: &MapState, input: &MappingInput<'_>) -> Option<ScenePlane> {
    let points = PlanePoints::new(state, input);
    if points.all.len() < FEW_OBSERVATIONS {
        return None;
    }
    let level = level_of(state);
    let sums = points.cumulative_weights();
    let best = (0..TRIALS)
        .into_par_iter()
        .filter_map(|k| {
            let plane = points.sample_plane(k, level, &sums)?;
            let score: f64 = points.fitting(&plane).map(|p| p.weight).sum();
            points.has_cameras_on_one_side(&plane).then_some((score, k, plane))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    let plane = points.refine_plane(points.refine_plane(best.2));
    let mut fitting: Vec<&PointRay<'_>> = points.fitting(&plane).collect();
    fitting.retain(|p| plane.intersect(p.centre, p.ray).is_some());
    let mut seen = vec![0usize; state.poses.len()];
    fitting.iter().flat_map(|p| &p.point.views).for_each(|v| seen[v[0] as usize] += 1);
    let seeing = seen.iter().filter(|n| **n >= FEWEST_VIEWS).count();
    let enough =
        fitting.len() >= FEW_OBSERVATIONS && seeing as f64 >= SEEN_BY * state.registered_count() as f64;
    if enough { frame_plane(plane, &points) } else { None }
}

/// The normal of the plane in which the cameras are, where they go round something.
fn level_of(state: &MapState) -> Option<DVec3> {
    let centres: Vec<DVec3> = state.poses.iter().flatten().map(Pose::centre).collect();
    let (_, [across, narrow, wide], normal) = spread_of(&centres);
    let round = across.max(0.0).sqrt() < FLAT * wide.sqrt() && narrow.sqrt() > ROUND * wide.sqrt();
    round.then_some(normal)
}

/// Mean of points, their sums of squares along their principal axes, ascending, and the axis along
/// which they spread least.
fn spread_of(points: &[DVec3]) -> (DVec3, [f64; 3], DVec3) {
    let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let (values, axes) = symmetric_eigen(&moments(points.iter().map(|x| (1.0, *x - middle))));
    (middle, values, DVec3::from_array(axes[0]))
}

/// The same plane with its origin in the middle of what many images show of it, and its reach about
/// that; `None` where they show nothing.
fn frame_plane(plane: ScenePlane, points: &PlanePoints<'_>) -> Option<ScenePlane> {
    let (state, input) = (points.state, points.input);
    let far: Vec<f64> = state.poses.iter().flatten().map(|p| p.centre().distance(plane.origin)).collect();
    let square = 2.0 * FARTHEST * median(far) / SQUARES as f64;
    let mut seen = vec![0usize; SQUARES * SQUARES];
    for (image, pose) in state.poses.iter().enumerate() {
        let Some(pose) = pose else { continue };
        let camera = &state.cameras[input.camera_of[image]];
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        let mut own = Vec::new();
        for k in 0..SQUARES * SQUARES {
            let at = DVec2::new((k % SQUARES) as f64 + 0.5, (k / SQUARES) as f64 + 0.5) / SQUARES as f64;
            let ray = pose.rotation.conjugate() * camera.ray(at * size);
            let Some(x) = plane.intersect(pose.centre(), ray) else { continue };
            let [u, v] = plane.axes.map(|a| a.dot(x - plane.origin) / square + 0.5 * SQUARES as f64);
            let inside = 0.0..SQUARES as f64;
            if inside.contains(&u) && inside.contains(&v) {
                own.push(v as usize * SQUARES + u as usize);
            }
        }
        own.sort_unstable();
        own.dedup();
        own.into_iter().for_each(|k| seen[k] += 1);
    }
    let least = SHARED * state.registered_count() as f64;
    let kept: Vec<usize> = (0..seen.len()).filter(|k| seen[*k] as f64 >= least).collect();
    let u = range_of(kept.iter().map(|k| k % SQUARES), square)?;
    let v = range_of(kept.iter().map(|k| k / SQUARES), square)?;
    let [du, dv] = [u, v].map(|r| 0.5 * (r.0 + r.1) - 0.5 * SQUARES as f64 * square);
    let origin = plane.origin + plane.axes[0] * du + plane.axes[1] * dv;
    Some(ScenePlane { origin, reach: 0.5 * (u.1 - u.0).max(v.1 - v.0), ..plane })
}

/// From where to where some squares lie.
fn range_of(squares: impl Iterator<Item = usize> + Clone, size: f64) -> Option<(f64, f64)> {
    Some((squares.clone().min()? as f64 * size, (squares.max()? + 1) as f64 * size))
}

impl<'a> PlanePoints<'a> {
    fn new(state: &'a MapState, input: &'a MappingInput<'a>) -> Self {
        let mut crowd: HashMap<(u32, i32, i32), f64> = HashMap::new();
        for view in state.live().flat_map(|(_, p)| &p.views) {
            *crowd.entry(square_of(*view, state, input)).or_default() += 1.0;
        }
        let mut all = Vec::new();
        for (_, point) in state.live() {
            let Some(&[image, feature]) = point.views.first() else { continue };
            let Some(pose) = state.poses[image as usize] else { continue };
            let camera = &state.cameras[input.camera_of[image as usize]];
            let pixel = input.keypoints[image as usize][feature as usize];
            let ray = pose.rotation.conjugate() * camera.ray(pixel);
            let weight = point.views.iter().map(|v| 1.0 / crowd[&square_of(*v, state, input)]).sum();
            all.push(PointRay { point, centre: pose.centre(), ray, weight });
        }
        Self { all, state, input }
    }

    /// Sums of the weights of all points up to each.
    fn cumulative_weights(&self) -> Vec<f64> {
        let mut below = 0.0;
        let mut sums = Vec::with_capacity(self.all.len());
        for p in &self.all {
            below += p.weight;
            sums.push(below);
        }
        sums
    }

    /// The k-th plane that is tried: through three points drawn by their weights, or through one
    /// across a known normal.
    fn sample_plane(&self, k: usize, level: Option<DVec3>, sums: &[f64]) -> Option<ScenePlane> {
        let mut rng = rng(self.input.seed, "plane", k as u64);
        let total = sums.last()?;
        let three = std::array::from_fn(|_| {
            let at = total * rng.random::<f64>();
            self.all[sums.partition_point(|s| *s <= at).min(sums.len() - 1)].point.position
        });
        match level {
            Some(normal) => Some(ScenePlane::across(normal, three[0])),
            None => ScenePlane::through(three),
        }
    }

    /// Reprojection errors of the other observations of a point that is put where its first ray
    /// meets the plane.
    fn errors<'b>(
        &'b self,
        p: &'b PointRay<'a>,
        plane: &ScenePlane,
    ) -> Option<impl Iterator<Item = Option<DVec2>> + 'b> {
        let x = plane.intersect(p.centre, p.ray)?;
        Some(p.point.views[1..].iter().map(move |&[image, feature]| {
            let pose = self.state.poses[image as usize]?;
            let camera = &self.state.cameras[self.input.camera_of[image as usize]];
            let seen = self.input.keypoints[image as usize][feature as usize];
            Some(camera.project(pose.transform(x))? - seen)
        }))
    }

    /// Points in the plane: their observations, taken to it along the first one's ray, are nowhere
    /// farther off than an observation of the model may be.
    fn fitting<'b>(&'b self, plane: &'b ScenePlane) -> impl Iterator<Item = &'b PointRay<'a>> + 'b {
        let most = self.input.config.max_reprojection_px.powi(2);
        self.all.iter().filter(move |p| {
            let mut errors = self.errors(p, plane).into_iter().flatten().peekable();
            errors.peek().is_some() && errors.all(|e| e.is_some_and(|e| e.length_squared() < most))
        })
    }

    /// Whether nearly all cameras look at the same side of it.
    fn has_cameras_on_one_side(&self, plane: &ScenePlane) -> bool {
        let n = plane.normal();
        let centres = self.state.poses.iter().flatten().map(|p| n.dot(p.centre() - plane.origin));
        let (mut above, mut all) = (0, 0);
        centres.for_each(|d| (above, all) = (above + usize::from(d > 0.0), all + 1));
        above * 20 <= all || above * 20 >= 19 * all
    }

    /// The plane that its points' observations agree with best: Gauss–Newton on their errors, with
    /// Huber's weights.
    fn refine_plane(&self, plane: ScenePlane) -> ScenePlane {
        let start = plane;
        let mut plane = plane;
        let fitting: Vec<&PointRay<'_>> = self.fitting(&start).collect();
        let distances = fitting.iter().map(|p| p.point.position.distance(plane.origin)).collect();
        let size = median(distances);
        if fitting.len() < 3 || size == 0.0 {
            return plane;
        }
        for _ in 0..6 {
            let step = [1e-4, 1e-4, 1e-4 * size];
            let now = self.residuals(&fitting, &plane);
            let by: [Vec<DVec2>; 3] = std::array::from_fn(|k| {
                let mut d = [0.0; 3];
                d[k] = step[k];
                self.residuals(&fitting, &plane.perturb(d))
                    .iter()
                    .zip(&now)
                    .map(|(a, b)| (*a - *b) / step[k])
                    .collect()
            });
            let (mut h, mut g) = ([[0.0; 3]; 3], [0.0; 3]);
            for (i, e) in now.iter().enumerate() {
                let w = 1.0 / e.length().max(1.0);
                for a in 0..3 {
                    g[a] -= w * by[a][i].dot(*e);
                    (0..3).for_each(|b| h[a][b] += w * by[a][i].dot(by[b][i]));
                }
            }
            let Some(d) = solve_spd(&h, &g) else { break };
            plane = plane.perturb(d);
        }
        plane
    }

    /// All errors of some points at a plane; 0 where they are not seen.
    fn residuals(&self, points: &[&PointRay<'a>], plane: &ScenePlane) -> Vec<DVec2> {
        let mut all = Vec::new();
        for p in points {
            match self.errors(p, plane) {
                Some(errors) => all.extend(errors.map(Option::unwrap_or_default)),
                None => all.resize(all.len() + p.point.views.len() - 1, DVec2::ZERO),
            }
        }
        all
    }
}

/// The image of an observation and the square of it in which it lies.
fn square_of([image, feature]: [u32; 2], state: &MapState, input: &MappingInput<'_>) -> (u32, i32, i32) {
    let camera = &state.cameras[input.camera_of[image as usize]];
    let side = SQUARE * f64::from(camera.width.max(camera.height));
    let p = (input.keypoints[image as usize][feature as usize] / side).floor();
    (image, p.x as i32, p.y as i32)
}
