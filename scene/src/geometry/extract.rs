//! The zero set of a volume of signed distances, by marching cubes.

use super::Mesh;
use super::cubes::{EDGES, axis_of, table};
use super::volume::{FusionBlock, FusionOptions, SIDE, VOXELS};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// A vertex: the edge of the grid that it lies on, by its lower end and its axis.
type Edge = ([i32; 3], usize);

/// The triangles of one block, given its neighbours.
fn patch(
    block: &FusionBlock,
    by_place: &HashMap<[i32; 3], &FusionBlock>,
    options: &FusionOptions,
) -> Vec<[(Edge, DVec3, [u8; 3]); 3]> {
    let mut patch = Vec::new();
    let near: [Option<&FusionBlock>; 8] = std::array::from_fn(|c| {
        let at: [i32; 3] = std::array::from_fn(|k| block.at[k] + (c as i32 >> k & 1));
        by_place.get(&at).copied()
    });
    for i in 0..VOXELS as i32 {
        polygonise(&near, [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)], options, &mut patch);
    }
    patch
}

/// The zero set of the blocks.
pub(super) fn extract(blocks: &[FusionBlock], options: &FusionOptions) -> Mesh {
    let by_place: HashMap<[i32; 3], &FusionBlock> = blocks.iter().map(|b| (b.at, b)).collect();
    let patches: Vec<Vec<[(Edge, DVec3, [u8; 3]); 3]>> =
        blocks.par_iter().map(|block| patch(block, &by_place, options)).collect();
    let mut mesh = Mesh::default();
    let mut known: HashMap<Edge, u32> = HashMap::new();
    for corners in patches.iter().flatten() {
        let triangle = corners.map(|(edge, position, rgb)| {
            *known.entry(edge).or_insert_with(|| {
                mesh.vertices.push(position);
                mesh.colors.push(rgb);
                mesh.vertices.len() as u32 - 1
            })
        });
        mesh.triangles.push(triangle);
    }
    mesh
}

/// The triangles of the cell whose lowest corner is voxel `cell` of the first block of `near` (its
/// neighbours in the directions of rising coordinates, by corner); none where a corner was not
/// seen.
fn polygonise(
    near: &[Option<&FusionBlock>; 8],
    cell: [i32; 3],
    options: &FusionOptions,
    patch: &mut Vec<[(Edge, DVec3, [u8; 3]); 3]>,
) {
    let mut corners = [(0.0_f32, [0.0_f32; 4]); 8];
    let mut inside = 0;
    for (c, corner) in corners.iter_mut().enumerate() {
        let at: [i32; 3] = std::array::from_fn(|k| cell[k] + (c as i32 >> k & 1));
        let number = (0..3).fold(0, |n, k| n | usize::from(at[k] == SIDE) << k);
        let Some(block) = near[number] else { return };
        let [x, y, z] = at.map(|v| (v % SIDE) as usize);
        let i = x + 8 * y + 64 * z;
        if block.views[i] < options.least_views.max(1) {
            return;
        }
        *corner = (block.distance[i], block.colour[i]);
        inside |= usize::from(block.distance[i] < 0.0) << c;
    }
    let Some(first) = near[0] else { return };
    let base: [i32; 3] = std::array::from_fn(|k| first.at[k] * SIDE + cell[k]);
    for triangle in &table()[inside] {
        patch.push(triangle.map(|e| {
            let (axis, [a, b]) = (axis_of(e as usize), EDGES[e as usize]);
            let low: [i32; 3] = std::array::from_fn(|k| base[k] + (a as i32 >> k & 1));
            let t = corners[a].0 / (corners[a].0 - corners[b].0);
            let mut position = DVec3::from(low.map(f64::from));
            position[axis] += f64::from(t);
            ((low, axis), position * options.voxel, mixed(corners[a].1, corners[b].1, t))
        }));
    }
}

fn mean_colour(sum: [f32; 4]) -> Option<[f32; 3]> {
    (sum[3] > 0.0).then(|| [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3]])
}

/// The colour between two sums of colours; grey where no view gave one.
fn mixed(a: [f32; 4], b: [f32; 4], t: f32) -> [u8; 3] {
    match (mean_colour(a), mean_colour(b)) {
        (Some(a), Some(b)) => std::array::from_fn(|c| (a[c] + (b[c] - a[c]) * t).round() as u8),
        (Some(one), None) | (None, Some(one)) => one.map(|v| v.round() as u8),
        (None, None) => [128; 3],
    }
}
