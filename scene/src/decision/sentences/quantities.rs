//! Numbers in words: name, digits, unit.

use crate::decision::Measurement;
use crate::decision::quantity::Unit;

impl Measurement {
    /// Name, number and unit.
    pub(super) fn clause(&self) -> String {
        format!("{} {}", self.quantity.words().0, self.figure())
    }

    /// The number with its unit and standard deviation.
    pub(super) fn figure(&self) -> String {
        match self.quantity.words().1 {
            Unit::Signed(digits) if self.deviation.is_none() => format!("{:+.digits$}", self.value),
            Unit::Plain(digits) | Unit::Signed(digits) => self.written(1.0, digits, ""),
            Unit::Percent(digits) => self.written(100.0, digits, " %"),
            Unit::Of(unit @ "°", digits) => self.written(1.0, digits, unit),
            Unit::Of(unit, digits) => self.written(1.0, digits, &format!(" {unit}")),
        }
    }

    /// Number and standard deviation times a factor, with so many digits.
    fn written(&self, factor: f64, digits: usize, unit: &str) -> String {
        let deviation = self.deviation.map_or(String::new(), |d| format!(" ± {:.digits$}", factor * d));
        format!("{:.digits$}{deviation}{unit}", factor * self.value)
    }
}
