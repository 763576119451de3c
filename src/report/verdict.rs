//! The traffic light: what is well, doubtful or wrong, each with its reason.

use crate::record::{Evaluation, Level, Light, Metrics, PoseSummary, RunRecord};
use scene::decision::Subject;
use scene::{Closure, FrameSet, Reconstruction, RingSequence, WideLens};

impl Level {
    /// Of a figure of which less is better.
    fn below(value: f64, good: f64, fair: f64) -> Self {
        if value <= good {
            Self::Good
        } else if value <= fair {
            Self::Fair
        } else {
            Self::Bad // also what is no number
        }
    }

    /// As a class of the style sheet.
    pub(crate) fn class(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Bad => "bad",
        }
    }
}

fn light(what: &str, level: Level, reason: String) -> Light {
    Light { what: what.to_owned(), level, reason }
}

/// The worst of the lights.
pub(crate) fn overall(lights: &[Light]) -> Level {
    lights.iter().map(|l| l.level).max().unwrap_or(Level::Unknown)
}

/// Every light that can be told from what the run knows; `model`: its poses and points.
pub(super) fn verdict(record: &RunRecord, model: Option<&Reconstruction>) -> Vec<Light> {
    let mut lights = Vec::new();
    if let Some(poses) = &record.poses {
        lights.push(registered(poses));
        if poses.no_model.is_some() {
            return lights;
        }
        if let (Some(model), Some(frames)) = (model, &record.frames) {
            lights.extend(closure(model, frames));
        }
        lights.extend(plausibility(poses));
        lights.extend(observations(poses));
        lights.push(weak(poses));
    }
    if let Some(evaluation) = record.evaluation.as_ref().filter(|e| !e.views.is_empty()) {
        lights.push(quality(evaluation));
        lights.push(overfit(evaluation));
        lights.extend(floaters(evaluation));
    }
    lights
}

/// Share of the opacity that lies outside the visual hull of the mattes; without mattes there is no
/// hull to judge by.
fn floaters(evaluation: &Evaluation) -> Option<Light> {
    let percent = evaluation.geometry.as_ref()?.floaters_pct?;
    let reason = format!("{percent:.2} % of the opacity lies outside the visual hull of the mattes");
    Some(light("floaters", Level::below(percent, 1.0, 5.0), reason))
}

fn registered(poses: &PoseSummary) -> Light {
    if let Some(reason) = &poses.no_model {
        return light("frames with a pose", Level::Bad, format!("no model: {reason}"));
    }
    let missing = 1.0 - poses.registered as f64 / poses.total.max(1) as f64;
    let given = if poses.imported { " (poses of the input)" } else { "" };
    let reason = format!("{} of {}{given}", poses.registered, poses.total);
    light("frames with a pose", Level::below(missing, 0.0, 0.2), reason)
}

/// How probable it is that the model is right.
fn plausibility(poses: &PoseSummary) -> Option<Light> {
    let decision = poses.decisions.iter().find(|d| d.subject == Subject::Plausibility)?;
    let level = if decision.is_doubt() { Level::Bad } else { Level::Good };
    let words = decision.remarks_in_words().collect::<Vec<_>>().join("; ");
    let reason =
        format!("{}{}{words}", decision.sentences().choice, if words.is_empty() { "" } else { ": " });
    Some(light("probability that the model is right", level, reason))
}

fn observations(poses: &PoseSummary) -> Option<Light> {
    if poses.points == 0 {
        return None; // poses of the input without a cloud
    }
    let reason = format!("{:.2} px on average over {} points", poses.mean_error_px, poses.points);
    Some(light("reprojection error", Level::below(poses.mean_error_px, 1.0, 2.0), reason))
}

fn weak(poses: &PoseSummary) -> Light {
    if poses.imported && poses.weak.is_empty() {
        return light("weak frames", Level::Unknown, "not judged: the poses came with the input".to_owned());
    }
    let share = poses.weak.len() as f64 / poses.registered.max(1) as f64;
    let names: Vec<&str> = poses.weak.iter().take(3).map(|w| w.0.as_str()).collect();
    let more = if poses.weak.len() > names.len() { ", …" } else { "" };
    let reason = match names.len() {
        0 => "no image is weakly constrained".to_owned(),
        _ => format!("{} of {}: {}{more}", poses.weak.len(), poses.registered, names.join(", ")),
    };
    light("weak frames", Level::below(share, 0.0, 0.1), reason)
}

/// Whether the cameras go all the way round, and in a video without a jump. Not asked of panoramas:
/// each looks all the way round.
fn closure(model: &Reconstruction, frames: &FrameSet) -> Option<Light> {
    if frames.wide_lens == Some(WideLens::Panorama) {
        return None;
    }
    let sequence = RingSequence::of(model, frames)?;
    let found = sequence.closure(frames.is_video);
    let [first, last] = sequence.ends(&found.arc);
    let (arc, step) = (found.arc.angle.to_degrees(), found.step.to_degrees());
    let (level, reason) = match found.closure {
        Closure::Jump => {
            let reason = format!(
                "{first} and {last} follow each other but lie {arc:.0}° apart a frame (others {step:.1}°): \
                 repeated structure may have been mistaken for one part"
            );
            (Level::Bad, reason)
        }
        Closure::Closed => {
            let reason = format!("closed: the largest gap is {arc:.1}°, between {first} and {last}");
            (Level::Good, reason)
        }
        Closure::Open => {
            let reason = format!("open: no camera in an arc of {arc:.0}°, between {first} and {last}");
            (Level::Fair, reason)
        }
    };
    Some(light("loop", level, reason))
}

