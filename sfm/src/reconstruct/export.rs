//! The solved model as the types that cross borders.

use crate::error::SfmError;
use crate::incremental::state::MapState;
use crate::limits::FEW_OBSERVATIONS;
use crate::result::{SfmStats, Uncertainty};
use crate::sift::unreadable;
use crate::tracks::NONE;
use glam::DVec2;
use rayon::prelude::*;
use scene::io::load::load_rgb;
use scene::{
    Features, Frame, FrameSet, Observation, PosedImage, Progress, Reconstruction, ScenePoint, TrackElement,
    TwoViewGeometry,
};
use std::collections::BTreeMap;

/// A rotation is uncertain if its standard deviation is above this, degrees, and so many times the
/// usual one.
/// Source: chosen by hand; names images in the report alone.
const WEAK_ROTATION: (f64, f64) = (0.1, 5.0);

/// What is counted of a model.
pub(super) fn fill_statistics(stats: &mut SfmStats, model: &Reconstruction) {
    let mut errors = model.reprojection_errors();
    stats.registered = model.images.len();
    stats.points = model.points.len();
    stats.observations = errors.len();
    stats.mean_track_length = errors.len() as f64 / model.points.len().max(1) as f64;
    let squares: f64 = errors.iter().map(|e| e * e).sum();
    stats.reprojection_rms_px = (squares / errors.len().max(1) as f64).sqrt();
    errors.sort_unstable_by(f64::total_cmp);
    stats.reprojection_median_px = errors.get(errors.len() / 2).copied().unwrap_or(0.0);
}

/// Numbers of a pose that nothing but its observations holds.
/// Source: derived.
const FREE_POSE: usize = 6;

/// Images with few observations for each free number of a pose, or with a rotation far less certain
/// than that of most. `turn`: a motion about one axis holds all of a pose but its angle.
pub(super) fn weak_images(
    model: &Reconstruction,
    uncertainty: Option<&Uncertainty>,
    turn: bool,
) -> Vec<(String, String)> {
    let fewest = if turn { FEW_OBSERVATIONS.div_ceil(FREE_POSE) } else { FEW_OBSERVATIONS };
    let mut deviations: BTreeMap<u32, f64> = BTreeMap::new();
    for (id, image) in uncertainty.iter().flat_map(|u| &u.images) {
        let largest = image.rotation.iter().fold(0.0_f64, |most, r| most.max(*r));
        deviations.insert(*id, largest.to_degrees());
    }
    deviations.retain(|id, _| model.images.contains_key(id));
    let mut all: Vec<f64> = deviations.values().copied().collect();
    all.sort_unstable_by(f64::total_cmp);
    let usual = all.get(all.len() / 2).copied().unwrap_or(0.0);
    let mut weak = Vec::new();
    for image in model.images.values() {
        let seen = image.observations.iter().filter(|o| o.point.is_some()).count();
        let deviation = deviations.get(&image.id).copied().unwrap_or(0.0);
        if seen < fewest {
            weak.push((image.name.clone(), format!("only {seen} points hold its pose")));
        } else if deviation > WEAK_ROTATION.0.max(WEAK_ROTATION.1 * usual) {
            let why = format!("its rotation is known to {deviation:.2}° only (most images: {usual:.2}°)");
            weak.push((image.name.clone(), why));
        }
    }
    weak
}

/// Why an image has no pose.
pub(super) fn why_missing(image: usize, features: &Features, verified: &[TwoViewGeometry]) -> String {
    let features = features.len();
    let pairs: Vec<usize> =
        verified.iter().filter(|g| g.a == image || g.b == image).map(|g| g.inliers.len()).collect();
    match pairs.iter().max() {
        _ if features < FEW_OBSERVATIONS => format!("only {features} features"),
        None => format!("none of its {features} features could be matched with another image's"),
        Some(best) => format!(
            "matches {} images (at best {best} points), but its pose does not agree with the model",
            pairs.len()
        ),
    }
}

/// Why no image has a pose.
pub(super) fn why_no_model(features: &[Features], verified: &[TwoViewGeometry]) -> String {
    let most = features.iter().map(Features::len).max().unwrap_or(0);
    if most < FEW_OBSERVATIONS {
        return format!(
            "at most {most} features were found in an image: too dark, too blurred or without texture"
        );
    }
    if verified.is_empty() {
        return "no two images show the same points: film more slowly, or from fewer sides".to_owned();
    }
    format!(
        "{} image pairs agree, but none has enough baseline to start from: move the camera sideways",
        verified.len()
    )
}

/// Image number = index of the frame + 1; points are numbered from 1 in the order in which they
/// were found.
pub(super) fn convert(
    state: &MapState,
    camera_of: &[usize],
    keypoints: &[Vec<DVec2>],
    frames: &[Frame],
) -> Reconstruction {
    let mut model = Reconstruction::default();
    let mut number = vec![0u64; state.points.len()];
    for ((id, _), n) in state.live().zip(1u64..) {
        number[id as usize] = n;
    }
    for (image, pose) in state.poses.iter().enumerate() {
        let Some(pose) = pose else { continue };
        let camera = &state.cameras[camera_of[image]];
        model.cameras.insert(camera.id, camera.clone());
        let seen = keypoints[image].iter().zip(&state.point_of[image]);
        let observations = seen
            .map(|(&pixel, &p)| Observation { pixel, point: (p != NONE).then(|| number[p as usize]) })
            .collect();
        let (id, name) = (image as u32 + 1, frames[image].name.clone());
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
pub(super) fn colour(
    model: &mut Reconstruction,
    frames: &FrameSet,
    progress: &Progress,
) -> Result<(), SfmError> {
    progress.begin("colours", model.images.len());
    let images: Vec<&PosedImage> = model.images.values().collect();
    let samples: Result<Vec<_>, SfmError> = images
        .par_iter()
        .map(|posed| {
            progress.tick()?;
            sample(posed, &frames.frames[posed.id as usize - 1])
        })
        .collect();
    let mut sums: BTreeMap<u64, [u32; 4]> = BTreeMap::new();
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

/// The colours at which one image sees its points.
fn sample(posed: &PosedImage, frame: &Frame) -> Result<Vec<(u64, [u8; 3])>, SfmError> {
    let pixels = load_rgb(&frame.path).map_err(|e| unreadable(&frame.path, &e))?;
    let mut colours = Vec::new();
    for observation in &posed.observations {
        let Some(point) = observation.point else { continue };
        let x = (observation.pixel.x.max(0.0) as u32).min(pixels.width().saturating_sub(1));
        let y = (observation.pixel.y.max(0.0) as u32).min(pixels.height().saturating_sub(1));
        colours.push((point, pixels.get_pixel(x, y).0));
    }
    Ok(colours)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::PoseDeviation;
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
            let deviation = PoseDeviation { rotation: [sigma, 0.0005, 0.0005], ..PoseDeviation::default() };
            uncertainty.images.insert(id, deviation);
        }
        let names = |u: Option<&Uncertainty>| {
            let of = |turn| weak_images(&model, u, turn).into_iter().map(|(name, _)| name);
            [false, true].map(|turn| of(turn).collect::<Vec<String>>())
        };
        assert_eq!(names(Some(&uncertainty)), [vec!["3.png", "5.png"], vec!["5.png"]]);
        assert_eq!(names(None), [vec!["3.png"], vec![]]);
    }
}
