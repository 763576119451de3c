//! A splat made ready for a format that packs it: what changes no picture is chosen so that it
//! compresses.

use super::item::unit;
use crate::Gaussians;
use crate::morton::morton_order;
use glam::{Mat3, Quat, Vec3};

/// A centre may be off by so much of the Gaussian's second largest standard deviation. Source:
/// chosen in trials on two splats, fox and temple_ring, which lost 0.02 to 0.04 dB at 0.05, 0.07 to
/// 0.10 dB at 0.1.
const SLACK: f32 = 0.03;

/// The Gaussians along a Morton curve, so that neighbours in the file are neighbours in space. The
/// axes of each are named and directed such that its rotation is the least of the 24 that describe
/// it.
pub(super) fn ready(g: &Gaussians) -> Gaussians {
    let order = morton_order(&g.means);
    let names = namings();
    let k = g.sh_coefficients() * 3;
    let mut ready = Gaussians { sh_degree: g.sh_degree, ..Default::default() };
    for i in order {
        let (rotation, log_scale) = least(unit(g.rotations[i]), g.log_scales[i], &names);
        ready.means.push(g.means[i]);
        ready.log_scales.push(log_scale);
        ready.rotations.push(rotation);
        ready.opacity_logits.push(g.opacity_logits[i]);
        ready.sh.extend_from_slice(&g.sh[i * k..(i + 1) * k]);
    }
    ready
}

/// The rotations that map the axes onto axes: (rotation, the old axis of each new one).
fn namings() -> Vec<(Quat, [usize; 3])> {
    let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let signs = (0..8).map(|s| [0, 1, 2].map(|axis| if s >> axis & 1 == 1 { -1.0 } else { 1.0 }));
    let all = orders.into_iter().flat_map(|order| signs.clone().map(move |sign| (order, sign)));
    all.map(|(order, sign): ([usize; 3], [f32; 3])| {
        let columns = [0, 1, 2].map(|axis| sign[axis] * Vec3::AXES[order[axis]]);
        (Mat3::from_cols(columns[0], columns[1], columns[2]), order)
    })
    .filter(|(matrix, _)| matrix.determinant() > 0.0)
    .map(|(matrix, order)| (Quat::from_mat3(&matrix), order))
    .collect()
}

/// The description of an ellipsoid with the least angle of rotation, w ≥ 0.
fn least(rotation: Quat, log_scale: Vec3, names: &[(Quat, [usize; 3])]) -> (Quat, Vec3) {
    let turned = names.iter().map(|(naming, order)| (rotation * *naming, order));
    let best = turned.max_by(|a, b| a.0.w.abs().total_cmp(&b.0.w.abs()));
    best.map_or((rotation, log_scale), |(rotation, order)| {
        let upright = if rotation.w < 0.0 { -rotation } else { rotation };
        (upright, Vec3::from(order.map(|axis| log_scale[axis])))
    })
}

/// How far the coordinates of a Gaussian's centre may be off.
pub(super) fn slack(log_scale: Vec3) -> f32 {
    let [a, b, c] = log_scale.to_array();
    SLACK * a.max(b).min(a.min(b).max(c)).exp()
}

/// The multiple of a power of two, not above 2 `slack` and from 1 to 65,536, that is next to
/// `value`.
pub(super) fn rounded(value: f32, slack: f32) -> f32 {
    let step = (2.0 * slack).clamp(1.0, 65_536.0).log2().floor().exp2();
    (value / step).round() * step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::rng;
    use rand::Rng;

    #[test]
    fn the_axes_are_named_anew_and_the_ellipsoid_is_the_same() {
        let names = namings();
        assert_eq!(names.len(), 24);
        let mut r = rng(3, "ready", 0);
        for _ in 0..500 {
            let mut v = || r.random_range(-1.0_f32..1.0);
            let (rotation, log_scale) =
                (Quat::from_xyzw(v(), v(), v(), v()).normalize(), Vec3::new(v(), v(), v()));
            let (found, scales) = least(rotation, log_scale, &names);
            let covariance = |q: Quat, s: Vec3| {
                let m = Mat3::from_quat(q) * Mat3::from_diagonal(s.exp());
                m * m.transpose()
            };
            let off = covariance(rotation, log_scale) - covariance(found, scales);
            assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-5));
            // No rotation is farther than 62.8° from a rotation of the cube.
            assert!(found.w > 0.853, "{found}");
        }
    }

    #[test]
    fn the_slack_is_that_of_the_second_axis_and_rounding_keeps_to_it() {
        for axes in [[0.0, 1.0, 2.0], [1.0, 0.0, 2.0], [2.0, 0.0, 1.0], [2.0, 1.0, 0.0]] {
            assert!((slack(axes.into()) - SLACK * 1.0_f32.exp()).abs() < 1e-6);
        }
        for (value, slack) in [(1003.3, 0.2), (1003.3, 5.0), (-77.0, 40.0), (3.0, f32::INFINITY)] {
            assert!((rounded(value, slack) - value).abs() <= slack.max(0.5), "{value} {slack}");
        }
        assert_eq!(rounded(1003.3, 5.0), 1000.0);
    }
}
