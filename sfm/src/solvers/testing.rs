//! Random scenes with known truth for the tests of solvers, RANSAC and verification.

use glam::{DQuat, DVec2, DVec3};
use rand::Rng as _;
use scene::Pose;
use scene::rng::{Rng, rng};

/// Two cameras at `z = 1` coordinates and the points they see.
pub(crate) struct TwoViews {
    /// Relative pose, translation as it is (not unit).
    pub b_from_a: Pose,
    /// Points in frame a.
    pub points: Vec<DVec3>,
    /// Normalised coordinates in a.
    pub a: Vec<DVec2>,
    /// Normalised coordinates in b.
    pub b: Vec<DVec2>,
}

/// What the points look like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Shape {
    /// In a box.
    General,
    /// On a slanted plane.
    Plane,
    /// On a line.
    Line,
    /// General, cameras in one place.
    NoBaseline,
    /// So far away that parallax vanishes.
    Infinity,
}

pub(crate) fn unit_vector(r: &mut Rng) -> DVec3 {
    loop {
        let v = DVec3::new(r.random_range(-1.0..1.0), r.random_range(-1.0..1.0), r.random_range(-1.0..1.0));
        if v.length() > 0.1 && v.length() < 1.0 {
            return v.normalize();
        }
    }
}

pub(crate) fn rotation(r: &mut Rng, max_angle: f64) -> DQuat {
    DQuat::from_axis_angle(unit_vector(r), r.random_range(0.2..1.0) * max_angle)
}

/// `n` points seen by two cameras that both look at them from about five units of `unit`.
pub(crate) fn two_views(seed: u64, n: usize, shape: Shape, unit: f64) -> TwoViews {
    let mut r = rng(seed, "two views", 0);
    // An axis across the view, so that there is a baseline.
    let axis = DVec3::new(r.random_range(-1.0..1.0), 1.0, r.random_range(-0.5..0.5)).normalize();
    let turn = DQuat::from_axis_angle(axis, r.random_range(0.15..0.5));
    let centre = DVec3::new(0.0, 0.0, 5.0);
    // Camera b turns about the middle of the scene, so that it sees it too.
    let mut translation = centre - turn * centre + 0.3 * unit_vector(&mut r);
    if shape == Shape::NoBaseline {
        translation = DVec3::ZERO;
    }
    let normal = DVec3::new(r.random_range(-0.5..0.5), r.random_range(-0.5..0.5), -1.0).normalize();
    let direction = DVec3::new(1.0, r.random_range(-1.0..1.0), r.random_range(-1.0..1.0));
    let points: Vec<DVec3> = (0..n)
        .map(|_| {
            let offset =
                DVec3::new(r.random_range(-1.5..1.5), r.random_range(-1.5..1.5), r.random_range(-1.5..1.5));
            match shape {
                Shape::General | Shape::NoBaseline => centre + offset,
                Shape::Plane => centre + offset - normal * normal.dot(offset),
                Shape::Line => centre + direction * offset.x,
                Shape::Infinity => (centre + offset) * 1e9,
            }
        })
        .collect();
    let b_from_a = Pose::new(turn, translation * unit);
    let points: Vec<DVec3> = points.into_iter().map(|p| p * unit).collect();
    let project = |x: DVec3| x.truncate() / x.z;
    let a = points.iter().map(|x| project(*x)).collect();
    let b = points.iter().map(|x| project(b_from_a.transform(*x))).collect();
    TwoViews { b_from_a, points, a, b }
}

/// Angle between two directions, radians.
pub(crate) fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// A number from the normal distribution (Box–Muller).
pub(crate) fn normal(r: &mut Rng) -> f64 {
    let u: f64 = r.random_range(f64::MIN_POSITIVE..1.0);
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * r.random_range(0.0..1.0)).cos()
}

pub(crate) fn array<const N: usize, T: Copy>(v: &[T]) -> [T; N] {
    std::array::from_fn(|i| v[i])
}
