//! Whether a model is better for observations of a supporting plane (see [`crate::plane_tracks`]).

use crate::SfmError;
use crate::incremental::finish::{free_principal_point, noise_of};
use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::camera::FreeIntrinsics;
use crate::plane_tracks::plane::widest;
use crate::plane_tracks::{PlanePoint, find_plane_tracks};
use crate::reconstruct::StepContext;
use crate::statistics::median;
use crate::tracks::{NONE, Tracks};
use glam::{DVec2, DVec3};
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule, Subject};
use scene::{Camera, FrameSet, Progress};

/// An image with fewer observations than this is weakly held, and so many of the images have to be (share).
const FEW: usize = 200;
const WEAK: f64 = 0.1;
/// The plane is looked at up to so often, each time from better poses: how far windows are looked for, squares.
const FARTHEST: [usize; 16] = [10, 6, 4, 4, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3];
/// Until what it shows is off by hardly less than the time before.
const LESS: f64 = 0.995;
/// What is known to show nothing is left out the next time, but for a margin, as a share of the reach.
const MARGIN: f64 = 0.1;
/// Standard deviation of its observations, as a share of what residuals say: those of features err together, and by twice as much as
/// residuals show at least (`single_axis/smoothness.rs`), while what all images show in common errs with none of them.
const TRUST: f64 = 0.5;
/// Share of the plane's observations that the adjusted model must keep.
const KEPT: f64 = 0.6;
/// Share of the others that it must keep, and by how much their median error may grow.
const OTHERS_KEPT: f64 = 0.9;
const GROWN: f64 = 1.1;
/// The median length of an error of two normal coordinates, in standard deviations.
const MEDIAN_LENGTH: f64 = 1.1774;

/// Keypoints, their standard deviations and tracks, those of the plane behind the others.
pub(crate) struct PlaneTracks {
    pub keypoints: Vec<Vec<DVec2>>,
    pub sigmas: Vec<Vec<f32>>,
    pub tracks: Tracks,
}

/// A model with observations of the plane, and what is solved for of its cameras.
pub(crate) struct PlaneTracksModel {
    pub plane_tracks: PlaneTracks,
    pub state: MapState,
    pub intrinsics: FreeIntrinsics,
}

