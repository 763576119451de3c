//! Pairs of images that go round evenly in the order of their files, matched along the lines of the
//! one motion that all neighbours share: in the dark a pair alone has too few right matches to say
//! how it lies.

use super::ties::most_are_weak;
use crate::circular::Motion;
use crate::circular::initialize::constant_step::ConstantStepMotion;
use crate::error::SfmError;
use crate::matching::{PairMatches, PreparedFeatures, guided_match_prepared};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{ConstantStepStart, MappedModel, SfmModel, StepResult};
use crate::tracks::{build_tracks, positions};
use crate::two_view;
use glam::DVec2;
use rayon::prelude::*;
use scene::TwoViewGeometry;
use scene::decision::{Choice, Decision, Measurement, Quantity, Remark, Rule, Subject};

/// Images farther apart than this are not matched along the motion, radians.
/// Source: docs/decisions/09.
const FARTHEST: f64 = 0.9;
/// Where most images share no more matches than this with any other, the pairs along the motion
/// take the others' place. Above, pairs that are verified alone are the more exact ones, and the
/// motion is for what they leave out.
/// Source: docs/decisions/09.
const FEW: usize = 100;

/// Matches and verifies the pairs of images near each other anew along the lines of a constant-step
/// circular motion, where most images are weakly tied and go round so.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let is_asked = context.images().is_some_and(|frames| !frames.is_video)
        && context.config.motion.motion != Motion::Free
        && model.setup.cameras.len() == 1
        && most_are_weak(&model.weakly_tied);
    if is_asked && let Some(motion) = find_motion(&model) {
        model.constant_step = Some(match_along(motion, &model, context)?);
    }
    Ok((model, Vec::new()))
}

fn find_motion(model: &SfmModel) -> Option<ConstantStepMotion> {
    let places: Vec<Vec<DVec2>> = model.features.iter().map(positions).collect();
    let known = &model.setup.known[0];
    let focal_known = known.fixed || known.focal_sigma.is_some();
    let matches = model.blurred_matches.as_ref().or(model.matches.as_ref())?;
    ConstantStepMotion::of(&model.setup.cameras[0], focal_known, &places, matches)
}

fn match_along(
    motion: ConstantStepMotion,
    model: &SfmModel,
    context: &StepContext<'_>,
) -> Result<ConstantStepStart, SfmError> {
    let StepContext { config, progress, .. } = *context;
    let (features, images) = (&model.features, model.features.len());
    // Cameras have motions of their own (docs/decisions/09: lines 8 px wide).
    let band = 2.0 * config.two_view.max_error_px;
    progress.begin("constant-step circular motion", images);
    let prepared: Vec<PreparedFeatures> = features.par_iter().map(PreparedFeatures::new).collect();
    let pairs: Vec<(usize, usize)> = (0..images)
        .flat_map(|a| (a + 1..images).map(move |b| (a, b)))
        .filter(|&(a, b)| motion.between(a, b).abs() <= FARTHEST)
        .collect();
    let found: Vec<PairMatches> = pairs
        .par_iter()
        .map(|&(a, b)| {
            let [a_side, b_side] = [a, b].map(|i| (&features[i], &prepared[i]));
            let f = motion.fundamental(a, b);
            (a, b, guided_match_prepared(a_side, b_side, &f, band, &config.matching))
        })
        .collect();
    progress.check()?;
    let cameras = model.setup.of_frames();
    let geometries =
        two_view::verify_pairs(features, &cameras, found, &config.two_view, config.seed, progress)?;
    let instead = strongest_tie(images, &model.geometries) < FEW;
    let decision = describe(&motion, instead, &geometries, &model.geometries);
    Ok(ConstantStepStart { motion, geometries, instead, decision })
}

/// `instead`: whether the pairs `along` the motion take the place of those `before`.
fn describe(
    motion: &ConstantStepMotion,
    instead: bool,
    along: &[TwoViewGeometry],
    before: &[TwoViewGeometry],
) -> Decision {
    let step = Measurement::new(Quantity::AngularStep, motion.step_deg());
    let decision = Decision::new(Subject::ConstantStepMotion, step, Rule::Evidence)
        .measured(Quantity::AgreeingShare, motion.agreeing[0])
        .measured(Quantity::ChanceShare, motion.agreeing[1])
        .compared(false, !instead, pair_scores(before))
        .compared(true, instead, pair_scores(along));
    if motion.closed { decision.remarked(Remark::ClosedCircle) } else { decision }
}

/// Verified pairs and their matches.
fn pair_scores(geometries: &[TwoViewGeometry]) -> Vec<Measurement> {
    let matches = geometries.iter().map(|g| g.inliers.len()).sum::<usize>();
    vec![
        Measurement::count(Quantity::Pairs, geometries.len()),
        Measurement::count(Quantity::Matches, matches),
    ]
}

/// The model that begins with all images in their places; `None` where they are not there.
pub(super) fn place_all_images(
    model: &SfmModel,
    start: &ConstantStepStart,
    context: &StepContext<'_>,
) -> Result<Option<MappedModel>, SfmError> {
    let tracks = build_tracks(&model.features, &start.geometries);
    let input = model.input_from(&tracks, &start.geometries, context);
    let found = start.motion.model(&model.motion_input(&input, context), model.intrinsics)?;
    let Some((state, kept)) = found else { return Ok(None) };
    let choice = Choice::share(state.registered_count(), model.keypoints.len());
    let decision = Decision::new(Subject::CircularStart, choice, Rule::Evidence)
        .measured(Quantity::KeptObservations, kept);
    let geometries = start.geometries.clone();
    Ok(Some(MappedModel { state, tracks, geometries, on_ring: true, decision: Some(decision) }))
}

/// The median over the images of the most matches with any other.
fn strongest_tie(images: usize, geometries: &[TwoViewGeometry]) -> usize {
    let mut most = vec![0; images];
    for g in geometries {
        for image in [g.a, g.b] {
            most[image] = g.inliers.len().max(most[image]);
        }
    }
    most.sort_unstable();
    most.get(images / 2).copied().unwrap_or(0)
}
