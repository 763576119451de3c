//! Observations of a supporting plane (see [`crate::plane_tracks`]), where images are weakly
//! constrained and the model is no worse for them.

use crate::error::SfmError;
use crate::incremental::finish::{free_principal_point, noise_of};
use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::accept::{Change, Support, accept};
use crate::model_selection::noise::median_noise;
use crate::plane_tracks::plane::widest;
use crate::plane_tracks::{PlanePoint, find_plane_tracks};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::statistics::median;
use crate::tracks::{NONE, Tracks};
use glam::{DVec2, DVec3};
use scene::FrameSet;
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule, Subject};

/// An image with fewer observations than this is weakly constrained.
/// Source: docs/decisions/11.
const FEW: usize = 200;
/// Share of the images that must be so.
/// Source: docs/decisions/11.
const WEAK: f64 = 0.1;
/// The plane is looked at up to so often, each time from better poses: how far windows are looked
/// for, squares.
/// Source: docs/decisions/11 (three to ten rounds are taken; three alone cost case 1 0.18° for
/// 0.10°).
const FARTHEST: [usize; 16] = [10, 6, 4, 4, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3];
/// Until what it shows is off by hardly less than the time before, as a share.
/// Source: chosen by hand, never measured.
const LESS: f64 = 0.995;
/// What is known to show nothing is left out the next time, but for a margin, as a share of the
/// reach.
/// Source: chosen by hand, never measured.
const MARGIN: f64 = 0.1;
/// Standard deviation of its observations, as a share of what residuals say: those of features err
/// together, and by twice as much as residuals show at least, while what all images show in common
/// errs with none of them.
/// Source: docs/decisions/08 (variances are too small by 2 to 6).
const TRUST: f64 = 0.5;

/// Keypoints, their standard deviations and tracks, those of the plane behind the others.
struct PlaneTracks {
    keypoints: Vec<Vec<DVec2>>,
    sigmas: Vec<Vec<f32>>,
    tracks: Tracks,
}

/// A model with observations of a plane, and how it came about.
struct PlaneRounds {
    plane_tracks: PlaneTracks,
    state: MapState,
    observations: usize,
    places: usize,
    /// Median distances of the observations from where the model had them, pixels, a round each.
    off: Vec<f64>,
}

/// Adds them, and frees the principal point where all observations together determine it.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let weak = model.state.order.iter().filter(|&&i| model.state.observations(i) < FEW).count();
    // What masks leave out may stand still while the object turns.
    let whole = context.images().filter(|images| images.frames.iter().all(|f| f.mask.is_none()));
    let is_weak = weak as f64 >= WEAK * model.state.registered_count() as f64;
    let Some(frames) = whole.filter(|_| is_weak) else { return Ok((model, Vec::new())) };
    let counts = [
        Measurement::count(Quantity::WeakImages, weak),
        Measurement::count(Quantity::RegisteredImages, model.state.registered_count()),
    ];
    let found = match add_plane(&model, frames, context)? {
        Ok(found) => found,
        Err(why) => return Ok((model, vec![not_used().with_all(counts).absorbing(why)])),
    };
    let input = model.input(context);
    let (before, after) = (fit(&model.state, &input), fit(&found.without_plane(&input), &input));
    let taken = accept(Change::PlaneTracks, &before, &after);
    let decision = Decision::new(Subject::PlaneTracks, taken, Rule::Evidence)
        .with_all(counts)
        .with_all(found.measurements([before, after]));
    let mut decisions = vec![decision];
    if !taken {
        return Ok((model, decisions));
    }
    let PlaneRounds { plane_tracks, mut state, .. } = found;
    let with = plane_tracks.input(&input);
    let now = (model.intrinsics, context.config.camera_model.model());
    let (known, starts) = (&model.setup.known, &model.starts);
    let freed = free_principal_point(&state, &with, known, starts, now, context.progress)?;
    if let Some((free, decision)) = freed {
        state = model.settle(state, &with, free, context)?;
        decisions.push(decision);
        model.intrinsics = free;
    }
    let PlaneTracks { keypoints, sigmas, tracks } = plane_tracks;
    (model.keypoints, model.sigmas, model.tracks, model.state) = (keypoints, sigmas, tracks, state);
    Ok((model, decisions))
}

