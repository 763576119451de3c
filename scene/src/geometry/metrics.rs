//! Accuracy, completeness, F-score and Chamfer distance of points against a mesh.

use super::{Mesh, Surface};
use glam::DVec3;
use rayon::prelude::*;
use rstar::{PointDistance, RTree};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How points and surface differ. Distances are in per cent of the mesh's size (diagonal of its
/// box).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GeometryErrors {
    /// Points that were judged.
    pub points: usize,
    /// Mean distance from a point to the surface.
    pub accuracy_mean_pct: f64,
    /// Median of the same.
    pub accuracy_median_pct: f64,
    /// Mean distance from the surface to the nearest point.
    pub completeness_mean_pct: f64,
    /// Median of the same.
    pub completeness_median_pct: f64,
    /// Share of the points within the threshold, per cent.
    pub precision_pct: f64,
    /// Share of the surface within the threshold, per cent.
    pub recall_pct: f64,
    /// Harmonic mean of precision and recall, per cent (Knapitsch et al., "Tanks and Temples",
    /// 2017).
    pub f_score_pct: f64,
    /// The same at half the threshold.
    #[serde(default)]
    pub f_score_half_pct: f64,
    /// The recall at the threshold of what is thin alone ([`super::thin_parts`]); `None` where
    /// nothing is.
    #[serde(default)]
    pub thin_recall_pct: Option<f64>,
    /// Mean of the two mean distances.
    pub chamfer_pct: f64,
    /// What counted as near, per cent of the size.
    pub threshold_pct: f64,
}

/// Judges `points` against `mesh` (same frame and units). `surface`: points spread evenly over the
/// part of the mesh that is to be found; `thin`: which of them are thin, empty where that is not
/// asked. `None` where either is empty or the mesh has no extent.
pub fn compare_points(
    points: &[DVec3],
    mesh: &Mesh,
    surface: &[DVec3],
    thin: &[bool],
    threshold_pct: f64,
) -> Option<GeometryErrors> {
    let size = mesh.size();
    let points: Vec<DVec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
    if points.is_empty() || surface.is_empty() || !(size > 0.0) {
        return None;
    }
    let triangles = Surface::new(mesh);
    let to_pct = 100.0 / size;
    let accuracy: Vec<f64> = points.par_iter().map(|p| triangles.distance(*p) * to_pct).collect();
    let tree = RTree::bulk_load(points.iter().map(|p| p.to_array()).collect());
    let completeness: Vec<f64> = surface
        .par_iter()
        .map(|s| {
            let at = s.to_array();
            tree.nearest_neighbor(at).map_or(f64::INFINITY, |p| p.distance_2(&at).sqrt() * to_pct)
        })
        .collect();
    let (precision, recall) = (within(&accuracy, threshold_pct), within(&completeness, threshold_pct));
    let of_thin: Vec<f64> = completeness.iter().zip(thin).filter(|(_, t)| **t).map(|(c, _)| *c).collect();
    let half = threshold_pct / 2.0;
    let f_score_half = harmonic_mean(within(&accuracy, half), within(&completeness, half));
    let (accuracy_mean, completeness_mean) = (mean(&accuracy), mean(&completeness));
    Some(GeometryErrors {
        points: points.len(),
        accuracy_mean_pct: accuracy_mean,
        accuracy_median_pct: median(accuracy),
        completeness_mean_pct: completeness_mean,
        completeness_median_pct: median(completeness),
        precision_pct: precision,
        recall_pct: recall,
        f_score_pct: harmonic_mean(precision, recall),
        f_score_half_pct: f_score_half,
        thin_recall_pct: (!of_thin.is_empty()).then(|| within(&of_thin, threshold_pct)),
        chamfer_pct: (accuracy_mean + completeness_mean) / 2.0,
        threshold_pct,
    })
}

/// Share of the distances up to a threshold, per cent.
fn within(distances: &[f64], threshold: f64) -> f64 {
    100.0 * distances.iter().filter(|d| **d <= threshold).count() as f64 / distances.len() as f64
}

