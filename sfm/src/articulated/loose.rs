//! Joints from the motions of pieces of an object that were let loose: each was followed through
//! the views as a rigid body of its own.
//!
//! The body's own motion in a view is that of most points (iteratively reweighted least squares).
//! What is left of a piece is compared with turns about an axis: `d(x, v) = θ_v (a × (x − p))`,
//! alternately linear in `θ` and in the twist `(a, a × −p)`.

use crate::solvers::linalg::solve_spd;
use glam::DVec3;
use scene::Pose;

/// A piece of an object.
#[derive(Clone, Debug, Default)]
pub struct LoosePiece {
    /// Some of its points at rest.
    pub points: Vec<DVec3>,
    /// Where it stands in each view: `body_from_rest`.
    pub poses: Vec<Pose>,
}

/// The joint that explains the motion of a piece best.
#[derive(Clone, Debug)]
pub struct LooseJoint {
    /// Direction, unit.
    pub axis: DVec3,
    /// The place on the axis nearest to the middle of the piece.
    pub place: DVec3,
    /// Angle in each view, radians; their mean is 0.
    pub angles: Vec<f64>,
    /// Standard deviation of the axis, radians, and of the place, units of the points: jackknife
    /// over stretches of the views.
    pub sigmas: [f64; 2],
    /// Share of the squares of the piece's displacements that it explains.
    pub explained: f64,
}

/// How a joint is fitted.
struct LooseLimits {
    /// Times that the body's twist and the weights of points follow from each other.
    rounds: usize,
    /// Times that angles and twist follow from each other. Source: power iteration of a matrix
    /// whose first two values differ by a third.
    alternations: usize,
    /// Stretches of the views of which the jackknife leaves out one at a time.
    stretches: usize,
}

/// The values in force. Source: chosen by hand.
const LOOSE: LooseLimits = LooseLimits { rounds: 20, alternations: 30, stretches: 10 };

/// A twist: velocity of the origin, and rotation.
type Twist = [f64; 6];

/// The joint of each piece; `None` where its motion tells of none.
pub fn loose_joints(pieces: &[LoosePiece]) -> Vec<Option<LooseJoint>> {
    let all: Vec<DVec3> = pieces.iter().flat_map(|p| p.points.iter().copied()).collect();
    let middle = all.iter().sum::<DVec3>() / all.len().max(1) as f64;
    let square = all.iter().map(|x| x.distance_squared(middle)).sum::<f64>() / all.len().max(1) as f64;
    let size = square.sqrt().max(f64::MIN_POSITIVE);
    let unit: Vec<LoosePiece> = pieces.iter().map(|p| p.in_unit(size)).collect();
    let moves = displacements(&unit);
    unit.iter().zip(&moves).map(|(piece, moves)| Some(joint(&piece.points, moves)?.times(size))).collect()
}

impl LooseJoint {
    /// In a unit that is so many times smaller.
    fn times(mut self, size: f64) -> Self {
        self.place *= size;
        self.sigmas[1] *= size;
        self
    }

    /// Share of the squares of displacements, by view, of points that it explains.
    fn explains(&self, points: &[DVec3], moves: &[Vec<DVec3>]) -> f64 {
        let fields: Vec<DVec3> = points.iter().map(|&x| self.axis.cross(x - self.place)).collect();
        let (mut left, mut all) = (0.0, 0.0);
        for (moved, angle) in moves.iter().zip(&self.angles) {
            for (d, field) in moved.iter().zip(&fields) {
                left += (*d - *angle * *field).length_squared();
                all += d.length_squared();
            }
        }
        1.0 - left / all
    }
}

impl LoosePiece {
    /// What moves its points in a view.
    fn moved(&self, view: usize) -> Vec<DVec3> {
        self.points.iter().map(|&x| self.poses[view].transform(x) - x).collect()
    }

