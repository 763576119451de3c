//! Whether training learns anything, by its curve.

use super::state::CurvePoint;
use scene::decision::{Decision, Quantity, Remark, Rule, Subject};

/// When a curve says that training goes wrong or has learnt nothing.
struct TrendLimits {
    /// Training goes the wrong way where its loss is this many times that of the first steps, a
    /// ratio. Source: docs/decisions/12.
    grown: f32,
    /// A loss below this is that of a scene of which nothing has to be learnt. Source: chosen by
    /// hand, never measured.
    matters: f32,
    /// Points of the curve in a row that must say so. Source: one point may be a single bad view.
    in_a_row: usize,
    /// A training at the end of which the loss is this share of the first and more has learnt
    /// nothing. Source: chosen by hand; docs/decisions/12 has unlearnt trainings at 1.
    learnt: f32,
}

/// The values in force.
const LIMITS: TrendLimits = TrendLimits { grown: 2.0, matters: 0.02, in_a_row: 2, learnt: 0.9 };

/// Why training cannot go on, if its loss stays far above what it began with: steps are too large
/// then, and all that comes is worse than the first Gaussians were.
pub(super) fn runaway(curve: &[CurvePoint]) -> Option<String> {
    let first = curve.first()?.loss;
    let last = &curve[curve.len().saturating_sub(LIMITS.in_a_row).max(1)..];
    let has_grown = last.iter().all(|p| p.loss > LIMITS.grown * first && p.loss > LIMITS.matters);
    (last.len() == LIMITS.in_a_row && has_grown).then(|| {
        let now = last[LIMITS.in_a_row - 1].loss;
        format!("the loss has grown from {first:.4} to {now:.4}; lower --learning-rate")
    })
}

/// What is to be said of a training that ended about where it began.
pub(super) fn stuck(curve: &[CurvePoint]) -> Option<Decision> {
    let [first, .., last] = curve else { return None };
    (last.loss >= LIMITS.learnt * first.loss && last.loss > LIMITS.matters).then(|| {
        Decision::new(Subject::Convergence, false, Rule::Evidence)
            .remarked(Remark::CheckInput)
            .measured(Quantity::FirstLoss, f64::from(first.loss))
            .measured(Quantity::LastLoss, f64::from(last.loss))
    })
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
        let losses = [Quantity::FirstLoss, Quantity::LastLoss].map(|q| told.value(q).unwrap() as f32);
        assert_eq!(losses, [0.15, 0.148]);
        for fine in [&[][..], &[0.1], &[0.1, 0.3, 0.05], &[1e-6, 1e-3], &[0.0, 0.0]] {
            assert_eq!(stuck(&curve(fine)), None, "{fine:?}");
        }
    }
}
