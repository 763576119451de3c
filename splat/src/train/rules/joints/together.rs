//! Joints that turn together, as two solar arrays behind one drive do: angles that agree within
//! their deviations, up to a sign and an offset, are one angle.
//!
//! What is wrong with a reading depends on how a part is seen, which differs from part to part.

/// Angles and their standard deviations by view, radians.
pub(super) type Angles = [Vec<f64>; 2];

/// Root mean square difference that is put down to the deviations, as a multiple of theirs.
/// Source: common: two standard deviations.
const AGREE: f64 = 2.0;

/// How one joint's angles follow from another's: times `sign`, plus `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct JointLink {
    sign: f64,
    offset: f64,
}

/// The link between two joints that agree within the deviations, `more` of which are added to
/// both joints' own.
fn link(a: &Angles, b: &Angles, more: [f64; 2]) -> Option<JointLink> {
    let count = a[0].len().max(1) as f64;
    let expected: f64 = variances(a, more[0]).zip(variances(b, more[1])).map(|(a, b)| a + b).sum();
    let found = [1.0, -1.0].map(|sign| {
        let apart: Vec<f64> = a[0].iter().zip(&b[0]).map(|(a, b)| a - sign * b).collect();
        let offset = apart.iter().sum::<f64>() / count;
        (JointLink { sign, offset }, apart.iter().map(|d| (d - offset).powi(2)).sum::<f64>())
    });
    let (link, squares) = if found[0].1 <= found[1].1 { found[0] } else { found[1] };
    (squares <= AGREE * AGREE * expected).then_some(link)
}

/// Variances of a joint's angles.
fn variances(of: &Angles, more: f64) -> impl Iterator<Item = f64> {
    of[1].iter().map(move |sigma| sigma * sigma + more * more)
}

/// Gives joints that turn together the mean of their angles, weighted by their variances; each
/// keeps its own offset. `more`: a deviation of all angles of a joint beside their own.
pub(super) fn tie(joints: &mut [Angles], more: &[f64]) {
    // The best known come first: a joint of which little is known agrees with all others.
    let mut order: Vec<usize> = (0..joints.len()).collect();
    let unsure: Vec<f64> = joints.iter().zip(more).map(|(j, &more)| variances(j, more).sum()).collect();
    order.sort_by(|&a, &b| unsure[a].total_cmp(&unsure[b]));
    let mut tied = vec![false; joints.len()];
    for (at, &first) in order.iter().enumerate() {
        if std::mem::replace(&mut tied[first], true) {
            continue;
        }
        let mut group = vec![(first, JointLink { sign: 1.0, offset: 0.0 })];
        for &other in &order[at + 1..] {
            let found = link(&joints[first], &joints[other], [more[first], more[other]]);
            if let Some(link) = found.filter(|_| !tied[other]) {
                tied[other] = true;
                group.push((other, link));
            }
        }
        if group.len() > 1 {
            mean(joints, more, &group);
        }
    }
}

/// The mean of a group in each view.
fn mean(joints: &mut [Angles], more: &[f64], group: &[(usize, JointLink)]) {
    for view in 0..joints[group[0].0][0].len() {
        let (mut sum, mut weights) = (0.0, 0.0);
        for &(joint, link) in group {
            let [angles, sigmas] = &joints[joint];
            let weight = (sigmas[view].powi(2) + more[joint].powi(2)).max(f64::MIN_POSITIVE).recip();
            sum += weight * (link.sign * angles[view] + link.offset);
            weights += weight;
        }
        for &(joint, link) in group {
            joints[joint][0][view] = link.sign * (sum / weights - link.offset);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(angle: impl Fn(usize) -> f64) -> Angles {
        [(0..50).map(angle).collect(), vec![0.01; 50]]
    }

    fn error(joint: &Angles, truth: impl Fn(usize) -> f64) -> f64 {
        joint[0].iter().enumerate().map(|(k, a)| (a - truth(k)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn joints_that_agree_get_their_mean_whichever_way_their_axes_point() {
        let (turn, wave) = (|k: usize| 0.03 * k as f64, |k: usize| 0.02 * (k as f64 * 0.7).sin());
        let mut joints = [joint(|k| turn(k) + wave(k)), joint(|k| 1.0 - turn(k) + wave(k))];
        tie(&mut joints, &[0.0; 2]);
        assert!(error(&joints[0], turn) < 2e-3 && error(&joints[1], |k| 1.0 - turn(k)) < 2e-3, "{joints:?}");
    }

    #[test]
    fn joints_at_other_rates_are_left_alone() {
        let mut joints =
            [joint(|k| 0.03 * k as f64), joint(|k| 0.025 * k as f64), joint(|k| 0.2 * (k as f64).sin())];
        let before = joints.clone();
        tie(&mut joints, &[0.005; 3]);
        assert_eq!(joints, before);
    }

    #[test]
    fn a_joint_of_which_nothing_is_known_ties_no_others() {
        let mut joints = [joint(|_| 0.0), joint(|k| 0.03 * k as f64), joint(|k| 0.01 * k as f64)];
        let before = joints.clone();
        tie(&mut joints, &[100.0, 0.0, 0.0]);
        assert!(error(&joints[1], |k| 0.03 * k as f64) < 1e-6, "{joints:?}");
        assert_eq!(joints[2], before[2]);
    }

    #[test]
    fn a_worse_known_joint_follows_the_better_one() {
        let mut joints = [joint(|k| 0.03 * k as f64), joint(|k| 0.03 * k as f64 + 0.1 * (k as f64).sin())];
        joints[1][1].fill(0.1);
        tie(&mut joints, &[0.0; 2]);
        assert!(error(&joints[1], |k| 0.03 * k as f64) < 3e-3, "{joints:?}");
    }
}
