//! The solved model as the types that cross borders.

use super::SolvedModel;
use crate::tracks::NONE;
use crate::{SfmError, SfmResult, Uncertainty};
use glam::DVec2;
use rayon::prelude::*;
use scene::{FrameSet, Observation, PosedImage, Progress, Reconstruction, ScenePoint, TrackElement};

/// Images with fewer observations than this are weakly constrained.
const FEW_OBSERVATIONS: usize = 30;
/// A rotation is uncertain if its standard deviation is above this (degrees) and so many times the usual one.
const WEAK_ROTATION_DEG: f64 = 0.1;
const WEAK_FACTOR: f64 = 5.0;

/// Fills in the model, its statistics and what is missing.
pub(super) fn fill(
    result: &mut SfmResult,
    frames: &FrameSet,
    solved: SolvedModel,
    progress: &Progress,
) -> Result<(), SfmError> {
    progress.check()?;
    let model = convert(&solved, frames);
    let mut errors = model.reprojection_errors();
    let stats = &mut result.stats;
    stats.registered = model.images.len();
    stats.points = model.points.len();
    stats.observations = errors.len();
    stats.mean_track_length = errors.len() as f64 / model.points.len().max(1) as f64;
    let squares: f64 = errors.iter().map(|e| e * e).sum();
    stats.reprojection_rms_px = (squares / errors.len().max(1) as f64).sqrt();
    errors.sort_unstable_by(f64::total_cmp);
    stats.reprojection_median_px = errors.get(errors.len() / 2).copied().unwrap_or(0.0);
    for (i, frame) in frames.frames.iter().enumerate() {
        if !model.images.contains_key(&(i as u32 + 1)) {
            result.missing.push((frame.name.clone(), why_missing(result, i)));
        }
    }
    result.weak_images = weak_images(&model, solved.uncertainty.as_ref());
    result.decisions.extend(solved.decisions);
    result.uncertainty = solved.uncertainty;
    result.reconstruction = Some(model);
    Ok(())
}

/// Images with few observations, or with a rotation far less certain than that of most.
fn weak_images(model: &Reconstruction, uncertainty: Option<&Uncertainty>) -> Vec<(String, String)> {
    let rotation = |id: &u32| {
        let d = uncertainty?.images.get(id)?.rotation;
        Some(d.iter().fold(0.0_f64, |most, r| most.max(*r)).to_degrees())
    };
    let mut all: Vec<f64> = model.images.keys().filter_map(rotation).collect();
    all.sort_unstable_by(f64::total_cmp);
    let usual = all.get(all.len() / 2).copied().unwrap_or(0.0);
    let weak = |image: &PosedImage| {
        let seen = image.observations.iter().filter(|o| o.point.is_some()).count();
        let deviation = rotation(&image.id).unwrap_or(0.0);
        let why = if seen < FEW_OBSERVATIONS {
            format!("only {seen} points hold its pose")
        } else if deviation > WEAK_ROTATION_DEG.max(WEAK_FACTOR * usual) {
            format!("its rotation is known to {deviation:.2}° only (most images: {usual:.2}°)")
        } else {
            return None;
        };
        Some((image.name.clone(), why))
    };
    model.images.values().filter_map(weak).collect()
}

fn why_missing(result: &SfmResult, image: usize) -> String {
    let features = result.features[image].len();
    let pairs: Vec<usize> =
        result.geometries.iter().filter(|g| g.a == image || g.b == image).map(|g| g.inliers.len()).collect();
    match pairs.iter().max() {
        _ if features < 50 => format!("only {features} features"),
        None => format!("none of its {features} features could be matched with another image's"),
        Some(best) => format!(
            "matches {} images (at best {best} points), but its pose does not agree with the model",
            pairs.len()
        ),
    }
}

