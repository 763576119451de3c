//! COLMAP's binary model files (<https://colmap.github.io/format.html>), little-endian, no padding.

use super::bytes::ByteReader;
use super::error::{IoError, read_file};
use super::{safe_name, write_atomic};
use crate::{Camera, CameraModel, Observation, Pose, PosedImage, Reconstruction, ScenePoint, TrackElement};
use glam::{DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// The number of "no point". Source: COLMAP's format.html, binary format.
const NO_POINT: u64 = u64::MAX;
/// Least bytes of a camera, an image, an observation and a point. Source: COLMAP's format.html,
/// binary format.
const CAMERA_BYTES: usize = 4 + 4 + 8 + 8 + 3 * 8;
/// See [`CAMERA_BYTES`]. Source: COLMAP's format.html, binary format.
const IMAGE_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
/// See [`CAMERA_BYTES`]. Source: COLMAP's format.html, binary format.
const OBSERVATION_BYTES: usize = 8 + 8 + 8;
/// See [`CAMERA_BYTES`]. Source: COLMAP's format.html, binary format.
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;

const NAMES: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];

pub(super) fn read(dir: &Path) -> Result<Reconstruction, IoError> {
    let paths = NAMES.map(|name| dir.join(name));
    let [cameras, images] = [read_file(&paths[0])?, read_file(&paths[1])?];
    let points = paths[2].is_file().then(|| read_file(&paths[2])).transpose()?;
    parse(dir, [&cameras, &images], points.as_deref())
}

/// The model of its files' contents: cameras and images, points.
pub(super) fn parse(
    dir: &Path,
    [cameras, images]: [&[u8]; 2],
    points: Option<&[u8]>,
) -> Result<Reconstruction, IoError> {
    Ok(Reconstruction {
        cameras: parse_cameras(&dir.join(NAMES[0]), cameras)?,
        images: parse_images(&dir.join(NAMES[1]), images)?,
        points: points.map(|data| parse_points(&dir.join(NAMES[2]), data)).transpose()?.unwrap_or_default(),
    })
}

pub(super) fn parse_cameras(path: &Path, data: &[u8]) -> Result<BTreeMap<u32, Camera>, IoError> {
    let mut r = ByteReader::new(path, data);
    let mut cameras = BTreeMap::new();
    for _ in 0..r.count(CAMERA_BYTES, "cameras")? {
        let id = r.u32("a camera number")?;
        let number = r.i32("a camera model")?;
        let size = [r.u64("a camera width")?, r.u64("a camera height")?];
        let Some(model) = CameraModel::from_colmap_id(number) else {
            let model =
                UNSUPPORTED.iter().find(|m| m.0 == number).map_or(format!("number {number}"), |m| m.1.into());
            return Err(IoError::UnsupportedCamera { path: path.into(), model });
        };
        let params = (0..model.num_params()).map(|_| r.f64("camera parameters")).collect::<Result<_, _>>()?;
        let camera = check_camera(path, id, model, size, params)?;
        insert(path, "camera", &mut cameras, id, camera)?;
    }
    Ok(cameras)
}

/// COLMAP's other models, for the message. Source: COLMAP's cameras.html.
const UNSUPPORTED: [(i32, &str); 8] = [
    (5, "OPENCV_FISHEYE"),
    (6, "FULL_OPENCV"),
    (7, "FOV"),
    (8, "SIMPLE_RADIAL_FISHEYE"),
    (9, "RADIAL_FISHEYE"),
    (10, "THIN_PRISM_FISHEYE"),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE"),
    (12, "SIMPLE_DIVISION"),
];

/// A camera whose size and parameters make sense.
pub(super) fn check_camera(
    path: &Path,
    id: u32,
    model: CameraModel,
    [width, height]: [u64; 2],
    params: Vec<f64>,
) -> Result<Camera, IoError> {
    if params.len() != model.num_params() {
        let (needed, found) = (model.num_params(), params.len());
        return Err(IoError::format(
            path,
            format!("camera {id}: {} has {needed} parameters, found {found}", model.name()),
        ));
    }
    if params.iter().any(|p| !p.is_finite()) {
        return Err(IoError::not_finite(path, format!("a parameter of camera {id}")));
    }
    if params[..model.num_focals()].iter().any(|&f| f <= 0.0) {
        return Err(IoError::format(
            path,
            format!("camera {id}: expected a focal length above 0, found {}", params[0]),
        ));
    }
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width @ 1..=1_000_000), Ok(height @ 1..=1_000_000)) => {
            Ok(Camera { id, model, width, height, params, has_prior_focal: false })
        }
        _ => Err(IoError::format(
            path,
            format!("camera {id}: expected an image size, found {width} × {height}"),
        )),
    }
}

/// Lengths of quaternions that were written as unit quaternions, with few digits at worst.
/// Source: derived; four numbers with one digit after the point.
const UNIT_LENGTH: std::ops::RangeInclusive<f64> = 0.9..=1.1;

/// A pose whose numbers are finite; the quaternion (w, x, y, z) is normalised.
pub(super) fn check_pose(path: &Path, name: &str, v: &[f64; 7]) -> Result<Pose, IoError> {
    let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]).sqrt();
    if v.iter().any(|x| !x.is_finite()) || !norm.is_finite() {
        return Err(IoError::not_finite(path, format!("the pose of image {name}")));
    }
    if !UNIT_LENGTH.contains(&norm) {
        return Err(IoError::format(
            path,
            format!("the rotation of image {name} is a quaternion of length {norm:.3e}, not 1"),
        ));
    }
    let rotation = DQuat::from_xyzw(v[1] / norm, v[2] / norm, v[3] / norm, v[0] / norm);
    // A unit quaternion is kept bit for bit, so that writing and reading changes nothing.
    let rotation =
        if (norm - 1.0).abs() < 1e-15 { DQuat::from_xyzw(v[1], v[2], v[3], v[0]) } else { rotation };
    Ok(Pose { rotation, translation: DVec3::new(v[4], v[5], v[6]) })
}

