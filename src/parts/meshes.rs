//! Meshes of the body and of each part at rest, and the file in which they move.

use super::record::labels;
use anyhow::Result;
use glam::DVec3;
use scene::io::{Hinge, MovingMesh};
use scene::{Gaussians, Pose, Progress};
use sfm::Articulation;
use splat::fusion::{DepthSource, MeasuredDepth, fused_mesh};
use splat::surface::median_depth;
use splat::{Dataset, View};
use std::path::Path;

/// A part is what is seen where nothing else lies before it by more than this share of the depth.
/// Source: as where stereo and splat are joined, docs/decisions/16.
const BEFORE: f64 = 0.02;
/// Gaussians nearer to a camera than this share of their median distance are not seen.
/// Source: as in training.
const NEAR: f64 = 0.01;

/// Writes the meshes, `resolution` voxels along the longest side, and how they moved.
pub(super) fn write(
    path: &Path,
    (gaussians, parts): (&Gaussians, &Articulation),
    mut dataset: Dataset,
    times_s: &[f64],
    (resolution, progress): (u32, &Progress),
) -> Result<()> {
    let depths = depths(gaussians, parts, &dataset, progress)?;
    let poses: Vec<Pose> = dataset.views.iter().map(|v| v.pose).collect();
    let mut all = Vec::new();
    for (number, measured) in depths.iter().enumerate() {
        let joint = number.checked_sub(1).map(|k| &parts.parts[k]);
        let source = DepthSource::Measured(measured);
        // The views as the part sees them that is at rest.
        for (view, pose) in dataset.views.iter_mut().zip(&poses) {
            view.pose = pose.compose(&motion(parts, view, number));
        }
        let mesh = fused_mesh(&source, &dataset, resolution, progress)?;
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

/// Of the body and of each part: depths of every view, where it is what is seen.
fn depths(
    gaussians: &Gaussians,
    parts: &Articulation,
    dataset: &Dataset,
    progress: &Progress,
) -> Result<Vec<Vec<MeasuredDepth>>> {
    let count = parts.parts.len() + 1;
    let of_parts: Vec<Gaussians> = (0..count).map(|k| of_part(gaussians, parts, k)).collect();
    let mut all = vec![Vec::new(); count];
    progress.begin("depths of parts", dataset.views.len());
    for view in &dataset.views {
        let each: Vec<Vec<Option<f64>>> = of_parts
            .iter()
            .enumerate()
            .map(|(number, some)| {
                let pose = view.pose.compose(&motion(parts, view, number));
                median_depth(some, &view.camera, &pose, NEAR * some.median_distance(pose.centre()), false)
            })
            .collect();
        for (number, out) in all.iter_mut().enumerate() {
            out.push(MeasuredDepth { width: view.camera.width as usize, depth: foremost(&each, number) });
        }
        progress.tick()?;
    }
    Ok(all)
}

/// The depths of one of several things where it lies before the others; 0 elsewhere.
fn foremost(each: &[Vec<Option<f64>>], number: usize) -> Vec<f32> {
    let nearest = |i: usize| each.iter().filter_map(|depths| depths[i]).fold(f64::INFINITY, f64::min);
    let own = each[number].iter().enumerate();
    own.map(|(i, depth)| depth.filter(|z| *z <= nearest(i) * (1.0 + BEFORE)).unwrap_or(0.0) as f32).collect()
}

/// The Gaussians of a part.
fn of_part(gaussians: &Gaussians, parts: &Articulation, number: usize) -> Gaussians {
    let (own, mut some) = (labels(parts), gaussians.clone());
    some.retain(|i| usize::from(own[i]) == number);
    some
}
