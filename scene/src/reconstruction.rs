//! Cameras, posed images and points: what structure from motion yields and COLMAP's files hold.

mod outside;

use crate::{Camera, Pose};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A keypoint of a posed image and the point it sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Pixel.
    pub pixel: DVec2,
    /// Number of the point it observes.
    pub point: Option<u64>,
}

/// An image with a pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosedImage {
    /// COLMAP image number.
    pub id: u32,
    /// Number of its camera.
    pub camera: u32,
    /// File name, relative to the image folder.
    pub name: String,
    /// `cam_from_world`.
    pub pose: Pose,
    /// All keypoints of the image (COLMAP's `points2D`), in the order of its features.
    pub observations: Vec<Observation>,
}

/// One observation of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TrackElement {
    /// Image number.
    pub image: u32,
    /// Index into [`PosedImage::observations`].
    pub observation: u32,
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScenePoint {
    /// Position, world frame, scene units.
    pub position: DVec3,
    /// sRGB colour.
    pub rgb: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// At least two observations.
    pub track: Vec<TrackElement>,
}

/// A model: every number that another refers to exists (checked by [`Reconstruction::validate`]).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reconstruction {
    /// By camera number.
    pub cameras: BTreeMap<u32, Camera>,
    /// By image number; registered images only.
    pub images: BTreeMap<u32, PosedImage>,
    /// By point number.
    pub points: BTreeMap<u64, ScenePoint>,
}

impl Reconstruction {
    /// Checks that all references resolve both ways, tracks have two observations and numbers are
    /// finite; the message names the first thing that does not.
    pub fn validate(&self) -> Result<(), String> {
        for image in self.images.values() {
            if !self.cameras.contains_key(&image.camera) {
                return Err(format!(
                    "image {} refers to camera {}, which is missing",
                    image.name, image.camera
                ));
            }
            if !image.pose.is_finite() {
                return Err(format!("image {} has a pose that is not finite", image.name));
            }
            for (i, observation) in image.observations.iter().enumerate() {
                if let Some(id) = observation.point
                    && !self.points.contains_key(&id)
                {
                    return Err(format!(
                        "keypoint {i} of {} refers to point {id}, which is missing",
                        image.name
                    ));
                }
            }
        }
        for (id, point) in &self.points {
            if !point.position.is_finite() {
                return Err(format!("point {id} is not finite"));
            }
            if point.track.len() < 2 {
                return Err(format!(
                    "point {id} has {} observations; at least 2 are needed",
                    point.track.len()
                ));
            }
            for element in &point.track {
                let seen = self
                    .images
                    .get(&element.image)
                    .and_then(|image| image.observations.get(element.observation as usize));
                if seen.and_then(|o| o.point) != Some(*id) {
                    return Err(format!(
                        "point {id} and image {} disagree about keypoint {}",
                        element.image, element.observation
                    ));
                }
            }
        }
        Ok(())
    }

    /// Residual of one observation, pixels (`projection − measurement`); `None` behind the camera
    /// or unresolved.
    pub fn residual(&self, point: &ScenePoint, element: &TrackElement) -> Option<DVec2> {
        let image = self.images.get(&element.image)?;
        let camera = self.cameras.get(&image.camera)?;
        let observation = image.observations.get(element.observation as usize)?;
        Some(camera.project(image.pose.transform(point.position))? - observation.pixel)
    }

    /// Reprojection error of every observation, pixels.
    pub fn reprojection_errors(&self) -> Vec<f64> {
        let residuals = self.points.values().flat_map(|p| p.track.iter().filter_map(|e| self.residual(p, e)));
        residuals.map(|r| r.length()).collect()
    }

    /// Mean reprojection error, pixels; 0 without observations.
    pub fn mean_reprojection_error(&self) -> f64 {
        let errors = self.reprojection_errors();
        errors.iter().sum::<f64>() / errors.len().max(1) as f64
    }

    /// Reprojection errors by image number, pixels; images without an observation are left out.
    pub fn reprojection_errors_by_image(&self) -> BTreeMap<u32, Vec<f64>> {
        let mut errors: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
        for point in self.points.values() {
            for element in &point.track {
                if let Some(residual) = self.residual(point, element) {
                    errors.entry(element.image).or_default().push(residual.length());
                }
            }
        }
        errors
    }

    /// The number of an equal camera of the model, or of this one, added.
    pub(crate) fn share_camera(&mut self, camera: Camera) -> u32 {
        let equal = self.cameras.values().rev().find(|c| {
            (c.model, c.width, c.height) == (camera.model, camera.width, camera.height)
                && c.params == camera.params
        });
        if let Some(found) = equal {
            return found.id;
        }
        let id = camera.id;
        self.cameras.insert(id, camera);
        id
    }

    /// Image by file name.
    pub fn image_named(&self, name: &str) -> Option<&PosedImage> {
        self.images.values().find(|image| image.name == name)
    }
}