/// The model with observations of the plane, where they are of use (see [`try_plane_tracks`]); its principal point, where all observations together
/// determine it. `settled` adjusts a model with given intrinsics; those of `cameras` are chosen already.
pub(crate) fn add_plane_tracks(
    given: &StepContext<'_>,
    (state, input): (&MapState, &MappingInput<'_>),
    rotated: &[bool],
    (starts, intrinsics): (&[Camera], FreeIntrinsics),
    settled: impl Fn(MapState, &MappingInput<'_>, FreeIntrinsics) -> Result<MapState, SfmError>,
    progress: &Progress,
) -> Result<(Option<PlaneTracksModel>, Vec<Decision>), SfmError> {
    let settle = |state: MapState, input: &MappingInput<'_>| settled(state, input, intrinsics);
    let (found, decision) = try_plane_tracks(given.images, (state, input), rotated, settle, progress)?;
    let mut decisions: Vec<Decision> = decision.into_iter().collect();
    let Some((plane_tracks, mut state)) = found else { return Ok((None, decisions)) };
    let (with, before) = (plane_tracks.input(input), (intrinsics, given.config.camera_model.model()));
    let Some((free, decision)) =
        free_principal_point(&state, &with, &given.setup.known, starts, before, progress)?
    else {
        return Ok((Some(PlaneTracksModel { plane_tracks, state, intrinsics }), decisions));
    };
    state = settled(state, &with, free)?;
    decisions.push(decision);
    Ok((Some(PlaneTracksModel { plane_tracks, state, intrinsics: free }), decisions))
}

/// The model with observations of the plane, where images are weakly held, there is such a plane, and the model is no worse for the
/// points it has. `images`: where they may be read. `settle` adjusts a model. The decision says what was found; there is none where nothing was asked.
fn try_plane_tracks(
    images: Option<&FrameSet>,
    (state, input): (&MapState, &MappingInput<'_>),
    rotated: &[bool],
    settle: impl Fn(MapState, &MappingInput<'_>) -> Result<MapState, SfmError>,
    progress: &Progress,
) -> Result<(Option<(PlaneTracks, MapState)>, Option<Decision>), SfmError> {
    let weak = state.order.iter().filter(|&&i| state.observations(i) < FEW).count();
    // What masks leave out may stand still while the object turns.
    let whole = images.filter(|images| images.frames.iter().all(|f| f.mask.is_none()));
    let Some(frames) = whole.filter(|_| weak as f64 >= WEAK * state.registered_count() as f64) else {
        return Ok((None, None));
    };
    let refused = Decision::new(Subject::PlaneTracks, false, Rule::NothingFound).with_all([
        Measurement::count(Quantity::WeakImages, weak),
        Measurement::count(Quantity::RegisteredImages, state.registered_count()),
    ]);
    let Some(mut plane) = widest(state, input) else {
        return Ok((None, Some(refused.remarked(Remark::NoPlane))));
    };
    let unit = noise_of(state, input);
    let (mut model, mut found, mut factor) = (state.clone(), None, 1.0);
    let mut off: Vec<f64> = Vec::new();
    for farthest in FARTHEST {
        let places = find_plane_tracks(plane, (&model, input), (frames, rotated), farthest, progress)?;
        if places.is_empty() {
            return Ok((None, Some(refused.remarked(Remark::EmptyPlane))));
        }
        off.push(median(places.iter().flat_map(|p| &p.observations).map(|s| s.off).collect()));
        let plane_tracks = PlaneTracks::new(input, &places, TRUST * factor / unit);
        let with = plane_tracks.input(input);
        let next = settle(plane_tracks.add_points(&model, input, &places, &with), &with)?;
        let held = plane_tracks.kept_points(&next, input);
        let asked: usize = places.iter().map(|p| p.observations.len()).sum();
        if (held.errors.len() as f64) < KEPT * asked as f64 {
            let decision = refused.remarked(Remark::PlaneDisagrees).with_all([
                Measurement::count(Quantity::PlaneObservations, asked),
                Measurement::new(Quantity::KeptObservations, held.errors.len() as f64 / asked as f64),
            ]);
            return Ok((None, Some(decision)));
        }
        factor *= (TRUST * median(held.errors) / unit / MEDIAN_LENGTH).clamp(0.2, 5.0);
        plane = plane.closer(&held.places).unwrap_or(plane).about(&held.places, MARGIN * plane.reach);
        model = without_plane_points(&next, input);
        found = Some((plane_tracks, next, asked, places.len()));
        if off.len() > 1 && off[off.len() - 1] > LESS * off[off.len() - 2] {
            break;
        }
    }
    let Some((plane_tracks, next, observations, places)) = found else { return Ok((None, None)) };
    let ((had, before), (has, after)) = (other_errors(state, input), other_errors(&model, input));
    let taken = has as f64 >= OTHERS_KEPT * had as f64 && after <= GROWN * before;
    let offsets = off.into_iter().map(|o| Measurement::new(Quantity::PlaneOffset, o));
    let decision = Decision { choice: taken.into(), rule: Rule::Evidence, ..refused }
        .with_all([
            Measurement::count(Quantity::PlanePlaces, places),
            Measurement::count(Quantity::PlaneObservations, observations),
        ])
        .with_all(offsets)
        .with_all([
            Measurement::count(Quantity::ObservationsBefore, had),
            Measurement::count(Quantity::ObservationsAfter, has),
            Measurement::new(Quantity::MedianErrorBefore, before),
            Measurement::new(Quantity::MedianErrorAfter, after),
        ]);
    Ok((taken.then_some((plane_tracks, next)), Some(decision)))
}

/// How many observations of features a model has, and their median error, pixels.
fn other_errors(state: &MapState, input: &MappingInput<'_>) -> (usize, f64) {
    let errors = state.errors(input);
    (errors.len(), if errors.is_empty() { f64::INFINITY } else { median(errors) })
}

/// Observations of the plane that a model has kept: their errors, pixels, over their standard deviations, and where the places are.
struct KeptPlanePoints {
    errors: Vec<f64>,
    places: Vec<DVec3>,
}

impl PlaneTracks {
    /// Behind the keypoints of `input` those of the plane; `per_px`: what a standard deviation of a pixel is in units of the
    /// others'.
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
    pub fn input<'a>(&'a self, input: &MappingInput<'a>) -> MappingInput<'a> {
        MappingInput { keypoints: &self.keypoints, sigmas: &self.sigmas, tracks: &self.tracks, ..*input }
    }

    /// What a model has kept of the plane.
    fn kept_points(&self, model: &MapState, input: &MappingInput<'_>) -> KeptPlanePoints {
        let (first, with) = (input.tracks.views.len() as u32, self.input(input));
        let mut held = KeptPlanePoints { errors: Vec::new(), places: Vec::new() };
        for (_, point) in model.live().filter(|(_, p)| p.track >= first) {
            held.places.push(point.position);
            held.errors.extend(point.views.iter().map(|v| {
                let sigma = self.sigmas[v[0] as usize][v[1] as usize];
                model.error_sq(&with, *v, point.position).sqrt() / f64::from(sigma)
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
