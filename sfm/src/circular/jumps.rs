//! What is believed of the turn in any video before more is known: that its rate does not jump.
//!
//! Where frames lie far apart, some share next to no points with those before them, and their angle may be anything that few wrong
//! observations say. A belief that is far weaker than any dozen good observations keeps them in their place.

use super::problem::Relation;
use crate::statistics::median;

/// Standard deviation of the change of the rate from one step to the next, as a share of the usual rate.
const CHANGE: f64 = 0.5;

/// That the rates of neighbouring steps are alike, `(θ₂ − θ₁) / (t₂ − t₁) = (θ₁ − θ₀) / (t₁ − t₀)`, over the frames that have an
/// angle; in units of the mean step. Nothing where no times are known or nothing turns.
pub(crate) fn not_jumping(angles: &[Option<f64>], times: &[f64]) -> Vec<Relation> {
    let known: Vec<(usize, f64, f64)> = angles
        .iter()
        .zip(times)
        .enumerate()
        .filter_map(|(frame, (angle, time))| Some((frame, (*angle)?, *time)))
        .collect();
    let rates = known.windows(2).map(|w| ((w[1].1 - w[0].1) / (w[1].2 - w[0].2)).abs());
    let usual = median(rates.filter(|r| r.is_finite()).collect());
    if !(usual > 0.0) {
        return Vec::new();
    }
    let alike = |w: &[(usize, f64, f64)]| {
        let (before, after) = (w[1].2 - w[0].2, w[2].2 - w[1].2);
        let step = 0.5 * (before + after);
        (before > 0.0 && after > 0.0).then(|| Relation {
            frames: [w[0].0, w[1].0, w[2].0].map(|f| Some(f as u32)),
            coefficients: [step / before, -step / before - step / after, step / after],
            target: 0.0,
            sigma: CHANGE * usual * step,
        })
    };
    known.windows(3).filter_map(alike).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_turn_fits_whatever_its_steps_and_a_jump_of_a_step_is_two_deviations() {
        let times = [0.0, 1.0, 2.5, 3.0, 4.0, 5.0];
        let steady: Vec<Option<f64>> = times.iter().map(|t| Some(0.2 * t + 1.0)).collect();
        let off = |r: &Relation, angles: &[Option<f64>]| -> f64 {
            let sum = r.frames.iter().flatten().zip(r.coefficients);
            (sum.map(|(f, c)| c * angles[*f as usize].unwrap()).sum::<f64>() - r.target) / r.sigma
        };
        let relations = not_jumping(&steady, &times);
        assert_eq!(relations.len(), 4);
        assert!(relations.iter().all(|r| off(r, &steady).abs() < 1e-12));
        let mut stuck = steady.clone();
        stuck[5] = stuck[4];
        assert!((off(&relations[3], &stuck).abs() - 1.0 / CHANGE).abs() < 1e-9);
        let mut some = steady.clone();
        some[1] = None;
        assert_eq!(not_jumping(&some, &times).len(), 3);
        assert!(not_jumping(&some, &times).iter().all(|r| off(r, &some).abs() < 1e-12));
    }

    #[test]
    fn nothing_is_believed_of_what_has_no_times_or_does_not_turn() {
        let angles = vec![Some(1.0); 5];
        assert!(not_jumping(&angles, &[]).is_empty());
        assert!(not_jumping(&angles, &[0.0, 1.0, 2.0, 3.0, 4.0]).is_empty());
        assert!(not_jumping(&[None; 5], &[0.0, 1.0, 2.0, 3.0, 4.0]).is_empty());
        assert!(not_jumping(&[Some(0.0), Some(1.0)], &[0.0, 1.0]).is_empty());
    }
}
