//! Outlines of parts of a matte that are too thin for depths to tell their sides apart.
//!
//! Truncated distances from both sides of a rod cancel where the rod is thinner than the
//! truncation. Its outline in the mattes is sharp, and views from all around bound it.

/// Thin parts of a mask (`white`, rows of this width): the way to their outline.
///
/// Returns [height × width] pixels to the outline, negative inside: of white pixels that no white
/// disc of this radius reaches, and of black ones within the radius of those that have no other
/// white pixel nearer. NaN elsewhere.
pub(crate) fn thin_parts(white: &[bool], width: usize, radius: f64) -> Vec<f32> {
    let black: Vec<bool> = white.iter().map(|w| !w).collect();
    let inwards = distances(&black, width, radius);
    let core: Vec<bool> = white.iter().zip(&inwards).map(|(w, d)| *w && *d >= radius).collect();
    let from_core = distances(&core, width, radius);
    let thin: Vec<bool> = white.iter().zip(&from_core).map(|(w, d)| *w && *d > radius).collect();
    let (from_thin, from_white) = (distances(&thin, width, radius), distances(white, width, radius));
    (0..white.len())
        .map(|i| match white[i] {
            // The outline is half a pixel from the middle of the last one.
            true if thin[i] => (0.5 - inwards[i]) as f32,
            false if from_thin[i] <= radius && from_thin[i] <= from_white[i] => (from_thin[i] - 0.5) as f32,
            _ => f32::NAN,
        })
        .collect()
}

/// [height × width] pixels to the nearest of these; infinite beyond the radius.
fn distances(these: &[bool], width: usize, radius: f64) -> Vec<f64> {
    let (mut nearest, reach) = (vec![f64::INFINITY; these.len()], radius.ceil() as usize);
    let rows = these.len() / width.max(1);
    for (i, _) in these.iter().enumerate().filter(|(_, is_one)| **is_one) {
        let (x, y) = (i % width, i / width);
        for v in y.saturating_sub(reach)..(y + reach + 1).min(rows) {
            for u in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                let distance = (u.abs_diff(x) as f64).hypot(v.abs_diff(y) as f64);
                if distance <= radius {
                    let known = &mut nearest[v * width + u];
                    *known = known.min(distance);
                }
            }
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rod_has_an_outline_and_a_body_has_none() {
        let (w, h) = (40, 30);
        // A body of 12 × 12 pixels, and a rod 3 pixels wide that stands on it.
        let is_white = |x: usize, y: usize| {
            (10..22).contains(&x) && (15..27).contains(&y) || (14..17).contains(&x) && (3..15).contains(&y)
        };
        let white: Vec<bool> = (0..w * h).map(|i| is_white(i % w, i / w)).collect();
        let outline = thin_parts(&white, w, 2.25);
        let at = |x: usize, y: usize| outline[y * w + x];
        assert_eq!([at(15, 8), at(14, 8), at(13, 8), at(12, 8)], [-1.5, -0.5, 0.5, 1.5]);
        assert!(at(11, 8).is_nan() && at(15, 20).is_nan() && at(9, 20).is_nan());
        assert!(thin_parts(&[], 1, 2.25).is_empty());
        // Nothing is thin for a radius of nothing.
        assert!(thin_parts(&white, w, 0.0).iter().all(|s| s.is_nan()));
    }
}