    /// In units of so many.
    fn in_unit(&self, size: f64) -> Self {
        let points = self.points.iter().map(|&x| x / size).collect();
        Self {
            points,
            poses: self.poses.iter().map(|p| Pose::new(p.rotation, p.translation / size)).collect(),
        }
    }
}

/// What moves the points of the pieces from their mean places, beside the body: by piece, view
/// and point.
fn displacements(pieces: &[LoosePiece]) -> Vec<Vec<Vec<DVec3>>> {
    let views = pieces.iter().map(|p| p.poses.len()).min().unwrap_or(0);
    let all: Vec<DVec3> = pieces.iter().flat_map(|p| p.points.iter().copied()).collect();
    let mut out: Vec<Vec<Vec<DVec3>>> = vec![Vec::new(); pieces.len()];
    for view in 0..views {
        let moved: Vec<Vec<DVec3>> = pieces.iter().map(|p| p.moved(view)).collect();
        let body = motion_of_most(&all, &moved.concat());
        for ((piece, moved), out) in pieces.iter().zip(moved).zip(&mut out) {
            let left = piece.points.iter().zip(moved).map(|(&x, d)| d - field(&body, x));
            out.push(left.collect());
        }
    }
    out.iter_mut().for_each(|moves| centre(moves));
    out
}

/// Takes the mean over the views away.
fn centre(moves: &mut [Vec<DVec3>]) {
    let views = moves.len().max(1) as f64;
    for point in 0..moves.first().map_or(0, Vec::len) {
        let mean = moves.iter().map(|m| m[point]).sum::<DVec3>() / views;
        moves.iter_mut().for_each(|m| m[point] -= mean);
    }
}

/// The displacement of a point by a twist.
fn field(twist: &Twist, x: DVec3) -> DVec3 {
    let [a, b, c, d, e, f] = *twist;
    DVec3::new(a, b, c) + DVec3::new(d, e, f).cross(x)
}

/// The twist that most points follow; points count the less the farther they are from it (Geman
/// and McClure's weights, whose scale is the median of what is left).
fn motion_of_most(points: &[DVec3], moved: &[DVec3]) -> Twist {
    let (mut weights, mut twist) = (vec![1.0; points.len()], Twist::default());
    for _ in 0..LOOSE.rounds {
        let Some(next) = least_squares(points, moved, &weights) else { return twist };
        twist = next;
        let left: Vec<f64> =
            points.iter().zip(moved).map(|(&x, &d)| (d - field(&twist, x)).length()).collect();
        let scale = crate::statistics::median(left.clone()).max(f64::MIN_POSITIVE);
        weights = left.iter().map(|r| (1.0 + (r / scale).powi(2)).powi(-2)).collect();
    }
    twist
}

/// The twist whose field is nearest to displacements.
fn least_squares(points: &[DVec3], moved: &[DVec3], weights: &[f64]) -> Option<Twist> {
    let (mut matrix, mut right) = ([[0.0; 6]; 6], [0.0; 6]);
    for ((&x, &d), &w) in points.iter().zip(moved).zip(weights) {
        // Columns of the field's derivative: unit vectors, and their products with the point.
        let units = [DVec3::X, DVec3::Y, DVec3::Z];
        let columns: [DVec3; 6] =
            std::array::from_fn(|k| if k < 3 { units[k] } else { units[k - 3].cross(x) });
        for (i, a) in columns.iter().enumerate() {
            right[i] += w * a.dot(d);
            (0..=i).for_each(|j| matrix[i][j] += w * a.dot(columns[j]));
        }
    }
    // Points on a line leave the turn about it open.
    let trace: f64 = (0..6).map(|i| matrix[i][i]).sum();
    (0..6).for_each(|i| matrix[i][i] += trace * f64::EPSILON.sqrt());
    solve_spd(&matrix, &right)
}

