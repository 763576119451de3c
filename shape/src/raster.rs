//! Which squares of a grid a triangle covers.

use glam::DVec2;

/// Walks over the squares, of side 1, whose middles lie in a triangle: with the weights of its
/// corners.
pub(crate) fn covered(corners: [DVec2; 3], mut visit: impl FnMut([i64; 2], [f64; 3])) {
    let [a, b, c] = corners;
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let (low, high) = (a.min(b).min(c).floor(), a.max(b).max(c).ceil());
    for y in low.y as i64..high.y as i64 {
        for x in low.x as i64..high.x as i64 {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let u = (c - b).perp_dot(p - b) / area;
            let v = (a - c).perp_dot(p - c) / area;
            let w = 1.0 - u - v;
            if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                visit([x, y], [u, v, w]);
            }
        }
    }
}
