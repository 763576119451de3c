//! Observations of a supporting plane. An object in the dark, or of glitter, leaves few points to
//! hold a camera by, but the table or the floor it stands on is seen by all cameras, and where it
//! is a plane a model that is nearly right says how each sees it: from straight above it looks the
//! same in all, but for noise and for what poses are off by. What most of them show (the median)
//! has little noise; where its windows lie in one image tells that image's errors, over pixels that
//! no detector would find a point in (docs/decisions/11).

pub(crate) mod plane;
mod sheet;
#[cfg(test)]
pub(crate) mod tests;
mod window;

use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::klt::pyramid::Pyramid;
use crate::limits::FEWEST_VIEWS;
use crate::sift::load_luma;
use glam::{DMat2, DVec2, DVec3};
use plane::ScenePlane;
use rayon::prelude::*;
use scene::{Camera, FrameSet, Pose, Progress};
use sheet::{Sheet, SheetPicture};
use window::{HALF, PlaneWindow};

/// Images are halved so often at most.
/// Source: chosen by hand, never measured.
const LEVELS: usize = 5;
/// Observations known less exactly than this are left out, pixels.
/// Source: chosen by hand, never measured.
const LOOSE_PX: f64 = 0.75;

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
    /// Standard deviation of a coordinate for independent noise of its squares, pixels.
    pub deviation: f64,
    /// How far it is from where the model has it, pixels.
    pub off: f64,
}

/// What is looked for windows in: registered images of a model.
struct PlaneViews<'a> {
    state: &'a MapState,
    input: &'a MappingInput<'a>,
    sheet: Sheet,
    /// By image, where it is registered.
    pictures: Vec<Option<SheetPicture>>,
}

/// Looks for windows of a plane in all registered images, up to `farthest` squares (about a pixel
/// each) from where the model has them. `rotated`: images that `input` shows rotated by 180°.
pub(crate) fn find_plane_tracks(
    plane: ScenePlane,
    (state, input): (&MapState, &MappingInput<'_>),
    (frames, rotated): (&FrameSet, &[bool]),
    farthest: usize,
    progress: &Progress,
) -> Result<Vec<PlanePoint>, SfmError> {
    let seen_by = (0..frames.len()).filter_map(|image| view(state, input, image));
    let Some(sheet) = Sheet::new(plane, seen_by) else { return Ok(Vec::new()) };
    progress.begin("plane tracks", frames.len());
    let pictures: Vec<Option<SheetPicture>> = (0..frames.len())
        .into_par_iter()
        .with_max_len(1)
        .map(|image| {
            progress.tick()?;
            let Some((camera, pose)) = view(state, input, image) else { return Ok(None) };
            let mut grey = load_luma(&frames.frames[image])?;
            if rotated[image] {
                grey.data.reverse();
            }
            Ok(Some(sheet.seen_by(camera, &pose, &Pyramid::new(&grey, LEVELS))))
        })
        .collect::<Result<_, SfmError>>()?;
    let common = sheet.common(&pictures);
    let views = PlaneViews { state, input, sheet, pictures };
    let middles: Vec<usize> = (0..sheet.side / (2 * HALF)).map(|i| HALF + 1 + 2 * HALF * i).collect();
    let windows: Vec<PlaneWindow> = middles
        .iter()
        .flat_map(|y| middles.iter().map(move |x| [*x, *y]))
        .filter_map(|m| PlaneWindow::of(&common, sheet.side, m))
        .collect();
    Ok(windows.par_iter().filter_map(|window| views.point(window, farthest)).collect())
}

/// Camera and pose of a registered image.
fn view<'a>(state: &'a MapState, input: &MappingInput<'_>, image: usize) -> Option<(&'a Camera, Pose)> {
    Some((&state.cameras[input.camera_of[image]], state.poses[image]?))
}

impl PlaneViews<'_> {
    /// A window's place with its observations. What only a minority of the images that show it has
    /// where it is meant to be is not of the plane, or of noise.
    fn point(&self, window: &PlaneWindow, farthest: usize) -> Option<PlanePoint> {
        let images = 0..self.pictures.len();
        let observations: Vec<PlaneObservation> =
            images.filter_map(|image| self.observation(window, image, farthest)).collect();
        let pictures = self.pictures.iter().flatten();
        let shown = pictures.filter(|p| window.shown_by(p, self.sheet.side)).count();
        let position = self.sheet.place(window.centre());
        (observations.len() >= FEWEST_VIEWS && 2 * observations.len() >= shown)
            .then_some(PlanePoint { position, observations })
    }

    fn observation(&self, window: &PlaneWindow, image: usize, farthest: usize) -> Option<PlaneObservation> {
        let (sheet, at) = (&self.sheet, window.centre());
        let found = window.find(self.pictures[image].as_ref()?, sheet.side, farthest)?;
        let (camera, pose) = view(self.state, self.input, image)?;
        let pixel = camera.project(pose.transform(sheet.place(at + found.by)))?;
        let meant = camera.project(pose.transform(sheet.place(at)))?;
        let shape = sheet.shape(camera, &pose, at)?;
        let spread: DMat2 = shape * found.covariance * shape.transpose();
        let deviation = (0.5 * (spread.x_axis.x + spread.y_axis.y)).sqrt();
        let off = pixel.distance(meant);
        (deviation < LOOSE_PX).then_some(PlaneObservation { image, pixel, deviation, off })
    }
}