/// The joint of a piece from what moves its points, by view.
fn joint(points: &[DVec3], moves: &[Vec<DVec3>]) -> Option<LooseJoint> {
    let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let near: Vec<DVec3> = points.iter().map(|&x| x - middle).collect();
    let all: Vec<&[DVec3]> = moves.iter().map(Vec::as_slice).collect();
    let first = all.iter().max_by(|a, b| squares(a).total_cmp(&squares(b)))?;
    let twist = turn(&near, &all, least_squares(&near, first, &vec![1.0; near.len()])?)?;
    let angles = angles(&near, &all, &twist);
    let (axis, place) = hinge(&twist);
    let sigmas = jackknife(&near, &all, &twist);
    let place = middle + place;
    let mut out = LooseJoint { axis, place, angles, sigmas, explained: 0.0 };
    out.explained = out.explains(points, moves);
    out.explained.is_finite().then_some(out)
}

fn squares(moved: &[DVec3]) -> f64 {
    moved.iter().map(|d| d.length_squared()).sum()
}

/// Direction and nearest place of a turn's axis.
fn hinge(twist: &Twist) -> (DVec3, DVec3) {
    let [a, b, c, d, e, f] = *twist;
    let axis = DVec3::new(d, e, f);
    (axis, axis.cross(DVec3::new(a, b, c)))
}

/// The turn, of 1 radian, that explains most of what moves points, from one near it.
fn turn(points: &[DVec3], moves: &[&[DVec3]], mut twist: Twist) -> Option<Twist> {
    let weights = vec![1.0; points.len()];
    for _ in 0..LOOSE.alternations {
        twist = unit(&twist)?;
        let angles = angles(points, moves, &twist);
        let square: f64 = angles.iter().map(|a| a * a).sum();
        let mut target = vec![DVec3::ZERO; points.len()];
        for (moved, angle) in moves.iter().zip(&angles) {
            target.iter_mut().zip(*moved).for_each(|(sum, d)| *sum += *d * (angle / square));
        }
        twist = least_squares(points, &target, &weights)?;
    }
    unit(&twist)
}

/// A twist without what moves along its axis, its rotation a unit vector.
fn unit(twist: &Twist) -> Option<Twist> {
    let [a, b, c, d, e, f] = *twist;
    let (moves, turns) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
    let axis = turns.try_normalize()?;
    let across = moves.reject_from_normalized(axis) / turns.length();
    let out = [across.x, across.y, across.z, axis.x, axis.y, axis.z];
    out.iter().all(|v| v.is_finite()).then_some(out)
}

/// The angle in each view, by least squares.
fn angles(points: &[DVec3], moves: &[&[DVec3]], twist: &Twist) -> Vec<f64> {
    let fields: Vec<DVec3> = points.iter().map(|&x| field(twist, x)).collect();
    let square: f64 = fields.iter().map(|f| f.length_squared()).sum();
    moves.iter().map(|d| d.iter().zip(&fields).map(|(d, f)| d.dot(*f)).sum::<f64>() / square).collect()
}

/// Standard deviations of axis and place: what leaving out a stretch of the views changes.
fn jackknife(points: &[DVec3], moves: &[&[DVec3]], twist: &Twist) -> [f64; 2] {
    let n = LOOSE.stretches.min(moves.len());
    let (axis, place) = hinge(twist);
    let found: Vec<(DVec3, DVec3)> =
        (0..n).filter_map(|k| hinge_without(points, moves, twist, [k, n])).collect();
    let share = (found.len().max(1) as f64 - 1.0) / found.len().max(1) as f64;
    let axes = found.iter().map(|(a, _)| a.reject_from_normalized(axis).length_squared());
    let places = found.iter().map(|(_, p)| (*p - place).reject_from_normalized(axis).length_squared());
    [(share * axes.sum::<f64>()).sqrt(), (share * places.sum::<f64>()).sqrt()]
}

