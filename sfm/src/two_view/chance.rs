//! Whether agreement could be chance: the a-contrario test.

use glam::DVec2;

/// How a model constrains a match in image b.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Constraint {
    /// To a strip along an epipolar line.
    Line,
    /// To a disc around a point.
    Point,
}

/// log10 of the number of false alarms: how many models that agree as well as this one are expected
/// among matches whose points in image b fell anywhere within their bounding box. Below 0 chance
/// becomes unlikely. The least over all numbers of inliers, so that it needs no threshold but the
/// largest `limit`. Moisan & Stival, "A Probabilistic Criterion to Detect Rigid Point Matches",
/// IJCV 2004: `NFA = M (n − s) C(n, k) C(k, s) α^(k − s)` with sample size `s` and `M` models a
/// sample. `squared`: squared residuals of all matches, pixels.
pub(crate) fn log10_false_alarms(
    squared: &[f64],
    points_b: &[DVec2],
    constraint: Constraint,
    sample_size: usize,
    models: f64,
    limit: f64,
) -> f64 {
    let n = squared.len();
    if n <= sample_size {
        return f64::INFINITY;
    }
    let low = points_b.iter().fold(DVec2::INFINITY, |m, p| m.min(*p));
    let extent = (points_b.iter().fold(DVec2::NEG_INFINITY, |m, p| m.max(*p)) - low).max(DVec2::splat(limit));
    let mut sorted = squared.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut factorial = vec![0.0_f64; n + 1]; // log10 of i!
    for i in 1..=n {
        factorial[i] = factorial[i - 1] + (i as f64).log10();
    }
    let mut least = f64::INFINITY;
    for k in sample_size + 1..=n {
        let residual = sorted[k - 1].max(0.25 * 0.25); // finer agreement than measurement is no evidence
        if residual > limit * limit {
            break;
        }
        let share = match constraint {
            Constraint::Line => 2.0 * residual.sqrt() * extent.length() / (extent.x * extent.y),
            Constraint::Point => std::f64::consts::PI * residual / (extent.x * extent.y),
        };
        let chance = share.min(1.0).log10() * (k - sample_size) as f64;
        let count = (models * (n - sample_size) as f64).log10()
            + choose(&factorial, n, k)
            + choose(&factorial, k, sample_size);
        least = least.min(count + chance);
    }
    least
}

/// log10 of the number of ways to choose `k` of `n`.
fn choose(factorial: &[f64], n: usize, k: usize) -> f64 {
    factorial[n] - factorial[k] - factorial[n - k]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    fn points(n: usize) -> Vec<DVec2> {
        let mut r = rng(1, "chance", 0);
        (0..n).map(|_| DVec2::new(r.random_range(0.0..640.0), r.random_range(0.0..480.0))).collect()
    }

    #[test]
    fn many_close_inliers_are_meaningful_and_few_among_many_are_not() {
        let inliers =
            |k: usize, n: usize| (0..n).map(|i| if i < k { 1.0 } else { 1e4 }).collect::<Vec<f64>>();
        let alarms = |k, n| log10_false_alarms(&inliers(k, n), &points(n), Constraint::Line, 7, 3.0, 4.0);
        assert!(alarms(50, 60) < -30.0);
        assert!(alarms(20, 25) < -3.0);
        assert!(alarms(15, 100) > 0.0);
    }

    #[test]
    fn without_data_beyond_a_sample_nothing_is_meaningful() {
        assert_eq!(log10_false_alarms(&[], &[], Constraint::Line, 7, 3.0, 4.0), f64::INFINITY);
        assert_eq!(log10_false_alarms(&[0.0; 7], &points(7), Constraint::Line, 7, 3.0, 4.0), f64::INFINITY);
        let infinite = [f64::INFINITY; 30];
        assert_eq!(log10_false_alarms(&infinite, &points(30), Constraint::Point, 4, 1.0, 4.0), f64::INFINITY);
    }
}
