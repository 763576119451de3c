//! Numbers as flags take them: finite and within sensible limits, so that nothing behind them has
//! to ask again.

use std::fmt::Display;
use std::str::FromStr;

/// A parser of numbers from `low` to `high`, both allowed; `nan` and `inf` are not.
///
/// ```
/// let share = scene::flag::between(0.0, 1.0);
/// assert_eq!(share("0.25"), Ok(0.25));
/// assert_eq!(share("2"), Err("2 is not from 0 to 1".to_owned()));
/// assert!(share("nan").is_err());
/// ```
pub fn between<T>(low: T, high: T) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr<Err: Display> + PartialOrd + Display + Copy + Send + Sync + 'static,
{
    move |text| {
        let value: T = text.parse().map_err(|e: T::Err| e.to_string())?;
        if low <= value && value <= high {
            Ok(value)
        } else {
            Err(format!("{value} is not from {low} to {high}"))
        }
    }
}
