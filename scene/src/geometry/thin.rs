//! The thin parts of a true surface: rods, and the edges of sheets such as solar arrays. They are
//! what depths lose first, and too small a share of the area to show in an F-score.

use crate::sim3::least_eigenvector;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use rstar::RTree;

/// What tells thin parts.
struct ThinLimits {
    /// A part is a rod where the surface around is spread along a second direction by at most this
    /// share of its spread along the first. Source: derived: a diameter of 0.8 of the reach.
    rod: f64,
    /// It is a sheet where the surface around is spread across it by at most this share of the
    /// square of the reach: 0.28 of the reach thick. Source: derived: half of the edge of a box.
    sheet: f64,
    /// A sheet ends where the middle of the surface around lies so far to the side, shares of the
    /// reach. Source: derived: 0.42 at the very edge and 0 a reach away from it.
    edge: f64,
    /// Fewer points around tell nothing. Source: chosen by hand, never measured.
    least_points: usize,
}

/// The values in force.
const THIN: ThinLimits = ThinLimits { rod: 0.25, sheet: 0.018, edge: 0.3, least_points: 8 };

/// Which of the points `of` lie on a rod or near the edge of a sheet, judged by the samples of the
/// whole `surface` (spread evenly) up to `reach` away, scene units.
pub fn thin_parts(of: &[DVec3], surface: &[DVec3], reach: f64) -> Vec<bool> {
    let tree = RTree::bulk_load(surface.iter().map(|p| p.to_array()).collect());
    let thin = of.par_iter().map(|at| {
        let near = tree.locate_within_distance(at.to_array(), reach * reach);
        let around: Vec<DVec3> = near.map(|p| (DVec3::from(*p) - *at) / reach).collect();
        around.len() >= THIN.least_points && is_thin(&around)
    });
    thin.collect()
}

fn trace(m: DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// Whether a part is thin whose surface within a reach of 1 around the origin these points are.
fn is_thin(around: &[DVec3]) -> bool {
    let n = around.len() as f64;
    let middle = around.iter().sum::<DVec3>() / n;
    let spread = around.iter().fold(DMat3::ZERO, |sum, p| {
        let d = *p - middle;
        sum + DMat3::from_cols(d * d.x, d * d.y, d * d.z)
    }) * (1.0 / n);
    let across = least_eigenvector(spread);
    let least = across.dot(spread * across);
    // The other two, by the traces of the matrix and of its square.
    let (sum, squares) = (trace(spread) - least, trace(spread * spread) - least * least);
    let root = (2.0 * squares - sum * sum).max(0.0).sqrt();
    let [most, second] = [(sum + root) / 2.0, (sum - root) / 2.0];
    second < THIN.rod * most || (least < THIN.sheet && middle.length() > THIN.edge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Mesh;

    /// A box with these half sides, its faces outwards.
    fn cuboid(half: DVec3) -> Mesh {
        let at = |c: u32| DVec3::from([0, 1, 2].map(|k| if c >> k & 1 == 1 { half[k] } else { -half[k] }));
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]);
        Mesh { vertices: (0..8).map(at).collect(), triangles: triangles.collect(), ..Mesh::default() }
    }

    /// The share of a box's points with `of` that count as thin at a reach of 1.
    fn share(half: DVec3, scale: f64, of: impl Fn(DVec3) -> bool) -> f64 {
        let surface: Vec<DVec3> = cuboid(half).sample(10_000, 1).iter().map(|p| *p * scale).collect();
        let chosen: Vec<DVec3> = surface.iter().copied().filter(|p| of(*p / scale)).collect();
        let thin = thin_parts(&chosen, &surface, scale);
        thin.iter().filter(|t| **t).count() as f64 / thin.len() as f64
    }

    #[test]
    fn rods_and_edges_of_sheets_are_thin_and_faces_and_edges_of_boxes_are_not() {
        for scale in [1.0, 1e-6, 1e6] {
            let rod = DVec3::new(0.2, 0.2, 6.0);
            assert_eq!(share(rod, scale, |p| p.z.abs() < 5.0), 1.0);
            let sheet = DVec3::new(6.0, 6.0, 0.05);
            let from_edge = |p: DVec3| 6.0 - p.x.abs().max(p.y.abs());
            assert!(share(sheet, scale, |p| from_edge(p) < 0.1) > 0.95);
            assert_eq!(share(sheet, scale, |p| from_edge(p) > 1.0), 0.0);
            let thick = DVec3::splat(4.0);
            assert!(share(thick, scale, |_| true) < 0.001);
        }
    }

    #[test]
    fn what_is_not_there_is_not_thin() {
        assert!(thin_parts(&[], &[], 1.0).is_empty());
        assert_eq!(thin_parts(&[DVec3::ZERO], &[DVec3::X * 0.5; 3], 1.0), [false]);
        assert_eq!(thin_parts(&[DVec3::NAN], &[DVec3::ZERO; 9], 1.0), [false]);
    }
}