fn harmonic_mean(a: f64, b: f64) -> f64 {
    if a + b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of side 2 in z = 0.
    fn square() -> Mesh {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        Mesh {
            vertices: vec![at(0.0, 0.0), at(2.0, 0.0), at(2.0, 2.0), at(0.0, 2.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn a_plane_at_a_known_height_is_so_far_away_both_ways() {
        let mesh = square();
        let surface = mesh.sample(5000, 1);
        let height = 0.005 * mesh.size();
        let lifted: Vec<DVec3> = surface.iter().map(|p| *p + DVec3::Z * height).collect();
        let errors = compare_points(&lifted, &mesh, &surface, &[], 1.0).unwrap();
        for value in [errors.accuracy_mean_pct, errors.completeness_median_pct, errors.chamfer_pct] {
            assert!((value - 0.5).abs() < 1e-9, "{errors:?}");
        }
        assert_eq!((errors.precision_pct, errors.recall_pct, errors.f_score_pct), (100.0, 100.0, 100.0));
        let nothing_near = compare_points(&lifted, &mesh, &surface, &[], 0.4).unwrap();
        assert_eq!((nothing_near.precision_pct, nothing_near.f_score_pct), (0.0, 0.0));
    }

    #[test]
    fn half_a_square_has_half_the_recall_and_floaters_cost_precision() {
        let mesh = square();
        let surface = mesh.sample(20_000, 1);
        let mut points: Vec<DVec3> = surface.iter().copied().filter(|p| p.x < 1.0).collect();
        let half = points.len();
        points.extend((0..half / 3).map(|_| DVec3::new(1.0, 1.0, 1.0)));
        let left: Vec<bool> = surface.iter().map(|p| p.x < 1.0).collect();
        let errors = compare_points(&points, &mesh, &surface, &left, 1.0).unwrap();
        assert_eq!(errors.thin_recall_pct, Some(100.0));
        assert!((errors.precision_pct - 75.0).abs() < 0.1, "{errors:?}");
        // The threshold reaches 0.028 beyond the middle of 2.
        assert!((errors.recall_pct - 51.4).abs() < 1.0, "{errors:?}");
        let expected =
            2.0 * errors.precision_pct * errors.recall_pct / (errors.precision_pct + errors.recall_pct);
        assert!((errors.f_score_pct - expected).abs() < 1e-12);
    }

    #[test]
    fn a_sphere_of_another_radius_is_off_by_the_difference() {
        let (mesh, n) = (sphere(64), 4000);
        let surface = mesh.sample(n, 2);
        let larger: Vec<DVec3> = surface.iter().map(|p| p.normalize() * 1.1).collect();
        let errors = compare_points(&larger, &mesh, &surface, &[], 1.0).unwrap();
        let expected = 100.0 * 0.1 / mesh.size();
        assert!((errors.accuracy_mean_pct - expected).abs() < 0.03 * expected, "{errors:?}");
        assert!((errors.completeness_mean_pct - expected).abs() < 0.06 * expected, "{errors:?}");
    }

    #[test]
    fn nothing_to_compare_is_a_value() {
        let mesh = square();
        assert_eq!(compare_points(&[], &mesh, &mesh.sample(10, 0), &[], 1.0), None);
        assert_eq!(compare_points(&[DVec3::NAN], &mesh, &mesh.sample(10, 0), &[], 1.0), None);
        assert_eq!(compare_points(&[DVec3::ZERO], &Mesh::default(), &[], &[], 1.0), None);
    }

    /// The unit sphere by longitude and latitude.
    fn sphere(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for j in 0..2 * n {
                let (lat, lon) = (f64::from(i), f64::from(j));
                let (a, b) =
                    (lat * std::f64::consts::PI / f64::from(n), lon * std::f64::consts::PI / f64::from(n));
                mesh.vertices.push(DVec3::new(a.sin() * b.cos(), a.sin() * b.sin(), a.cos()));
            }
        }
        for i in 0..n {
            for j in 0..2 * n {
                let at = |i: u32, j: u32| i * 2 * n + j % (2 * n);
                mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        mesh
    }
}
