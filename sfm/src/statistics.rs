//! Small statistics that several modules need.

/// Median (the upper of two); 0 of nothing.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// The median absolute deviation of a normal variable, in standard deviations.
/// Source: the 75th percentile of the standard normal distribution.
pub(crate) const MEDIAN_DEVIATION: f64 = 0.6745;
/// The median length of a vector of three standard normal coordinates.
/// Source: the square root of the median of a chi-square variable with three degrees of freedom.
pub(crate) const MEDIAN_LENGTH: f64 = 1.538;
