//! Pairs of images that go round evenly in the order of their files, matched along the lines of the one motion that all
//! neighbours share: in the dark a pair alone has too few right matches to say how it lies.

use super::matching::most_are_loose;
use crate::circular::Motion;
use crate::circular::initialize::constant_step::ConstantStepMotion;
use crate::matching::{PairMatches, PreparedFeatures, guided_match_prepared};
use crate::model_selection::camera;
use crate::reconstruct::{MappedModel, ReconstructionRequest, StepContext, grow_model};
use crate::tracks::{build_tracks, positions};
use crate::{SfmError, SfmResult, two_view};
use rayon::prelude::*;
use scene::decision::{Choice, Decision, Measurement, Quantity, Remark, Rule, Subject};
use scene::{Progress, TwoViewGeometry};

/// Farthest that a match may be from the line that the constant-step circular motion gives, pixels: cameras have motions of their own.
const BAND_PX: f64 = 8.0;
/// Images farther apart than this hardly show the same, radians.
const FARTHEST: f64 = 0.9;
/// Where most images share no more matches than this with any other, the pairs along the constant-step circular motion take the others' place. Above,
/// pairs that are verified alone are the more exact ones, and the constant-step circular motion is for what they leave out.
const FEW: usize = 100;
/// Share of the images with which a model that grew from other pairs needs no other start: what it misses finds its place later.
const WHOLE: f64 = 0.9;

/// A constant-step circular motion, the pairs along it, and whether they are to take the others' place.
pub(crate) struct ConstantStepStart {
    turn: ConstantStepMotion,
    geometries: Vec<TwoViewGeometry>,
    instead: bool,
    decision: Decision,
}

impl ConstantStepStart {
    /// The model that begins with all images in their places; `None` where they are not there.
    fn place_all_images(
        &self,
        given: &StepContext<'_>,
        keypoints: &[Vec<glam::DVec2>],
        progress: &Progress,
    ) -> Result<Option<MappedModel>, SfmError> {
        let tracks = build_tracks(given.features, &self.geometries);
        let input = given.input(keypoints, &tracks, &self.geometries);
        let intrinsics = camera::before_the_choice(given.config.camera_model.model());
        let job = given.motion_input(&input, &given.setup.cameras, progress);
        let Some((state, kept)) = self.turn.model(&job, intrinsics)? else { return Ok(None) };
        let choice = Choice::share(state.registered_count(), keypoints.len());
        let start = Decision::new(Subject::CircularStart, choice, Rule::Evidence)
            .measured(Quantity::KeptObservations, kept);
        let mapper = Some(start);
        Ok(Some(MappedModel { state, tracks, mapper, ringed: true }))
    }
}

/// The pairs of images near each other, matched and verified anew along a constant-step circular motion's lines, where most images are loosely
/// tied and go round so. `matches`: those of loosely tied pairs, before verification.
pub(crate) fn match_along_motion(
    result: &SfmResult,
    matches: &[PairMatches],
    loose: &[bool],
    job: &ReconstructionRequest<'_>,
) -> Result<Option<ConstantStepStart>, SfmError> {
    let ReconstructionRequest { frames, config, setup, progress, .. } = *job;
    let asked = !frames.is_video && config.motion.motion != Motion::Free && setup.cameras.len() == 1;
    if !asked || !most_are_loose(loose) {
        return Ok(None);
    }
    let places: Vec<_> = result.features.iter().map(positions).collect();
    let known = setup.known[0].fixed || setup.known[0].focal_sigma.is_some();
    let Some(turn) = ConstantStepMotion::of(&setup.cameras[0], known, &places, matches) else {
        return Ok(None);
    };
    progress.begin("constant-step circular motion", loose.len());
    let prepared: Vec<PreparedFeatures> = result.features.par_iter().map(PreparedFeatures::new).collect();
    let images = loose.len();
    let pairs: Vec<(usize, usize)> = (0..images)
        .flat_map(|a| (a + 1..images).map(move |b| (a, b)))
        .filter(|&(a, b)| turn.between(a, b).abs() <= FARTHEST)
        .collect();
    let along = |&(a, b): &(usize, usize)| {
        let side = |i: usize| (&result.features[i], &prepared[i]);
        let f = turn.fundamental(a, b);
        (a, b, guided_match_prepared(side(a), side(b), &f, BAND_PX, &config.matching))
    };
    let found: Vec<PairMatches> = pairs.par_iter().map(along).collect();
    progress.check()?;
    let cameras = setup.of_frames();
    let verified =
        two_view::verify_pairs(&result.features, &cameras, found, &config.two_view, config.seed, progress)?;
    let strongest = strongest_tie(images, &result.geometries);
    let instead = strongest < FEW;
    let step = Measurement::new(Quantity::AngularStep, turn.step_deg());
    let mut decision = Decision::new(Subject::ConstantStepMotion, step, Rule::Evidence)
        .measured(Quantity::AgreeingShare, turn.agreeing[0])
        .measured(Quantity::ChanceShare, turn.agreeing[1])
        .compared(false, !instead, pair_scores(&result.geometries))
        .compared(true, instead, pair_scores(&verified));
    if turn.closed {
        decision = decision.remarked(Remark::ClosedCircle);
    }
    Ok(Some(ConstantStepStart { turn, geometries: verified, instead, decision }))
}

/// Verified pairs and their matches.
fn pair_scores(geometries: &[TwoViewGeometry]) -> Vec<Measurement> {
    let matches = geometries.iter().map(|g| g.inliers.len()).sum::<usize>();
    vec![
        Measurement::count(Quantity::Pairs, geometries.len()),
        Measurement::count(Quantity::Matches, matches),
    ]
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

/// The model that grows from the pairs, or the one that begins with all images in their places on a ring: where that stands and
/// pairs alone say little, or where the first misses many images or has them elsewhere. `geometries` become those of the model.
pub(crate) fn grow_or_place(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &mut Vec<TwoViewGeometry>,
    decisions: &mut Vec<Decision>,
    progress: &Progress,
) -> Result<Option<MappedModel>, SfmError> {
    let Some(start) = &given.start else { return grow_model(given, keypoints, geometries, progress) };
    let standing = |g: &MappedModel| g.state.registered_count() - start.turn.astray(&g.state.poses);
    let mut placed = None;
    if start.instead {
        placed = start.place_all_images(given, keypoints, progress)?;
        if placed.is_some() {
            geometries.clone_from(&start.geometries);
            decisions.push(start.decision.clone());
        }
    }
    let first = grow_model(given, keypoints, geometries, progress)?;
    let before = first.as_ref().map_or(0, standing);
    let enough = if placed.is_some() { 1.0 } else { WHOLE };
    if before as f64 >= enough * keypoints.len() as f64 {
        return Ok(first);
    }
    let later = if placed.is_none() && !start.instead {
        start.place_all_images(given, keypoints, progress)?
    } else {
        None
    };
    match placed.or(later).filter(|p| standing(p) > before) {
        Some(placed) => {
            geometries.clone_from(&start.geometries);
            Ok(Some(placed))
        }
        None => Ok(first),
    }
}