/// No plane that could have been taken.
fn not_used() -> Decision {
    Decision::new(Subject::PlaneTracks, false, Rule::NothingFound)
}

/// The model with observations of the widest plane, looked for again from better poses until that
/// changes little; why not, where there is none.
fn add_plane(
    model: &SfmModel,
    frames: &FrameSet,
    context: &StepContext<'_>,
) -> Result<Result<PlaneRounds, Decision>, SfmError> {
    let input = &model.input(context);
    let Some(mut plane) = widest(&model.state, input) else {
        return Ok(Err(not_used().remarked(Remark::NoPlane)));
    };
    let unit = noise_of(&model.state, input);
    let (mut bare, mut factor) = (model.state.clone(), 1.0);
    let mut found: Option<PlaneRounds> = None;
    for farthest in FARTHEST {
        let seen = (frames, model.rotated.as_slice());
        let places = find_plane_tracks(plane, (&bare, input), seen, farthest, context.progress)?;
        if places.is_empty() {
            return Ok(Err(not_used().remarked(Remark::EmptyPlane)));
        }
        let mut off = found.take().map_or_else(Vec::new, |last| last.off);
        off.push(median(places.iter().flat_map(|p| &p.observations).map(|s| s.off).collect()));
        let plane_tracks = PlaneTracks::new(input, &places, factor / unit);
        let with = plane_tracks.input(input);
        let start = plane_tracks.add_points(&bare, input, &places, &with);
        let state = model.settle(start, &with, model.intrinsics, context)?;
        let held = plane_tracks.kept_points(&state, input);
        let observations: usize = places.iter().map(|p| p.observations.len()).sum();
        if !accept(Change::PlanePlaces, &Support::of(observations), &Support::of(held.errors_sq.len())) {
            let kept = held.errors_sq.len() as f64 / observations as f64;
            return Ok(Err(not_used().remarked(Remark::PlaneDisagrees).with_all([
                Measurement::count(Quantity::PlaneObservations, observations),
                Measurement::new(Quantity::KeptObservations, kept),
            ])));
        }
        factor *= (TRUST * median_noise(held.errors_sq) / unit).clamp(0.2, 5.0);
        plane = plane.closer(&held.places).unwrap_or(plane).about(&held.places, MARGIN * plane.reach);
        bare = without_plane_points(&state, input);
        let ends = off.len() > 1 && off[off.len() - 1] > LESS * off[off.len() - 2];
        found = Some(PlaneRounds { plane_tracks, state, observations, places: places.len(), off });
        if ends {
            break;
        }
    }
    Ok(found.ok_or_else(|| not_used().remarked(Remark::EmptyPlane)))
}

/// How many observations of features a model has, and their median error, pixels; infinite where it
/// has none.
fn fit(state: &MapState, input: &MappingInput<'_>) -> Support {
    let errors = state.errors(input);
    let explained = errors.len();
    let error_px = if errors.is_empty() { f64::INFINITY } else { median(errors) };
    Support { explained, error_px: Some(error_px), ..Support::default() }
}

impl PlaneRounds {
    /// The model without the plane's points.
    fn without_plane(&self, input: &MappingInput<'_>) -> MapState {
        without_plane_points(&self.state, input)
    }

    /// What was found of the plane, and what is explained of features, before and after.
    fn measurements(&self, [had, has]: [Support; 2]) -> Vec<Measurement> {
        let mut all = vec![
            Measurement::count(Quantity::PlanePlaces, self.places),
            Measurement::count(Quantity::PlaneObservations, self.observations),
        ];
        all.extend(self.off.iter().map(|off| Measurement::new(Quantity::PlaneOffset, *off)));
        all.extend([
            Measurement::count(Quantity::ObservationsBefore, had.explained),
            Measurement::count(Quantity::ObservationsAfter, has.explained),
            Measurement::new(Quantity::MedianErrorBefore, had.error_px.unwrap_or_default()),
            Measurement::new(Quantity::MedianErrorAfter, has.error_px.unwrap_or_default()),
        ]);
        all
    }
}

