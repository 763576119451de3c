//! Cameras on a circle: turntables, orbits, and objects that turn before a camera that stands
//! still.

mod sequence;

pub use sequence::{Closure, RingClosure, RingSequence};

use crate::Pose;
use crate::sim3::least_eigenvector;
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// The circle through camera centres and where on it each of them stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Ring {
    /// Centre of the circle, world frame.
    pub centre: DVec3,
    /// Its axis, unit, on the side that is up in most images.
    pub axis: DVec3,
    /// Its radius, scene units.
    pub radius: f64,
    /// One per pose, radians about the axis, counted on over full turns: each lies within π of the
    /// one before.
    pub angles: Vec<f64>,
    /// Root mean square distance of the centres from the circle, in radii.
    pub misfit: f64,
}

/// An arc of a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arc {
    /// Its angle, radians, not negative.
    pub angle: f64,
    /// The poses at its ends, by their place in what the ring was fitted to.
    pub ends: [usize; 2],
}

impl Ring {
    /// The plane through the centres (least squares) and in it the circle of least algebraic error
    /// (Kåsa 1976). `poses` are `cam_from_world`, in the order of filming. `None` with fewer than
    /// four poses, or where their centres lie on a line or are not finite.
    pub fn fit(poses: &[Pose]) -> Option<Self> {
        if poses.len() < 4 {
            return None;
        }
        let centres: Vec<DVec3> = poses.iter().map(Pose::centre).collect();
        let n = centres.len() as f64;
        let mean = centres.iter().sum::<DVec3>() / n;
        let size = centres.iter().map(|c| c.distance(mean)).fold(0.0, f64::max);
        if !(size.is_finite() && size > 0.0) {
            return None;
        }
        let flat: Vec<DVec3> = centres.iter().map(|c| (*c - mean) / size).collect();
        let mut axis = normal(&flat);
        let up: DVec3 = poses.iter().map(|p| p.rotation.conjugate() * -DVec3::Y).sum();
        if axis.dot(up) < 0.0 {
            axis = -axis;
        }
        let (x, y) = axis.any_orthonormal_pair();
        let plane: Vec<DVec2> = flat.iter().map(|c| DVec2::new(c.dot(x), c.dot(y))).collect();
        let (centre, radius) = circle(&plane)?;
        let off = flat.iter().zip(&plane);
        let off = off.map(|(c, p)| c.dot(axis).powi(2) + ((*p - centre).length() - radius).powi(2));
        let misfit = (off.sum::<f64>() / n).sqrt() / radius;
        let angles = unwrapped(plane.iter().map(|p| (*p - centre).to_angle()));
        Some(Self {
            centre: mean + (x * centre.x + y * centre.y) * size,
            axis,
            radius: radius * size,
            angles,
            misfit,
        })
    }

    /// The largest arc without a camera; a full turn's poses leave one about as wide as their step.
    pub(crate) fn largest_gap(&self) -> Arc {
        let mut order: Vec<usize> = (0..self.angles.len()).collect();
        let at: Vec<f64> = self.angles.iter().map(|a| a.rem_euclid(TAU)).collect();
        order.sort_by(|&a, &b| at[a].total_cmp(&at[b]));
        let pairs = order.iter().zip(order.iter().cycle().skip(1));
        let arcs = pairs.map(|(&a, &b)| Arc { angle: (at[b] - at[a]).rem_euclid(TAU), ends: [a, b] });
        arcs.max_by(|a, b| a.angle.total_cmp(&b.angle)).unwrap_or(Arc { angle: TAU, ends: [0, 0] })
    }

    /// The largest and the median angle between poses that follow each other, for one unit of
    /// `places`: where in the sequence each pose stands (ascending), so that a frame that is
    /// missing does not look like a jump.
    pub fn steps(&self, places: &[f64]) -> (Arc, f64) {
        let mut steps: Vec<Arc> = (1..self.angles.len().min(places.len()))
            .filter(|&i| places[i] > places[i - 1])
            .map(|i| {
                let turn = (self.angles[i] - self.angles[i - 1]).abs();
                Arc { angle: turn / (places[i] - places[i - 1]), ends: [i - 1, i] }
            })
            .collect();
        steps.sort_by(|a, b| a.angle.total_cmp(&b.angle));
        let last = steps.last().copied().unwrap_or(Arc { angle: 0.0, ends: [0, 0] });
        (last, steps.get(steps.len() / 2).map_or(0.0, |s| s.angle))
    }

    /// The steady rate that fits the angles best (least squares), radians for one unit of `places`,
    /// and how far each angle is from it, radians.
    pub fn steadiness(&self, places: &[f64]) -> (f64, Vec<f64>) {
        let n = self.angles.len().max(1) as f64;
        let (x0, y0) = (places.iter().sum::<f64>() / n, self.angles.iter().sum::<f64>() / n);
        let pairs = places.iter().map(|x| x - x0).zip(self.angles.iter().map(|y| y - y0));
        let (xy, xx) = pairs.clone().fold((0.0, 0.0), |(xy, xx), (x, y)| (xy + x * y, xx + x * x));
        let rate = if xx > 0.0 { xy / xx } else { 0.0 };
        (rate, pairs.map(|(x, y)| y - rate * x).collect())
    }
}

