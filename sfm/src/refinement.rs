//! Keypoints of one point moved to where the windows about them show the same, once a model says
//! how they are warped.
//!
//! A detector finds each observation by itself, and not the same spot of the surface from every
//! side. One observation of a point, the one that looks at it from the middle, says which spot is
//! meant; where that lies in the other images is found by its window (Lucas & Kanade 1981), which
//! begins as the model says it is sheared and stretched (keypoints refined over tracks: Dusmanu,
//! Schönberger & Pollefeys, ECCV 2020; Lindenberger et al., ICCV 2021).

use crate::error::SfmError;
use crate::incremental::state::{MapPoint, MapState, MappingInput};
use crate::klt::pyramid::{LEAST_SIDE, Pyramid, PyramidLevel};
use crate::klt::reference::{Reference, Warp};
use crate::klt::window::ReferencePatch;
use crate::model_selection::accept::Support;
use crate::sift::load_luma;
use crate::statistics::median;
use crate::tracks::NONE;
use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Frame, FrameSet, Pose, Progress};

/// Scale of a keypoint up to which its window is looked at in the image's own size; each halving
/// doubles it.
/// Source: measured: halved and doubled, AUC@1 of temple_ring is 83.4 and 84.1 (83.8), of
/// fountain_p11 93.1 and 92.8 (92.9).
const SCALE: f64 = 4.0;
/// Least correlation of a window with the one of the observation that says what is meant.
/// Source: measured: at 0.85 the rotation error of temple_ring is 0.143° (0.137°), that of
/// fountain_p11 0.061° (0.060°).
const CORRELATION: f64 = 0.9;
/// Standard deviation of a keypoint that was not moved, in its scales.
/// Source: measured: halved and doubled, AUC@1 of temple_ring is 83.8 and 84.0 (83.8), of
/// fountain_p11 92.9 (92.9).
const UNMOVED: f64 = 0.25;
/// What windows that correlate perfectly are still off by, pixels of the level.
/// Source: measured: halved and doubled, AUC@1 of temple_ring is 83.9 and 83.5 (83.8), of
/// fountain_p11 92.8 and 93.0 (92.9).
const FLOOR_PX: f64 = 0.05;
/// Most points; of more, those with the longest tracks (a patch takes a kilobyte).
/// Source: derived: a hundred megabytes of patches.
const MOST_POINTS: usize = 100_000;

/// Keypoints that fit together better than those they come from.
pub(crate) struct RefinedKeypoints {
    pub keypoints: Vec<Vec<DVec2>>,
    /// Standard deviations of all keypoints, the median of the moved ones 1.
    pub sigmas: Vec<Vec<f32>>,
    /// (image, feature) of the observations whose windows were found.
    pub moved: Vec<[u32; 2]>,
    /// Those of the same points whose windows were not.
    pub unsure: Vec<[u32; 2]>,
}

/// A point with the observation that says which spot of the surface is meant.
struct AnchoredPoint<'a> {
    point: &'a MapPoint,
    /// Which of its views.
    first: usize,
    level: usize,
    tangents: [DVec3; 2],
    /// How a step along the tangents moves its image.
    shape: DMat2,
}

/// Where an observation was found, and the standard deviation of that, pixels.
struct FoundWindow {
    anchor: usize,
    view: [u32; 2],
    place: DVec2,
    deviation: f64,
}

/// Looks for the windows of all points of a model. `rotated`: images that `input` shows rotated by
/// 180°. No image is kept; each is read twice.
pub(crate) fn refine(
    state: &MapState,
    input: &MappingInput<'_>,
    frames: &FrameSet,
    rotated: &[bool],
    progress: &Progress,
) -> Result<RefinedKeypoints, SfmError> {
    let anchors: Vec<AnchoredPoint<'_>> =
        most_seen(state).into_iter().filter_map(|p| anchor(p, state, input)).collect();
    let n = frames.len();
    let (mut of_image, mut views_of) = (vec![Vec::new(); n], vec![Vec::new(); n]);
    for (k, a) in anchors.iter().enumerate() {
        of_image[a.point.views[a.first][0] as usize].push(k);
        let others = a.point.views.iter().enumerate().filter(|(i, _)| *i != a.first);
        others.for_each(|(_, v)| views_of[v[0] as usize].push((k, *v)));
    }
    progress.begin("windows of keypoints", 2 * n);
    let taken: Result<Vec<_>, SfmError> = of_image
        .par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(image, own)| {
            progress.tick()?;
            let pyramid = load(&frames.frames[image], rotated[image])?;
            Ok(own.iter().map(|&k| (k, anchors[k].patch(&pyramid, input))).collect::<Vec<_>>())
        })
        .collect();
    let mut patch_of: Vec<Option<Box<ReferencePatch>>> = (0..anchors.len()).map(|_| None).collect();
    taken?.into_iter().flatten().for_each(|(k, patch)| patch_of[k] = patch);
    let found: Result<Vec<Vec<FoundWindow>>, SfmError> = views_of
        .par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(image, views)| {
            progress.tick()?;
            let pyramid = load(&frames.frames[image], rotated[image])?;
            let mut windows = Vec::new();
            for &(anchor, view) in views {
                let Some(patch) = patch_of[anchor].as_deref() else { continue };
                if let Some((place, deviation)) = anchors[anchor].find(view, patch, &pyramid, state, input) {
                    windows.push(FoundWindow { anchor, view, place, deviation });
                }
            }
            Ok(windows)
        })
        .collect();
    Ok(gather(&anchors, found?.into_iter().flatten(), input))
}

