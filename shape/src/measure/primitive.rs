//! Planes and cylinders: residuals, candidates from oriented pieces, least squares.

use super::elements::{Elements, cube};
use super::least_squares::{ResidualRow, Solution, solve};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Steps of a fit. Source: derived: Gauss–Newton steps double the number of right digits.
const STEPS: usize = 4;

/// Side of the cubes that connect elements, tolerances. Source: docs/decisions/16.
pub(crate) const CELL: f64 = 4.0;

/// An unbounded surface.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Primitive {
    /// Points with `normal · (x − point) = 0`.
    Plane { point: DVec3, normal: DVec3 },
    /// Points at `radius` from the axis; its surface looks outwards (1) or inwards (−1).
    Cylinder { point: DVec3, axis: DVec3, radius: f64, facing: f64 },
}

/// Standard deviations of a primitive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AxisDeviations {
    /// Of the normal or axis, radians.
    pub(crate) angle: f64,
    /// Of the place along the normal, at the middle of the surface.
    pub(crate) offset: f64,
    /// Of the radius.
    pub(crate) radius: f64,
}

impl AxisDeviations {
    /// Whether all are known.
    pub(crate) fn is_finite(&self) -> bool {
        self.angle.is_finite() && self.offset.is_finite() && self.radius.is_finite()
    }
}

impl Primitive {
    /// The plane of an element.
    pub(crate) fn plane(elements: &Elements, i: usize) -> Self {
        Self::Plane { point: elements.middle(i), normal: elements.normals[i] }
    }

    /// The cylinder through two elements whose normals meet in its axis; `None` where they are
    /// parallel, or where the radius is below `least` or above `most`.
    pub(crate) fn cylinder(elements: &Elements, [i, j]: [usize; 2], least: f64, most: f64) -> Option<Self> {
        let (p, q) = (elements.middle(i), elements.middle(j));
        let (n, m) = (elements.normals[i], elements.normals[j]);
        let axis = n.cross(m).try_normalize()?;
        let [u, v] = frame(axis);
        let [a, b, na, nb] = [p, q, n, m].map(|x| flat(x, axis));
        // a − s na = b − t nb.
        let det = na.perp_dot(nb);
        let s = (a - b).perp_dot(nb) / det;
        let t = (a - b).perp_dot(na) / det;
        let radius = (s + t) / 2.0;
        let close = (s - t).abs() < 0.2 * radius.abs();
        if !(close && (least..most).contains(&radius.abs())) {
            return None;
        }
        let centre = (a - na * s + b - nb * t) / 2.0;
        let point = u * centre.x + v * centre.y + axis * axis.dot(p);
        Some(Self::Cylinder { point, axis, radius: radius.abs(), facing: radius.signum() })
    }

    /// Signed distance of a place, along [`Self::normal`] of a cylinder that looks outwards.
    pub(crate) fn residual(&self, x: DVec3) -> f64 {
        match *self {
            Self::Plane { point, normal } => (x - point).dot(normal),
            Self::Cylinder { point, axis, radius, .. } => {
                (x - point).reject_from_normalized(axis).length() - radius
            }
        }
    }

    /// Direction in which the surface looks nearest to `x`.
    fn normal(&self, x: DVec3) -> DVec3 {
        match *self {
            Self::Plane { normal, .. } => normal,
            Self::Cylinder { point, axis, facing, .. } => {
                (x - point).reject_from_normalized(axis).normalize_or_zero() * facing
            }
        }
    }

    /// The normal of a plane, the axis of a cylinder.
    pub(crate) fn axis(&self) -> DVec3 {
        match *self {
            Self::Plane { normal: axis, .. } | Self::Cylinder { axis, .. } => axis,
        }
    }

    /// Whether all of an element lies within `tolerance`.
    pub(crate) fn holds(&self, elements: &Elements, i: usize, tolerance: f64) -> bool {
        elements.corners[i].iter().all(|x| self.residual(*x).abs() <= tolerance)
    }

    /// Whether it does and looks the same way within the angle with this cosine.
    pub(crate) fn fits(&self, elements: &Elements, i: usize, tolerance: f64, cosine: f64) -> bool {
        self.holds(elements, i, tolerance)
            && self.normal(elements.middle(i)).dot(elements.normals[i]) >= cosine
    }

    /// Fitted to the corners of these elements by least squares, each with a third of its element's
    /// area as weight; with deviations by patches of side `patch`. `None` where they do not
    /// determine it.
    pub(crate) fn fitted(
        mut self,
        elements: &Elements,
        of: &[usize],
        patch: f64,
    ) -> Option<(Self, AxisDeviations)> {
        let area = elements.area(of);
        let middle = of.iter().map(|&i| elements.middle(i) * elements.areas[i]).sum::<DVec3>() / area;
        let mut deviations = AxisDeviations::default();
        for step in 0..=STEPS {
            self.centre_at(middle);
            // Patches only matter for the deviations.
            let patch = if step == STEPS { patch } else { f64::INFINITY };
            deviations = match self {
                Self::Plane { .. } => self.step_plane(elements, of, patch)?,
                Self::Cylinder { .. } => self.step_cylinder(elements, of, patch)?,
            };
        }
        let sound = match self {
            Self::Plane { point, .. } => point.is_finite(),
            Self::Cylinder { point, radius, .. } => point.is_finite() && radius > 0.0 && radius.is_finite(),
        };
        (sound && self.axis().is_finite()).then_some((self, deviations))
    }

