//! loss: picture and target → how far they are apart.
//!
//! in: rendered x and target y [H × W] rgb, weights w [H × W] · out: L and ∂L/∂x
//!
//! ```text
//! L = (1 − λ) L1 + λ (1 − SSIM)                                    Kerbl 2023, eq. 7
//! L1 = Σ w |x − y| / (3 Σ w)        SSIM = Σ w S / (3 Σ w)         sums over pixels and channels
//! S = (2 μx μy + c1)(2 σxy + c2) / ((μx² + μy² + c1)(σx² + σy² + c2))    Wang 2004, eq. 13, each
//! channel by itself
//! μx = G * x,  σx² = G * x² − μx²,  σxy = G * (x y) − μx μy
//! ```
//! G is an 11 × 11 Gaussian window of σ = 1.5 that sums to 1, zero outside the image; c1 = 0.01²,
//! c2 = 0.03². A pixel of weight 0 is ignored: its target is taken to be what was rendered, so that
//! windows that reach over it see no difference there, and its derivative is zero. Where all
//! weights are 0, L is 0.

use glam::DVec3;
use scene::metrics::{SSIM_K, SSIM_REACH, SSIM_SIGMA};

/// Values of the loss.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ReferenceLoss {
    /// L.
    pub(crate) loss: f64,
    /// L1.
    pub(crate) l1: f64,
    /// Mean SSIM.
    pub(crate) ssim: f64,
    /// Mean squared error, weighted as L1.
    pub(crate) mse: f64,
    /// [H × W] ∂L/∂x.
    pub(crate) gradient: Vec<DVec3>,
}

