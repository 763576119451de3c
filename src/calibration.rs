//! `--camera-from`: the camera of an earlier run or of a COLMAP model.

use crate::record::KnownRun;
use anyhow::{Context, Result, bail};
use scene::Camera;
use sfm::Calibration;
use std::collections::BTreeMap;
use std::path::Path;

/// A run's standard deviations are those that the noise of the observations gives; what its camera
/// model leaves out is not in them. Another run uses them times this factor. Source: chosen by
/// hand, never measured.
const TRUST: f64 = 3.0;
/// Standard deviations of what a run held fixed: focal lengths (share of them), principal points
/// (longer image sides), distortion (no unit). Source: chosen by hand, never measured.
const HELD: [f64; 3] = [0.05, 0.03, 0.1];

/// The camera that took most of the images: of a run's folder with its standard deviations, of a
/// COLMAP model exactly.
pub(crate) fn read(path: &Path) -> Result<Calibration> {
    let folder = path.join("sparse/0");
    let folder = if folder.is_dir() { folder.as_path() } else { path };
    let model = scene::io::read_model(folder).with_context(|| {
        format!("--camera-from {}: neither a run's folder nor a COLMAP model", path.display())
    })?;
    let mut images: BTreeMap<u32, usize> = BTreeMap::new();
    model.images.values().for_each(|i| *images.entry(i.camera).or_default() += 1);
    let most = images.iter().max_by_key(|(id, n)| (**n, std::cmp::Reverse(**id)));
    let Some(camera) = most.and_then(|(id, _)| model.cameras.get(id)).cloned() else {
        bail!("--camera-from {}: no image has a camera", path.display());
    };
    let is_run = path.join("run.json").is_file();
    let sigmas = if is_run { deviations(path, &camera)? } else { vec![0.0; camera.params.len()] };
    Ok(Calibration { camera, sigmas })
}

fn deviations(run: &Path, camera: &Camera) -> Result<Vec<f64>> {
    let known = KnownRun::read(run)?.poses.and_then(|p| p.deviations);
    let own = known.and_then(|mut d| d.cameras.remove(&camera.id)).unwrap_or_default();
    let focals = camera.model.num_focals();
    let side = f64::from(camera.width.max(camera.height));
    let values = camera.params.iter().enumerate();
    let sigmas = values.map(|(i, value)| match own.get(i) {
        Some(s) if s.is_finite() && *s > 0.0 => TRUST * s,
        _ if i < focals => HELD[0] * value,
        _ if i < focals + 2 => HELD[1] * side,
        _ => HELD[2],
    });
    Ok(sigmas.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{CameraModel, Pose, PosedImage, Reconstruction};

    fn folder(name: &str) -> std::path::PathBuf {
        let folder =
            std::env::temp_dir().join(format!("sat-recon-calibration-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&folder).ok();
        std::fs::create_dir_all(folder.join("sparse/0")).unwrap();
        folder
    }

    #[test]
    fn the_camera_of_most_images_comes_with_its_deviations() {
        let folder = folder("most");
        let mut model = Reconstruction::default();
        for (id, focal) in [(1, 500.0), (2, 600.0)] {
            model.cameras.insert(id, Camera::centred(id, CameraModel::SimpleRadial, 640, 480, focal));
        }
        for (id, camera) in [(1, 2), (2, 1), (3, 2)] {
            let image = PosedImage {
                id,
                camera,
                name: format!("{id}.png"),
                pose: Pose::IDENTITY,
                observations: Vec::new(),
            };
            model.images.insert(id, image);
        }
        scene::io::write_model_bin(&model, &folder.join("sparse/0")).unwrap();
        let exact = read(&folder).unwrap();
        assert_eq!((exact.camera.params[0], exact.sigmas), (600.0, vec![0.0; 4]));
        let cameras = r#""cameras": {"1": [9, 9, 9, 9], "2": [2.0, 0.5, 0.0, 0.01]}"#;
        let record =
            format!(r#"{{"poses": {{"deviations": {{"sigma_px": 0.1, {cameras}, "images": []}}}}}}"#);
        std::fs::write(folder.join("run.json"), record).unwrap();
        let near = read(&folder).unwrap();
        let wanted = [6.0, 1.5, 0.03 * 640.0, 0.03];
        assert!(near.sigmas.iter().zip(wanted).all(|(s, w)| (s - w).abs() < 1e-12), "{:?}", near.sigmas);
        std::fs::write(folder.join("run.json"), "{").unwrap();
        assert!(format!("{:#}", read(&folder).unwrap_err()).contains("run.json"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_without_a_model_is_refused_by_name() {
        let folder = folder("empty");
        let error = format!("{:#}", read(&folder).unwrap_err());
        assert!(error.contains("--camera-from") && error.contains("calibration-empty"), "{error}");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