/// The PSNR that is judged: inside the matte where there are mattes, since black pixels around an
/// object are easy to render.
fn judged(metrics: &Metrics) -> f64 {
    metrics.psnr_mask.unwrap_or(metrics.psnr)
}

/// Where [`judged`] looks, in words.
fn place(evaluation: &Evaluation) -> &'static str {
    if evaluation.mean.psnr_mask.is_some() { " inside the mattes" } else { "" }
}

fn quality(evaluation: &Evaluation) -> Light {
    let worst = evaluation.views.iter().min_by(|a, b| judged(&a.metrics).total_cmp(&judged(&b.metrics)));
    let (mean, low) = (judged(&evaluation.mean), worst.map_or(0.0, |w| judged(&w.metrics)));
    let name = worst.map_or("", |w| w.name.as_str());
    let mut level = Level::below(-mean, -25.0, -20.0);
    let mut reason = format!(
        "PSNR {mean:.2} dB, SSIM {:.4}{} on {} views, at worst {low:.2} dB ({name})",
        evaluation.mean.ssim_mask.unwrap_or(evaluation.mean.ssim),
        place(evaluation),
        evaluation.views.len()
    );
    if level == Level::Good && low < mean - 6.0 {
        level = Level::Fair;
        reason += ", far below the others";
    }
    light("held-out views", level, reason)
}

fn overfit(evaluation: &Evaluation) -> Light {
    let Some(training) = &evaluation.training else {
        return light("overfitting", Level::Unknown, "no training view was evaluated".to_owned());
    };
    let (seen, unseen) = (judged(&training.mean), judged(&evaluation.mean));
    let gap = seen - unseen;
    let reason = format!(
        "{seen:.2} dB{} on {} views that training saw, {unseen:.2} dB on those it did not: a gap of {gap:.1} dB",
        place(evaluation),
        training.views
    );
    light("overfitting", Level::below(gap, 2.0, 5.0), reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{TrainingViews, ViewMetrics};

    #[test]
    fn the_gap_between_training_and_held_out_views_is_overfitting() {
        let psnr = |psnr| Metrics { psnr, ..Metrics::default() };
        let evaluation = |training: Option<f64>| Evaluation {
            mean: psnr(30.0),
            views: vec![ViewMetrics { name: "a".into(), picture: "a.png".into(), metrics: psnr(30.0) }],
            training: training.map(|p| TrainingViews { views: 1, mean: psnr(p) }),
            ..Evaluation::default()
        };
        for (training, level) in
            [(Some(31.0), Level::Good), (Some(34.0), Level::Fair), (Some(38.0), Level::Bad)]
        {
            assert_eq!(overfit(&evaluation(training)).level, level);
        }
        assert_eq!(overfit(&evaluation(None)).level, Level::Unknown);
        assert_eq!(overall(&[overfit(&evaluation(Some(34.0))), quality(&evaluation(None))]), Level::Fair);
    }

    #[test]
    fn floaters_are_no_light_where_there_is_no_matte() {
        let evaluation = |floaters_pct| Evaluation {
            geometry: Some(crate::record::ShapeEvaluation { floaters_pct, ..Default::default() }),
            ..Evaluation::default()
        };
        assert_eq!(floaters(&evaluation(None)), None);
        assert_eq!(floaters(&Evaluation::default()), None);
        assert_eq!(floaters(&evaluation(Some(7.0))).unwrap().level, Level::Bad);
    }

    #[test]
    fn pixels_outside_the_matte_are_not_judged() {
        let of = |psnr, inside| Metrics { psnr, psnr_mask: inside, ..Metrics::default() };
        let evaluation = |all: &[Metrics], training| Evaluation {
            mean: Metrics::mean(all),
            views: all
                .iter()
                .map(|m| ViewMetrics { name: "a".into(), picture: "a.png".into(), metrics: *m })
                .collect(),
            training: Some(TrainingViews { views: 1, mean: training }),
            ..Evaluation::default()
        };
        let flattered = evaluation(&[of(34.0, Some(18.0))], of(35.0, Some(24.0)));
        assert_eq!((quality(&flattered).level, overfit(&flattered).level), (Level::Bad, Level::Bad));
        assert!(quality(&flattered).reason.contains("18.00 dB"), "{}", quality(&flattered).reason);
        let whole = evaluation(&[of(34.0, None)], of(35.0, None));
        assert_eq!((quality(&whole).level, overfit(&whole).level), (Level::Good, Level::Good));
        let uneven = evaluation(&[of(34.0, Some(36.0)), of(34.0, Some(20.0))], of(30.0, Some(24.0)));
        assert_eq!(quality(&uneven).level, Level::Fair, "the worst view is the worst inside");
    }
}