/// G * image, zero outside. The window is symmetric, so this is its own adjoint.
fn blur(image: &[DVec3], width: usize, height: usize) -> Vec<DVec3> {
    let radius = SSIM_REACH as i64;
    let weight = |d: i64| (-(d * d) as f64 / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp();
    let norm: f64 = (-radius..=radius).map(weight).sum();
    let along = |image: &[DVec3], step: (i64, i64)| -> Vec<DVec3> {
        let at = |x: i64, y: i64| {
            let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
            if inside { image[y as usize * width + x as usize] } else { DVec3::ZERO }
        };
        let pixel = |i: usize| {
            let (x, y) = ((i % width) as i64, (i / width) as i64);
            let taps = (-radius..=radius).map(|d| weight(d) / norm * at(x + d * step.0, y + d * step.1));
            taps.fold(DVec3::ZERO, |a, b| a + b)
        };
        (0..image.len()).map(pixel).collect()
    };
    along(&along(image, (1, 0)), (0, 1))
}

/// SSIM of a pixel and its derivatives with respect to μx, G * x² and G * xy.
fn similarity(mx: DVec3, my: DVec3, xx: DVec3, yy: DVec3, xy: DVec3) -> [DVec3; 4] {
    let [c1, c2] = SSIM_K.map(|k| k * k);
    let (a1, b1) = (2.0 * mx * my + c1, mx * mx + my * my + c1);
    let (a2, b2) = (2.0 * (xy - mx * my) + c2, (xx - mx * mx) + (yy - my * my) + c2);
    let s = a1 * a2 / (b1 * b2);
    let by_mx = (2.0 * my * a2 - 2.0 * my * a1) / (b1 * b2) - s * (2.0 * mx / b1 - 2.0 * mx / b2);
    [s, by_mx, -s / b2, 2.0 * a1 / (b1 * b2)]
}

/// L and its derivative. `rendered`, `target` [H × W]; `weights` [H × W] or all 1.
pub(crate) fn loss(
    rendered: &[DVec3],
    target: &[DVec3],
    weights: Option<&[f64]>,
    width: usize,
    lambda: f64,
) -> ReferenceLoss {
    let n = rendered.len();
    let height = n.checked_div(width).unwrap_or(0);
    let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
    let count: f64 = 3.0 * (0..n).map(weight).sum::<f64>();
    if count <= 0.0 {
        return ReferenceLoss { ssim: 1.0, gradient: vec![DVec3::ZERO; n], ..ReferenceLoss::default() };
    }
    let y: Vec<_> = (0..n).map(|i| if weight(i) > 0.0 { target[i] } else { rendered[i] }).collect();
    let of = |f: &dyn Fn(usize) -> DVec3| blur(&(0..n).map(f).collect::<Vec<_>>(), width, height);
    let x = rendered;
    let (mx, my) = (of(&|i| x[i]), of(&|i| y[i]));
    let (xx, yy, xy) = (of(&|i| x[i] * x[i]), of(&|i| y[i] * y[i]), of(&|i| x[i] * y[i]));
    let maps: Vec<_> =
        (0..n).map(|i| similarity(mx[i], my[i], xx[i], yy[i], xy[i]).map(|v| v * weight(i))).collect();
    let (by_mx, by_xx, by_xy) = (of(&|i| maps[i][1]), of(&|i| maps[i][2]), of(&|i| maps[i][3]));

    let mean = |f: &dyn Fn(usize) -> DVec3| (0..n).map(|i| f(i).element_sum()).sum::<f64>() / count;
    let l1 = mean(&|i| weight(i) * (x[i] - y[i]).abs());
    let mse = mean(&|i| weight(i) * (x[i] - y[i]) * (x[i] - y[i]));
    let ssim = mean(&|i| maps[i][0]);
    let gradient = |i: usize| {
        if weight(i) <= 0.0 {
            return DVec3::ZERO;
        }
        let sign = (x[i] - y[i]).map(|d| if d == 0.0 { 0.0 } else { d.signum() });
        let by_ssim = by_mx[i] + 2.0 * x[i] * by_xx[i] + y[i] * by_xy[i];
        ((1.0 - lambda) * weight(i) * sign - lambda * by_ssim) / count
    };
    ReferenceLoss {
        loss: (1.0 - lambda) * l1 + lambda * (1.0 - ssim),
        l1,
        ssim,
        mse,
        gradient: (0..n).map(gradient).collect(),
    }
}

/// What the picture should be where a mask means coverage: image · m + background (1 − m).
pub(crate) fn over_background(image: DVec3, coverage: f64, background: DVec3) -> DVec3 {
    image * coverage + background * (1.0 - coverage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    fn random(seed: u64, n: usize) -> Vec<DVec3> {
        let mut rng = scene::rng::rng(seed, "loss test", 0);
        (0..n).map(|_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..1.0)))).collect()
    }

    #[test]
    fn its_gradient_is_its_finite_difference_with_and_without_weights() {
        let (width, n) = (9, 9 * 14);
        for seed in 0..4 {
            let (mut x, y) = (random(seed, n), random(seed + 100, n));
            let weights: Vec<f64> =
                random(seed + 200, n).iter().map(|v| if v.x < 0.3 { 0.0 } else { v.y }).collect();
            for (weights, lambda) in
                [(None, 0.2), (None, 1.0), (Some(weights.as_slice()), 0.0), (Some(&weights), 0.2)]
            {
                let g = loss(&x, &y, weights, width, lambda).gradient;
                // Where the weight is 0 the target follows the picture: no derivative to take.
                for i in (0..n).filter(|&i| weights.is_none_or(|w| w[i] > 0.0)) {
                    for c in 0..3 {
                        let (h, kept) = (1e-6, x[i][c]);
                        x[i][c] = kept + h;
                        let right = loss(&x, &y, weights, width, lambda).loss;
                        x[i][c] = kept - h;
                        let left = loss(&x, &y, weights, width, lambda).loss;
                        x[i][c] = kept;
                        let numeric = (right - left) / (2.0 * h);
                        let error = (numeric - g[i][c]).abs() / g[i][c].abs().max(1e-4);
                        assert!(error < 1e-5, "seed {seed} pixel {i}: {} should be {numeric}", g[i][c]);
                    }
                }
            }
        }
    }

    #[test]
    fn equal_pictures_have_no_loss_and_no_gradient() {
        for value in [0.0, 0.5, 1.0] {
            let x = vec![DVec3::splat(value); 300];
            let l = loss(&x, &x, None, 20, 0.2);
            assert!(l.loss.abs() < 1e-12 && (l.ssim - 1.0).abs() < 1e-12);
            assert!(l.gradient.iter().all(|g| g.length() < 1e-12));
        }
    }

    #[test]
    fn an_empty_mask_is_no_loss_and_what_is_masked_is_not_seen() {
        let (x, mut y) = (random(1, 400), random(2, 400));
        let none = loss(&x, &y, Some(&[0.0; 400]), 20, 0.2);
        assert_eq!((none.loss, none.gradient), (0.0, vec![DVec3::ZERO; 400]));
        let weights: Vec<f64> = (0..400).map(|i| if i % 20 < 12 { 1.0 } else { 0.0 }).collect();
        let a = loss(&x, &y, Some(&weights), 20, 0.2);
        (0..400).filter(|i| i % 20 >= 12).for_each(|i| y[i] = DVec3::splat(1e3));
        assert_eq!(a, loss(&x, &y, Some(&weights), 20, 0.2));
    }

    #[test]
    fn opposite_checkerboards_are_as_unlike_as_can_be() {
        let board = |phase: usize| {
            (0..32 * 32).map(|i| DVec3::splat(((i / 32 + i % 32 + phase) % 2) as f64)).collect()
        };
        let (a, b): (Vec<_>, Vec<_>) = (board(0), board(1));
        let l = loss(&a, &b, None, 32, 0.2);
        assert!(l.ssim < -0.85 && (l.l1 - 1.0).abs() < 1e-12, "{}", l.ssim);
    }
}
