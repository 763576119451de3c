//! `transforms.json` of a run, with the point cloud, masks, times and held-out views that belong to
//! it.

use anyhow::Result;
use scene::io::{CloudPoint, TransformsOptions, WORLD_FROM_TRANSFORMS, write_points_ply, write_transforms};
use scene::{FrameSet, Reconstruction};
use splat::DatasetConfig;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The cloud beside a run's `transforms.json`.
pub(crate) const CLOUD: &str = "sparse_points.ply";

/// Writes the points in the frame of a `transforms.json`.
pub(crate) fn write_cloud(path: &Path, model: &Reconstruction) -> Result<()> {
    let turn = WORLD_FROM_TRANSFORMS.inverse();
    let points = model.points.values();
    let points: Vec<CloudPoint> =
        points.map(|p| CloudPoint { position: turn.transform(p.position), rgb: p.rgb }).collect();
    Ok(write_points_ply(path, &points)?)
}

/// Writes a run's model as `transforms.json`, which lies (or is to lie) in the run's folder: images
/// in `images/`, masks in `masks/`, the cloud beside it. Without `frames` there are no masks and no
/// times.
pub(crate) fn write(
    path: &Path,
    model: &Reconstruction,
    frames: Option<&FrameSet>,
    dataset: &DatasetConfig,
) -> Result<()> {
    let frames = frames.map_or(&[][..], |f| &f.frames);
    let by_name: BTreeMap<&str, &scene::Frame> = frames.iter().map(|f| (&*f.name, f)).collect();
    let mut options = TransformsOptions {
        image_folder: "images".into(),
        held_out: held_out(model, dataset),
        ply_file_path: (!model.points.is_empty()).then(|| CLOUD.into()),
        ..TransformsOptions::default()
    };
    for image in model.images.values() {
        let Some(frame) = by_name.get(&*image.name) else { continue };
        if let Some(mask) = frame.mask.as_ref().and_then(|m| m.file_name()) {
            options.masks.insert(image.id, format!("masks/{}", mask.to_string_lossy()));
        }
        options.times_s.extend(frame.time_s.map(|t| (image.id, t)));
    }
    Ok(write_transforms(path, model, &options)?)
}

/// Numbers of the images that training does not see.
pub(crate) fn held_out(model: &Reconstruction, dataset: &DatasetConfig) -> BTreeSet<u32> {
    let mut images: Vec<(&str, u32)> = model.images.values().map(|i| (&*i.name, i.id)).collect();
    images.sort_unstable();
    let count = images.len();
    let chosen = images.into_iter().enumerate().filter(|(i, (name, _))| dataset.holds_out(name, *i, count));
    chosen.map(|(_, (_, id))| id).collect()
}