/// Image number = index of the frame + 1; points are numbered from 1 in the order in which they were found.
pub(super) fn convert(solved: &SolvedModel, frames: &FrameSet) -> Reconstruction {
    let state = &solved.state;
    let mut model = Reconstruction::default();
    let mut number = vec![0u64; state.points.len()];
    for ((id, _), n) in state.live().zip(1u64..) {
        number[id as usize] = n;
    }
    for (image, pose) in state.poses.iter().enumerate() {
        let Some(pose) = pose else { continue };
        let camera = &state.cameras[solved.camera_of[image]];
        model.cameras.insert(camera.id, camera.clone());
        let point = |p: u32| (p != NONE).then(|| number[p as usize]);
        let keypoints = solved.keypoints[image].iter().zip(&state.point_of[image]);
        let observations = keypoints.map(|(&pixel, &p)| Observation { pixel, point: point(p) }).collect();
        let id = image as u32 + 1;
        let name = frames.frames[image].name.clone();
        model.images.insert(id, PosedImage { id, camera: camera.id, name, pose: *pose, observations });
    }
    for (id, p) in state.live() {
        let track: Vec<TrackElement> =
            p.views.iter().map(|v| TrackElement { image: v[0] + 1, observation: v[1] }).collect();
        let mut point = ScenePoint { position: p.position, rgb: [128; 3], error_px: 0.0, track };
        let errors: Vec<f64> =
            point.track.iter().filter_map(|e| model.residual(&point, e)).map(DVec2::length).collect();
        point.error_px = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        model.points.insert(number[id as usize], point);
    }
    model
}

/// Gives every point the mean colour of the pixels at which it is seen.
pub(super) fn colour(result: &mut SfmResult, frames: &FrameSet, progress: &Progress) -> Result<(), SfmError> {
    let Some(model) = &mut result.reconstruction else { return Ok(()) };
    progress.begin("colours", model.images.len());
    type Samples = Vec<(u64, [u8; 3])>;
    let images: Vec<&PosedImage> = model.images.values().collect();
    let sample = |posed: &&PosedImage| -> Result<Samples, SfmError> {
        progress.tick()?;
        let path = &frames.frames[posed.id as usize - 1].path;
        let unreadable = |reason: String| SfmError::UnreadableImage { path: path.clone(), reason };
        let reader = image::ImageReader::open(path).and_then(|r| r.with_guessed_format());
        let decoded = reader.map_err(|e| unreadable(e.to_string()))?.decode();
        let pixels = decoded.map_err(|e| unreadable(e.to_string()))?.to_rgb8();
        let at = |p: DVec2| {
            let x = (p.x.max(0.0) as u32).min(pixels.width().saturating_sub(1));
            let y = (p.y.max(0.0) as u32).min(pixels.height().saturating_sub(1));
            pixels.get_pixel(x, y).0
        };
        Ok(posed.observations.iter().filter_map(|o| Some((o.point?, at(o.pixel)))).collect())
    };
    let samples: Result<Vec<Samples>, SfmError> = images.par_iter().map(sample).collect();
    let mut sums: std::collections::BTreeMap<u64, [u32; 4]> = std::collections::BTreeMap::new();
    for (id, rgb) in samples?.into_iter().flatten() {
        let sum = sums.entry(id).or_default();
        (0..3).for_each(|c| sum[c] += u32::from(rgb[c]));
        sum[3] += 1;
    }
    for (id, [r, g, b, n]) in sums {
        if let Some(point) = model.points.get_mut(&id) {
            point.rgb = [r, g, b].map(|sum| ((sum + n / 2) / n) as u8);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PoseDeviation;
    use scene::Pose;

    #[test]
    fn weakly_constrained_images_are_named() {
        let mut model = Reconstruction::default();
        let mut uncertainty = Uncertainty::default();
        for id in 1..=7 {
            let seen = if id == 3 { 20 } else { 200 };
            let observations = (0..300)
                .map(|i| Observation { pixel: DVec2::ZERO, point: (i < seen).then_some(i) })
                .collect();
            let name = format!("{id}.png");
            model.images.insert(id, PosedImage { id, camera: 1, name, pose: Pose::IDENTITY, observations });
            let sigma = if id == 5 { 0.02 } else { 0.001 };
            let deviation = PoseDeviation { rotation: [sigma, 0.0005, 0.0005], centre: [0.0; 3] };
            uncertainty.images.insert(id, deviation);
        }
        let names = |u: Option<&Uncertainty>| {
            weak_images(&model, u).into_iter().map(|(name, _)| name).collect::<Vec<String>>()
        };
        assert_eq!(names(Some(&uncertainty)), ["3.png", "5.png"]);
        assert_eq!(names(None), ["3.png"]);
    }
}
