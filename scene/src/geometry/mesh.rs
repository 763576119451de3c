//! Triangle meshes: evenly spread points on them, and distances to them.

use crate::rng::rng;
use glam::DVec3;
use rand::Rng;
use rstar::{AABB, PointDistance, RTree, RTreeObject};

/// Triangles; every index is below the number of vertices (checked by [`Mesh::validate`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions, scene units.
    pub vertices: Vec<DVec3>,
    /// Indices of three vertices each, anticlockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// sRGB of each vertex, or empty.
    pub colors: Vec<[u8; 3]>,
}

impl Mesh {
    /// Checks that there are triangles, that their vertices exist and that positions are finite.
    pub fn validate(&self) -> Result<(), String> {
        if self.triangles.is_empty() {
            return Err("it has no triangles".to_owned());
        }
        if let Some(i) = self.vertices.iter().position(|v| !v.is_finite()) {
            return Err(format!("vertex {i} is not finite"));
        }
        let n = self.vertices.len();
        if !self.colors.is_empty() && self.colors.len() != n {
            return Err(format!("{n} vertices have {} colours", self.colors.len()));
        }
        match self.triangles.iter().flatten().find(|&&i| i as usize >= n) {
            Some(i) => Err(format!("a triangle names vertex {i} of {n}")),
            None => Ok(()),
        }
    }

    /// Corners of triangle `i`.
    pub fn corners(&self, i: usize) -> [DVec3; 3] {
        self.triangles[i].map(|v| self.vertices[v as usize])
    }

    /// Diagonal of the axis-parallel box around the triangles' corners.
    pub fn size(&self) -> f64 {
        let corners = self.triangles.iter().flatten().map(|&v| self.vertices[v as usize]);
        let low = corners.clone().fold(DVec3::INFINITY, DVec3::min);
        let high = corners.fold(DVec3::NEG_INFINITY, DVec3::max);
        if self.triangles.is_empty() { 0.0 } else { (high - low).length() }
    }

    /// Sum of the triangles' areas.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|i| self.triangle_area(i)).sum()
    }

    /// Area of triangle `i`.
    pub(crate) fn triangle_area(&self, i: usize) -> f64 {
        area(&self.corners(i))
    }

    /// Unit normal of each vertex: the mean of its triangles', by their areas; zero where it has
    /// none.
    pub fn normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.vertices.len()];
        // Lengths of tiny scenes would vanish when squared.
        let size = self.size();
        for (i, triangle) in self.triangles.iter().enumerate() {
            let [a, b, c] = self.corners(i).map(|v| v / size);
            let normal = (b - a).cross(c - a);
            triangle.iter().for_each(|&v| normals[v as usize] += normal);
        }
        normals.iter().map(|n| n.normalize_or_zero()).collect()
    }

    /// `n` points spread evenly by area; the same for the same seed.
    pub fn sample(&self, n: usize, seed: u64) -> Vec<DVec3> {
        let mut up_to = Vec::with_capacity(self.triangles.len());
        let mut sum = 0.0;
        for i in 0..self.triangles.len() {
            sum += area(&self.corners(i));
            up_to.push(sum);
        }
        if !(sum > 0.0 && sum.is_finite()) {
            return Vec::new();
        }
        let mut random = rng(seed, "mesh", 0);
        let points = (0..n).map(|k| {
            // One point a stratum of area: evener than drawing each anywhere.
            let at = (k as f64 + random.random::<f64>()) / n as f64 * sum;
            let i = up_to.partition_point(|&a| a < at).min(up_to.len() - 1);
            let [a, b, c] = self.corners(i);
            let (u, v) = (random.random::<f64>().sqrt(), random.random::<f64>());
            a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)
        });
        points.collect()
    }
}

fn area([a, b, c]: &[DVec3; 3]) -> f64 {
    (*b - *a).cross(*c - *a).length() / 2.0
}

