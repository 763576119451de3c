//! The probability that a model is right, from its features: a logistic regression on many captures
//! whose truth is known (tools/plausibility; docs/decisions/17).

use scene::decision::{Measurement, Quantity, Remark};

/// How a number enters.
#[derive(Clone, Copy)]
enum Scale {
    /// By how much it is above 1.
    Excess,
    /// The logarithm of its odds.
    Odds,
    /// Its logarithm.
    Log,
}

impl Scale {
    /// The offsets keep numbers of 0 and 1 finite, about where they can no longer be told apart.
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Excess => (value - 1.0).max(0.0),
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

/// Source: SRC
const TERMS: [Term; 1] = [];
/// Log odds of a model with usual features.
/// Source: SRC
const CONSTANT: f64 = 0.0;
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
    let against = terms.into_iter().take_while(|t| t.0 < NAMED).map(|t| t.1);
    (1.0 / (1.0 + (-odds).exp()), against.collect())
}
