//! Exact shapes for the tests.

use glam::{DVec2, DVec3};
use scene::geometry::Mesh;
use std::collections::BTreeMap;

/// A grid of `n` × `n` squares over [0, 1]², moved into space, anticlockwise as `at` has it.
fn grid(n: u32, at: impl Fn(DVec2) -> DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for j in 0..=n {
        for i in 0..=n {
            mesh.vertices.push(at(DVec2::new(f64::from(i), f64::from(j)) / f64::from(n)));
        }
    }
    for j in 0..n {
        for i in 0..n {
            let v = j * (n + 1) + i;
            mesh.triangles.extend([[v, v + 1, v + n + 2], [v, v + n + 2, v + n + 1]]);
        }
    }
    mesh
}

/// Joins vertices that lie within a billionth of the size in one place.
fn welded(parts: &[Mesh]) -> Mesh {
    let mut all = Mesh::default();
    let size = parts.iter().map(Mesh::size).fold(0.0, f64::max);
    let mut known: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    for part in parts {
        let mut number = Vec::new();
        for v in &part.vertices {
            let key = (*v / size * 1e9).round().to_array().map(|x| x as i64);
            let next = all.vertices.len() as u32;
            let n = *known.entry(key).or_insert(next);
            if n == next {
                all.vertices.push(*v);
            }
            number.push(n);
        }
        all.triangles.extend(part.triangles.iter().map(|t| t.map(|v| number[v as usize])));
    }
    all.triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    all
}

/// A rectangle about the origin in the plane z = 0, seen from above.
pub(crate) fn sheet(width: f64, height: f64, n: u32) -> Mesh {
    grid(n, |p| DVec3::new((p.x - 0.5) * width, (p.y - 0.5) * height, 0.0))
}

/// A closed box about the origin, `n`² squares a face.
pub(crate) fn box_mesh(size: DVec3, n: u32) -> Mesh {
    let faces: Vec<Mesh> = (0..6)
        .map(|face| {
            let (axis, side) = (face / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
            grid(n, |p| {
                let mut x = DVec3::ZERO;
                let (u, v) = if side > 0.0 { (p.x, p.y) } else { (p.y, p.x) };
                x[axis] = side / 2.0;
                x[(axis + 1) % 3] = u - 0.5;
                x[(axis + 2) % 3] = v - 0.5;
                x * size
            })
        })
        .collect();
    welded(&faces)
}

/// A closed cylinder about z, its ends discs; `n` sides.
pub(crate) fn cylinder(radius: f64, length: f64, n: u32) -> Mesh {
    let round = |turn: f64, r: f64, z: f64| {
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        DVec3::new(r * cos, r * sin, z)
    };
    welded(&[
        grid(n, |p| round(p.x, radius, (p.y - 0.5) * length)),
        grid(n, |p| round(p.x, radius * (1.0 - p.y), length / 2.0)),
        grid(n, |p| round(p.x, radius * p.y, -length / 2.0)),
    ])
}

/// A sphere about the origin.
pub(crate) fn sphere(radius: f64, n: u32) -> Mesh {
    let mesh = grid(n, |p| {
        let (theta, phi) = ((1.0 - p.y) * std::f64::consts::PI, p.x * std::f64::consts::TAU);
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()) * radius
    });
    welded(&[mesh])
}

/// Sides of triangles that are not the side of exactly one other triangle in the other direction.
pub(crate) fn open_edges(mesh: &Mesh) -> Vec<(u32, u32)> {
    let mut count: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for t in &mesh.triangles {
        for side in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *count.entry(side).or_default() += 1;
        }
    }
    let wrong = count.iter().filter(|&(&(a, b), &n)| n != 1 || count.get(&(b, a)) != Some(&1));
    wrong.map(|(side, _)| *side).collect()
}
