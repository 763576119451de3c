//! The surface as the search for shapes sees it: small oriented pieces.

use crate::decimate::{bounds, cleaned};
use glam::DVec3;
use rand::Rng as _;
use scene::geometry::{JoinedSets, Mesh};
use scene::rng::Rng;
use std::collections::HashMap;

/// How often normals are averaged with those of their neighbours. Source: docs/decisions/16.
const SMOOTHINGS: usize = 3;
/// Neighbours beyond this angle lie round an edge: cosine of 45°. Source: docs/decisions/16.
const AROUND_AN_EDGE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Triangles of a mesh in a frame where its box is 1 long, about the box's middle.
pub(crate) struct Elements {
    /// The corners of each.
    pub(crate) corners: Vec<[DVec3; 3]>,
    /// Unit normals, smoothed within faces.
    pub(crate) normals: Vec<DVec3>,
    /// Areas.
    pub(crate) areas: Vec<f64>,
    /// Vertices of each.
    pub(crate) vertices: Vec<[u32; 3]>,
    /// The place of each in the triangles of the mesh given.
    pub(crate) source: Vec<u32>,
    /// Middle of the mesh's box, scene units.
    pub(crate) centre: DVec3,
    /// Longest side of the mesh's box, scene units.
    pub(crate) scale: f64,
}

impl Elements {
    /// Of the triangles with an area; `None` where there are none.
    pub(crate) fn new(mesh: &Mesh) -> Option<Self> {
        let clean = cleaned(mesh);
        let (low, high) = bounds(&clean.vertices);
        let (centre, scale) = ((low + high) / 2.0, (high - low).max_element());
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let mut found = Self {
            corners: vec![],
            normals: vec![],
            areas: vec![],
            vertices: vec![],
            source: vec![],
            centre,
            scale,
        };
        // The places of the triangles that cleaning kept.
        let kept = (0..mesh.triangles.len() as u32).filter(|&i| is_sound(mesh, i as usize));
        for ((i, place), triangle) in (0..).zip(kept).zip(&clean.triangles) {
            let corners = clean.corners(i).map(|v| (v - centre) / scale);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let area = normal.length() / 2.0;
            if area > 0.0 {
                found.corners.push(corners);
                found.normals.push(normal / (2.0 * area));
                found.areas.push(area);
                found.vertices.push(*triangle);
                found.source.push(place);
            }
        }
        found.smooth(clean.vertices.len());
        (!found.areas.is_empty()).then_some(found)
    }

    /// Averages normals over triangles that share a vertex and face alike.
    fn smooth(&mut self, vertices: usize) {
        let mut around = vec![vec![]; vertices];
        for (i, triangle) in (0_u32..).zip(&self.vertices) {
            triangle.iter().for_each(|&v| around[v as usize].push(i));
        }
        for _ in 0..SMOOTHINGS {
            let sums = self.vertices.iter().enumerate().map(|(i, triangle)| {
                let own = self.normals[i];
                let near = triangle.iter().flat_map(|&v| &around[v as usize]).map(|&j| j as usize);
                let alike = near.filter(|&j| self.normals[j].dot(own) > AROUND_AN_EDGE);
                let sum: DVec3 = alike.map(|j| self.normals[j] * self.areas[j]).sum();
                sum.try_normalize().unwrap_or(own)
            });
            self.normals = sums.collect();
        }
    }

    /// Middle of element `i`.
    pub(crate) fn middle(&self, i: usize) -> DVec3 {
        self.corners[i].iter().sum::<DVec3>() / 3.0
    }

    /// Sum of the areas of these.
    pub(crate) fn area(&self, of: &[usize]) -> f64 {
        of.iter().map(|&i| self.areas[i]).sum()
    }

    /// `count` of these, drawn by area, evenly.
    pub(crate) fn draw(&self, of: &[usize], count: usize, random: &mut Rng) -> Vec<usize> {
        let mut up_to = Vec::with_capacity(of.len());
        let mut sum = 0.0;
        for &i in of {
            sum += self.areas[i];
            up_to.push(sum);
        }
        if of.is_empty() {
            return Vec::new();
        }
        let strata = (0..count).map(|k| {
            let at = (k as f64 + random.random::<f64>()) / count as f64 * sum;
            of[up_to.partition_point(|&a| a < at).min(of.len() - 1)]
        });
        strata.collect()
    }

    /// Of these elements the connected part with the largest area: by shared vertices, and by
    /// corners in one cube of side `cell`.
    pub(crate) fn largest_part(&self, of: &[usize], cell: f64) -> Vec<usize> {
        let mut sets = JoinedSets::new(of.len());
        let mut by_vertex: HashMap<u32, u32> = HashMap::new();
        let mut by_cube: HashMap<[i64; 3], u32> = HashMap::new();
        for (k, &i) in (0_u32..).zip(of) {
            for (vertex, corner) in self.vertices[i].iter().zip(self.corners[i]) {
                sets.join(k, *by_vertex.entry(*vertex).or_insert(k));
                sets.join(k, *by_cube.entry(cube(corner, cell)).or_insert(k));
            }
        }
        let mut areas = vec![0.0; of.len()];
        for (k, &i) in (0_u32..).zip(of) {
            areas[sets.root(k) as usize] += self.areas[i];
        }
        let best = (0..of.len()).max_by(|&a, &b| areas[a].total_cmp(&areas[b]).then(b.cmp(&a)));
        let part = (0_u32..).zip(of).filter(|&(k, _)| Some(sets.root(k) as usize) == best);
        part.map(|(_, &i)| i).collect()
    }
}

/// Which cube of a grid holds a place.
pub(crate) fn cube(p: DVec3, side: f64) -> [i64; 3] {
    (p / side).floor().to_array().map(|v| v as i64)
}

/// As [`cleaned`] has it.
fn is_sound(mesh: &Mesh, i: usize) -> bool {
    let [a, b, c] = mesh.triangles[i];
    let corners = [a, b, c].map(|v| mesh.vertices.get(v as usize));
    a != b && b != c && c != a && corners.iter().all(|x| x.is_some_and(|x| x.is_finite()))
}