/// The points with the longest tracks, in their order.
fn most_seen(state: &MapState) -> Vec<&MapPoint> {
    let mut points: Vec<(u32, &MapPoint)> = state.live().collect();
    if points.len() > MOST_POINTS {
        points.sort_by_key(|(id, p)| (std::cmp::Reverse(p.views.len()), *id));
        points.truncate(MOST_POINTS);
        points.sort_unstable_by_key(|(id, _)| *id);
    }
    points.into_iter().map(|(_, p)| p).collect()
}

/// Smoothed grey levels, the way up that the solver sees the image.
fn load(frame: &Frame, rotated: bool) -> Result<Pyramid, SfmError> {
    let mut grey = load_luma(frame)?;
    if rotated {
        grey.data.reverse();
    }
    Ok(Pyramid::new(&grey, usize::MAX))
}

fn sigma_of(input: &MappingInput<'_>, [image, feature]: [u32; 2]) -> f64 {
    input.sigmas.get(image as usize).map_or(1.0, |s| f64::from(s[feature as usize]))
}

fn pixel(input: &MappingInput<'_>, [image, feature]: [u32; 2]) -> DVec2 {
    input.keypoints[image as usize][feature as usize]
}

fn anchor<'a>(point: &'a MapPoint, state: &MapState, input: &MappingInput<'_>) -> Option<AnchoredPoint<'a>> {
    let rays: Option<Vec<DVec3>> = point
        .views
        .iter()
        .map(|v| (state.poses[v[0] as usize]?.centre() - point.position).try_normalize())
        .collect();
    let rays = rays?;
    // The surface is taken to face the middle of its cameras.
    let normal = rays.iter().sum::<DVec3>().try_normalize()?;
    let (first, _) = rays.iter().enumerate().max_by(|a, b| a.1.dot(normal).total_cmp(&b.1.dot(normal)))?;
    let view = point.views[first];
    let across = normal.any_orthonormal_vector();
    let tangents = [across, normal.cross(across)];
    let camera = &state.cameras[input.camera_of[view[0] as usize]];
    let shape = image_of_tangents(camera, &state.poses[view[0] as usize]?, point.position, tangents)?;
    let wanted = (sigma_of(input, view) / SCALE).log2().ceil().max(0.0) as usize;
    let cameras = point.views.iter().map(|v| &state.cameras[input.camera_of[v[0] as usize]]);
    let side = cameras.map(|c| c.width.min(c.height)).min()?;
    let deepest = (side / LEAST_SIDE as u32).max(1).ilog2() as usize;
    let level = deepest.min(wanted);
    Some(AnchoredPoint { point, first, level, tangents, shape })
}

/// Derivatives of a point's image by steps along two tangents of its surface, pixels a unit.
fn image_of_tangents(camera: &Camera, pose: &Pose, x: DVec3, tangents: [DVec3; 2]) -> Option<DMat2> {
    let h = 1e-4 * pose.transform(x).z.abs();
    let mut columns = [DVec2::ZERO; 2];
    for (column, t) in columns.iter_mut().zip(tangents) {
        let ahead = camera.project(pose.transform(x + t * h))?;
        let behind = camera.project(pose.transform(x - t * h))?;
        *column = (ahead - behind) / (2.0 * h);
    }
    let m = DMat2::from_cols(columns[0], columns[1]);
    let area = m.x_axis.length() * m.y_axis.length();
    (m.is_finite() && m.determinant().abs() > 1e-3 * area).then_some(m)
}

