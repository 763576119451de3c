//! Lamps as they might be.

use glam::DVec3;

/// Directions spread evenly over the sphere (Fibonacci's spiral).
pub(crate) fn sphere(count: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5_f64.sqrt());
    (0..count)
        .map(|k| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
            let angle = golden * k as f64;
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * angle.cos(), r * angle.sin(), z)
        })
        .collect()
}

/// Direction (camera frame) and ambient light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trial {
    pub(crate) towards: DVec3,
    pub(crate) ambient: f64,
}