/// The direction in which points with mean zero spread least.
fn normal(points: &[DVec3]) -> DVec3 {
    let mut spread = DMat3::ZERO;
    points.iter().for_each(|d| spread += DMat3::from_cols(*d * d.x, *d * d.y, *d * d.z));
    least_eigenvector(spread)
}

/// Centre and radius that minimise `Σ (|p|² − 2 c·p − k)²`, `k = r² − |c|²`.
fn circle(points: &[DVec2]) -> Option<(DVec2, f64)> {
    let (mut m, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for p in points {
        let row = DVec3::new(2.0 * p.x, 2.0 * p.y, 1.0);
        m += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        b += row * p.length_squared();
    }
    let n = points.len() as f64;
    let (m, b) = (m * (1.0 / n), b / n);
    if m.determinant().abs() < 1e-12 {
        return None; // on a line
    }
    let s = m.inverse() * b;
    let centre = DVec2::new(s.x, s.y);
    let radius = (s.z + centre.length_squared()).sqrt();
    (radius.is_finite() && radius > 0.0 && centre.is_finite()).then_some((centre, radius))
}

fn unwrapped(angles: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut previous: Option<f64> = None;
    let steady = angles.map(|angle| {
        let turned = previous.map_or(angle, |p| p + (angle - p + PI).rem_euclid(TAU) - PI);
        previous = Some(turned);
        turned
    });
    steady.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Poses at these angles (degrees) on a tilted circle of radius 3.
    fn poses(angles: &[f64]) -> Vec<Pose> {
        let axis = DVec3::new(0.2, 0.3, 0.9).normalize();
        let (x, y) = axis.any_orthonormal_pair();
        let focus = DVec3::new(5.0, -2.0, 1.0);
        let at = |a: f64| focus + axis * 0.7 + (x * a.cos() + y * a.sin()) * 3.0;
        angles.iter().map(|a| Pose::look_at(at(a.to_radians()), focus, axis)).collect()
    }

    #[test]
    fn a_turn_and_a_half_is_counted_on_and_its_circle_found() {
        let angles: Vec<f64> = (0..55).map(|i| f64::from(i) * 10.0).collect();
        let ring = Ring::fit(&poses(&angles)).unwrap();
        assert!((ring.radius - 3.0).abs() < 1e-9 && ring.misfit < 1e-9, "{ring:?}");
        assert!(ring.axis.dot(DVec3::new(0.2, 0.3, 0.9).normalize()) > 1.0 - 1e-12);
        let turned = (ring.angles[54] - ring.angles[0]).to_degrees();
        assert!((turned - 540.0).abs() < 1e-6, "{turned}");
        let places: Vec<f64> = (0..55).map(f64::from).collect();
        assert!((ring.steps(&places).1.to_degrees() - 10.0).abs() < 1e-6);
        let (rate, off) = ring.steadiness(&places);
        assert!((rate.abs().to_degrees() - 10.0).abs() < 1e-6 && off.iter().all(|o| o.abs() < 1e-9));
    }

    #[test]
    fn the_largest_gap_and_the_largest_step_name_their_ends() {
        let ring = Ring::fit(&poses(&[0.0, 20.0, 40.0, 130.0, 150.0, 170.0])).unwrap();
        let gap = ring.largest_gap();
        assert!((gap.angle.to_degrees() - 190.0).abs() < 1e-6 && gap.ends == [5, 0], "{gap:?}");
        let (step, median) = ring.steps(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert!((step.angle.to_degrees() - 90.0).abs() < 1e-6 && step.ends == [2, 3], "{step:?}");
        assert!((median.to_degrees() - 20.0).abs() < 1e-6);
        let (step, _) = ring.steps(&[0.0, 1.0, 2.0, 6.0, 7.0, 8.0]);
        assert!((step.angle.to_degrees() - 22.5).abs() < 1e-6, "three frames are missing: {step:?}");
    }

    #[test]
    fn what_is_no_ring_has_a_misfit_or_none() {
        assert_eq!(Ring::fit(&poses(&[0.0, 90.0, 180.0])), None);
        let line: Vec<Pose> =
            (0..9).map(|i| Pose::from_centre(glam::DQuat::IDENTITY, DVec3::X * f64::from(i))).collect();
        assert_eq!(Ring::fit(&line), None);
        let scattered: Vec<Pose> = (0..40)
            .map(|i| f64::from(i) * 1.3)
            .map(|i| DVec3::new(i.sin(), (1.7 * i).cos(), (2.3 * i).sin()))
            .map(|c| Pose::from_centre(glam::DQuat::IDENTITY, c))
            .collect();
        assert!(Ring::fit(&scattered).unwrap().misfit > 0.2);
    }
}
