//! The traffic light: what is well, what is doubtful and what is wrong, each with its reason.

use crate::evaluate::Evaluation;
use crate::evaluate::metrics::Metrics;
use crate::pipeline::{PoseSummary, RunRecord};
use scene::{FrameSet, Pose, Reconstruction, Ring};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// How well something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Not measured.
    Unknown,
    /// As it should be.
    Good,
    /// Usable, with a doubt.
    Fair,
    /// Not to be relied on.
    Bad,
}

/// One light of the verdict.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Light {
    /// What is judged.
    pub what: String,
    /// The colour.
    pub level: Level,
    /// Why, with the figures.
    pub reason: String,
}

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
    pub fn class(self) -> &'static str {
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
pub fn overall(lights: &[Light]) -> Level {
    lights.iter().map(|l| l.level).max().unwrap_or(Level::Unknown)
}

/// Every light that can be told of what the run knows. `model`: its solved poses; `geometry`: what the evaluation
/// measured of the shape.
pub fn verdict(record: &RunRecord, model: Option<&Reconstruction>, geometry: Option<&Value>) -> Vec<Light> {
    let mut lights = Vec::new();
    if let Some(poses) = &record.poses {
        lights.push(registered(poses));
        if poses.no_model.is_some() {
            return lights;
        }
        if let (Some(model), Some(frames)) = (model, &record.frames) {
            lights.extend(turn(model, frames));
        }
        lights.extend(sightings(poses));
        lights.push(weak(poses));
    }
    if let Some(evaluation) = record.evaluation.as_ref().filter(|e| !e.views.is_empty()) {
        lights.push(quality(evaluation));
        lights.push(overfit(evaluation));
        lights.push(floaters(geometry));
    }
    lights
}

