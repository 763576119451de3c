//! The probability that a model is right, from its features: a logistic regression on many captures
//! whose truth is known (tools/plausibility; docs/decisions/20).

use scene::decision::{Measurement, Quantity, Remark};

/// How a number enters.
#[derive(Clone, Copy)]
enum Scale {
    /// What a Cauchy variable's logarithm of the density falls by: files may state a wrong lens.
    Cauchy,
    /// The logarithm of its odds.
    Odds,
    /// Its logarithm.
    Log,
}

impl Scale {
    /// The offsets keep numbers of 0 and 1 finite, about where they can no longer be told apart.
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Cauchy => (value * value).ln_1p(),
            Self::Odds => ((value + 0.02) / (1.02 - value)).ln(),
            Self::Log => (value + 0.05).ln(),
        }
    }
}

/// A feature, and what it adds to the log odds.
struct Term {
    quantity: Quantity,
    scale: Scale,
    weight: f64,
    /// Its value on its scale in the middle of all captures.
    usual: f64,
    /// What is said where it speaks against the model.
    against: Remark,
}

impl Term {
    const fn new(quantity: Quantity, scale: Scale, weight: f64, usual: f64, against: Remark) -> Self {
        Self { quantity, scale, weight, usual, against }
    }
}

/// What is known of a model adds to its log odds.
/// Source: tools/plausibility/fit.py on half A of docs/results/plausibility.csv.
const TERMS: [Term; 5] = [
    Term::new(Quantity::CameraSurprise, Scale::Cauchy, -1.128, 1.073, Remark::UnusualCamera),
    Term::new(Quantity::LeastExplained, Scale::Odds, 2.151, 0.666, Remark::UnexplainedMatches),
    Term::new(Quantity::PointAngle, Scale::Log, 3.471, 2.880, Remark::NarrowViews),
    Term::new(Quantity::HeldOutAgreement, Scale::Odds, 2.081, 0.567, Remark::HeldOutDisagree),
    Term::new(Quantity::SecondDifference, Scale::Log, -0.633, 0.040, Remark::SolutionsDisagree),
];
/// Log odds of a model with usual features.
/// Source: the same fit.
const CONSTANT: f64 = 4.034;
/// Log odds that a feature must take away to be named as a reason.
/// Source: derived; less does not halve the odds.
const NAMED: f64 = -std::f64::consts::LN_2;

/// What the features say together: the probability, and what speaks against the model, the gravest
/// first.
pub(super) fn weigh(features: &[Measurement]) -> (f64, Vec<Remark>) {
    let value = |q: Quantity| features.iter().find(|m| m.quantity == q).map(|m| m.value);
    let mut terms: Vec<(f64, Remark)> = Vec::new();
    for term in &TERMS {
        let known = value(term.quantity).filter(|v| v.is_finite());
        let added = known.map_or(0.0, |v| term.weight * (term.scale.of(v) - term.usual));
        terms.push((added, term.against));
    }
    let odds = CONSTANT + terms.iter().map(|t| t.0).sum::<f64>();
    terms.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut against: Vec<Remark> = Vec::new();
    for (_, remark) in terms.into_iter().take_while(|t| t.0 < NAMED) {
        if !against.contains(&remark) {
            against.push(remark);
        }
    }
    (1.0 / (1.0 + (-odds).exp()), against)
}
