//! Meshes of the body and of each part at rest, and the file in which they move.

use super::record::labels;
use crate::dense;
use anyhow::{Context as _, Result};
use glam::DVec3;
use scene::io::{Hinge, MovingMesh};
use scene::{Gaussians, Pose, Progress};
use sfm::Articulation;
use splat::fusion::{DepthSource, MeasuredDepth, fused_mesh};
use splat::surface::median_depth;
use splat::{Dataset, View};
use std::path::Path;

/// Places of a part that say how deep it lies. Source: as many as a sparse cloud has.
const PLACES: usize = 5_000;

/// What the splat shows in a view: all parts together.
struct PartsView {
    /// [height × width] depth of what is foremost, scene units; 0 where nothing is.
    depth: Vec<f32>,
    /// [height × width] the part that is foremost.
    owner: Vec<u8>,
    /// [height × width] a bit for each part that the ray meets, seen or hidden.
    meets: Vec<u8>,
}

/// Writes the meshes, `resolution` voxels along the longest side, and how they moved.
pub(super) fn write(
    path: &Path,
    (gaussians, parts): (&Gaussians, &Articulation),
    mut dataset: Dataset,
    times_s: &[f64],
    (resolution, progress): (u32, &Progress),
) -> Result<()> {
    let of_parts: Vec<Gaussians> = (0..=parts.parts.len()).map(|k| of_part(gaussians, parts, k)).collect();
    let shown = shown(&of_parts, parts, &dataset, progress)?;
    let mut covers = shown.iter().map(|s| s.meets.iter().map(|m| if *m > 0 { u8::MAX } else { 0 }).collect());
    let matted = dataset.with_silhouettes(|_| covers.next().context("a view is new"))?;
    dataset = matted.unwrap_or(dataset);
    let poses: Vec<Pose> = dataset.views.iter().map(|v| v.pose).collect();
    let mut all = Vec::new();
    for (number, own) in of_parts.iter().enumerate() {
        let joint = number.checked_sub(1).map(|k| &parts.parts[k]);
        // The views as the part sees them that is at rest.
        for (view, pose) in dataset.views.iter_mut().zip(&poses) {
            view.pose = pose.compose(&motion(parts, view, number));
        }
        let measured = measured(number as u8, own, &shown, &dataset, progress)?;
        let mesh = fused_mesh(&DepthSource::Measured(&measured), &dataset, resolution, progress)?;
        let hinge = joint.map(|part| Hinge {
            axis: DVec3::from(part.axis),
            place: DVec3::from(part.place),
            angles: part.angles_deg.iter().map(|a| a.to_radians()).collect(),
        });
        let name = if number == 0 { "body".to_owned() } else { format!("part{number}") };
        all.push(MovingMesh { name, mesh, hinge });
    }
    Ok(scene::io::write_moving_glb(path, &all, times_s)?)
}

/// The body's frame from that of a part at rest, when a view was taken.
fn motion(parts: &Articulation, view: &View, number: usize) -> Pose {
    let frame = parts.number(&view.name).unwrap_or(0);
    let part = number.checked_sub(1).and_then(|k| parts.parts.get(k));
    part.map_or(Pose::IDENTITY, |part| part.pose(part.angle_deg(frame as f64)))
}

/// What the splat shows in every view.
fn shown(
    of_parts: &[Gaussians],
    parts: &Articulation,
    dataset: &Dataset,
    progress: &Progress,
) -> Result<Vec<PartsView>> {
    progress.begin("depths of parts", dataset.views.len());
    let mut all = Vec::with_capacity(dataset.views.len());
    for view in &dataset.views {
        let pixels = view.camera.width as usize * view.camera.height as usize;
        let [owner, meets] = [(); 2].map(|()| vec![0; pixels]);
        let mut out = PartsView { depth: vec![0.0; pixels], owner, meets };
        for (number, own) in of_parts.iter().enumerate() {
            let pose = view.pose.compose(&motion(parts, view, number));
            let near = dense::NEAR * own.median_distance(pose.centre());
            let depths = median_depth(own, &view.camera, &pose, near, false);
            for (i, z) in depths.into_iter().enumerate().filter_map(|(i, z)| Some((i, z? as f32))) {
                out.meets[i] |= 1 << number;
                if out.depth[i] == 0.0 || z < out.depth[i] {
                    (out.depth[i], out.owner[i]) = (z, number as u8);
                }
            }
        }
        all.push(out);
        progress.tick()?;
    }
    Ok(all)
}

/// Depths of a part in every view where it is foremost: by stereo between the views as the part at
/// rest sees them, and the splat's where stereo knows nothing or looks through it.
fn measured(
    number: u8,
    own: &Gaussians,
    shown: &[PartsView],
    dataset: &Dataset,
    progress: &Progress,
) -> Result<Vec<MeasuredDepth>> {
    let masks: Vec<Vec<u8>> = shown
        .iter()
        .map(|s| s.meets.iter().map(|bits| if bits >> number & 1 == 1 { u8::MAX } else { 0 }).collect())
        .collect();
    let splat = shown.iter().zip(&dataset.views).map(|(s, view)| {
        let own = s.depth.iter().zip(&s.owner);
        let depth = own.map(|(z, owner)| if *owner == number { *z } else { 0.0 }).collect();
        let columns = view.camera.width as usize;
        let size = [columns, view.camera.height as usize];
        MeasuredDepth { size, corner: [0; 2], columns, depth }
    });
    let splat: Vec<MeasuredDepth> = splat.collect();
    dense::part_depths(dataset, &masks, &some_places(own), &splat, progress)
}

/// Some places of Gaussians that are more opaque than not.
fn some_places(gaussians: &Gaussians) -> Vec<DVec3> {
    let opaque = (0..gaussians.len()).filter(|&i| gaussians.opacity_logits[i] > 0.0);
    let all: Vec<DVec3> = opaque.map(|i| gaussians.means[i].as_dvec3()).collect();
    all.iter().step_by(all.len().div_ceil(PLACES).max(1)).copied().collect()
}

/// The Gaussians of a part.
fn of_part(gaussians: &Gaussians, parts: &Articulation, number: usize) -> Gaussians {
    let (own, mut some) = (labels(parts), gaussians.clone());
    some.retain(|i| usize::from(own[i]) == number);
    some
}
