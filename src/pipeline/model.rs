//! The files of a run's model.

use crate::transforms;
use anyhow::Result;
use scene::Reconstruction;
use std::path::Path;

/// Writes `sparse/0` and the cloud into the folder `new`.
pub(super) fn write(model: &Reconstruction, new: &Path, text: bool) -> Result<()> {
    let target = new.join("sparse").join("0");
    scene::io::atomic::replace_folder(&target, |folder| {
        scene::io::write_model_bin(model, folder)?;
        if text {
            scene::io::write_model_txt(model, folder)?;
        }
        Ok::<(), scene::io::IoError>(())
    })?;
    transforms::write_cloud(&new.join(transforms::CLOUD), model)
}

/// Writes `refined/0` into the folder `new`: the model of the run in `out` with the poses that
/// training moved; nothing where it moved none.
pub(super) fn write_refined(out: &Path, new: &Path, poses: &[(String, scene::Pose)]) -> Result<()> {
    if poses.is_empty() {
        return Ok(());
    }
    let mut model = scene::io::read_model(&out.join("sparse/0"))?;
    for image in model.images.values_mut() {
        if let Some((_, pose)) = poses.iter().find(|(name, _)| *name == image.name) {
            image.pose = *pose;
        }
    }
    let target = new.join("refined/0");
    Ok(scene::io::atomic::replace_folder(&target, |folder| scene::io::write_model_bin(&model, folder))?)
}
