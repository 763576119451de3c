//! `frames.json`: poses of all frames of a video, chosen for the model or not.

use crate::record::centre_deviation;
use crate::stage::write_json;
use anyhow::Result;
use scene::FrameSet;
use serde::Serialize;
use sfm::FramePose;
use std::path::Path;

/// A frame as it is written. World, camera and quaternion as in COLMAP's `images.txt`.
#[derive(Serialize)]
struct WrittenFrame<'a> {
    time_s: f64,
    /// The image of the model, where the frame was chosen.
    image: Option<&'a str>,
    /// Camera from world, w x y z.
    rotation: [f64; 4],
    /// Camera from world, scene units.
    translation: [f64; 3],
    /// Standard deviation of the rotation about the camera's axes.
    rotation_deviation_deg: [f64; 3],
    /// Standard deviation of the camera's centre along the world's axes, scene units.
    centre_deviation: [f64; 3],
}

/// Writes the file; removes an earlier one where there is nothing to write.
pub(super) fn write(path: &Path, poses: &[FramePose], frames: &FrameSet) -> Result<()> {
    if poses.is_empty() {
        if path.exists() {
            std::fs::remove_file(path)?;
        }
        return Ok(());
    }
    let name_at = |time: f64| frames.frames.iter().find(|f| f.time_s == Some(time)).map(|f| f.name.as_str());
    let written: Vec<WrittenFrame<'_>> = poses
        .iter()
        .map(|f| {
            let q = f.pose.rotation;
            WrittenFrame {
                time_s: f.time_s,
                image: name_at(f.time_s),
                rotation: [q.w, q.x, q.y, q.z],
                translation: f.pose.translation.to_array(),
                rotation_deviation_deg: f.deviation.rotation.map(f64::to_degrees),
                centre_deviation: centre_deviation(&f.deviation),
            }
        })
        .collect();
    write_json(path, &serde_json::json!({ "frames": written }))
}
