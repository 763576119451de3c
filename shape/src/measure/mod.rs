//! What a mission planner measures on a surface: overall dimensions, planes, discs and cylinders,
//! the angles and distances between them, each with its standard deviation.
//!
//! A deviation says how far the surface scatters about the shape, and holds where errors of
//! neighbours are alike. What moves the surface as a whole, such as the scale, is not in it.

mod elements;
mod feature;
mod least_squares;
mod oriented_box;
pub(crate) mod outline;
pub(crate) mod primitive;
mod search;
mod side_view;
#[cfg(test)]
mod tests;
mod types;

use elements::Elements;
use glam::DVec3;
use scene::geometry::Mesh;
use scene::motion_report::Estimate;
use scene::{Cancelled, Progress};

pub use side_view::{SideView, side_views};
pub use types::{Feature, FeatureKind, FeatureRelation, MeasureOptions, Measures, OrientedBox, Size};

/// Shapes of which relations are told. Source: derived: 28 pairs fit a screen.
const RELATED: usize = 8;
/// Parallel is what differs by no more, degrees. Source: chosen by hand, never measured.
const PARALLEL_DEG: f64 = 1.0;

/// Measures a mesh; and says of each of its triangles to which of the features it belongs. `None`
/// of a mesh without a triangle that has an area.
pub fn measure(
    mesh: &Mesh,
    options: &MeasureOptions,
    progress: &Progress,
) -> Result<Option<(Measures, Vec<Option<usize>>)>, Cancelled> {
    let Some(elements) = Elements::new(mesh) else { return Ok(None) };
    let found = search::shapes(&elements, options, progress)?;
    let features: Vec<Feature> = found.iter().map(|f| feature::feature(&elements, f, options)).collect();
    let shaped: f64 = features.iter().map(|f| f.area).sum();
    let noise = features.iter().map(|f| f.rms * f.area / elements.scale).sum::<f64>() / shaped;
    // Without any shape nothing is known of the noise but the tolerance.
    let noise = if shaped > 0.0 { noise } else { options.tolerance };
    let directions: Vec<DVec3> = features.iter().map(|f| DVec3::from_array(f.axis)).collect();
    let overall = oriented_box::oriented_box(&elements, &directions, options, noise);
    let mut labels = vec![None; mesh.triangles.len()];
    for (label, shape) in found.iter().enumerate() {
        shape.elements.iter().for_each(|&i| labels[elements.source[i] as usize] = Some(label));
    }
    let all: Vec<usize> = (0..elements.areas.len()).collect();
    let area = elements.area(&all) * elements.scale.powi(2);
    let relations = relations(&features);
    Ok(Some((Measures { overall, features, relations, area }, labels)))
}

fn relations(features: &[Feature]) -> Vec<FeatureRelation> {
    let count = features.len().min(RELATED);
    let pairs = (0..count).flat_map(|i| (i + 1..count).map(move |j| [i, j]));
    pairs.map(|between| relation(features, between)).collect()
}

fn relation(features: &[Feature], between: [usize; 2]) -> FeatureRelation {
    let [a, b] = between.map(|i| &features[i]);
    let (n, m) = (DVec3::from_array(a.axis), DVec3::from_array(b.axis));
    let value = n.cross(m).length().atan2(n.dot(m).abs()).to_degrees();
    let deviation = a.axis_deviation_deg.hypot(b.axis_deviation_deg);
    let is_flat = a.kind != FeatureKind::Cylinder && b.kind != FeatureKind::Cylinder;
    let is_parallel = value <= PARALLEL_DEG.max(deviation);
    let apart = DVec3::from_array(b.centre) - DVec3::from_array(a.centre);
    let normal = if n.dot(m) < 0.0 { n - m } else { n + m }.normalize_or(n);
    // Across a tilt the distance depends on where it is taken.
    let tilt = apart.reject_from_normalized(normal).length() / 2.0 * deviation.to_radians();
    let distance = Estimate {
        value: apart.dot(normal).abs(),
        deviation: a.offset_deviation.hypot(b.offset_deviation).hypot(tilt),
    };
    FeatureRelation {
        between,
        angle_deg: Estimate { value, deviation },
        distance: (is_flat && is_parallel).then_some(distance),
    }
}