    /// Moves the point of reference next to a place.
    fn centre_at(&mut self, x: DVec3) {
        match self {
            Self::Plane { point, normal } => *point = x - *normal * (x - *point).dot(*normal),
            Self::Cylinder { point, axis, .. } => *point += *axis * (x - *point).dot(*axis),
        }
    }

    /// One step in offset and two tilts.
    fn step_plane(&mut self, elements: &Elements, of: &[usize], patch: f64) -> Option<AxisDeviations> {
        let Self::Plane { point, normal } = self else { return None };
        let [u, v] = frame(*normal);
        let row = |x: DVec3| {
            let d = x - *point;
            ([-1.0, -d.dot(u), -d.dot(v)], d.dot(*normal))
        };
        let Solution { step, covariance } = solve(&rows(elements, of, patch, row))?;
        *point += *normal * step[0];
        *normal = (*normal - u * step[1] - v * step[2]).try_normalize()?;
        let angle = ((covariance[1][1] + covariance[2][2]) / 2.0).sqrt();
        Some(AxisDeviations { angle, offset: covariance[0][0].sqrt(), radius: 0.0 })
    }

    /// One step in two shifts and two tilts of the axis, and the radius.
    fn step_cylinder(&mut self, elements: &Elements, of: &[usize], patch: f64) -> Option<AxisDeviations> {
        let Self::Cylinder { point, axis, radius, .. } = self else { return None };
        let [u, v] = frame(*axis);
        let row = |x: DVec3| {
            let d = x - *point;
            let along = d.dot(*axis);
            let away = d - *axis * along;
            let out = away.normalize_or_zero();
            let (a, b) = (out.dot(u), out.dot(v));
            ([-a, -b, -a * along, -b * along, -1.0], away.length() - *radius)
        };
        let Solution { step, covariance } = solve(&rows(elements, of, patch, row))?;
        *point += u * step[0] + v * step[1];
        *axis = (*axis + u * step[2] + v * step[3]).try_normalize()?;
        *radius += step[4];
        let angle = ((covariance[2][2] + covariance[3][3]) / 2.0).sqrt();
        let offset = ((covariance[0][0] + covariance[1][1]) / 2.0).sqrt();
        Some(AxisDeviations { angle, offset, radius: covariance[4][4].sqrt() })
    }

    /// Root mean square distance of these elements' corners.
    pub(crate) fn rms(&self, elements: &Elements, of: &[usize]) -> f64 {
        let squares = of.iter().map(|&i| {
            elements.areas[i] / 3.0
                * elements.corners[i].iter().map(|x| self.residual(*x).powi(2)).sum::<f64>()
        });
        (squares.sum::<f64>() / elements.area(of)).sqrt()
    }
}

/// A shape and the elements that lie on it.
pub(crate) struct Found {
    pub(crate) primitive: Primitive,
    pub(crate) deviations: AxisDeviations,
    pub(crate) elements: Vec<usize>,
}

impl Found {
    /// Angle round a cylinder's axis that its elements span: a full turn less the widest gap,
    /// degrees; 0 of a plane.
    pub(crate) fn coverage_deg(&self, elements: &Elements) -> f64 {
        let Primitive::Cylinder { point, axis, .. } = self.primitive else { return 0.0 };
        let corners = self.elements.iter().flat_map(|&i| elements.corners[i]);
        let mut angles: Vec<f64> = corners
            .map(|x| {
                let across = flat(x - point, axis);
                across.y.atan2(across.x)
            })
            .collect();
        angles.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (angles.first(), angles.last()) else { return 0.0 };
        let gap = angles.windows(2).map(|w| w[1] - w[0]).fold(first + TAU - last, f64::max);
        (TAU - gap).to_degrees()
    }
}

/// Rows of all corners.
fn rows<const P: usize>(
    elements: &Elements,
    of: &[usize],
    patch: f64,
    row: impl Fn(DVec3) -> ([f64; P], f64),
) -> Vec<ResidualRow<P>> {
    let corners = of.iter().flat_map(|&i| elements.corners[i].map(|x| (x, elements.areas[i] / 3.0)));
    let rows = corners.map(|(x, weight)| {
        let (derivatives, residual) = row(x);
        ResidualRow { derivatives, residual, weight, patch: cube(x, patch) }
    });
    rows.collect()
}

/// Two unit vectors that make a right-handed frame with a third.
pub(crate) fn frame(axis: DVec3) -> [DVec3; 2] {
    let (u, v) = axis.any_orthonormal_pair();
    if u.cross(v).dot(axis) > 0.0 { [u, v] } else { [v, u] }
}

/// A vector across an axis, in its [`frame`].
pub(crate) fn flat(x: DVec3, axis: DVec3) -> DVec2 {
    let [u, v] = frame(axis);
    DVec2::new(x.dot(u), x.dot(v))
}
