//! Closes a mesh: every side of a triangle is the side of exactly one other, in the other
//! direction.

use crate::decimate::cleaned;
use glam::DVec3;
use scene::geometry::Mesh;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The mesh without holes: vertices in one place are joined, triangles at a side that others have
/// taken already are left out, and each border is closed by a fan about its middle. A surface that
/// is open as a whole, such as a sheet, gets its border's fan for a back.
pub fn watertight(mesh: &Mesh) -> Mesh {
    let mut mesh = cleaned(mesh);
    weld(&mut mesh);
    let mut sides = BTreeSet::new();
    mesh.triangles.retain(|t| {
        let own = sides_of(t);
        own[0].0 != own[0].1
            && own[1].0 != own[1].1
            && own[2].0 != own[2].1
            && own.iter().all(|side| !sides.contains(side))
            && own.into_iter().all(|side| sides.insert(side))
    });
    let open = sides.iter().copied().filter(|&(a, b)| !sides.contains(&(b, a))).map(|(a, b)| (b, a));
    for border in loops(open.collect()) {
        close(&mut mesh, &border);
    }
    mesh.drop_unused();
    mesh
}

fn sides_of(t: &[u32; 3]) -> [(u32, u32); 3] {
    [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]
}

/// Joins vertices whose positions are equal.
fn weld(mesh: &mut Mesh) {
    let mut first: HashMap<[u64; 3], u32> = HashMap::new();
    let number: Vec<u32> = (0..)
        .zip(&mesh.vertices)
        .map(|(i, v)| *first.entry((*v + 0.0).to_array().map(f64::to_bits)).or_insert(i))
        .collect();
    mesh.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
}

/// Takes directed sides, of which as many begin as end at each vertex, apart into loops that meet
/// no vertex twice.
fn loops(sides: Vec<(u32, u32)>) -> Vec<Vec<u32>> {
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (a, b) in sides {
        next.entry(a).or_default().push(b);
    }
    let mut found = Vec::new();
    while let Some((&start, _)) = next.iter().find(|(_, to)| !to.is_empty()) {
        let mut path = vec![start];
        while let Some(to) = path.last().and_then(|at| next.get_mut(at)?.pop()) {
            match path.iter().position(|&v| v == to) {
                Some(at) => {
                    found.push(path.split_off(at));
                    path.push(to);
                }
                None => path.push(to),
            }
        }
        next.retain(|_, to| !to.is_empty());
    }
    found
}

/// A fan about the middle of a loop of sides, along them.
fn close(mesh: &mut Mesh, border: &[u32]) {
    if let &[a, b, c] = border {
        mesh.triangles.push([a, b, c]);
        return;
    }
    let n = border.len() as f64;
    let middle = mesh.vertices.len() as u32;
    mesh.vertices.push(border.iter().map(|&v| mesh.vertices[v as usize] / n).sum::<DVec3>());
    if !mesh.colors.is_empty() {
        let mean = [0, 1, 2].map(|k| {
            let sum: f64 = border.iter().map(|&v| f64::from(mesh.colors[v as usize][k])).sum();
            (sum / n).round() as u8
        });
        mesh.colors.push(mean);
    }
    for (i, &a) in border.iter().enumerate() {
        mesh.triangles.push([a, border[(i + 1) % border.len()], middle]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decimate::{Decimation, decimated};
    use crate::testing::{box_mesh, open_edges, sphere};

    fn volume(mesh: &Mesh) -> f64 {
        (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn a_box_without_a_face_gets_it_back() {
        let whole = box_mesh(DVec3::new(1.0, 2.0, 3.0), 6);
        let mut open = whole.clone();
        open.colors = vec![[7; 3]; open.vertices.len()];
        open.triangles.retain(|t| t.iter().any(|&v| open.vertices[v as usize].z < 1.49));
        assert!(!open_edges(&open).is_empty());
        let closed = watertight(&open);
        assert!(open_edges(&closed).is_empty());
        assert!((volume(&closed) - 6.0).abs() < 1e-9, "{}", volume(&closed));
        closed.validate().unwrap();
        let few = decimated(&closed, &Decimation { error: 1e-3, color_error: None });
        assert!(open_edges(&few).is_empty() && few.triangles.len() < 100, "{}", few.triangles.len());
    }

    #[test]
    fn holes_that_touch_and_triangles_too_many_are_no_trouble() {
        for seed in 0..50_u64 {
            let mut mesh = sphere(1.0, 12);
            let mut k = 0;
            // A third of the triangles goes, so that holes meet in vertices and parts in borders.
            mesh.triangles.retain(|_| {
                k += 1;
                !(seed * 977 + k * 31).is_multiple_of(3)
            });
            mesh.triangles.extend(mesh.triangles.clone().iter().take(5).map(|t| [t[0], t[2], t[1]]));
            mesh.triangles.push(mesh.triangles[0]);
            let closed = watertight(&mesh);
            assert!(open_edges(&closed).is_empty(), "seed {seed}");
            assert!(closed.vertices.iter().all(|v| v.is_finite()));
        }
    }

    #[test]
    fn nothing_stays_nothing_and_a_triangle_gets_a_back() {
        assert_eq!(watertight(&Mesh::default()), Mesh::default());
        let one = Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::NAN],
            triangles: vec![[0, 1, 2], [0, 1, 3]],
            ..Mesh::default()
        };
        let closed = watertight(&one);
        assert_eq!(closed.triangles.len(), 2);
        assert!(open_edges(&closed).is_empty());
    }
}
