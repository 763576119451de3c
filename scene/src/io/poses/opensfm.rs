//! OpenSfM's `reconstruction.json` (also of OpenDroneMap). The world has z up; camera axes are x
//! right, y down, z forward; lengths in the image are in units of its longer side.

use super::imported::{ImportedPoses, add, brown, refuse_distortion};
use crate::io::error::{IoError, read_text};
use crate::io::transforms::WORLD_FROM_TRANSFORMS;
use crate::{Camera, Pose, Reconstruction};
use glam::{DQuat, DVec3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Deserialize)]
struct SolvedPart {
    cameras: BTreeMap<String, Lens>,
    shots: BTreeMap<String, Shot>,
}

#[derive(Deserialize)]
struct Lens {
    projection_type: String,
    width: u32,
    height: u32,
    focal: Option<f64>,
    focal_x: Option<f64>,
    focal_y: Option<f64>,
    #[serde(default)]
    c_x: f64,
    #[serde(default)]
    c_y: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
}

#[derive(Deserialize)]
struct Shot {
    camera: String,
    /// Axis times angle, radians.
    rotation: [f64; 3],
    translation: [f64; 3],
}

/// Whether a `.json` is a list of reconstructions, and no `transforms.json`.
pub(super) fn is_reconstruction(path: &Path) -> Result<bool, IoError> {
    Ok(read_text(path)?.trim_start().starts_with('['))
}

/// The reconstruction with the most images.
pub(super) fn read(path: &Path) -> Result<ImportedPoses, IoError> {
    parse(path, &read_text(path)?)
}

/// Parses the content of OpenSfM's `reconstruction.json`. `path` names the file in messages.
pub fn parse(path: &Path, text: &str) -> Result<ImportedPoses, IoError> {
    let entries: Vec<SolvedPart> = serde_json::from_str(text)
        .map_err(|e| IoError::format(path, format!("expected OpenSfM's reconstructions: {e}")))?;
    let mut model = Reconstruction::default();
    let largest = entries.into_iter().max_by_key(|e| e.shots.len());
    let Some(entry) = largest else { return Err(IoError::format(path, "expected a reconstruction")) };
    for (name, shot) in &entry.shots {
        let Some(lens) = entry.cameras.get(&shot.camera) else {
            return Err(IoError::format(path, format!("{name}: its camera {} is missing", shot.camera)));
        };
        let rotation = DQuat::from_scaled_axis(DVec3::from_array(shot.rotation));
        let pose = Pose::new(rotation, DVec3::from_array(shot.translation));
        add(path, &mut model, name, camera(path, lens)?, WORLD_FROM_TRANSFORMS.transform_pose(&pose))?;
    }
    Ok(ImportedPoses::of(model, WORLD_FROM_TRANSFORMS))
}

fn camera(path: &Path, lens: &Lens) -> Result<Camera, IoError> {
    let known = ["perspective", "brown"].contains(&lens.projection_type.as_str());
    if !known {
        return Err(IoError::UnsupportedCamera { path: path.into(), model: lens.projection_type.clone() });
    }
    refuse_distortion(path, "brown with k3", &[lens.k3])?;
    let (w, h) = (f64::from(lens.width), f64::from(lens.height));
    let side = w.max(h);
    let [fx, fy] = [lens.focal_x, lens.focal_y].map(|f| f.or(lens.focal).unwrap_or(0.0) * side);
    let intrinsics = [fx, fy, w / 2.0 + lens.c_x * side, h / 2.0 + lens.c_y * side];
    Ok(brown([lens.width, lens.height], intrinsics, [lens.k1, lens.k2, lens.p1, lens.p2]))
}

#[cfg(test)]
mod tests {
    use super::super::imported::looks_along_x;
    use super::super::read_poses;
    use crate::io::test_folder;

    #[test]
    fn lengths_are_in_units_of_the_longer_side_and_z_is_up() {
        let dir = test_folder("opensfm");
        let path = dir.join("reconstruction.json");
        // World x ahead, −y right, −z down: the rotation by 120° about (1, −1, 1) / √3.
        let angle = 2.0 * std::f64::consts::PI / 3.0 / 3.0_f64.sqrt();
        let turn = format!("[{angle},{},{angle}]", -angle);
        let text = format!(
            r#"[{{"cameras":{{}},"shots":{{}},"points":{{}}}},
            {{"cameras":{{"c":{{"projection_type":"perspective","width":200,"height":100,
              "focal":0.75,"k1":0.1,"k2":0.0}}}},
            "shots":{{"a.jpg":{{"camera":"c","rotation":{turn},"translation":[2,3,-1]}}}},"points":{{}}}}]"#
        );
        std::fs::write(&path, &text).unwrap();
        let found = read_poses(&path, &dir).unwrap();
        looks_along_x(&found.model, &found.world_from_file);
        assert_eq!(found.model.cameras[&1].params, [150.0, 150.0, 100.0, 50.0, 0.1, 0.0, 0.0, 0.0]);
        std::fs::write(&path, text.replace("perspective", "spherical")).unwrap();
        assert!(read_poses(&path, &dir).unwrap_err().to_string().contains("spherical"));
    }
}
