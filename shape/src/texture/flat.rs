//! A chart in the plane, and which of its triangles covers which texel.

use crate::measure::outline::{convex_hull, least_rectangle};
use crate::measure::primitive::flat;
use crate::raster::covered;
use glam::{DVec2, DVec3};
use scene::geometry::Mesh;
use std::collections::HashMap;

/// Triangles laid flat.
#[derive(Clone, Debug)]
pub(super) struct FlatChart {
    /// Their places in the mesh.
    pub(super) triangles: Vec<u32>,
    /// Where their corners lie, scene units, from the lower corner of the chart's box on.
    pub(super) corners: Vec<[DVec2; 3]>,
    /// The box.
    pub(super) size: DVec2,
}

impl FlatChart {
    /// Lays triangles onto the plane across `normal`, the sides of the least rectangle around them
    /// along the axes. Those that would lie over others, by the middles of texels of this size,
    /// come back. `None` of no triangles.
    pub(super) fn new(
        mesh: &Mesh,
        triangles: Vec<u32>,
        normal: DVec3,
        texel: f64,
    ) -> (Option<Self>, Vec<u32>) {
        let Some(&first) = triangles.first() else { return (None, vec![]) };
        let origin = mesh.corners(first as usize)[0];
        let (along, _) =
            least_rectangle(&convex_hull(corners_of(mesh, &triangles).map(|x| flat(x - origin, normal))));
        let (mut kept, mut corners, mut over) = (vec![], vec![], vec![]);
        let mut taken: HashMap<[i64; 2], u32> = HashMap::new();
        for t in triangles {
            let placed = mesh.corners(t as usize).map(|x| {
                let p = flat(x - origin, normal);
                DVec2::new(p.dot(along), p.dot(along.perp()))
            });
            let mut is_over = false;
            covered(placed.map(|p| p / texel), |at, weights| {
                // A middle on a common side belongs to both.
                is_over |= taken.contains_key(&at) && weights.iter().all(|w| *w > 1e-9);
            });
            if is_over {
                over.push(t);
                continue;
            }
            covered(placed.map(|p| p / texel), |at, _| _ = taken.insert(at, t));
            kept.push(t);
            corners.push(placed);
        }
        let low = corners.iter().flatten().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = corners.iter().flatten().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        corners.iter_mut().flatten().for_each(|p| *p -= low);
        (Some(Self { triangles: kept, corners, size: high - low }), over)
    }
}

fn corners_of(mesh: &Mesh, triangles: &[u32]) -> impl Iterator<Item = DVec3> {
    triangles.iter().flat_map(|&t| mesh.corners(t as usize))
}
