//! Order statistics.

/// The value below which a share (0 to 1) of the values lies, the nearest one; `None` without
/// values.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let place = ((values.len().max(1) - 1) as f64 * share).round() as usize;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(place, f64::total_cmp).1)
}

/// The middle value, the upper of two; `None` without values.
pub(crate) fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_of_the_sample() {
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median(vec![5.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(quantile((0..=100).map(f64::from).collect(), 0.05), Some(5.0));
        assert_eq!(median(Vec::new()), None);
    }
}