/// The point of a triangle nearest to `p`: Ericson, "Real-Time Collision Detection", 2005, section
/// 5.1.5.
pub(super) fn nearest_on_triangle(p: DVec3, [a, b, c]: &[DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (*b - *a, *c - *a, p - *a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - *b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return *a + ab * (d1 / (d1 - d3));
    }
    let cp = p - *c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return *a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return *b + (*c - *b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { *a + ab * (vb / sum) + ac * (vc / sum) } else { *a } // zero area
}

struct Triangle([DVec3; 3]);

impl RTreeObject for Triangle {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_points(self.0.map(|v| v.to_array()).iter())
    }
}

impl PointDistance for Triangle {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let p = DVec3::from_array(*point);
        nearest_on_triangle(p, &self.0).distance_squared(p)
    }
}

/// A mesh that can be asked for distances.
pub struct Surface(RTree<Triangle>);

impl Surface {
    /// Of all triangles.
    pub fn new(mesh: &Mesh) -> Self {
        Self(RTree::bulk_load((0..mesh.triangles.len()).map(|i| Triangle(mesh.corners(i))).collect()))
    }

    /// Distance of a point from the nearest triangle, exact; infinite where there is none.
    pub fn distance(&self, p: DVec3) -> f64 {
        let point = p.to_array();
        self.0.nearest_neighbor(point).map_or(f64::INFINITY, |t| t.distance_2(&point).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn square() -> Mesh {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        Mesh {
            vertices: vec![at(0.0, 0.0), at(2.0, 0.0), at(2.0, 2.0), at(0.0, 2.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn distances_to_a_square_are_known_everywhere() {
        let surface = Surface::new(&square());
        for (p, expected) in [
            (DVec3::new(1.0, 1.0, 0.5), 0.5),
            (DVec3::new(1.5, 0.2, -3.0), 3.0),
            (DVec3::new(3.0, 1.0, 0.0), 1.0),
            (DVec3::new(-3.0, -4.0, 0.0), 5.0),
            (DVec3::new(3.0, 3.0, 1.0), 3.0_f64.sqrt()),
            (DVec3::new(0.7, 1.3, 0.0), 0.0),
        ] {
            assert!((surface.distance(p) - expected).abs() < 1e-12, "{p}");
        }
        assert_eq!(Surface::new(&Mesh::default()).distance(DVec3::ZERO), f64::INFINITY);
    }

    #[test]
    fn a_triangle_without_area_is_a_segment_or_a_point() {
        let line = [DVec3::ZERO, DVec3::X, DVec3::X * 2.0];
        assert!(
            (nearest_on_triangle(DVec3::new(1.5, 1.0, 0.0), &line).distance(DVec3::new(1.5, 0.0, 0.0)))
                < 1e-12
        );
        assert_eq!(nearest_on_triangle(DVec3::Y, &[DVec3::X; 3]), DVec3::X);
    }

    #[test]
    fn the_nearest_point_beats_every_sample_of_the_triangle() {
        for seed in 0..100 {
            let mut r = rng(seed, "triangle", 0);
            let mut v = || {
                DVec3::new(r.random_range(-1.0..1.0), r.random_range(-1.0..1.0), r.random_range(-1.0..1.0))
            };
            let (triangle, p) = ([v(), v(), v()], v() * 2.0);
            let best = nearest_on_triangle(p, &triangle).distance(p);
            let mut least = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (u, w) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    let q = triangle[0] * (1.0 - u - w) + triangle[1] * u + triangle[2] * w;
                    least = least.min(q.distance(p));
                }
            }
            assert!(best <= least + 1e-12 && least - best < 0.06, "seed {seed}: {best} {least}");
        }
    }

    #[test]
    fn samples_are_even_repeatable_and_on_the_surface() {
        let mesh = square();
        let points = mesh.sample(10_000, 3);
        assert_eq!(points, mesh.sample(10_000, 3));
        let left = points.iter().filter(|p| p.x < 0.5).count();
        assert!((2350..2650).contains(&left), "{left}");
        assert!(points.iter().all(|p| p.z == 0.0 && p.min_element() >= 0.0 && p.max_element() <= 2.0));
        assert!((mesh.area() - 4.0).abs() < 1e-12 && (mesh.size() - 8.0_f64.sqrt()).abs() < 1e-12);
        assert!(Mesh::default().sample(10, 0).is_empty());
    }
}
