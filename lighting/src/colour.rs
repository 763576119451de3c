//! sRGB and linear light (IEC 61966-2-1).

/// Linear light of an sRGB value; below 0 nothing, beyond 1 the curve goes on.
pub(crate) fn linear(v: f64) -> f64 {
    let v = v.max(0.0);
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The sRGB value of linear light.
pub(crate) fn srgb(v: f64) -> f64 {
    let v = v.max(0.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_lead_back_and_know_a_published_value() {
        for v in [0.0, 0.01, 0.0404, 0.0405, 0.5, 1.0, 1.3] {
            assert!((srgb(linear(v)) - v).abs() < 1e-4, "{v}");
        }
        // Middle grey: sRGB 0.5 is linear 0.2140.
        assert!((linear(0.5) - 0.2140).abs() < 1e-4);
        assert_eq!([linear(-1.0), srgb(-1.0)], [0.0; 2]);
    }
}
