//! `transforms.json` as NeRF's Blender scenes, instant-ngp and nerfstudio write it.
//!
//! Poses there are camera-to-world with OpenGL axes (x right, y up, looking along −z), in a world
//! with z up: it is turned on the way, as nerfstudio turns COLMAP's models.

use super::error::{IoError, read_text};
use super::load::image_info;
use super::{safe_name, write_atomic};
use crate::sim3::{Sim3, nearest_rotation};
use crate::{Camera, CameraModel, Pose, PosedImage, Reconstruction};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_1_SQRT_2;
use std::io::Write;
use std::path::{Path, PathBuf};

/// One frame of a [`TransformsFile`].
#[derive(Clone, Debug, PartialEq)]
pub struct TransformsFrame {
    /// Image number in the reconstruction.
    pub image: u32,
    /// File of the image, relative to the folder of the JSON file (with its extension, if the file
    /// was found).
    pub file_path: String,
    /// Whether that file is there.
    pub found: bool,
    /// File of the mask, likewise.
    pub mask_path: Option<String>,
    /// Time, as dynamic scenes give it.
    pub time: Option<f64>,
}

/// What a `transforms.json` holds.
#[derive(Clone, Debug, Default)]
pub struct TransformsFile {
    /// Cameras and poses; no points. Image names are the frames' `file_path`.
    pub reconstruction: Reconstruction,
    /// In the order of the file; image numbers count from 1.
    pub frames: Vec<TransformsFrame>,
    /// `ply_file_path`: a point cloud to start from, relative to the folder of the JSON file.
    pub ply_file_path: Option<String>,
    /// `file_path` of the frames that are for evaluation alone.
    pub held_out: BTreeSet<String>,
}

