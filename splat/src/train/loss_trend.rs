//! Whether training goes the wrong way.

use super::CurvePoint;

/// This many times the loss of the first steps, ...
const GROWN: f32 = 2.0;
/// ... and more than a scene that nothing has to be learnt of can have.
const MATTERS: f32 = 0.02;
/// Points of the curve in a row that must say so.
const IN_A_ROW: usize = 2;

/// Why training cannot go on, if its loss stays far above what it began with: steps are too large then, and all that comes is
/// worse than the first Gaussians were.
pub(super) fn runaway(curve: &[CurvePoint]) -> Option<String> {
    let first = curve.first()?.loss;
    let last = &curve[curve.len().saturating_sub(IN_A_ROW).max(1)..];
    let grown = |p: &CurvePoint| p.loss > GROWN * first && p.loss > MATTERS;
    (last.len() == IN_A_ROW && last.iter().all(grown)).then(|| {
        let now = last[IN_A_ROW - 1].loss;
        format!("the loss has grown from {first:.4} to {now:.4}; lower --learning-rate")
    })
}

/// A training at the end of which the loss is this share of the first and more has learnt nothing.
const LEARNT: f32 = 0.9;

/// What is to be said of a training that ended about where it began.
pub(super) fn stuck(curve: &[CurvePoint]) -> Option<String> {
    let [first, .., last] = curve else { return None };
    if last.loss < LEARNT * first.loss {
        return None;
    }
    let from_to = format!("the loss was {:.4} at first and is {:.4} at the end", first.loss, last.loss);
    (last.loss > MATTERS)
        .then(|| format!("{from_to}; poses or masks may be wrong, or --learning-rate too large"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(losses: &[f32]) -> Vec<CurvePoint> {
        losses.iter().map(|&loss| CurvePoint { loss, ..CurvePoint::default() }).collect()
    }

    #[test]
    fn only_a_loss_that_stays_far_above_the_first_ends_training() {
        let told = runaway(&curve(&[0.1, 0.05, 0.25, 0.3])).unwrap();
        assert!(
            told.contains("0.1000") && told.contains("0.3000") && told.contains("--learning-rate"),
            "{told}"
        );
        for fine in [
            &[][..],
            &[0.1],
            &[0.1, 0.3],
            &[0.1, 0.3, 0.1],
            &[0.1, 0.3, 0.3, 0.19],
            &[0.1, 0.19, 0.19],
            &[1e-6, 1e-3, 1e-2],
        ] {
            assert_eq!(runaway(&curve(fine)), None, "{fine:?}");
        }
    }

    #[test]
    fn an_end_like_the_beginning_is_remarked_on() {
        let told = stuck(&curve(&[0.15, 0.1, 0.148])).unwrap();
        assert!(told.contains("0.1500") && told.contains("0.1480"), "{told}");
        for fine in [&[][..], &[0.1], &[0.1, 0.3, 0.05], &[1e-6, 1e-3], &[0.0, 0.0]] {
            assert_eq!(stuck(&curve(fine)), None, "{fine:?}");
        }
    }
}
