//! What a found shape is: a rectangle-like plane, a disc, a cylinder, with its sizes.

use super::elements::{Elements, cube};
use super::outline::{CELLS, convex_hull, least_rectangle, length, outline_circle};
use super::primitive::{CELL, Found, Primitive, flat, frame};
use super::types::{Feature, FeatureKind, MeasureOptions, Size};
use glam::{DVec2, DVec3};
use scene::motion_report::Estimate;
use std::collections::HashSet;
use std::f64::consts::TAU;

/// A disc's outline is off its circle by at most this share of the radius, root mean square; that
/// of a regular hexagon is by 0.04. Source: derived.
const ROUND: f64 = 0.03;
/// A disc fills at least this share of its circle. Source: chosen by hand, never measured.
const FULL: f64 = 0.5;

fn corners(elements: &Elements, of: &[usize]) -> impl Iterator<Item = DVec3> {
    of.iter().flat_map(|&i| elements.corners[i])
}

/// Measures a shape; lengths in scene units.
pub(crate) fn feature(elements: &Elements, found: &Found, options: &MeasureOptions) -> Feature {
    let rms = found.primitive.rms(elements, &found.elements);
    let ends = with_rim(elements, found, options.tolerance);
    let area = elements.area(&found.elements);
    let middle = found.elements.iter().map(|&i| elements.middle(i) * elements.areas[i]).sum::<DVec3>() / area;
    let axis = found.primitive.axis();
    let mut feature = Feature {
        kind: FeatureKind::Plane,
        centre: middle.to_array(),
        axis: axis.to_array(),
        axis_deviation_deg: found.deviations.angle.to_degrees(),
        offset_deviation: found.deviations.offset * elements.scale,
        sizes: vec![],
        area: area * elements.scale.powi(2),
        rms: rms * elements.scale,
        coverage_deg: None,
    };
    let mut centre = middle;
    match found.primitive {
        Primitive::Plane { point, normal } => {
            centre -= normal * (centre - point).dot(normal);
            plane_or_disc(&mut feature, &mut centre, &ends, [area, rms, options.tolerance]);
        }
        Primitive::Cylinder { point, axis, radius, .. } => {
            let points: Vec<(f64, usize)> = ends.iter().map(|x| along(*x - point, axis)).collect();
            let (at, long) = length(&points, options.tolerance, rms);
            centre = point + axis * at;
            let diameter = Estimate { value: 2.0 * radius, deviation: 2.0 * found.deviations.radius };
            feature.kind = FeatureKind::Cylinder;
            feature.sizes = vec![Size::Diameter(diameter), Size::Length(long)];
            feature.coverage_deg = Some(found.coverage_deg(elements));
        }
    }
    feature.centre = (elements.centre + centre * elements.scale).to_array();
    feature.sizes.iter_mut().for_each(|size| {
        let e = size.estimate_mut();
        e.value *= elements.scale;
        e.deviation *= elements.scale;
    });
    feature
}

/// Height along an axis, and in which sector round it.
fn along(x: DVec3, axis: DVec3) -> (f64, usize) {
    let p = flat(x, axis);
    let turn = (p.y.atan2(p.x) / TAU + 1.0).fract();
    (x.dot(axis), (turn * CELLS as f64) as usize % CELLS)
}

/// Corners of a shape's elements, and of those beside them that lie within `tolerance` of it
/// however they face: a rounded edge belongs to both of its faces.
fn with_rim(elements: &Elements, found: &Found, tolerance: f64) -> Vec<DVec3> {
    let cell = CELL * tolerance;
    let cubes: HashSet<[i64; 3]> = corners(elements, &found.elements).map(|x| cube(x, cell)).collect();
    let beside = (0..elements.areas.len()).filter(|&i| {
        found.primitive.holds(elements, i, tolerance)
            && elements.corners[i].iter().any(|x| cubes.contains(&cube(*x, cell)))
    });
    let all: Vec<usize> = found.elements.iter().copied().chain(beside).collect();
    corners(elements, &all).collect()
}

/// A disc where the outline is round, else a plane with the sides of the least rectangle around it.
fn plane_or_disc(feature: &mut Feature, centre: &mut DVec3, ends: &[DVec3], limits: [f64; 3]) {
    let [area, rms, tolerance] = limits;
    let normal = DVec3::from_array(feature.axis);
    let [u, v] = frame(normal);
    let points: Vec<DVec2> = ends.iter().map(|x| flat(*x - *centre, normal)).collect();
    let circle = outline_circle(&points, DVec2::ZERO);
    let is_round = circle.filter(|c| {
        c.rms <= tolerance.min(ROUND * c.radius) && area >= FULL * std::f64::consts::PI * c.radius.powi(2)
    });
    if let Some(circle) = is_round {
        *centre += u * circle.centre.x + v * circle.centre.y;
        let deviation = 2.0 * circle.deviation.hypot(rms);
        feature.kind = FeatureKind::Disc;
        feature.sizes = vec![Size::Diameter(Estimate { value: 2.0 * circle.radius, deviation })];
        return;
    }
    let (side, _) = least_rectangle(&convex_hull(points.iter().copied()));
    let mut sizes = [side, side.perp()].map(|along| {
        let heights: Vec<f64> = points.iter().map(|p| p.dot(along.perp())).collect();
        let cells = cells_of(&heights, CELLS);
        let ends: Vec<(f64, usize)> = points.iter().map(|p| p.dot(along)).zip(cells).collect();
        (along, length(&ends, tolerance, rms))
    });
    for (along, (at, _)) in &sizes {
        *centre += (u * along.x + v * along.y) * *at;
    }
    sizes.sort_by(|a, b| b.1.1.value.total_cmp(&a.1.1.value));
    feature.sizes = vec![Size::Length(sizes[0].1.1), Size::Width(sizes[1].1.1)];
}

/// In which of `count` cells between the lowest and the highest each value lies.
pub(crate) fn cells_of(values: &[f64], count: usize) -> Vec<usize> {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let range = if high > low { high - low } else { 1.0 };
    values.iter().map(|v| (((v - low) / range * count as f64) as usize).min(count - 1)).collect()
}
