//! Folders of Nerfies and HyperNeRF (Park et al. 2021): `dataset.json` with the images and what is
//! held out, `metadata.json` with their times, `camera/NAME.json`, and images in `rgb/1x`, `rgb/2x`
//! and so on. Camera axes are x right, y down, z forward; nothing says what is up.

use super::imported::{ImportedPoses, add, brown, refuse_distortion, rotation};
use crate::io::error::{IoError, read_text};
use crate::io::safe_name;
use crate::sim3::Sim3;
use crate::{Camera, Pose, Reconstruction};
use glam::DVec3;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::Path;

/// The file by which such a folder is known.
pub(super) const DATASET: &str = "dataset.json";

#[derive(Deserialize)]
struct Listed {
    ids: Vec<String>,
    #[serde(default)]
    val_ids: Vec<String>,
}

/// What is known of an image; programs name its number in time differently.
#[derive(Deserialize)]
struct Moment {
    time_id: Option<f64>,
    warp_id: Option<f64>,
}

#[derive(Deserialize)]
struct Filmed {
    /// Camera from world, by rows.
    orientation: [[f64; 3]; 3],
    /// Centre of the camera.
    position: [f64; 3],
    focal_length: f64,
    principal_point: [f64; 2],
    #[serde(default)]
    skew: f64,
    pixel_aspect_ratio: Option<f64>,
    #[serde(default)]
    radial_distortion: Vec<f64>,
    #[serde(default)]
    tangential_distortion: Vec<f64>,
    image_size: [u32; 2],
}

fn read_json<T: DeserializeOwned>(path: &Path, what: &str) -> Result<T, IoError> {
    serde_json::from_str(&read_text(path)?)
        .map_err(|e| IoError::format(path, format!("expected {what}: {e}")))
}

/// Reads the folder in which `path`, its `dataset.json`, lies. Images are those of the largest size
/// that is there.
pub(super) fn read(path: &Path) -> Result<ImportedPoses, IoError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let listed: Listed = read_json(path, "HyperNeRF's list of images")?;
    let metadata = folder.join("metadata.json");
    let moments: BTreeMap<String, Moment> = match metadata.is_file() {
        true => read_json(&metadata, "HyperNeRF's times of images")?,
        false => BTreeMap::new(),
    };
    let images = images_folder(path)?;
    let mut found = ImportedPoses::of(Reconstruction::default(), Sim3::IDENTITY);
    for id in &listed.ids {
        let id = safe_name(id).map_err(IoError::name(path))?;
        let name = format!("{images}/{id}.png");
        let (camera, pose) = camera(&folder.join(format!("camera/{id}.json")))?;
        add(path, &mut found.model, &name, camera, pose)?;
        let moment = moments.get(id).and_then(|m| m.time_id.or(m.warp_id));
        found.times.extend(moment.map(|t| (name.clone(), t)));
        if listed.val_ids.iter().any(|held_out| held_out == id) {
            found.held_out.insert(name);
        }
    }
    Ok(found)
}

/// The largest size in which the images are there, `rgb/1x` before `rgb/2x`.
fn images_folder(path: &Path) -> Result<String, IoError> {
    let folder = path.parent().unwrap_or(Path::new(".")).join("rgb");
    let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let sizes = entries.filter_map(|e| e.file_name().to_str()?.strip_suffix('x')?.parse::<u32>().ok());
    let smallest = sizes.min().ok_or_else(|| IoError::format(path, "expected images in rgb/1x, 2x or 4x"))?;
    Ok(format!("rgb/{smallest}x"))
}

fn camera(path: &Path) -> Result<(Camera, Pose), IoError> {
    let filmed: Filmed = read_json(path, "HyperNeRF's camera")?;
    let radial = |i: usize| filmed.radial_distortion.get(i).copied().unwrap_or(0.0);
    let tangential = |i: usize| filmed.tangential_distortion.get(i).copied().unwrap_or(0.0);
    refuse_distortion(path, "a camera with skew or k3", &[filmed.skew, radial(2)])?;
    let fy = filmed.focal_length * filmed.pixel_aspect_ratio.unwrap_or(1.0);
    let [cx, cy] = filmed.principal_point;
    let distortion = [radial(0), radial(1), tangential(0), tangential(1)];
    let camera = brown(filmed.image_size, [filmed.focal_length, fy, cx, cy], distortion);
    let name = path.display().to_string();
    let turned = rotation(path, &name, filmed.orientation.as_flattened())?;
    Ok((camera, Pose::from_centre(turned, DVec3::from_array(filmed.position))))
}

#[cfg(test)]
mod tests {
    use super::super::read_poses;
    use crate::io::listed_images;
    use std::fs;

    #[test]
    fn images_times_and_what_is_held_out_are_read() {
        let dir = std::env::temp_dir().join(format!("hypernerf-{}", std::process::id()));
        for sub in ["camera", "rgb/4x", "rgb/2x"] {
            fs::create_dir_all(dir.join(sub)).unwrap();
        }
        let dataset = dir.join("dataset.json");
        fs::write(&dataset, r#"{"count":2,"ids":["a","b"],"train_ids":["a"],"val_ids":["b"]}"#).unwrap();
        fs::write(dir.join("metadata.json"), r#"{"a":{"warp_id":3},"b":{"time_id":5,"camera_id":0}}"#)
            .unwrap();
        let camera = r#"{"orientation":[[0,-1,0],[0,0,-1],[1,0,0]],"position":[1,2,3],"focal_length":500,
            "principal_point":[320,240],"skew":0,"pixel_aspect_ratio":1.1,"image_size":[640,480],
            "radial_distortion":[0.1,0,0],"tangential_distortion":[0,0]}"#;
        for name in ["a", "b"] {
            fs::write(dir.join(format!("camera/{name}.json")), camera).unwrap();
        }
        let found = read_poses(&dataset, &dir).unwrap();
        super::super::imported::looks_along_x(&found.model, &found.world_from_file);
        let camera = found.model.cameras.values().next().unwrap();
        assert_eq!(camera.params[..5], [500.0, 550.0, 320.0, 240.0, 0.1]);
        let times: Vec<_> = found.times.iter().map(|(name, t)| (name.as_str(), *t)).collect();
        assert_eq!(times, [("rgb/2x/a.png", 3.0), ("rgb/2x/b.png", 5.0)]);
        assert!(found.held_out.iter().eq(["rgb/2x/b.png"]));
        assert_eq!(listed_images(&dataset).unwrap(), ["rgb/2x/a.png", "rgb/2x/b.png"]);

        fs::write(&dataset, r#"{"ids":["../a"]}"#).unwrap();
        assert!(read_poses(&dataset, &dir).is_err());
        fs::remove_dir_all(dir).unwrap();
    }
}
