//! Growing a model image by image.

use super::adjust::{Adjustment, adjust, plausible};
use super::resection::{Resection, next_images, resect};
use super::state::{MapState, MappingInput};
use super::structureless_resection::{consistency, resect_structureless};
use crate::bundle::{IntrinsicsPrior, free_parameters};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::{AGREEING_SHARE, JOINT_IMAGES};
use crate::plausibility::camera_prior::{FOCAL_LOG_SIGMA, usual_focal_px};
use crate::skip::StepName;
use crate::tracks::NONE;
use scene::{Camera, Progress};

/// Focal lengths farther from the median than by this factor belong to no camera.
/// Source: `plausible` of `adjust.rs`: 60 longer image sides over the median of 1.2.
const EXTREME_RATIO: f64 = 50.0;
/// Images of the small models that are compared before one is grown; with more, distortion is
/// solved for.
/// Source: chosen by hand, never measured.
pub(super) const SMALL: usize = 5;
/// Images up to which the model is adjusted after each registration; then after one more for each
/// so many.
/// Source: chosen by hand, never measured.
const IMAGES_FOR_EACH: usize = 12;
/// Images that move in a local adjustment.
/// Source: chosen by hand, never measured.
const LOCAL_IMAGES: usize = 8;
/// Points an image contributes to an adjustment while the model grows.
/// Source: chosen by hand, never measured.
const POINTS_PER_IMAGE: usize = 60;

/// What priors and repairs refer to: the start's intrinsics where they were known, the small
/// model's where not.
pub(crate) fn starts_of(cameras: &[Camera], known: &[Knowledge], state: &MapState) -> Vec<Camera> {
    let all = cameras.iter().zip(&state.cameras).zip(known);
    all.map(|((start, now), k)| if k.focal_sigma.is_some() || k.fixed { start } else { now })
        .cloned()
        .collect()
}

/// Which intrinsics are free with `images` images in the model, and what holds them.
pub(crate) fn freedom(
    cameras: &[Camera],
    known: &[Knowledge],
    starts: &[Camera],
    images: usize,
) -> (Vec<Vec<bool>>, Vec<IntrinsicsPrior>) {
    let distortion = images > SMALL;
    let free = cameras.iter().zip(known).map(|(c, k)| {
        let free = !k.fixed && images > 2;
        free_parameters(c, free, false, free && distortion)
    });
    let mut priors = Vec::new();
    for (camera, (start, k)) in starts.iter().zip(known).enumerate() {
        let focals = start.model.num_focals();
        if !k.fixed {
            priors.extend((0..focals).map(|parameter| match k.focal_sigma {
                Some(share) => {
                    let mean = start.params[parameter];
                    IntrinsicsPrior { camera, parameter, mean, sigma: share * mean }
                }
                None => usual_focal_prior(camera, parameter, &cameras[camera]),
            }));
        }
        // Distortion of ordinary lenses is a few per cent at the corner; this matters only where
        // the views say nothing.
        let relative = start.mean_focal() / f64::from(start.width.max(start.height));
        let mild =
            |parameter| IntrinsicsPrior { camera, parameter, mean: 0.0, sigma: 0.5 * relative * relative };
        priors.extend((focals + 2..start.params.len()).map(mild));
    }
    (free.collect(), priors)
}

/// What is known of a parameter that is a focal length of `camera` (the last estimate), as real
/// cameras have it: normal in the logarithm. Here a normal distribution about the same median whose
/// slope at the last estimate is that of the log-normal one: `(f − m) / s² = ln(f / m) / (σ² f)`.
fn usual_focal_prior(index: usize, parameter: usize, camera: &Camera) -> IntrinsicsPrior {
    let (focal, mean) = (camera.mean_focal(), usual_focal_px(camera.width, camera.height));
    // What a failed step has left behind, beyond all lenses, pulls no harder.
    let ratio = (focal / mean).clamp(1.0 / EXTREME_RATIO, EXTREME_RATIO);
    // (r − 1) / (r ln r), which is 1 at r = 1.
    let spread = if (ratio - 1.0).abs() > 1e-6 { (ratio - 1.0) / (ratio * ratio.ln()) } else { 1.0 };
    IntrinsicsPrior { camera: index, parameter, mean, sigma: FOCAL_LOG_SIGMA * ratio * mean * spread.sqrt() }
}

