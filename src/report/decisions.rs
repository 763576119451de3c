//! What was decided: by the stages, and what stands where no stage decided.

use crate::record::RunRecord;
use maud::{Markup, html};
use scene::decision::{
    BackgroundModel, Choice, Decision, LightModel, Measurement, MotionModel, PrincipalPoint, Quantity,
    Remark, Rule, Subject,
};
use splat::PoseRefinement;

/// What a run decides in any case, with what is so where no stage did.
const DEFAULTS: [(Subject, fn(&RunRecord) -> Option<Decision>); 8] = [
    (Subject::CameraModel, camera_model),
    (Subject::Motion, motion),
    (Subject::Background, background),
    (Subject::ShDegree, sh_degree),
    (Subject::GaussianCount, gaussian_count),
    (Subject::TrainingPoses, training_poses),
    (Subject::Exposure, exposure),
    (Subject::Illumination, illumination),
];

/// All decisions of a run in the order of their subjects, one or more for each that a run always
/// decides.
pub(super) fn all(record: &RunRecord) -> Vec<Decision> {
    let poses = record.poses.iter().flat_map(|p| &p.decisions);
    let splat = record.splat.iter().flat_map(|s| &s.decisions);
    let frames = record.frames.iter().flat_map(|f| &f.decisions);
    let mut all: Vec<Decision> = frames.chain(poses).chain(splat).cloned().collect();
    for (subject, default) in DEFAULTS {
        if !all.iter().any(|d| d.subject == subject) {
            all.extend(default(record));
        }
    }
    all.sort_by_key(|d| d.subject);
    all
}

fn is_imported(record: &RunRecord) -> bool {
    record.poses.as_ref().is_some_and(|p| p.imported)
}

fn camera_model(record: &RunRecord) -> Option<Decision> {
    let choice = Choice::Camera { model: None, principal_point: PrincipalPoint::Given };
    is_imported(record).then(|| Decision::new(Subject::CameraModel, choice, Rule::Given))
}

fn motion(record: &RunRecord) -> Option<Decision> {
    if is_imported(record) {
        return Some(Decision::new(Subject::Motion, MotionModel::Given, Rule::Given));
    }
    record.poses.as_ref().filter(|p| p.no_model.is_none())?;
    Some(Decision::new(Subject::Motion, MotionModel::Free, Rule::Default))
}

fn background(record: &RunRecord) -> Option<Decision> {
    record.splat.as_ref()?;
    let frames = record.frames.as_ref()?;
    let mattes = frames.frames.iter().filter(|f| f.mask.is_some()).count();
    let decision = match (mattes, record.config.dataset.alpha) {
        (0, _) => Decision::new(Subject::Background, BackgroundModel::Scene, Rule::NothingFound),
        (_, splat::AlphaMode::Transparent) => {
            Decision::new(Subject::Background, BackgroundModel::Transparent, Rule::Evidence)
                .remarked(Remark::RandomBackground)
        }
        (_, splat::AlphaMode::Ignore) => {
            Decision::new(Subject::Background, BackgroundModel::Ignored, Rule::Requested)
        }
    };
    let counts = [
        Measurement::count(Quantity::MattedFrames, mattes),
        Measurement::count(Quantity::Frames, frames.len()),
    ];
    Some(decision.with_all(counts))
}

fn sh_degree(record: &RunRecord) -> Option<Decision> {
    let degree = record.splat.as_ref()?.sh_degree;
    let choice = Measurement::new(Quantity::ShDegree, f64::from(degree));
    Some(Decision::new(Subject::ShDegree, choice, Rule::Default).remarked(Remark::NoValidation))
}

fn gaussian_count(record: &RunRecord) -> Option<Decision> {
    let choice = Choice::count(record.splat.as_ref()?.gaussians);
    Some(Decision::new(Subject::GaussianCount, choice, Rule::Default).remarked(Remark::NoValidation))
}

fn training_poses(record: &RunRecord) -> Option<Decision> {
    record.splat.as_ref()?;
    let (refined, rule) = match record.config.train.refine_poses {
        PoseRefinement::On => (true, Rule::Requested),
        PoseRefinement::Off => (false, Rule::Requested),
        PoseRefinement::Auto => (false, Rule::TooFewImages),
    };
    Some(Decision::new(Subject::TrainingPoses, refined, rule))
}

fn exposure(record: &RunRecord) -> Option<Decision> {
    record.splat.as_ref()?;
    Some(Decision::new(Subject::Exposure, false, Rule::Default))
}

/// Where the object turned before a camera and a lamp that stood still, the lamp moves with the
/// camera in the object's frame.
fn illumination(record: &RunRecord) -> Option<Decision> {
    record.splat.as_ref()?;
    let decisions = record.poses.iter().flat_map(|p| &p.decisions);
    let turned = decisions.filter_map(Decision::motion).any(|m| m == MotionModel::SingleAxis);
    Some(if turned {
        Decision::new(Subject::Illumination, LightModel::FixedToCamera, Rule::Evidence)
            .remarked(Remark::LampMovesWithCamera)
    } else {
        Decision::new(Subject::Illumination, LightModel::ViewDependent, Rule::Default)
    })
}

/// The decisions as cards.
pub(super) fn section(record: &RunRecord) -> Markup {
    html! {
        @if !record.decisions.is_empty() {
            h2 { "What was decided, and why" }
            div.cards { @for decision in &record.decisions { (card(decision)) } }
        }
    }
}

fn card(decision: &Decision) -> Markup {
    let words = decision.sentences();
    html! {
        div.card {
            h3 { (words.title) }
            b { (words.choice) }
            @match words.evidence.split_first() {
                None => {}
                Some((only, [])) => p { (only) },
                Some((first, others)) => details {
                    summary { (first) " …" }
                    ul { @for clause in others { li { (clause) } } }
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_of_several_clauses_is_folded_behind_its_first() {
        let decision = Decision::new(Subject::Motion, MotionModel::Orbit, Rule::Evidence);
        assert!(!card(&decision).into_string().contains("details"));
        let one = decision.measured(Quantity::Noise, 0.3);
        assert!(card(&one).into_string().contains("<p>noise 0.300 px</p>"));
        let two = one.measured(Quantity::Images, 40.0);
        let shown = card(&two).into_string();
        assert!(shown.contains("<summary>noise 0.300 px …</summary>"), "{shown}");
        assert!(shown.contains("<li>images 40</li>"), "{shown}");
    }
}
