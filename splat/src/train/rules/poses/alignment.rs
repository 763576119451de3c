//! Where views were moved, the whole may have moved with them: the similarity that takes the splat
//! back to the poses as given.

use super::linear::solve;
use crate::train::context::RuleContext;
use crate::train::evidence::SAMPLE;
use crate::view::{NEAREST, PinholeView};
use glam::{DQuat, DVec3};
use scene::sim3::Sim3;
use scene::{Gaussians, Pose};

/// How the similarity is sought.
struct SearchRules {
    /// Gaussians, evenly over all, as far as they are more opaque than not.
    /// Source: chosen by hand, never measured; seven numbers are sought.
    points: usize,
    /// Rounds of reweighting. Source: chosen by hand; the tests' similarity is found to 1e-5.
    rounds: usize,
    /// Distances of so many times their root mean square count half, a ratio (Cauchy's weights).
    /// Source: Holland and Welsch 1977 have 2.385 of a robust deviation; chosen by hand, never
    /// measured.
    outlier: f64,
}

/// See [`SearchRules`].
const RULES: SearchRules = SearchRules { points: 400, rounds: 10, outlier: 2.0 };

/// Moves Gaussians; colours keep their directions, which such turns (parts of a degree) hardly
/// change.
fn apply(moved: &Sim3, g: &mut Gaussians) {
    let (turn, larger) = (moved.rotation.as_quat(), moved.scale.ln() as f32);
    g.means.iter_mut().for_each(|m| *m = moved.transform(m.as_dvec3()).as_vec3());
    g.rotations.iter_mut().for_each(|r| *r = turn * *r);
    g.log_scales.iter_mut().for_each(|s| *s += larger);
}

/// The similarity with which `given` views see the points where `seen` views see them without it
/// (robust least squares, pixels), and the root mean square of the distances that are left.
pub(super) fn similarity(points: &[DVec3], given: &[PinholeView], seen: &[PinholeView]) -> (Sim3, f64) {
    let (mut found, mut rms) = (Sim3::IDENTITY, f64::INFINITY);
    for _ in 0..RULES.rounds {
        let (mut a, mut b, mut sum, mut n) = ([[0.0; 7]; 7], [0.0; 7], 0.0, 0.0);
        for x in points {
            let y = found.transform(*x);
            for (from, to) in given.iter().zip(seen) {
                for (e, row) in distances(*x, y, from, to).into_iter().flatten() {
                    let weight = 1.0 / (1.0 + (e / (RULES.outlier * rms)).powi(2));
                    (sum, n) = (sum + e * e, n + 1.0);
                    for r in 0..7 {
                        b[r] += weight * row[r] * e;
                        a[r].iter_mut().zip(&row).for_each(|(m, j)| *m += weight * row[r] * j);
                    }
                }
            }
        }
        rms = (sum / f64::max(n, 1.0)).sqrt().max(f64::EPSILON);
        let Some(step) = solve(a, b) else { break };
        let step = Sim3 {
            scale: step[6].clamp(-1.0, 1.0).exp(),
            rotation: DQuat::from_scaled_axis(DVec3::from_slice(&step[..3])),
            translation: DVec3::from_slice(&step[3..6]),
        };
        found = step.compose(&found);
    }
    (found, rms)
}

/// How far apart x is seen by `to` and y by `from`, pixels, with the derivative by a turn, a shift
/// and a growth of y.
fn distances(x: DVec3, y: DVec3, from: &PinholeView, to: &PinholeView) -> Option<[(f64, [f64; 7]); 2]> {
    let p = to.rotation.as_dmat3() * x + to.translation.as_dvec3();
    let rotation = from.rotation.as_dmat3();
    let q = rotation * y + from.translation.as_dvec3();
    let beside = (0..2).any(|k| (p[k] / p.z).abs() > 1.0);
    if p.z < NEAREST || q.z < NEAREST || beside {
        return None;
    }
    Some([0, 1].map(|k| {
        let f = f64::from(from.focal[k]);
        let mut row = DVec3::new(0.0, 0.0, -f * q[k] / (q.z * q.z));
        row[k] = f / q.z;
        let d = rotation.transpose() * row;
        let c = y.cross(d);
        (f * (p[k] / p.z - q[k] / q.z), [c.x, c.y, c.z, d.x, d.y, d.z, d.dot(y)])
    }))
}

/// Takes Gaussians that were trained on refined poses to the poses as given: how far apart these
/// are in the pictures, pixels, and the refined poses there (names of training views,
/// `cam_from_world`, world frame). `None` where no pose was refined.
pub(super) fn align(step: &RuleContext, g: &mut Gaussians) -> Option<(f64, Vec<(String, Pose)>)> {
    if step.state.corrections.poses.is_empty() {
        return None;
    }
    let (dataset, all) = (step.setup.dataset, &step.setup.views);
    let some: Vec<usize> = all.iter().copied().step_by(all.len().div_ceil(SAMPLE)).collect();
    let given: Vec<PinholeView> = some.iter().map(|&v| dataset.views[v].view).collect();
    let seen: Vec<PinholeView> = some.iter().map(|&v| step.camera(v)).collect();
    let opaque: Vec<usize> = (0..g.means.len()).filter(|&i| g.opacity_logits[i] > 0.0).collect();
    let chosen = opaque.iter().step_by(opaque.len().div_ceil(RULES.points).max(1));
    let points: Vec<DVec3> = chosen.map(|&i| g.means[i].as_dvec3()).collect();
    let (found, rms) = similarity(&points, &given, &seen);
    apply(&found, g);
    let poses = all.iter().map(|&v| (dataset.views[v].name.clone(), world_pose(step, v, &found)));
    Some((rms, poses.collect()))
}

/// `cam_from_world` of a refined view, where the splat was moved by the similarity.
fn world_pose(step: &RuleContext, view: usize, moved: &Sim3) -> Pose {
    let (view, frame) = (step.camera(view), &step.setup.dataset.normalisation);
    let own = Pose::from_matrix(view.rotation.as_dmat3(), view.translation.as_dvec3());
    let world = Sim3 { scale: 1.0 / frame.scale, rotation: DQuat::IDENTITY, translation: frame.centre };
    world.transform_pose(&moved.transform_pose(&own))
}
