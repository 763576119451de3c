//! The box around all.

use super::elements::Elements;
use super::feature::cells_of;
use super::outline::{CELLS, convex_hull, least_rectangle, length};
use super::primitive::frame;
use super::types::{MeasureOptions, OrientedBox};
use glam::{DVec2, DVec3};
use scene::motion_report::Estimate;

/// Turns of the search in which the box's own axes are tried. Source: chosen by hand, never
/// measured.
const TURNS: usize = 4;

/// Boxes whose volumes differ by less, in cubes of the longest side, have the same. Source:
/// rounding.
const NOTHING: f64 = 1e-12;

/// The least of the boxes that have one of these directions, or an axis of the frame, as an axis
/// (O'Rourke, IJCIS 1985: the least box has a face on an edge of the hull; here the rectangle
/// across the axis does). Its own axes are tried in turn until it gets no smaller.
pub(crate) fn oriented_box(
    elements: &Elements,
    directions: &[DVec3],
    options: &MeasureOptions,
    noise: f64,
) -> OrientedBox {
    let mut points: Vec<DVec3> = elements.corners.iter().flatten().copied().collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
    points.dedup();
    let mut axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let mut least = [f64::INFINITY; 2];
    let mut tried: Vec<DVec3> = axes.iter().chain(directions).copied().collect();
    for _ in 0..TURNS {
        let before = least;
        for &direction in &tried {
            let (found, [volume, surface]) = box_along(&points, direction);
            // All boxes around something flat have no volume.
            let is_as_small = volume <= least[0] + NOTHING && surface < least[1];
            if volume < least[0] - NOTHING || is_as_small {
                (axes, least) = (found, [volume, surface]);
            }
        }
        if least == before {
            break;
        }
        tried = axes.to_vec();
    }
    let mut sides = axes.map(|axis| side(&points, axis, axes, options.tolerance, noise));
    let centre: DVec3 = axes.iter().zip(&sides).map(|(axis, (at, _))| *axis * *at).sum();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| sides[b].1.value.total_cmp(&sides[a].1.value));
    for (_, estimate) in &mut sides {
        estimate.value *= elements.scale;
        estimate.deviation *= elements.scale;
    }
    OrientedBox {
        sides: order.map(|i| sides[i].1),
        axes: order.map(|i| axes[i].to_array()),
        centre: (elements.centre + centre * elements.scale).to_array(),
    }
}

/// The least box with this axis, its volume and its surface.
fn box_along(points: &[DVec3], axis: DVec3) -> ([DVec3; 3], [f64; 2]) {
    let [u, v] = frame(axis);
    let hull = convex_hull(points.iter().map(|p| DVec2::new(p.dot(u), p.dot(v))));
    let (along, sides) = least_rectangle(&hull);
    let low = points.iter().map(|p| p.dot(axis)).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|p| p.dot(axis)).fold(f64::NEG_INFINITY, f64::max);
    let first = (u * along.x + v * along.y).normalize_or(u);
    let (base, height) = (sides.element_product(), high - low);
    let surface = 2.0 * (base + (sides.x + sides.y) * height);
    ([axis, first, axis.cross(first)], [base * height, surface])
}

/// Middle and length along one of three axes.
fn side(points: &[DVec3], axis: DVec3, axes: [DVec3; 3], tolerance: f64, noise: f64) -> (f64, Estimate) {
    let across: Vec<DVec3> = axes.into_iter().filter(|a| *a != axis).collect();
    let cells: Vec<Vec<usize>> = across
        .iter()
        .map(|a| cells_of(&points.iter().map(|p| p.dot(*a)).collect::<Vec<_>>(), CELLS))
        .collect();
    let heights = points.iter().enumerate().map(|(i, p)| {
        let cell = cells.iter().fold(0, |sum, c| sum * CELLS + c[i]);
        (p.dot(axis), cell)
    });
    length(&heights.collect::<Vec<_>>(), tolerance, noise)
}
