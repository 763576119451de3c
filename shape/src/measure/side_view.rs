//! The surface seen from three sides, without perspective, as a drawing shows it.

use super::types::OrientedBox;
use crate::raster::covered;
use glam::{DVec2, DVec3};
use scene::geometry::Mesh;

/// What is seen from one side: the nearest surface at each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct SideView {
    /// Which axes of the box point to the right and up.
    pub axes: [usize; 2],
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// [height × width] cosine of the angle between the line of sight and the surface, and the
    /// place of its triangle in the mesh; `None` where nothing is.
    pub pixels: Vec<Option<(f32, usize)>>,
}

/// The mesh from the three sides of a box: with the longest axis to the right and each of the
/// others up, and with the shortest to the right and the middle one up. All have the same scale:
/// the box's longest side is so many pixels long.
pub fn side_views(mesh: &Mesh, around: &OrientedBox, pixels: usize) -> [SideView; 3] {
    [[0, 1], [2, 1], [0, 2]].map(|axes| side_view(mesh, around, axes, pixels))
}

fn side_view(mesh: &Mesh, around: &OrientedBox, axes: [usize; 2], pixels: usize) -> SideView {
    let [right, up] = axes.map(|i| DVec3::from_array(around.axes[i]));
    let towards = right.cross(up);
    let scale = pixels as f64 / around.sides[0].value.max(f64::MIN_POSITIVE);
    let [width, height] = axes.map(|i| ((around.sides[i].value * scale).round() as usize).clamp(1, pixels));
    let centre = DVec3::from_array(around.centre);
    let middle = DVec2::new(width as f64, height as f64) / 2.0;
    let mut view = SideView { axes, width, height, pixels: vec![None; width * height] };
    let mut nearest = vec![f64::NEG_INFINITY; width * height];
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let corners =
            triangle.map(|v| mesh.vertices.get(v as usize).map_or(DVec3::NAN, |x| (*x - centre) * scale));
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let flat = corners.map(|x| middle + DVec2::new(x.dot(right), -x.dot(up)));
        covered(flat, |[x, y], weights| {
            let depth: f64 = corners.iter().zip(weights).map(|(c, w)| c.dot(towards) * w).sum();
            if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                let at = y as usize * width + x as usize;
                if depth > nearest[at] {
                    nearest[at] = depth;
                    view.pixels[at] = Some((normal.dot(towards).abs() as f32, i));
                }
            }
        });
    }
    view
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{MeasureOptions, measure};
    use crate::testing::box_mesh;
    use scene::Progress;

    #[test]
    fn a_box_fills_its_three_sides_with_one_face_each() {
        let mesh = box_mesh(DVec3::new(0.4, 1.0, 0.7), 3);
        let options = MeasureOptions { tolerance: 0.005, least_share: 0.01, most_shapes: 20, seed: 0 };
        let (measures, labels) = measure(&mesh, &options, &Progress::silent()).unwrap().unwrap();
        let views = side_views(&mesh, &measures.overall, 100);
        for (view, size) in views.iter().zip([[100, 70], [40, 70], [100, 40]]) {
            assert_eq!([view.width, view.height], size);
            let seen: Vec<usize> = view.pixels.iter().flatten().map(|(_, i)| labels[*i].unwrap()).collect();
            assert_eq!(seen.len(), view.width * view.height, "no gaps");
            assert!(seen.iter().all(|label| *label == seen[0]), "one face is seen");
            assert!(view.pixels.iter().flatten().all(|(cosine, _)| *cosine > 0.999));
        }
        assert_eq!(side_views(&Mesh::default(), &measures.overall, 10)[0].pixels, vec![None; 70]);
    }
}