/// Registers images until `most` are in, or none can be added.
pub(crate) fn grow(
    state: &mut MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    most: usize,
    progress: &Progress,
) -> Result<(), SfmError> {
    // Each attempt counts anew: images that an earlier one placed are placed again.
    progress.begin("mapping", most.min(state.poses.len()).saturating_sub(state.registered_count()));
    let mut tried = vec![0usize; state.poses.len()];
    let mut last_full = state.registered_count();
    let mut fresh = false;
    let mut due = 0;
    let mut structureless = vec![false; state.poses.len()];
    while state.registered_count() < most {
        progress.check()?;
        let mut candidates = next_images(state, input);
        candidates.retain(|&(i, n)| n > tried[i]);
        let next = candidates.into_iter().find_map(|(image, n)| {
            let camera = input.camera_of[image];
            let unseen = !state.order.iter().any(|&i| input.camera_of[i] == camera);
            let search = unseen && !known[camera].fixed && known[camera].focal_sigma.is_none();
            tried[image] = n;
            resect(state, input, image, search).map(|r| (image, r))
        });
        let next = next.or_else(|| {
            if input.skips(StepName::StructurelessResection) {
                return None;
            }
            let (image, pose) = resect_structureless(state, input, &structureless)?;
            structureless[image] = true;
            Some((image, Resection { pose, focal: None }))
        });
        let Some((image, found)) = next else {
            if fresh {
                break;
            }
            // A last effort: everything triangulated and adjusted, then the images that failed once
            // more.
            settle(state, input, known, starts, progress)?;
            (fresh, last_full) = (true, state.registered_count());
            tried.fill(0);
            continue;
        };
        fresh = false;
        if let Some(focal) = found.focal {
            let camera = &mut state.cameras[input.camera_of[image]];
            let focals = camera.model.num_focals();
            camera.params[..focals].fill(focal);
        }
        state.register(image, found.pose);
        state.grow_image(input, image);
        if progress.wants_preview() {
            progress.preview(state.preview(input.camera_of));
        }
        let images = state.registered_count();
        let full = images <= JOINT_IMAGES || images as f64 > 1.08 * last_full as f64;
        if full {
            last_full = images;
        }
        // A few images more do not bend a model that stands; the next adjustment takes them along.
        if images > IMAGES_FOR_EACH && images < JOINT_IMAGES && images < most && images < due {
            progress.tick_with(&format!("{images} images"))?;
            continue;
        }
        due = images + 1 + images / IMAGES_FOR_EACH;
        let (free, priors) = freedom(&state.cameras, known, starts, images);
        let mut what = Adjustment::growing(free, priors);
        what.points_per_image =
            Some(if images > SMALL + 1 { POINTS_PER_IMAGE } else { 3 * POINTS_PER_IMAGE });
        if !full {
            what.moving = Some(neighbours(state, image, LOCAL_IMAGES));
            what.free = state.cameras.iter().map(|c| vec![false; c.params.len()]).collect();
        }
        adjust(state, input, &what, progress)?;
        repair(state, known, starts);
        match &what.moving {
            Some(moved) => state.filter_seen_by(input, input.config.max_reprojection_px, moved),
            None => state.filter(input, input.config.max_reprojection_px),
        };
        if state.observations(image) < input.config.min_observations {
            state.unregister(image);
        } else {
            progress.tick_with(&format!("{images} images"))?;
        }
    }
    Ok(())
}

/// Triangulates, adjusts and filters the whole model a few times.
pub(crate) fn settle(
    state: &mut MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    progress: &Progress,
) -> Result<(), SfmError> {
    for _ in 0..3 {
        let added = state.grow_all(input);
        let (free, priors) = freedom(&state.cameras, known, starts, state.registered_count());
        let mut what = Adjustment::growing(free, priors);
        what.points_per_image = Some(4 * POINTS_PER_IMAGE);
        adjust(state, input, &what, progress)?;
        repair(state, known, starts);
        let gone = state.filter(input, input.config.max_reprojection_px);
        let all: usize = state.live().map(|(_, p)| p.views.len()).sum();
        if (added + gone) * 100 < all {
            break;
        }
    }
    Ok(())
}

/// Takes out images whose pose most of their verified matches contradict, or that see too little.
pub(crate) fn expel(state: &mut MapState, input: &MappingInput<'_>) {
    let mut wrong = state.order.clone();
    wrong.retain(|&image| is_doubtful(state, input, image));
    wrong.into_iter().for_each(|image| state.unregister(image));
}

fn is_doubtful(state: &MapState, input: &MappingInput<'_>, image: usize) -> bool {
    let (agreeing, all) = consistency(state, input, image);
    let few = state.observations(image) < input.config.min_observations;
    few || (all >= 2 * input.config.min_observations && (agreeing as f64) < AGREEING_SHARE * all as f64)
}

/// Puts intrinsics that ran away back to their start.
fn repair(state: &mut MapState, known: &[Knowledge], starts: &[Camera]) {
    for ((camera, k), start) in state.cameras.iter_mut().zip(known).zip(starts) {
        if !k.fixed && !plausible(camera) {
            camera.params.clone_from(&start.params);
        }
    }
}

/// The image and those registered images that share most points with it.
fn neighbours(state: &MapState, image: usize, count: usize) -> Vec<usize> {
    let mut shared = vec![0usize; state.poses.len()];
    let seen = state.point_of[image].iter().filter(|&&id| id != NONE);
    for point in seen.filter_map(|&id| state.points[id as usize].as_ref()) {
        point.views.iter().for_each(|v| shared[v[0] as usize] += 1);
    }
    shared[image] = usize::MAX;
    let mut ranked: Vec<usize> = (0..shared.len()).filter(|&i| shared[i] > 0).collect();
    ranked.sort_by_key(|&i| (std::cmp::Reverse(shared[i]), i));
    ranked.truncate(count);
    ranked
}