pub(super) fn insert<K: Ord + std::fmt::Display + Copy, V>(
    path: &Path,
    what: &str,
    map: &mut BTreeMap<K, V>,
    id: K,
    value: V,
) -> Result<(), IoError> {
    match map.insert(id, value) {
        None => Ok(()),
        Some(_) => Err(IoError::format(path, format!("{what} {id} appears twice; the file is damaged"))),
    }
}

pub(super) fn parse_images(path: &Path, data: &[u8]) -> Result<BTreeMap<u32, PosedImage>, IoError> {
    let mut r = ByteReader::new(path, data);
    let mut images = BTreeMap::new();
    for _ in 0..r.count(IMAGE_BYTES, "images")? {
        let id = r.u32("an image number")?;
        let pose = r.f64s::<7>("a pose")?;
        let camera = r.u32("a camera number")?;
        let name = safe_name(r.c_string("an image name")?).map_err(IoError::name(path))?.to_string();
        let pose = check_pose(path, &name, &pose)?;
        let n = r.count(OBSERVATION_BYTES, "keypoints")?;
        let mut observations = Vec::with_capacity(n);
        for i in 0..n {
            let [x, y] = r.f64s("a keypoint")?;
            let point = r.u64("a point number")?;
            observations.push(check_observation(
                path,
                &name,
                i,
                DVec2::new(x, y),
                (point != NO_POINT).then_some(point),
            )?);
        }
        insert(path, "image", &mut images, id, PosedImage { id, camera, name, pose, observations })?;
    }
    Ok(images)
}

/// An observation; a position that is not a number is an error only where a point depends on it.
pub(super) fn check_observation(
    path: &Path,
    name: &str,
    i: usize,
    pixel: DVec2,
    point: Option<u64>,
) -> Result<Observation, IoError> {
    if pixel.is_finite() {
        return Ok(Observation { pixel, point });
    }
    Err(IoError::not_finite(path, format!("keypoint {i} of image {name}")))
}

pub(super) fn parse_points(path: &Path, data: &[u8]) -> Result<BTreeMap<u64, ScenePoint>, IoError> {
    let mut r = ByteReader::new(path, data);
    let mut points = BTreeMap::new();
    for _ in 0..r.count(POINT_BYTES, "points")? {
        let id = r.u64("a point number")?;
        let position = DVec3::from_array(r.f64s("a position")?);
        if !position.is_finite() {
            return Err(IoError::not_finite(path, format!("the position of point {id}")));
        }
        let rgb = [r.u8("a colour")?, r.u8("a colour")?, r.u8("a colour")?];
        let error_px = r.f64("an error")?;
        let n = r.count(8, "observations of a point")?;
        let mut track = Vec::with_capacity(n);
        for _ in 0..n {
            track.push(TrackElement {
                image: r.u32("an observation")?,
                observation: r.u32("an observation")?,
            });
        }
        insert(path, "point", &mut points, id, ScenePoint { position, rgb, error_px, track })?;
    }
    Ok(points)
}

pub(super) fn write(model: &Reconstruction, dir: &Path) -> Result<(), IoError> {
    write_atomic(&dir.join("cameras.bin"), |w| write_cameras(model, w))?;
    write_atomic(&dir.join("images.bin"), |w| write_images(model, w))?;
    write_atomic(&dir.join("points3D.bin"), |w| write_points(model, w))
}

fn write_cameras(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    w.write_all(&(model.cameras.len() as u64).to_le_bytes())?;
    for (id, camera) in &model.cameras {
        w.write_all(&id.to_le_bytes())?;
        w.write_all(&camera.model.colmap_id().to_le_bytes())?;
        w.write_all(&u64::from(camera.width).to_le_bytes())?;
        w.write_all(&u64::from(camera.height).to_le_bytes())?;
        camera.params.iter().try_for_each(|p| w.write_all(&p.to_le_bytes()))?;
    }
    Ok(())
}

fn write_images(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    w.write_all(&(model.images.len() as u64).to_le_bytes())?;
    for (id, image) in &model.images {
        w.write_all(&id.to_le_bytes())?;
        let (q, t) = (image.pose.rotation, image.pose.translation);
        [q.w, q.x, q.y, q.z, t.x, t.y, t.z].iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
        w.write_all(&image.camera.to_le_bytes())?;
        w.write_all(image.name.as_bytes())?;
        w.write_all(&[0])?;
        w.write_all(&(image.observations.len() as u64).to_le_bytes())?;
        for observation in &image.observations {
            w.write_all(&observation.pixel.x.to_le_bytes())?;
            w.write_all(&observation.pixel.y.to_le_bytes())?;
            w.write_all(&observation.point.unwrap_or(NO_POINT).to_le_bytes())?;
        }
    }
    Ok(())
}

fn write_points(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    w.write_all(&(model.points.len() as u64).to_le_bytes())?;
    for (id, point) in &model.points {
        w.write_all(&id.to_le_bytes())?;
        point.position.to_array().iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
        w.write_all(&point.rgb)?;
        w.write_all(&point.error_px.to_le_bytes())?;
        w.write_all(&(point.track.len() as u64).to_le_bytes())?;
        for element in &point.track {
            w.write_all(&element.image.to_le_bytes())?;
            w.write_all(&element.observation.to_le_bytes())?;
        }
    }
    Ok(())
}