/// Observations of the plane that a model has kept: their squared errors, pixels², over their
/// variances, and where the places are.
struct KeptPlanePoints {
    errors_sq: Vec<f64>,
    places: Vec<DVec3>,
}

impl PlaneTracks {
    /// Behind the keypoints of `input` those of the plane; `per_px`: what a standard deviation of a
    /// pixel is in units of the others'.
    fn new(input: &MappingInput<'_>, places: &[PlanePoint], per_px: f64) -> Self {
        let mut keypoints = input.keypoints.to_vec();
        let all_one = || input.keypoints.iter().map(|k| vec![1.0; k.len()]).collect();
        let mut sigmas: Vec<Vec<f32>> =
            if input.sigmas.is_empty() { all_one() } else { input.sigmas.to_vec() };
        let mut tracks = input.tracks.clone();
        for place in places {
            let track = tracks.views.len() as u32;
            let mut views = Vec::with_capacity(place.observations.len());
            for s in &place.observations {
                views.push([s.image as u32, keypoints[s.image].len() as u32]);
                keypoints[s.image].push(s.pixel);
                sigmas[s.image].push((s.deviation * per_px) as f32);
                tracks.of[s.image].push(track);
            }
            tracks.views.push(views);
        }
        Self { keypoints, sigmas, tracks }
    }

    /// `input` with the plane.
    fn input<'a>(&'a self, input: &MappingInput<'a>) -> MappingInput<'a> {
        MappingInput { keypoints: &self.keypoints, sigmas: &self.sigmas, tracks: &self.tracks, ..*input }
    }

    /// What a model has kept of the plane.
    fn kept_points(&self, model: &MapState, input: &MappingInput<'_>) -> KeptPlanePoints {
        let (first, with) = (input.tracks.views.len() as u32, self.input(input));
        let mut held = KeptPlanePoints { errors_sq: Vec::new(), places: Vec::new() };
        for (_, point) in model.live().filter(|(_, p)| p.track >= first) {
            held.places.push(point.position);
            held.errors_sq.extend(point.views.iter().map(|v| {
                let sigma = self.sigmas[v[0] as usize][v[1] as usize];
                model.error_sq(&with, *v, point.position) / f64::from(sigma).powi(2)
            }));
        }
        held
    }

    /// A model with these places as points.
    fn add_points(
        &self,
        model: &MapState,
        input: &MappingInput<'_>,
        places: &[PlanePoint],
        with: &MappingInput<'_>,
    ) -> MapState {
        let mut next = model.clone();
        for (points, keypoints) in next.point_of.iter_mut().zip(&self.keypoints) {
            points.resize(keypoints.len(), NONE);
        }
        next.of_track.resize(self.tracks.views.len(), Vec::new());
        let first = input.tracks.views.len() as u32;
        for (track, place) in (first..).zip(places) {
            next.place(with, track, place.position);
        }
        next
    }
}

/// A model without its places of the plane.
fn without_plane_points(model: &MapState, input: &MappingInput<'_>) -> MapState {
    let mut bare = model.clone();
    let first = input.tracks.views.len();
    let ids: Vec<u32> = bare.live().filter(|(_, p)| p.track as usize >= first).map(|(id, _)| id).collect();
    ids.into_iter().for_each(|id| bare.drop_point(id));
    for (points, keypoints) in bare.point_of.iter_mut().zip(input.keypoints) {
        points.truncate(keypoints.len());
    }
    bare.of_track.truncate(first);
    bare
}

#[cfg(test)]
#[path = "plane_tracks_tests.rs"]
mod tests;
