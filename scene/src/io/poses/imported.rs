//! What the readers of poses share.

use crate::io::error::IoError;
use crate::io::load::image_info;
use crate::io::safe_name;
use crate::sim3::Sim3;
use crate::{Camera, CameraModel, Pose, PosedImage, Reconstruction};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Poses of a file, turned so that y is down where the format says what is up.
#[derive(Clone, Debug)]
pub struct ImportedPoses {
    /// Cameras and poses.
    pub model: Reconstruction,
    /// From the frame of the file into that of the model.
    pub world_from_file: Sim3,
    /// When images were taken, by their names, in any unit; empty where the file does not say.
    pub times: BTreeMap<String, f64>,
    /// Names of the images that are for evaluation alone.
    pub held_out: BTreeSet<String>,
}

impl ImportedPoses {
    /// Cameras and poses, of which neither times nor a split are known.
    pub(super) fn of(model: Reconstruction, world_from_file: Sim3) -> Self {
        Self { model, world_from_file, times: BTreeMap::new(), held_out: BTreeSet::new() }
    }
}

/// Adds an image; images with equal intrinsics share a camera. `cam_from_world` is of the model.
pub(super) fn add(
    path: &Path,
    model: &mut Reconstruction,
    name: &str,
    camera: Camera,
    pose: Pose,
) -> Result<(), IoError> {
    let name = name.replace('\\', "/");
    let name = safe_name(name.trim_start_matches("./")).map_err(IoError::name(path))?.to_owned();
    let size = [camera.width, camera.height];
    if !pose.is_finite() || camera.params.iter().any(|p| !p.is_finite()) {
        return Err(IoError::not_finite(path, format!("the camera of {name}")));
    }
    if camera.focal().min_element() <= 0.0 || size.iter().any(|s| !(1..=1_000_000).contains(s)) {
        let message = format!("{name}: expected a focal length and an image size above 0");
        return Err(IoError::format(path, message));
    }
    let camera = model.share_camera(Camera { id: model.cameras.len() as u32 + 1, ..camera });
    let id = model.images.len() as u32 + 1;
    model.images.insert(id, PosedImage { id, camera, name, pose, observations: Vec::new() });
    Ok(())
}

/// The camera with a distortion `k1, k2, p1, p2`, or PINHOLE where that is zero.
pub(super) fn brown([width, height]: [u32; 2], [fx, fy, cx, cy]: [f64; 4], distortion: [f64; 4]) -> Camera {
    let mut params = vec![fx, fy, cx, cy];
    let distorted = distortion.iter().any(|k| *k != 0.0);
    if distorted {
        params.extend(distortion);
    }
    let model = if distorted { CameraModel::Opencv } else { CameraModel::Pinhole };
    Camera { id: 1, model, width, height, params, has_prior_focal: true }
}

/// An error where distortion is given that no camera model of ours has.
pub(super) fn refuse_distortion(path: &Path, model: &str, coefficients: &[f64]) -> Result<(), IoError> {
    match coefficients.iter().all(|k| *k == 0.0) {
        true => Ok(()),
        false => Err(IoError::UnsupportedCamera { path: path.into(), model: model.to_owned() }),
    }
}

/// Size of an image that lies beside the file, in the folder of the images, or under its bare name
/// there.
pub(super) fn size_of(path: &Path, images: &Path, name: &str) -> Result<[u32; 2], IoError> {
    let plain = name.replace('\\', "/");
    let bare = plain.rsplit('/').next().unwrap_or(&plain);
    let beside = path.parent().unwrap_or(Path::new("."));
    let places = [beside.join(&plain), images.join(&plain), beside.join(bare), images.join(bare)];
    let Some(found) = places.iter().find(|p| p.is_file()) else {
        let message = format!("{name}: the image is needed for its size; put the images beside the file");
        return Err(IoError::format(path, message));
    };
    image_info(found).map(|i| [i.width, i.height])
}

/// Numbers separated by blanks.
pub(super) fn numbers(path: &Path, what: &str, text: &str) -> Result<Vec<f64>, IoError> {
    let parsed: Option<Vec<f64>> =
        text.split_whitespace().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
    parsed.ok_or_else(|| IoError::format(path, format!("{what}: expected finite numbers")))
}

/// A matrix written row by row as the nearest rotation; an error where it mirrors.
pub(super) fn rotation(path: &Path, name: &str, rows: &[f64]) -> Result<glam::DQuat, IoError> {
    let matrix = glam::DMat3::from_cols_slice(rows).transpose();
    if matrix.determinant() <= 0.0 {
        return Err(IoError::format(path, format!("{name}: expected a rotation (determinant above 0)")));
    }
    Ok(crate::sim3::nearest_rotation(matrix))
}

/// A rotation by 180° about x: y down and z forward instead of y up and z backward.
pub(super) const GL_FROM_CV: glam::DQuat = glam::DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);

/// A model with one camera at (1, 2, 3) of a world with z up, which looks along x; file by file.
#[cfg(test)]
pub(super) fn looks_along_x(model: &Reconstruction, world_from_file: &Sim3) {
    let image = model.images.values().next().expect("an image");
    let centre = world_from_file.inverse().transform(image.pose.centre());
    assert!(centre.abs_diff_eq(glam::DVec3::new(1.0, 2.0, 3.0), 1e-9), "{centre}");
    let file_from_camera = (image.pose.rotation * world_from_file.rotation).conjugate();
    let [right, ahead] = [glam::DVec3::X, glam::DVec3::Z].map(|d| file_from_camera * d);
    assert!(ahead.abs_diff_eq(glam::DVec3::X, 1e-9), "{ahead}");
    assert!(right.abs_diff_eq(glam::DVec3::NEG_Y, 1e-9), "z is up: {right}");
}
