//! Many images: the question which were rotated is asked of windows of images that see the same
//! points, and the answers are joined where the windows overlap. What two images that share no
//! points say about each other is little, and the joint information of all would grow with the
//! square of their number.

use super::offsets::OffsetLikelihood;
use crate::bundle::{BundleObservation, BundleProblem};
use crate::error::SfmError;
use crate::limits::{FEWEST_VIEWS, JOINT_IMAGES};
use scene::Progress;

/// For each of `poses` (of one camera) whether it belongs to the smaller of two groups; `None`
/// where one group does as well in every window.
pub(super) fn split(
    problem: &BundleProblem,
    camera: usize,
    poses: &[usize],
    progress: &Progress,
) -> Result<Option<Vec<bool>>, SfmError> {
    let observations = ObservationIndex::of(problem);
    let mut parts = Vec::new();
    for window in windows(&observations, poses) {
        let all: Vec<usize> = (0..window.len()).collect();
        let measured =
            OffsetLikelihood::measure(&observations.restrict(problem, &window), camera, &all, progress)?;
        let best = measured.and_then(|q| q.splits().into_iter().next());
        let signs: Vec<f64> = match best {
            Some(split) => split.iter().map(|t| if *t { -1.0 } else { 1.0 }).collect(),
            None => vec![1.0; window.len()],
        };
        parts.push(window.into_iter().zip(signs).collect());
    }
    let votes = join_signs(&parts, problem.poses.len());
    let negative = poses.iter().filter(|&&p| votes[p] < 0.0).count();
    // Of two groups of a size the one without the first image is the smaller.
    let first = poses.first().map_or(0.0, |&p| votes[p]);
    let smaller =
        if 2 * negative < poses.len() || (2 * negative == poses.len() && first >= 0.0) { -1.0 } else { 1.0 };
    let of_smaller: Vec<bool> = poses.iter().map(|&p| votes[p] * smaller > 0.0).collect();
    Ok(of_smaller.contains(&true).then_some(of_smaller))
}

/// A problem's observations by pose and by point.
struct ObservationIndex<'a> {
    of_pose: Vec<Vec<&'a BundleObservation>>,
    of_point: Vec<Vec<u32>>,
}

impl<'a> ObservationIndex<'a> {
    fn of(problem: &'a BundleProblem) -> Self {
        let mut of_pose = vec![Vec::new(); problem.poses.len()];
        let mut of_point = vec![Vec::new(); problem.points.len()];
        for o in &problem.observations {
            of_pose[o.pose as usize].push(o);
            of_point[o.point as usize].push(o.pose);
        }
        Self { of_pose, of_point }
    }

    /// The adjustment of some poses alone, in their order, with the points that at least two of
    /// them see.
    fn restrict(&self, problem: &BundleProblem, poses: &[usize]) -> BundleProblem {
        let mut views = vec![0u32; problem.points.len()];
        let own = || poses.iter().flat_map(|&p| self.of_pose[p].iter().copied());
        own().for_each(|o| views[o.point as usize] += 1);
        let mut number = vec![u32::MAX; problem.points.len()];
        let mut part = BundleProblem {
            cameras: problem.cameras.clone(),
            camera_free: problem.camera_free.clone(),
            priors: problem.priors.clone(),
            poses: poses.iter().map(|&p| problem.poses[p]).collect(),
            pose_camera: poses.iter().map(|&p| problem.pose_camera[p]).collect(),
            pose_constant: vec![false; poses.len()],
            ..BundleProblem::default()
        };
        for (pose, &of) in (0u32..).zip(poses) {
            for o in self.of_pose[of].iter().filter(|o| views[o.point as usize] >= 2) {
                let point = &mut number[o.point as usize];
                if *point == u32::MAX {
                    *point = part.points.len() as u32;
                    part.points.push(problem.points[o.point as usize]);
                }
                part.observations.push(BundleObservation { pose, point: *point, ..**o });
            }
        }
        part.point_constant = vec![false; part.points.len()];
        part
    }
}

