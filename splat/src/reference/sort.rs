//! sort: the order in which Gaussians are composited.
//!
//! in: \[N\] [`Projected`] or nothing · out: indices of those that are seen, nearest first, ties by
//! index.

use super::project::Projected;

/// Indices of the Gaussians that are seen, by ascending depth, ties by index. It has no derivative:
/// L is taken as smooth within an order.
pub(crate) fn sort(projected: &[Option<Projected>]) -> Vec<usize> {
    let mut seen: Vec<(f64, usize)> =
        projected.iter().enumerate().filter_map(|(i, p)| p.map(|p| (p.depth, i))).collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    seen.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_comes_first_and_equal_depths_keep_their_order() {
        let at = |depth| Some(Projected { depth, ..Projected::default() });
        assert_eq!(sort(&[at(2.0), None, at(1.0), at(2.0), at(0.5), at(1.0)]), [4, 2, 5, 0, 3]);
    }
}
