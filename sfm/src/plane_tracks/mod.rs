//! Observations of a supporting plane. An object in the dark, or of glitter, leaves few points to hold a camera by, but the table or the floor it
//! stands on is seen by all cameras, and where it is a plane a model that is nearly right says how each sees it: from straight above it
//! looks the same in all, but for noise and for what poses are off by. What most of them show (the median) has little noise; where
//! its windows lie in one image tells that image's errors, over pixels that no detector would find a point in.

pub(crate) mod plane;
mod sheet;
#[cfg(test)]
pub(crate) mod tests;
mod window;

use crate::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::klt::pyramid::Pyramid;
use crate::sift::load_luma;
use glam::{DMat2, DVec2, DVec3};
use plane::ScenePlane;
use rayon::prelude::*;
use scene::{FrameSet, Progress};
use sheet::{Sheet, SheetPicture};
use window::{HALF, PlaneWindow};

/// Images are halved so often at most.
const LEVELS: usize = 5;
/// Observations known less exactly than this are left out, pixels.
const LOOSE_PX: f64 = 1.5;
/// Fewest images that see a window.
const FEWEST: usize = 3;
/// What only a smaller share of the images that show it has where it is meant to be is not of the plane, or of noise.
const FOUND: f64 = 0.5;

/// A place of the plane and its observations.
#[derive(Clone, Debug)]
pub(crate) struct PlanePoint {
    pub position: DVec3,
    pub observations: Vec<PlaneObservation>,
}

/// Where an image shows a place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneObservation {
    pub image: usize,
    pub pixel: DVec2,
    /// Standard deviation of a coordinate, pixels.
    pub deviation: f64,
    /// How far it is from where the model has it, pixels.
    pub off: f64,
}

/// Looks for windows of a plane in all registered images, up to `farthest` squares (about a pixel each) from where the model
/// has them. `rotated`: images that `input` shows rotated by 180°.
pub(crate) fn find_plane_tracks(
    plane: ScenePlane,
    (state, input): (&MapState, &MappingInput<'_>),
    (frames, rotated): (&FrameSet, &[bool]),
    farthest: usize,
    progress: &Progress,
) -> Result<Vec<PlanePoint>, SfmError> {
    let view = |image: usize| Some((&state.cameras[input.camera_of[image]], state.poses[image]?));
    let Some(sheet) = Sheet::new(plane, (0..frames.len()).filter_map(view)) else { return Ok(Vec::new()) };
    progress.begin("plane tracks", frames.len());
    let picture = |image: usize| -> Result<Option<SheetPicture>, SfmError> {
        progress.tick()?;
        let Some((camera, pose)) = view(image) else { return Ok(None) };
        let mut grey = load_luma(&frames.frames[image])?;
        if rotated[image] {
            grey.data.reverse();
        }
        Ok(Some(sheet.seen_by(camera, &pose, &Pyramid::new(&grey, LEVELS))))
    };
    let pictures: Vec<Option<SheetPicture>> =
        (0..frames.len()).into_par_iter().with_max_len(1).map(picture).collect::<Result<_, _>>()?;
    let common = sheet.common(&pictures);
    let middles = (0..sheet.side / (2 * HALF)).map(|i| HALF + 1 + 2 * HALF * i);
    let windows: Vec<PlaneWindow> = middles
        .clone()
        .flat_map(|y| middles.clone().map(move |x| [x, y]))
        .filter_map(|m| PlaneWindow::of(&common, sheet.side, m))
        .collect();
    let place = |window: &PlaneWindow| {
        let at = DVec2::new(window.middle[0] as f64, window.middle[1] as f64) + 0.5;
        let position = sheet.place(at);
        let observation = |image: usize| {
            let found = window.find(pictures[image].as_ref()?, sheet.side, farthest)?;
            let (camera, pose) = view(image)?;
            let pixel = camera.project(pose.transform(sheet.place(at + found.by)))?;
            let meant = camera.project(pose.transform(position))?;
            let shape = sheet.shape(camera, &pose, at)?;
            let spread: DMat2 = shape * found.covariance * shape.transpose();
            let deviation = (0.5 * (spread.x_axis.x + spread.y_axis.y)).sqrt();
            let off = pixel.distance(meant);
            (deviation < LOOSE_PX).then_some(PlaneObservation { image, pixel, deviation, off })
        };
        let observations: Vec<PlaneObservation> = (0..frames.len()).filter_map(observation).collect();
        let shown = pictures.iter().flatten().filter(|p| window.shown_by(p, sheet.side)).count();
        (observations.len() >= FEWEST && observations.len() as f64 >= FOUND * shown as f64)
            .then_some(PlanePoint { position, observations })
    };
    Ok(windows.par_iter().filter_map(place).collect())
}