/// Windows in which every pose that shares points with enough others is one of the first new ones.
/// Each grows from a pose by those that share most observations with what it has, in turn any and a
/// new one, so that windows overlap and yet get on where all images see the same; the next starts
/// at its rim.
fn windows(observations: &ObservationIndex<'_>, poses: &[usize]) -> Vec<Vec<usize>> {
    let n = observations.of_pose.len();
    let mut eligible = vec![false; n];
    poses.iter().for_each(|&p| eligible[p] = true);
    let mut open = eligible.clone();
    let (mut found, mut rim): (Vec<Vec<usize>>, Option<usize>) = (Vec::new(), None);
    while let Some(start) = rim.or_else(|| open.iter().position(|o| *o)) {
        let (mut shared, mut free) = (vec![0usize; n], eligible.clone());
        let mut window: Vec<usize> = Vec::new();
        let mut next = Some(start);
        while let Some(pose) = next.filter(|_| window.len() < JOINT_IMAGES) {
            window.push(pose);
            free[pose] = false;
            for o in &observations.of_pose[pose] {
                observations.of_point[o.point as usize].iter().for_each(|&p| shared[p as usize] += 1);
            }
            let most = |wanted: &[bool]| {
                let tied = (0..n).filter(|&p| free[p] && wanted[p] && shared[p] > 0);
                tied.max_by_key(|&p| (shared[p], std::cmp::Reverse(p)))
            };
            let fresh = if window.len() % 2 == 1 { most(&open) } else { None };
            next = fresh.or_else(|| most(&eligible));
        }
        let mut fresh = window.iter().copied().filter(|&p| open[p]).collect::<Vec<usize>>();
        let beyond = fresh.split_off(fresh.len().min(JOINT_IMAGES / 2));
        fresh.iter().for_each(|&p| open[p] = false);
        rim = beyond.last().copied();
        if window.len() >= 2 * FEWEST_VIEWS {
            found.push(window);
        }
    }
    found
}

/// For each of `n` poses the sum of its signs over the windows. What a window calls the other group
/// is turned round where its neighbours do; the windows that agree most clearly are joined first.
fn join_signs(parts: &[Vec<(usize, f64)>], n: usize) -> Vec<f64> {
    let mut of_pose: Vec<Vec<(usize, f64)>> = vec![Vec::new(); n];
    for (part, signs) in parts.iter().enumerate() {
        signs.iter().for_each(|&(pose, sign)| of_pose[pose].push((part, sign)));
    }
    let mut ties: std::collections::BTreeMap<(usize, usize), f64> = std::collections::BTreeMap::new();
    for of in &of_pose {
        for (i, a) in of.iter().enumerate() {
            of[i + 1..].iter().for_each(|b| *ties.entry((a.0, b.0)).or_default() += a.1 * b.1);
        }
    }
    let mut ranked: Vec<((usize, usize), f64)> = ties.into_iter().collect();
    ranked.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()).then(a.0.cmp(&b.0)));
    let mut group: Vec<usize> = (0..parts.len()).collect();
    let mut flip = vec![1.0; parts.len()];
    for ((a, b), agreement) in ranked {
        let (of_a, of_b) = (group[a], group[b]);
        if of_a == of_b || agreement == 0.0 {
            continue;
        }
        let turn = flip[a] * flip[b] * agreement.signum();
        for (g, f) in group.iter_mut().zip(&mut flip).filter(|(g, _)| **g == of_b) {
            *g = of_a;
            *f *= turn;
        }
    }
    of_pose.iter().map(|of| of.iter().map(|(part, sign)| flip[*part] * sign).sum()).collect()
}

/// How many windows these poses of a problem make.
#[cfg(test)]
pub(super) fn count(problem: &BundleProblem, poses: &[usize]) -> usize {
    windows(&ObservationIndex::of(problem), poses).len()
}
