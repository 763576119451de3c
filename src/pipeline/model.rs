//! The files of a run's model.

use crate::transforms;
use anyhow::{Context, Result};
use scene::{FrameSet, Reconstruction};
use splat::DatasetConfig;
use std::path::Path;

/// Writes `sparse/0` and the cloud.
pub(super) fn write(model: &Reconstruction, out: &Path, text: bool) -> Result<()> {
    let target = out.join("sparse").join("0");
    scene::io::atomic::replace_folder(&target, |folder| {
        scene::io::write_model_bin(model, folder)?;
        if text {
            scene::io::write_model_txt(model, folder)?;
        }
        Ok::<(), scene::io::IoError>(())
    })?;
    transforms::write_cloud(&out.join(transforms::CLOUD), model)
}

/// Writes `transforms.json` of the model in `out`; which views are held out is no matter of the
/// poses.
pub(super) fn write_transforms(out: &Path, frames: &FrameSet, dataset: &DatasetConfig) -> Result<()> {
    let model = scene::io::read_model(&out.join("sparse/0"))?;
    transforms::write(&out.join("transforms.json"), &model, Some(frames), dataset)
}

/// `refined/0`: the model with the poses that training moved; none where it moved none.
pub(super) fn write_refined(out: &Path, poses: &[(String, scene::Pose)]) -> Result<()> {
    let folder = out.join("refined");
    match std::fs::remove_dir_all(&folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            return Err(e).with_context(|| format!("cannot clear {}", folder.display()));
        }
        _ if poses.is_empty() => return Ok(()),
        _ => {}
    }
    let mut model = scene::io::read_model(&out.join("sparse/0"))?;
    for image in model.images.values_mut() {
        if let Some((_, pose)) = poses.iter().find(|(name, _)| *name == image.name) {
            image.pose = *pose;
        }
    }
    Ok(scene::io::atomic::replace_folder(&folder.join("0"), |new| {
        scene::io::write_model_bin(&model, new)
    })?)
}