/// Axis and place without one of some stretches of the views.
fn hinge_without(
    points: &[DVec3],
    moves: &[&[DVec3]],
    twist: &Twist,
    [one, stretches]: [usize; 2],
) -> Option<(DVec3, DVec3)> {
    let views = moves.iter().enumerate();
    let some = views.filter(|(v, _)| v * stretches / moves.len() != one).map(|(_, moved)| *moved);
    Some(hinge(&turn(points, &some.collect::<Vec<_>>(), *twist)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use rand::Rng as _;

    const VIEWS: usize = 60;

    fn drift(view: usize, unit: f64) -> Pose {
        Pose::new(DQuat::from_rotation_x(1e-3 * view as f64), DVec3::Y * (1e-3 * unit))
    }

    /// Pieces of a body that drifts, the last of which swings about an axis; places in `unit`s.
    fn pieces(unit: f64, swings: bool) -> Vec<LoosePiece> {
        let mut rng = scene::rng::rng(3, "loose", 0);
        (0..12)
            .map(|k| {
                let middle = DVec3::from(rng.random::<[f64; 3]>()) * 4.0 - 2.0;
                let points: Vec<DVec3> = (0..30)
                    .map(|_| (middle + DVec3::from(rng.random::<[f64; 3]>()) * 0.4 - 0.2) * unit)
                    .collect();
                let noise: Vec<DVec3> =
                    (0..VIEWS).map(|_| DVec3::from(rng.random::<[f64; 3]>()) * 4e-3 - 2e-3).collect();
                let own = |v: usize| {
                    let angle = if swings && k == 11 { 0.2 * (v as f64 / 6.0).sin() } else { 0.0 };
                    let turn =
                        DQuat::from_axis_angle(AXIS.normalize(), angle) * DQuat::from_scaled_axis(noise[v]);
                    let place = PLACE * unit;
                    drift(v, unit).compose(&Pose::new(turn, place - turn * place))
                };
                LoosePiece { points, poses: (0..VIEWS).map(own).collect() }
            })
            .collect()
    }

    /// What taking displacements as linear in an angle of 0.2 makes of a joint.
    const LINEAR: f64 = 0.005;
    const AXIS: DVec3 = DVec3::new(1.0, 0.4, -0.3);
    const PLACE: DVec3 = DVec3::new(0.5, 0.0, 0.3);

    #[test]
    fn the_joint_of_a_piece_that_swings_is_found_in_any_unit() {
        for unit in [1e-6, 1.0, 1e6] {
            let joints = loose_joints(&pieces(unit, true));
            let found = joints[11].as_ref().unwrap();
            let axis = AXIS.normalize();
            let off = found.axis.cross(axis).length();
            let place = (found.place - PLACE * unit).reject_from_normalized(axis).length() / unit;
            assert!(off < 3.0 * found.sigmas[0] + LINEAR, "{off} ± {}", found.sigmas[0]);
            assert!(place < 3.0 * found.sigmas[1] / unit + LINEAR, "{place}");
            assert!(found.explained > 0.95, "{}", found.explained);
            let sign = found.axis.dot(axis).signum();
            let mean = (0..VIEWS).map(|v| 0.2 * (v as f64 / 6.0).sin()).sum::<f64>() / VIEWS as f64;
            for (v, angle) in found.angles.iter().enumerate() {
                let truth = 0.2 * (v as f64 / 6.0).sin() - mean;
                assert!((sign * angle - truth).abs() < 0.02, "{v}: {angle} {truth}");
            }
        }
    }

    #[test]
    fn pieces_of_a_body_move_hardly_and_no_pieces_have_no_joints() {
        let joints = loose_joints(&pieces(1.0, false));
        let most = joints.iter().flatten().flat_map(|j| j.angles.clone()).fold(0.0, f64::max);
        assert!(most < 0.02, "{most}");
        assert!(loose_joints(&[]).is_empty());
        assert!(loose_joints(&[LoosePiece::default()])[0].is_none());
    }
}
