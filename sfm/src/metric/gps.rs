//! Scale from the places that EXIF names.

use glam::DVec3;
use scene::decision::ScaleEvidence;
use scene::io::exif::GpsPosition;
use scene::sim3::robust_alignment;
use scene::{FrameSet, MetricScale, Reconstruction};

/// Radius of a ball with the Earth's volume, metres. Source: WGS 84; on the ellipsoid lengths are
/// within 0.4 % of it.
const EARTH_M: f64 = 6_371_000.8;
/// A scale that is less certain is left alone, share. Source: chosen by hand: it would be taken for
/// exact.
const MOST_UNCERTAIN: f64 = 0.05;

/// From at least four photos whose places fit the cameras' so well that the scale is certain to a
/// twentieth: flights about buildings, not walks about a table.
pub(super) fn scale(model: &Reconstruction, frames: &FrameSet) -> Option<MetricScale> {
    let places = frames.frames.iter().filter_map(|f| {
        let image = model.images.values().find(|i| i.name == f.name)?;
        Some((image.pose.centre(), f.gps?))
    });
    let (centres, places): (Vec<DVec3>, Vec<GpsPosition>) = places.unzip();
    let metres = local(&places)?;
    let (sim, inliers) = robust_alignment(&centres, &metres).filter(|_| centres.len() > 3)?;
    let pairs = centres.iter().zip(&metres).zip(&inliers).filter(|(_, good)| **good);
    let pairs: Vec<(DVec3, DVec3)> = pairs.map(|((c, m), _)| (*c, *m)).collect();
    let count = pairs.len() as f64;
    let mean = pairs.iter().map(|p| p.1).sum::<DVec3>() / count;
    let residual: f64 = pairs.iter().map(|(c, m)| sim.transform(*c).distance_squared(*m)).sum();
    let spread: f64 = pairs.iter().map(|(_, m)| m.distance_squared(mean)).sum();
    // Variance of the scale of a similarity: σ² / Σ |x − x̄|²; three coordinates a place, seven
    // parameters.
    let variance = residual / (3.0 * count - 7.0);
    let deviation = (variance / spread).sqrt();
    let certain = deviation < MOST_UNCERTAIN && pairs.len() > 3;
    certain.then_some(MetricScale {
        evidence: ScaleEvidence::Gps(pairs.len()),
        metres_per_unit: sim.scale,
        relative_deviation: Some(deviation),
    })
}

/// East, north and up of the first place, metres; altitudes count only where all are known.
fn local(places: &[GpsPosition]) -> Option<Vec<DVec3>> {
    let first = places.first()?;
    let known = places.iter().all(|p| p.altitude_m.is_some());
    let narrow = first.latitude_deg.to_radians().cos();
    Some(
        places
            .iter()
            .map(|p| {
                let east = (p.longitude_deg - first.longitude_deg).to_radians() * narrow * EARTH_M;
                let north = (p.latitude_deg - first.latitude_deg).to_radians() * EARTH_M;
                let rise = p.altitude_m.zip(first.altitude_m).map_or(0.0, |(a, b)| a - b);
                DVec3::new(east, north, if known { rise } else { 0.0 })
            })
            .collect(),
    )
}
