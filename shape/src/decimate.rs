//! Fewer triangles within a given error: quadric error metrics (Garland and Heckbert, SIGGRAPH
//! 1997; with colours as attributes: Hoppe, Visualization 1999), by meshoptimizer.

use glam::{DVec3, Vec3};
use meshopt::{SimplifyOptions, simplify_with_update};
use scene::geometry::Mesh;

/// How far a decimated mesh may be from the one it was made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decimation {
    /// Error of the surface (the quadrics' root mean square distance), share of the longest side of
    /// the mesh's box.
    pub error: f64,
    /// Error of the vertices' colours, share of the range from black to white, that weighs as much
    /// as `error`; `None`: colours do not matter, as under a texture.
    pub color_error: Option<f64>,
}

/// The mesh with as few triangles as the error allows. Borders stay where they are, vertex for
/// vertex, and a closed mesh stays closed. Triangles with corners that are not finite, or that are
/// one vertex twice, are left out; colours are interpolated. An error of 0 only cleans.
pub fn decimated(mesh: &Mesh, options: &Decimation) -> Mesh {
    let mut mesh = cleaned(mesh);
    let (low, high) = bounds(&mesh.vertices);
    let (centre, side) = ((low + high) / 2.0, (high - low).max_element());
    if !(options.error > 0.0 && side > 0.0 && side.is_finite()) {
        return mesh;
    }
    let mut positions: Vec<[f32; 3]> =
        mesh.vertices.iter().map(|v| ((*v - centre) / side).as_vec3().to_array()).collect();
    let color_error = options.color_error.filter(|e| *e > 0.0 && !mesh.colors.is_empty());
    let weights: Vec<f32> = color_error.map_or(vec![], |e| vec![(options.error / e) as f32; 3]);
    let mut colors: Vec<f32> = match weights.len() {
        0 => vec![],
        _ => mesh.colors.iter().flatten().map(|c| f32::from(*c) / 255.0).collect(),
    };
    let mut indices = mesh.triangles.concat();
    let left = simplify_with_update(
        &mut indices,
        &mut positions,
        &mut colors,
        &weights,
        weights.len() * size_of::<f32>(),
        None,
        0,
        options.error as f32,
        SimplifyOptions::LockBorder,
        None,
    );
    indices.truncate(left);
    // What is named by no triangle keeps its old place, and goes.
    mesh.triangles = indices.as_chunks::<3>().0.to_vec();
    for (vertex, position) in mesh.vertices.iter_mut().zip(&positions) {
        *vertex = centre + Vec3::from(*position).as_dvec3() * side;
    }
    for (color, new) in mesh.colors.iter_mut().zip(colors.as_chunks::<3>().0) {
        *color = new.map(|v| (v * 255.0).round().clamp(0.0, 255.0) as u8);
    }
    mesh.drop_unused();
    mesh
}

/// Without triangles that have no place or no area by their indices, and with no other vertices
/// than theirs.
pub(crate) fn cleaned(mesh: &Mesh) -> Mesh {
    let mut mesh = mesh.clone();
    let n = mesh.vertices.len();
    let finite: Vec<bool> = mesh.vertices.iter().map(|v| v.is_finite()).collect();
    mesh.triangles.retain(|t| {
        let [a, b, c] = *t;
        a != b && b != c && c != a && t.iter().all(|&v| (v as usize) < n && finite[v as usize])
    });
    if mesh.colors.len() != n {
        mesh.colors.clear();
    }
    mesh.drop_unused();
    mesh
}

/// The lowest and highest corner of a box around points; infinite and inverted around none.
pub(crate) fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    (low, points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{box_mesh, open_edges, sheet, sphere};
    use scene::geometry::Surface;

    const FINE: Decimation = Decimation { error: 1e-3, color_error: None };

    #[test]
    fn a_fine_cube_stays_a_cube_at_any_scale() {
        for scale in [1e-6, 1.0, 1e6] {
            let fine = box_mesh(DVec3::new(1.0, 0.7, 0.4) * scale, 20);
            let coarse = decimated(&fine, &FINE);
            assert!(coarse.triangles.len() < 40, "{scale}: {} triangles", coarse.triangles.len());
            assert!((coarse.area() / fine.area() - 1.0).abs() < 1e-3, "{scale}");
            assert!(open_edges(&coarse).is_empty(), "{scale}: it has holes");
            let surface = Surface::new(&coarse);
            let off = fine.vertices.iter().map(|v| surface.distance(*v)).fold(0.0, f64::max);
            assert!(off < 2e-3 * scale, "{scale}: {off}");
        }
    }

    #[test]
    fn a_sphere_keeps_within_the_error_and_more_error_means_fewer_triangles() {
        let fine = sphere(1.0, 60);
        let mut before = fine.triangles.len();
        for error in [1e-4, 1e-3, 1e-2] {
            let coarse = decimated(&fine, &Decimation { error, color_error: None });
            assert!(coarse.triangles.len() < before, "{error}: {}", coarse.triangles.len());
            before = coarse.triangles.len();
            let surface = Surface::new(&coarse);
            let off: Vec<f64> = fine.vertices.iter().map(|v| surface.distance(*v)).collect();
            let rms = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
            assert!(rms < 2.0 * error * 2.0, "{error}: {rms}");
        }
    }

    #[test]
    fn borders_and_colours_are_kept() {
        let mut square = sheet(2.0, 3.0, 16);
        let border = open_edges(&square).len();
        square.colors =
            square.vertices.iter().map(|v| if v.length() < 0.6 { [255; 3] } else { [0; 3] }).collect();
        let plain = decimated(&square, &FINE);
        let coloured = decimated(&square, &Decimation { color_error: Some(0.02), ..FINE });
        assert_eq!(open_edges(&plain).len(), border);
        assert!((plain.area() - 6.0).abs() < 1e-5 && (coloured.area() - 6.0).abs() < 1e-5);
        assert!(plain.triangles.len() < coloured.triangles.len());
        assert!(coloured.triangles.len() < square.triangles.len());
        for (v, c) in coloured.vertices.iter().zip(&coloured.colors) {
            let r = v.length();
            assert!(r > 0.4 || c[0] > 200, "{v} {c:?}");
            assert!(r < 0.9 || c[0] < 55, "{v} {c:?}");
        }
    }

    #[test]
    fn what_is_broken_is_left_out_and_little_is_kept() {
        assert_eq!(decimated(&Mesh::default(), &FINE), Mesh::default());
        let mut one = Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        assert_eq!(decimated(&one, &FINE).triangles, [[0, 1, 2]]);
        one.vertices.push(DVec3::NAN);
        one.triangles.extend([[0, 1, 3], [1, 1, 2], [0, 1, 9]]);
        let kept = decimated(&one, &FINE);
        assert_eq!((kept.triangles.len(), kept.vertices.len()), (1, 3));
        one.vertices = vec![DVec3::splat(3.0); 4];
        assert!(decimated(&one, &FINE).triangles.len() <= 2, "a point");
    }
}
