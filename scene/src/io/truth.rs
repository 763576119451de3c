//! Ground truth in the formats of the benchmarks.

use super::error::{IoError, read_text};
use super::{has_model, read_model, read_transforms, safe_name};
use crate::sim3::nearest_rotation;
use crate::{Camera, CameraModel, Pose, PosedImage, Reconstruction};
use glam::{DMat3, DVec3};
use std::path::Path;

/// Reads true cameras, whatever form they have: a COLMAP model folder, a folder of Strecha
/// `*.camera` files, `transforms.json`, or a Middlebury `*_par.txt`.
pub fn read_truth(path: &Path) -> Result<Reconstruction, IoError> {
    if path.is_dir() {
        if !has_model(path) && !camera_files(path)?.is_empty() {
            return read_strecha(path);
        }
        return read_model(path);
    }
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        return Ok(read_transforms(path)?.reconstruction);
    }
    read_middlebury(path)
}

/// Middlebury multi-view: a line with the number of images, then `name k11 … k33 r11 … r33 t1 t2
/// t3` with `x ~ K [R | t] X`, row by row (Seitz et al. 2006). The image size is not in the file
/// and stays 0.
pub fn read_middlebury(path: &Path) -> Result<Reconstruction, IoError> {
    parse_middlebury(path, &read_text(path)?)
}

/// The same, of the file's content. `path` names the file in messages.
pub fn parse_middlebury(path: &Path, text: &str) -> Result<Reconstruction, IoError> {
    let mut model = Reconstruction::default();
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let Some(name) = words.next() else { continue };
        let rest: Vec<&str> = words.collect();
        if number == 0 && rest.is_empty() {
            continue; // the number of images; what counts is the lines
        }
        let v = numbers(path, &rest)?;
        if v.len() != 21 {
            let message = format!("line {}: expected a name and 21 numbers, found {}", number + 1, v.len());
            return Err(IoError::format(path, message));
        }
        let rotation = nearest_rotation(matrix(&v[9..18]));
        let pose = Pose::new(rotation, DVec3::from_slice(&v[18..21]));
        add(path, &mut model, name, &v[..9], [0, 0], pose)?;
    }
    Ok(model)
}

/// Strecha et al. 2008: one `IMAGE.camera` an image: K, a line of zeros, R (camera to world), the
/// centre, the image size.
pub fn read_strecha(dir: &Path) -> Result<Reconstruction, IoError> {
    let mut model = Reconstruction::default();
    for name in camera_files(dir)? {
        let path = dir.join(&name);
        let text = read_text(&path)?;
        let v = numbers(&path, &text.split_whitespace().collect::<Vec<_>>())?;
        if v.len() < 26 {
            return Err(IoError::format(&path, format!("expected 26 numbers, found {}", v.len())));
        }
        let world_from_cam = nearest_rotation(matrix(&v[12..21]));
        let pose = Pose::from_centre(world_from_cam.conjugate(), DVec3::from_slice(&v[21..24]));
        let size = [v[24], v[25]].map(|s| s.clamp(0.0, 1e6) as u32);
        add(&path, &mut model, name.trim_end_matches(".camera"), &v[..9], size, pose)?;
    }
    Ok(model)
}

fn camera_files(dir: &Path) -> Result<Vec<String>, IoError> {
    let entries = std::fs::read_dir(dir).map_err(IoError::file("list", dir))?;
    let names = entries.filter_map(|e| e.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|n| n.ends_with(".camera")).collect();
    names.sort();
    Ok(names)
}

fn numbers(path: &Path, words: &[&str]) -> Result<Vec<f64>, IoError> {
    let parsed = words.iter().map(|w| {
        let value: Option<f64> = w.parse().ok();
        value.filter(|v| v.is_finite()).ok_or_else(|| {
            let found: String = w.chars().take(40).collect();
            IoError::format(path, format!("expected a finite number, found {found:?}"))
        })
    });
    parsed.collect()
}

/// A matrix written row by row.
fn matrix(v: &[f64]) -> DMat3 {
    DMat3::from_cols_slice(v).transpose()
}

/// Adds an image; images with equal intrinsics share a camera. Skew is left out.
fn add(
    path: &Path,
    model: &mut Reconstruction,
    name: &str,
    k: &[f64],
    [width, height]: [u32; 2],
    pose: Pose,
) -> Result<(), IoError> {
    let name = safe_name(name).map_err(IoError::name(path))?.to_string();
    let params = vec![k[0], k[4], k[2], k[5]];
    if params[0] <= 0.0 || params[1] <= 0.0 {
        return Err(IoError::format(
            path,
            format!("{name}: expected a focal length above 0, found {}", params[0]),
        ));
    }
    let next = model.cameras.len() as u32 + 1;
    let camera =
        Camera { id: next, model: CameraModel::Pinhole, width, height, params, has_prior_focal: true };
    let camera = model.share_camera(camera);
    let id = model.images.len() as u32 + 1;
    model.images.insert(id, PosedImage { id, camera, name, pose, observations: Vec::new() });
    Ok(())
}