/// Intrinsics, at the top of the file or in a frame.
#[derive(Clone, Debug, Default, Deserialize)]
struct Intrinsics {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

#[derive(Deserialize)]
struct FrameEntry {
    file_path: String,
    mask_path: Option<String>,
    time: Option<f64>,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

#[derive(Deserialize)]
struct Document {
    frames: Vec<FrameEntry>,
    ply_file_path: Option<String>,
    #[serde(default)]
    test_filenames: Vec<String>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

/// Names of the files in which the Blender scenes of NeRF and D-NeRF come: what is trained on, and
/// what is held out. (`transforms_val.json`, for choosing settings, is in neither.)
pub(super) const SPLIT: [&str; 2] = ["transforms_train.json", "transforms_test.json"];

/// Reads a `transforms.json`, or a `transforms_train.json` with the `transforms_test.json` beside
/// it. A frame's own intrinsics go before those at the top. Sizes that are not given are taken from
/// the image files, whose names may lack their extension. Frames with equal intrinsics share a
/// camera.
pub fn read_transforms(path: &Path) -> Result<TransformsFile, IoError> {
    let mut file = TransformsFile::default();
    file.append(path)?;
    let test = path.with_file_name(SPLIT[1]);
    if path.file_name().is_some_and(|name| name == SPLIT[0]) && test.is_file() {
        let training = file.frames.len();
        file.append(&test)?;
        file.held_out = file.frames[training..].iter().map(|f| f.file_path.clone()).collect();
    }
    let mut names: Vec<&str> = file.frames.iter().map(|f| f.file_path.as_str()).collect();
    names.sort_unstable();
    match names.windows(2).find(|w| w[0] == w[1]) {
        Some(twice) => Err(IoError::format(path, format!("two frames have the file_path {:?}", twice[0]))),
        None => Ok(file),
    }
}

impl TransformsFile {
    /// The frames of one more file.
    fn append(&mut self, path: &Path) -> Result<(), IoError> {
        let text = read_text(path)?;
        let document: Document = serde_json::from_str(&text)
            .map_err(|e| IoError::format(path, format!("expected a transforms.json with frames: {e}")))?;
        if document.frames.is_empty() {
            return Err(IoError::format(path, "expected frames, found none"));
        }
        let folder = path.parent().unwrap_or(Path::new("."));
        let clean = |name: &str| {
            safe_name(name.trim_start_matches("./")).map(String::from).map_err(IoError::name(path))
        };
        self.ply_file_path = document.ply_file_path.as_deref().map(clean).transpose()?;
        for name in &document.test_filenames {
            self.held_out.insert(locate(folder, clean(name)?).0);
        }
        for entry in &document.frames {
            let (file_path, on_disk) = locate(folder, clean(&entry.file_path)?);
            let pose = pose_of(path, entry)?;
            let camera =
                camera_of(path, &document.intrinsics, &entry.intrinsics, on_disk.as_deref(), &file_path)?;
            let model = &mut self.reconstruction;
            let id = model.images.len() as u32 + 1;
            let camera = model.share_camera(Camera { id: model.cameras.len() as u32 + 1, ..camera });
            model.images.insert(
                id,
                PosedImage { id, camera, name: file_path.clone(), pose, observations: Vec::new() },
            );
            let mask_path = entry.mask_path.as_deref().map(clean).transpose()?;
            self.frames.push(TransformsFrame {
                image: id,
                file_path,
                found: on_disk.is_some(),
                mask_path,
                time: entry.time,
            });
        }
        Ok(())
    }
}

/// The name with the extension of the file that is there, and where it lies.
fn locate(folder: &Path, name: String) -> (String, Option<PathBuf>) {
    let extensions = ["", ".png", ".jpg", ".jpeg", ".PNG", ".JPG"];
    let found = extensions.iter().map(|e| format!("{name}{e}")).find(|n| folder.join(n).is_file());
    match found {
        Some(found) => {
            let on_disk = folder.join(&found);
            (found, Some(on_disk))
        }
        None => (name, None),
    }
}

/// Largest difference of a number in a transform_matrix from the nearest rotation's.
/// Source: derived; numbers with one digit after the point.
const SKEW: f64 = 0.05;

/// `cam_from_world` of a camera-to-world matrix with OpenGL axes; a uniform scale in it is taken
/// out.
fn pose_of(path: &Path, entry: &FrameEntry) -> Result<Pose, IoError> {
    let m = &entry.transform_matrix;
    if !(3..=4).contains(&m.len()) || m.iter().any(|row| row.len() != 4) {
        return Err(IoError::format(path, format!("{}: expected a 4×4 transform_matrix", entry.file_path)));
    }
    let [x, y, z, centre] = [0, 1, 2, 3].map(|c| DVec3::new(m[0][c], m[1][c], m[2][c]));
    let world_from_gl = DMat3::from_cols(x, y, z);
    if !world_from_gl.is_finite() || !centre.is_finite() {
        return Err(IoError::not_finite(path, format!("the transform_matrix of {}", entry.file_path)));
    }
    if world_from_gl.determinant() <= 0.0 {
        let message = format!(
            "{}: the transform_matrix is no rotation (its determinant is not above 0)",
            entry.file_path
        );
        return Err(IoError::format(path, message));
    }
    let rotation = nearest_rotation(world_from_gl);
    let scale = world_from_gl.determinant().cbrt();
    let skew = world_from_gl * scale.recip() - DMat3::from_quat(rotation);
    if skew.to_cols_array().iter().any(|v| v.abs() > SKEW) {
        let message = format!("{}: the transform_matrix is no rotation (it shears)", entry.file_path);
        return Err(IoError::format(path, message));
    }
    let file_from_cam = rotation * GL_FROM_CV;
    let cam_from_file = Pose::from_centre(file_from_cam.conjugate(), centre);
    Ok(WORLD_FROM_TRANSFORMS.transform_pose(&cam_from_file))
}

/// A rotation by 180° about x: y down and z forward instead of y up and z backward.
const GL_FROM_CV: DQuat = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);

/// From the world of a `transforms.json`, where z is up, into ours, where y is down: a quarter turn
/// about x.
pub const WORLD_FROM_TRANSFORMS: Sim3 = Sim3 {
    scale: 1.0,
    rotation: DQuat::from_xyzw(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2),
    translation: DVec3::ZERO,
};

/// Focal length, pixels, of an angle of view (radians) over so many pixels.
fn focal_from_angle(angle: f64, size: f64) -> f64 {
    size / 2.0 / (angle / 2.0).tan()
}

fn camera_of(
    path: &Path,
    top: &Intrinsics,
    own: &Intrinsics,
    on_disk: Option<&Path>,
    name: &str,
) -> Result<Camera, IoError> {
    let either = |get: fn(&Intrinsics) -> Option<f64>| get(own).or_else(|| get(top));
    let model = own.camera_model.as_ref().or(top.camera_model.as_ref());
    let fisheye = own.is_fisheye.or(top.is_fisheye).unwrap_or(false);
    let known = model.is_none_or(|m| {
        ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"].contains(&m.as_str())
    });
    if fisheye || !known {
        let model = model.map_or("fisheye".into(), |m| m.chars().take(40).collect());
        return Err(IoError::UnsupportedCamera { path: path.into(), model });
    }
    if [either(|i| i.k3), either(|i| i.k4)].iter().any(|k| k.is_some_and(|k| k != 0.0)) {
        return Err(IoError::UnsupportedCamera { path: path.into(), model: "OPENCV with k3 or k4".into() });
    }
    let (width, height) = match (either(|i| i.w), either(|i| i.h), on_disk) {
        (Some(w), Some(h), _) => (w, h),
        (_, _, Some(file)) => image_info(file).map(|i| (f64::from(i.width), f64::from(i.height)))?,
        _ => {
            return Err(IoError::format(
                path,
                format!("{name}: neither w and h nor the image file are there"),
            ));
        }
    };
    if ![width, height].iter().all(|s| (1.0..=1e6).contains(s)) {
        return Err(IoError::format(
            path,
            format!("{name}: expected an image size, found {width} × {height}"),
        ));
    }
    let fx = either(|i| i.fl_x).or_else(|| Some(focal_from_angle(either(|i| i.camera_angle_x)?, width)));
    let fy = either(|i| i.fl_y).or_else(|| Some(focal_from_angle(either(|i| i.camera_angle_y)?, height)));
    let (Some(fx), Some(fy)) = (fx.or(fy), fy.or(fx)) else {
        return Err(IoError::format(path, format!("{name}: neither fl_x nor camera_angle_x is given")));
    };
    let centre = [either(|i| i.cx).unwrap_or(width / 2.0), either(|i| i.cy).unwrap_or(height / 2.0)];
    let distortion =
        [either(|i| i.k1), either(|i| i.k2), either(|i| i.p1), either(|i| i.p2)].map(|k| k.unwrap_or(0.0));
    let mut params = vec![fx, fy, centre[0], centre[1]];
    let distorted = distortion.iter().any(|&k| k != 0.0);
    if distorted {
        params.extend(distortion);
    }
    if params.iter().any(|p| !p.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(IoError::format(
            path,
            format!("{name}: expected finite intrinsics with a focal length above 0"),
        ));
    }
    let model = if distorted { CameraModel::Opencv } else { CameraModel::Pinhole };
    Ok(Camera { id: 1, model, width: width as u32, height: height as u32, params, has_prior_focal: true })
}

/// What goes into a written file besides cameras and poses.
#[derive(Clone, Debug, Default)]
pub struct TransformsOptions {
    /// Put before every image name, for instance "images".
    pub image_folder: String,
    /// Mask file by image number, relative to the folder of the JSON file.
    pub masks: BTreeMap<u32, String>,
    /// A point cloud to start from, relative to the folder of the JSON file.
    pub ply_file_path: Option<String>,
    /// Times by image number, seconds: written as they are, and as shares of the whole, as dynamic
    /// scenes have them.
    pub times_s: BTreeMap<u32, f64>,
    /// Numbers of the images that are not to be trained on; nerfstudio splits by itself where there
    /// are none.
    pub held_out: BTreeSet<u32>,
}

impl TransformsOptions {
    /// The time of an image: seconds, and its share of the time from the first image to the last.
    fn time(&self, image: u32) -> Option<[f64; 2]> {
        let time = *self.times_s.get(&image)?;
        let first = self.times_s.values().copied().fold(f64::INFINITY, f64::min);
        let last = self.times_s.values().copied().fold(f64::NEG_INFINITY, f64::max);
        let share = if last > first { (time - first) / (last - first) } else { 0.0 };
        Some([time, share])
    }
}

/// Writes nerfstudio's dialect (`camera_model` OPENCV): intrinsics at the top if all images share a
/// camera, else in each frame.
pub fn write_transforms(
    path: &Path,
    model: &Reconstruction,
    options: &TransformsOptions,
) -> Result<(), IoError> {
    model.validate().map_err(|m| {
        IoError::format(path, format!("refused to write a model that contradicts itself: {m}"))
    })?;
    let mut document = Map::new();
    let mut used: Vec<u32> = model.images.values().map(|i| i.camera).collect();
    used.dedup();
    let shared = match used[..] {
        [only] => model.cameras.get(&only),
        _ => None,
    };
    document.insert("camera_model".into(), json!("OPENCV"));
    if let Some(camera) = shared {
        document.extend(intrinsics_of(camera));
    }
    let mut frames = Vec::new();
    let [mut training, mut held_out] = [Vec::new(), Vec::new()];
    for (id, image) in &model.images {
        let mut frame = Map::new();
        let separator = if options.image_folder.is_empty() { "" } else { "/" };
        let file_path = format!("{}{separator}{}", options.image_folder, image.name);
        safe_name(&file_path).map_err(IoError::name(path))?;
        frame.insert("file_path".into(), json!(file_path));
        if options.held_out.contains(id) { &mut held_out } else { &mut training }.push(file_path);
        if let Some([seconds, share]) = options.time(*id) {
            frame.insert("time".into(), json!(share));
            frame.insert("time_s".into(), json!(seconds));
        }
        if let Some(mask) = options.masks.get(id) {
            frame.insert("mask_path".into(), json!(mask));
        }
        if let (None, Some(camera)) = (shared, model.cameras.get(&image.camera)) {
            frame.extend(intrinsics_of(camera));
        }
        let pose = WORLD_FROM_TRANSFORMS.inverse().transform_pose(&image.pose);
        frame.insert("transform_matrix".into(), matrix_of(&pose));
        frames.push(Value::Object(frame));
    }
    document.insert("frames".into(), Value::Array(frames));
    if !held_out.is_empty() && !training.is_empty() {
        document.insert("train_filenames".into(), json!(training));
        document.insert("val_filenames".into(), json!(held_out));
        document.insert("test_filenames".into(), json!(held_out));
    }
    if let Some(ply) = &options.ply_file_path {
        document.insert("ply_file_path".into(), json!(ply));
    }
    write_atomic(path, |w| {
        serde_json::to_writer_pretty(&mut *w, &document)?;
        writeln!(w)
    })
}

fn intrinsics_of(camera: &Camera) -> Map<String, Value> {
    let (focal, centre) = (camera.focal(), camera.principal_point());
    let distortion = [0, 1, 2, 3].map(|i| camera.distortion().get(i).copied().unwrap_or(0.0));
    let entries = [
        ("w", json!(camera.width)),
        ("h", json!(camera.height)),
        ("fl_x", json!(focal.x)),
        ("fl_y", json!(focal.y)),
        ("cx", json!(centre.x)),
        ("cy", json!(centre.y)),
        ("k1", json!(distortion[0])),
        ("k2", json!(distortion[1])),
        ("p1", json!(distortion[2])),
        ("p2", json!(distortion[3])),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

fn matrix_of(pose: &Pose) -> Value {
    let file_from_gl = DMat3::from_quat(pose.rotation.conjugate() * GL_FROM_CV.conjugate());
    let centre = pose.centre();
    let rows = [0, 1, 2].map(|r| file_from_gl.row(r).extend(centre[r]).to_array());
    json!([rows[0], rows[1], rows[2], [0.0, 0.0, 0.0, 1.0]])
}