/// Share of the opacity that lies outside the visual hull of the mattes.
fn floaters(geometry: Option<&Value>) -> Light {
    match geometry.and_then(|g| g.get("floaters_pct")).and_then(Value::as_f64).map(|pct| pct / 100.0) {
        Some(share) => {
            let reason =
                format!("{:.2} % of the opacity lies outside the mattes' visual hull", 100.0 * share);
            light("floaters", Level::below(share, 0.01, 0.05), reason)
        }
        None => light("floaters", Level::Unknown, "not measured".to_owned()),
    }
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

fn sightings(poses: &PoseSummary) -> Option<Light> {
    if poses.points == 0 {
        return None; // poses of the input without a cloud
    }
    let reason = format!("{:.2} px on average over {} points", poses.mean_error_px, poses.points);
    Some(light("reprojection error", Level::below(poses.mean_error_px, 1.0, 2.0), reason))
}

fn weak(poses: &PoseSummary) -> Light {
    if poses.imported {
        return light("weak frames", Level::Unknown, "not judged: the poses are the input's".to_owned());
    }
    let share = poses.weak.len() as f64 / poses.registered.max(1) as f64;
    let names: Vec<&str> = poses.weak.iter().take(3).map(|w| w.0.as_str()).collect();
    let more = if poses.weak.len() > names.len() { ", …" } else { "" };
    let reason = match names.len() {
        0 => "none hangs by a thread".to_owned(),
        _ => format!("{} of {}: {}{more}", poses.weak.len(), poses.registered, names.join(", ")),
    };
    light("weak frames", Level::below(share, 0.0, 0.1), reason)
}

/// Centres farther from their circle than this, in radii, do not go round anything.
const RING_MISFIT: f64 = 0.1;

/// An eighth of the turn: surfaces that face it are seen from aslant only.
const WIDE_GAP_DEG: f64 = 45.0;

/// The circle the cameras stand on, in the order of the frames: with their names and places in that order.
pub fn ring(model: &Reconstruction, frames: &FrameSet) -> Option<(Ring, Vec<String>, Vec<f64>)> {
    let mut found: Vec<(f64, &str, Pose)> = Vec::new();
    for (place, frame) in frames.frames.iter().enumerate() {
        if let Some(image) = model.image_named(&frame.name) {
            found.push((place as f64, &frame.name, image.pose));
        }
    }
    let poses: Vec<Pose> = found.iter().map(|f| f.2).collect();
    let ring = Ring::fit(&poses).filter(|r| r.misfit < RING_MISFIT)?;
    Some((ring, found.iter().map(|f| f.1.to_owned()).collect(), found.iter().map(|f| f.0).collect()))
}

/// Whether the loop closes: no wide arc without a camera, and in a video no jump between neighbours.
fn turn(model: &Reconstruction, frames: &FrameSet) -> Option<Light> {
    let (ring, names, places) = ring(model, frames)?;
    let (gap, (jump, step)) = (ring.largest_gap(), ring.steps(&places));
    let [gap_deg, jump_deg, step_deg]: [f64; 3] = [gap.angle, jump.angle, step].map(f64::to_degrees);
    let ends = |ends: [usize; 2]| format!("{} and {}", names[ends[0]], names[ends[1]]);
    if frames.is_video && jump_deg > (6.0 * step_deg).max(20.0) {
        let reason = format!(
            "{} follow each other but lie {jump_deg:.0}° a frame apart (others {step_deg:.1}°): the model may be folded",
            ends(jump.ends)
        );
        return Some(light("loop", Level::Bad, reason));
    }
    // Without an order in time the cameras' own mean distance is the measure.
    let mean_deg: f64 = 360.0 / names.len() as f64;
    let is_closed = gap_deg <= (4.0 * step_deg.min(mean_deg)).max(WIDE_GAP_DEG);
    let reason = if is_closed {
        format!("closed: the largest gap is {gap_deg:.1}°, between {}", ends(gap.ends))
    } else {
        format!("open: {gap_deg:.0}° without a camera, between {}", ends(gap.ends))
    };
    Some(light("loop", if is_closed { Level::Good } else { Level::Fair }, reason))
}

/// The PSNR that is judged: inside the matte where there are mattes, since black around an object is no achievement.
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
        return light("overfitting", Level::Unknown, "no training view was judged".to_owned());
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
    use crate::evaluate::{TrainingViews, ViewMetrics};
    use glam::DVec3;
    use scene::{Frame, PosedImage};

    /// Cameras at these angles (degrees) on a circle, filmed in this order.
    fn filmed(angles: &[f64]) -> (Reconstruction, FrameSet) {
        let (mut model, mut frames) =
            (Reconstruction::default(), FrameSet { is_video: true, ..FrameSet::default() });
        for (i, a) in angles.iter().enumerate() {
            let (sin, cos) = a.to_radians().sin_cos();
            let pose = Pose::look_at(DVec3::new(cos, sin, 0.2), DVec3::ZERO, DVec3::Z);
            let (id, name) = (i as u32 + 1, format!("{i:03}.png"));
            model
                .images
                .insert(id, PosedImage { id, camera: 1, name: name.clone(), pose, observations: vec![] });
            frames.frames.push(Frame { name, ..Frame::default() });
        }
        (model, frames)
    }

    fn steps(from: f64, step: f64, count: usize) -> Vec<f64> {
        (0..count).map(|i| from + step * i as f64).collect()
    }

    #[test]
    fn a_full_turn_is_closed_half_a_turn_is_open_and_a_jump_is_a_fold() {
        let level = |angles: &[f64]| {
            let (model, frames) = filmed(angles);
            turn(&model, &frames).map(|l| l.level)
        };
        assert_eq!(level(&steps(0.0, 5.0, 72)), Some(Level::Good));
        assert_eq!(level(&steps(0.0, 5.0, 36)), Some(Level::Fair));
        // A gap counts from an eighth of a turn on, however densely the rest was filmed.
        assert_eq!(level(&steps(0.0, 4.0, 81)), Some(Level::Good), "a gap of 40°");
        assert_eq!(level(&steps(0.0, 4.0, 78)), Some(Level::Fair), "a gap of 52°");
        assert_eq!(level(&[steps(0.0, 5.0, 36), steps(0.0, 5.0, 36)].concat()), Some(Level::Bad));
    }

    #[test]
    fn frames_without_a_pose_are_no_jump() {
        let (mut model, frames) = filmed(&steps(0.0, 5.0, 72));
        (20..32).for_each(|id| drop(model.images.remove(&id)));
        let found = turn(&model, &frames).unwrap();
        assert_eq!(found.level, Level::Fair, "{}", found.reason);
        assert!(found.reason.contains("018.png and 031.png"), "{}", found.reason);
    }

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
    fn black_around_an_object_is_no_achievement() {
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