impl AnchoredPoint<'_> {
    fn level<'b>(&self, pyramid: &'b Pyramid) -> (Option<&'b PyramidLevel>, f64) {
        (pyramid.levels.get(self.level), f64::from(1u32 << self.level))
    }

    fn patch(&self, pyramid: &Pyramid, input: &MappingInput<'_>) -> Option<Box<ReferencePatch>> {
        let (level, size) = self.level(pyramid);
        let place = (pixel(input, self.point.views[self.first]) / size).as_vec2();
        level?.patch(place.x, place.y).map(Box::new)
    }

    /// Place of the window in a view's image and its standard deviation, pixels.
    fn find(
        &self,
        view: [u32; 2],
        patch: &ReferencePatch,
        pyramid: &Pyramid,
        state: &MapState,
        input: &MappingInput<'_>,
    ) -> Option<(DVec2, f64)> {
        let image = view[0] as usize;
        let camera = &state.cameras[input.camera_of[image]];
        let pose = state.poses[image].as_ref()?;
        let shape = image_of_tangents(camera, pose, self.point.position, self.tangents)?;
        let (level, size) = self.level(pyramid);
        let reference = Reference::central(patch)?;
        let start = Warp { shape: shape * self.shape.inverse(), place: pixel(input, view) / size };
        let (warp, correlation) = reference.find(level?, start)?;
        let place = warp.place * size;
        // Keypoints move by less than their scale (docs/decisions, tried.md: 0.3 and 0.6 scales).
        let near = place.distance(pixel(input, view)) < sigma_of(input, view).max(1.0);
        let deviation = size * reference.deviation(correlation).hypot(FLOOR_PX);
        (near && correlation > CORRELATION && deviation.is_finite()).then_some((place, deviation))
    }
}

fn gather(
    anchors: &[AnchoredPoint<'_>],
    found: impl Iterator<Item = FoundWindow>,
    input: &MappingInput<'_>,
) -> RefinedKeypoints {
    let mut keypoints = input.keypoints.to_vec();
    let mut sigmas: Vec<Vec<f32>> = Vec::with_capacity(keypoints.len());
    for (image, points) in (0u32..).zip(&keypoints) {
        let features = 0..points.len() as u32;
        sigmas.push(features.map(|k| (UNMOVED * sigma_of(input, [image, k])) as f32).collect());
    }
    let mut of_anchor: Vec<Vec<f64>> = vec![Vec::new(); anchors.len()];
    let mut moved = Vec::new();
    for f in found {
        let [image, feature] = f.view.map(|i| i as usize);
        keypoints[image][feature] = f.place;
        sigmas[image][feature] = f.deviation as f32;
        of_anchor[f.anchor].push(f.deviation);
        moved.push(f.view);
    }
    moved.sort_unstable();
    let mut unsure = Vec::new();
    for (anchor, deviations) in anchors.iter().zip(&of_anchor).filter(|(_, d)| !d.is_empty()) {
        let views = &anchor.point.views;
        let [image, feature] = views[anchor.first].map(|i| i as usize);
        // The spot is where it is said to be; what it is worth is what the others are.
        sigmas[image][feature] = median(deviations.clone()) as f32;
        let others =
            views.iter().enumerate().filter(|(i, v)| *i != anchor.first && moved.binary_search(v).is_err());
        unsure.extend(others.map(|(_, v)| *v));
    }
    let all: Vec<f64> = of_anchor.into_iter().flatten().collect();
    let unit = if all.is_empty() { 1.0 } else { median(all) as f32 };
    sigmas.iter_mut().flatten().for_each(|s| *s /= unit);
    RefinedKeypoints { keypoints, sigmas, moved, unsure }
}

/// How many of `observations` a model has, and their median reprojection error, pixels; infinite
/// where it has none.
pub(crate) fn fit(state: &MapState, input: &MappingInput<'_>, observations: &[[u32; 2]]) -> Support {
    let mut errors = Vec::with_capacity(observations.len());
    for view in observations {
        let point = state.point_of[view[0] as usize][view[1] as usize];
        if point != NONE
            && let Some(point) = &state.points[point as usize]
        {
            errors.push(state.error_sq(input, *view, point.position));
        }
    }
    let explained = errors.len();
    let error_px = if errors.is_empty() { f64::INFINITY } else { median(errors).sqrt() };
    Support { explained, error_px: Some(error_px), ..Support::default() }
}

#[cfg(test)]
mod tests;
