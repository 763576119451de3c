//! Poses that came with the input against the photos: what the photos share among each other, found
//! without the poses, must lie where the poses say.
//!
//! in: frames and a model whose images bear their names · out: images that are contradicted, and
//! images that nothing confirms. Small copies of the photos are enough.

use super::given::{GivenPoses, neighbours};
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::incremental::MapperConfig;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::{AGREEING_SHARE, FEW_OBSERVATIONS, FEWEST_VIEWS, LEAST_ERROR_PX, OUTLIER_SIGMAS};
use crate::matching::match_pairs;
use crate::sift::{self, SiftConfig};
use crate::tracks::{build_tracks, positions};
use crate::two_view::verify_pairs;
use glam::DVec2;
use scene::{Camera, Features, FrameSet, Progress, Reconstruction, TwoViewKind};
use std::collections::BTreeSet;

/// Photos are looked at in this size, pixels of the longer side.
/// Source: tools/reliability/models.py, whose photos of 240 pixels are told apart when they are
/// exchanged with their neighbours, 5° away.
const SIDE: u32 = 320;
/// What lies farther from where its point should be seen contradicts, however inaccurate the poses
/// are, longer image sides.
/// Source: derived; the same as in `scene::Reconstruction::admit`.
const TOLERANCE: f64 = 0.02;

/// What photos say of the poses that came with them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GivenCheck {
    /// Images that the photos contradict, and why.
    pub contradicted: Vec<(String, String)>,
    /// Images that no other photo confirms though most are, and why.
    pub unconfirmed: Vec<(String, String)>,
    /// Whether half of all that the photos share lies more than a pixel of a small copy off: poses
    /// of real captures leave a third of that.
    pub is_off: bool,
}

