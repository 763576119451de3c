//! Whether a part explains photos that no training has seen.

use super::loose::{Freedom, LooseTraining, Seen, total};
use anyhow::Result;
use glam::DVec3;
use scene::Progress;
use sfm::LooseJoint;

/// How candidates are judged.
struct JudgeLimits {
    /// One training view in so many only judges. Source: chosen by hand.
    every: usize,
    /// Pixels whose errors are as one. Source: as for poses and joints.
    pixels_as_one: f64,
    /// What a part adds to what is to be known: axis and place, and an angle for each knot of its
    /// motion. Source: derived: 4 and 11.
    parameters: f64,
}

/// The values in force.
const JUDGE: JudgeLimits = JudgeLimits { every: 6, pixels_as_one: 1000.0, parameters: 15.0 };

/// The views that judge, and the others.
pub(super) fn split(training: &[usize]) -> [Vec<usize>; 2] {
    let places = training.iter().copied().enumerate();
    let (judges, others): (Vec<_>, Vec<_>) = places.partition(|(k, _)| k % JUDGE.every == JUDGE.every / 2);
    [judges, others].map(|views| views.into_iter().map(|(_, view)| view).collect())
}

/// How much better photos of `judges` are explained where points move on a joint than where they
/// rest, dB; `None` where the photos have no evidence for it.
pub(super) fn gain_db(
    seen: Seen,
    judges: &[usize],
    joint: &LooseJoint,
    points: &[DVec3],
    progress: &Progress,
) -> Result<Option<f64>> {
    let pieces = seen.pieces.with(points);
    let seen = Seen { pieces: &pieces, ..seen };
    let rest = errors(seen, judges, Freedom::Rest, progress)?;
    let moving = errors(seen, judges, Freedom::Last(joint), progress)?;
    let gain = 10.0 * (total(&rest) / total(&moving)).log10();
    Ok((evidence(&rest, &moving) > 0.0).then_some(gain))
}

/// Errors of views that a training has not seen.
fn errors(seen: Seen, views: &[usize], freedom: Freedom, progress: &Progress) -> Result<Vec<[f64; 2]>> {
    let mut training = LooseTraining::new(seen, freedom)?;
    training.run(progress)?;
    training.errors(views, None)
}

/// How much more probable the photos are with a part than without, natural logarithm, less what its
/// parameters are worth (Schwarz 1978). The photo that speaks most for the part is left out: no one
/// of them decides.
fn evidence(rest: &[[f64; 2]], moving: &[[f64; 2]]) -> f64 {
    let ratios = rest.iter().zip(moving).map(|(a, b)| a[0] / b[0].max(f64::MIN_POSITIVE));
    let gains: Vec<f64> = rest.iter().zip(ratios).map(|(a, ratio)| 0.5 * samples(a) * ratio.ln()).collect();
    let most = gains.iter().copied().fold(0.0, f64::max);
    let all: f64 = rest.iter().map(samples).sum();
    gains.iter().sum::<f64>() - most - 0.5 * JUDGE.parameters * all.max(1.0).ln()
}

/// Independent errors of a photo.
fn samples([_, pixels]: &[f64; 2]) -> f64 {
    pixels / JUDGE.pixels_as_one
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photos(error: f64) -> [[f64; 2]; 12] {
        [[error, 3e5]; 12]
    }

    #[test]
    fn a_part_has_evidence_where_several_photos_speak_for_it() {
        assert!(evidence(&photos(1e-3), &photos(1e-3)) < 0.0, "it costs something");
        assert!(evidence(&photos(1e-3), &photos(0.9e-3)) > 50.0);
        let mut one = photos(1e-3);
        one[4][0] = 1e-5;
        assert!(evidence(&photos(1e-3), &one) < 0.0, "one photo does not decide");
    }

    #[test]
    fn views_judge_or_are_trained_on() {
        let all: Vec<usize> = (10..30).collect();
        assert_eq!(split(&all), [vec![13, 19, 25], all.iter().copied().filter(|v| v % 6 != 1).collect()]);
        assert_eq!(split(&[4]), [vec![], vec![4]]);
    }
}
