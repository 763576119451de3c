//! Small dense systems.

/// Solves `A x = b` by elimination; `None` where a pivot is not positive or anything is not finite.
pub(super) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    for k in 0..N {
        let row = a[k];
        if !(row[k] > 0.0 && row[k].is_finite()) {
            return None;
        }
        for r in k + 1..N {
            let factor = a[r][k] / row[k];
            a[r].iter_mut().zip(&row).skip(k).for_each(|(x, y)| *x -= factor * y);
            b[r] -= factor * b[k];
        }
    }
    for k in (0..N).rev() {
        let known: f64 = (k + 1..N).map(|q| a[k][q] * b[q]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b.iter().all(|v| v.is_finite()).then_some(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems_are_solved_and_singular_ones_are_refused() {
        assert_eq!(solve([[4.0, 2.0], [2.0, 3.0]], [10.0, 9.0]), Some([1.5, 2.0]));
        assert_eq!(solve([[0.0]], [1.0]), None);
        assert_eq!(solve([[f64::NAN]], [1.0]), None);
    }
}