/// Compares the poses of a model with the photos; nothing is said of fewer than three images.
///
/// A track is what at least three photos show alike. It agrees with an image where the point that
/// three of them see as posed lies there in the image, too, as near as is usual for these poses.
pub fn check_given(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<GivenCheck, SfmError> {
    let given = GivenPoses::of(frames, model);
    if given.poses.len() < FEWEST_VIEWS {
        return Ok(GivenCheck::default());
    }
    let residuals = residuals_of_given(&given, config, progress)?;
    let counts = counted(&residuals, given.poses.len());
    let mut most: Vec<usize> = counts.iter().map(|c| c[1]).collect();
    most.sort_unstable();
    let shared = most[most.len() / 2];
    let is_off = residuals.len() >= FEW_OBSERVATIONS && usual(&residuals) > LEAST_ERROR_PX;
    let mut found = GivenCheck { is_off, ..GivenCheck::default() };
    for ([agreeing, all], frame) in counts.into_iter().zip(&given.frames.frames) {
        if all >= FEW_OBSERVATIONS && (agreeing as f64) < AGREEING_SHARE * all as f64 {
            let why = format!(
                "its photo contradicts its pose: {agreeing} of {all} details that three photos share lie where \
                 the poses say"
            );
            found.contradicted.push((frame.name.clone(), why));
        } else if all == 0 && shared >= FEW_OBSERVATIONS {
            let why = format!("it shares no detail with two other photos, the others {shared} (median)");
            found.unconfirmed.push((frame.name.clone(), why));
        }
    }
    Ok(found)
}

/// How far what three photos share lies from where the poses say, pixels of the small copies.
fn residuals_of_given(
    given: &GivenPoses,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<Vec<([u32; 2], f64)>, SfmError> {
    let size = config.sift.max_feature_size.min(SIDE as usize);
    let sift = SiftConfig { max_feature_size: size, ..config.sift.clone() };
    let mut features = sift::extract_all(&given.frames, &sift, progress)?;
    let cameras: Vec<Camera> = given.camera_of.iter().map(|&c| reduced(&given.cameras[c])).collect();
    for (features, (camera, frame)) in features.iter_mut().zip(cameras.iter().zip(&given.frames.frames)) {
        let scale = [
            f64::from(camera.width) / f64::from(frame.width.max(1)),
            f64::from(camera.height) / f64::from(frame.height.max(1)),
        ];
        resize(features, scale);
    }
    let matches = match_pairs(&features, &pairs(given), &config.matching, progress)?;
    let mut geometries = verify_pairs(&features, &cameras, matches, &config.two_view, config.seed, progress)?;
    geometries.retain(|g| g.kind != TwoViewKind::Watermark);
    let tracks = build_tracks(&features, &geometries);
    let keypoints: Vec<Vec<DVec2>> = features.iter().map(positions).collect();
    let mapper = MapperConfig {
        max_reprojection_px: TOLERANCE * f64::from(SIDE),
        min_angle_deg: 0.0, // what is far away agrees as well
        ..config.mapper.clone()
    };
    let input = MappingInput {
        keypoints: &keypoints,
        sigmas: &vec![Vec::new(); features.len()],
        tracks: &tracks,
        camera_of: &(0..features.len()).collect::<Vec<usize>>(),
        geometries: &geometries,
        config: &mapper,
        is_video: given.frames.is_video,
        skip: &config.skip,
        seed: config.seed,
    };
    let mut state = MapState::new(&input, cameras.clone());
    given.poses.iter().enumerate().for_each(|(i, pose)| state.register(i, *pose));
    state.grow_all(&input);
    Ok(residuals(&state, &input))
}

/// The camera of a copy whose longer side is [`SIDE`].
fn reduced(camera: &Camera) -> Camera {
    let scale = (f64::from(SIDE) / f64::from(camera.width.max(camera.height).max(1))).min(1.0);
    let [width, height] =
        [camera.width, camera.height].map(|side| ((f64::from(side) * scale).round() as u32).max(1));
    camera.scaled(width, height)
}

fn resize(features: &mut Features, scale: [f64; 2]) {
    for keypoint in &mut features.keypoints {
        keypoint.x *= scale[0] as f32;
        keypoint.y *= scale[1] as f32;
        keypoint.scale *= scale[0] as f32;
    }
}

/// Neighbours by their poses, however far apart they look, and by their order, which stays true
/// where poses are wrong.
fn pairs(given: &GivenPoses) -> Vec<(usize, usize)> {
    let count = given.poses.len();
    let by_order = (0..count).flat_map(|a| (a + 1..count.min(a + 1 + FEWEST_VIEWS)).map(move |b| (a, b)));
    let all: BTreeSet<(usize, usize)> =
        neighbours(&given.poses, std::f64::consts::PI).into_iter().chain(by_order).collect();
    all.into_iter().collect()
}

/// How far the views of each track lie from the point that three of them see, pixels; infinite
/// where there is none.
fn residuals(state: &MapState, input: &MappingInput<'_>) -> Vec<([u32; 2], f64)> {
    let mut found = Vec::new();
    for (views, points) in input.tracks.views.iter().zip(&state.of_track) {
        if views.len() < FEWEST_VIEWS {
            continue;
        }
        let points = points.iter().filter_map(|&p| state.points[p as usize].as_ref());
        let best = points.max_by_key(|p| p.views.len()).filter(|p| p.views.len() >= FEWEST_VIEWS);
        found.extend(views.iter().map(|&view| {
            let apart = best.map_or(f64::INFINITY, |p| state.error_sq(input, view, p.position).sqrt());
            (view, apart)
        }));
    }
    found
}

/// [agreeing, all] of each image. What poses leave is judged by what they leave usually, so that
/// poses of little accuracy agree as well, within the tolerance.
fn counted(residuals: &[([u32; 2], f64)], images: usize) -> Vec<[usize; 2]> {
    let limit = (OUTLIER_SIGMAS * usual(residuals)).max(LEAST_ERROR_PX).min(TOLERANCE * f64::from(SIDE));
    let mut counts = vec![[0; 2]; images];
    for (view, apart) in residuals {
        counts[view[0] as usize][0] += usize::from(*apart <= limit);
        counts[view[0] as usize][1] += 1;
    }
    counts
}

/// The median, pixels.
fn usual(residuals: &[([u32; 2], f64)]) -> f64 {
    let mut sorted: Vec<f64> = residuals.iter().map(|r| r.1).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_far_off_what_is_usual_is_told_and_poses_of_little_accuracy_agree() {
        // Eight images of 40 tracks each; the residuals of image 3 are ten times the others'.
        let of = |usual: f64| -> Vec<([u32; 2], f64)> {
            let all = (0..8).flat_map(|image| (0..40).map(move |feature| [image, feature]));
            all.map(|view| (view, if view[0] == 3 { 10.0 * usual } else { usual })).collect()
        };
        let counts = counted(&of(0.4), 8);
        assert_eq!((counts[2], counts[3]), ([40, 40], [0, 40]));
        assert_eq!(counted(&of(0.05), 8)[3], [40, 40], "half a pixel is no contradiction");
        assert_eq!(counted(&of(5.0), 8)[2], [40, 40], "nor is what all have");
        assert_eq!(counted(&of(f64::INFINITY), 8)[2], [0, 40]);
    }
}
