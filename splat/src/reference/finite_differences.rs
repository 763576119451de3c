//! The backward functions against central differences of the forward ones.

use super::rasterise::{ImageGradient, contributions};
use super::render::{backward, render};
use super::{Options, Parameters, ReferenceView};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rand::Rng;

/// Random Gaussians in front of a small camera: many overlap, some lie partly outside the picture.
pub(super) fn random_scene(seed: u64, n: usize, sh_degree: u32) -> (Parameters, ReferenceView) {
    let mut rng = scene::rng::rng(seed, "reference scene", 0);
    let mut real = |low: f64, high: f64| rng.random_range(low..high);
    let mut p = Parameters { sh_degree, ..Parameters::default() };
    for _ in 0..n {
        p.means.push(DVec3::new(real(-0.9, 0.9), real(-0.7, 0.7), real(-0.6, 0.6)));
        p.log_scales.push(DVec3::new(real(-4.0, -1.0), real(-4.0, -1.0), real(-4.0, -1.0)));
        p.rotations.push(DQuat::from_xyzw(
            real(-1.0, 1.0),
            real(-1.0, 1.0),
            real(-1.0, 1.0),
            real(-1.0, 1.0),
        ));
        p.opacity_logits.push(real(-4.0, 4.0));
        let stride = p.sh_stride();
        p.sh.extend((0..stride).map(|_| real(-0.5, 0.5)));
    }
    let rotation = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(
        real(-0.3, 0.3),
        real(-0.3, 0.3),
        real(-3.0, 3.0),
    )));
    let view = ReferenceView {
        rotation,
        translation: DVec3::new(real(-0.2, 0.2), real(-0.2, 0.2), 2.0),
        focal: DVec2::new(20.0, 22.0),
        centre: DVec2::new(10.3, 7.9),
        width: 20,
        height: 16,
    };
    (p, view)
}

/// L = Σ w · picture with random weights, and ∂L/∂picture.
pub(super) fn random_loss(seed: u64, pixels: usize) -> ImageGradient {
    let mut rng = scene::rng::rng(seed, "reference loss", 0);
    let mut real = || rng.random_range(-1.0..1.0);
    ImageGradient {
        rgb: (0..pixels).map(|_| DVec3::new(real(), real(), real())).collect(),
        alpha: (0..pixels).map(|_| real()).collect(),
        depth: (0..pixels).map(|_| real()).collect(),
    }
}

/// L, and which cut-offs decide it: differences across a change of them are not derivatives.
fn evaluate(p: &Parameters, view: &ReferenceView, options: &Options, w: &ImageGradient) -> (f64, Vec<u64>) {
    let r = render(p, view, options);
    let mut sum = 0.0;
    let mut cut_offs = Vec::new();
    for i in 0..view.pixels() {
        sum += w.rgb[i].dot(r.picture.rgb[i])
            + w.alpha[i] * r.picture.alpha[i]
            + w.depth[i] * r.picture.depth[i];
        let centre = DVec2::new((i % view.width) as f64 + 0.5, (i / view.width) as f64 + 0.5);
        let (list, _) = contributions(&r.projected, &r.order, centre);
        let fnv = |h: u64, v: u64| (h ^ v).wrapping_mul(0x0100_0000_01b3);
        cut_offs.push(list.iter().fold(1, |h, c| fnv(h, 2 * c.gaussian as u64 + u64::from(c.clamped))));
    }
    for (i, colour) in r.colours.iter().enumerate() {
        cut_offs.push(colour.to_array().iter().fold(i as u64, |h, &c| 2 * h + u64::from(c > 0.0)));
    }
    (sum, cut_offs)
}

/// Number `k` of the parameters as one long vector, 11 + 3K a Gaussian.
fn component(p: &mut Parameters, k: usize) -> (&mut f64, &'static str) {
    let stride = p.sh_stride();
    let (i, k) = (k / (11 + stride), k % (11 + stride));
    let q = &mut p.rotations[i];
    match k {
        0..3 => (&mut p.means[i][k], "mean"),
        3..6 => (&mut p.log_scales[i][k - 3], "log-scale"),
        6 => (&mut q.w, "rotation"),
        7 => (&mut q.x, "rotation"),
        8 => (&mut q.y, "rotation"),
        9 => (&mut q.z, "rotation"),
        10 => (&mut p.opacity_logits[i], "opacity"),
        _ => (&mut p.sh[i * stride + k - 11], "sh"),
    }
}

/// Compares; `at(h)` is L with the variable moved by h. Whether it could be checked away from
/// cut-offs.
fn agrees(at: &dyn Fn(f64) -> (f64, Vec<u64>), analytic: f64, floor: f64, what: &str) -> bool {
    let h = 2e-6;
    let ((right, right_cut), (left, left_cut)) = (at(h), at(-h));
    if right_cut != left_cut {
        return false;
    }
    let numeric = (right - left) / (2.0 * h);
    let error = (numeric - analytic).abs() / analytic.abs().max(floor);
    assert!(error < 1e-5, "{what}: {analytic} should be {numeric}, relative error {error:e}");
    true
}

fn check_scene(seed: u64, sh_degree: u32, options: &Options) {
    let (p, view) = random_scene(seed, 12, sh_degree);
    let w = random_loss(seed, view.pixels());
    let r = render(&p, &view, options);
    let g = backward(&p, &view, options, &r, &w);
    let count = p.len() * (11 + p.sh_stride());
    let mut analytic = g.parameters.clone();
    let values: Vec<f64> = (0..count).map(|k| *component(&mut analytic, k).0).collect();
    let largest = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut checked = 0;
    for (k, &value) in values.iter().enumerate() {
        let what = format!("seed {seed} degree {sh_degree} {} {k}", component(&mut p.clone(), k).1);
        let at = |h: f64| {
            let mut moved = p.clone();
            *component(&mut moved, k).0 += h;
            evaluate(&moved, &view, options, &w)
        };
        checked += usize::from(agrees(&at, value, 1e-3 * largest, &what));
    }
    assert!(checked * 10 > count * 8, "seed {seed}: only {checked} of {count} lie away from cut-offs");
    for axis in 0..3 {
        let unit = DVec3::from_array(std::array::from_fn(|k| f64::from(u8::from(k == axis))));
        let turned = |h: f64| evaluate(&p, &view.moved(h * unit, DVec3::ZERO), options, &w);
        let shifted = |h: f64| evaluate(&p, &view.moved(DVec3::ZERO, h * unit), options, &w);
        agrees(&turned, g.pose.omega[axis], 1e-3 * largest, &format!("seed {seed} pose rotation {axis}"));
        agrees(
            &shifted,
            g.pose.translation[axis],
            1e-3 * largest,
            &format!("seed {seed} pose translation {axis}"),
        );
    }
}

#[test]
fn every_gradient_is_its_finite_difference_for_every_degree_and_with_antialiasing() {
    for seed in 0..3 {
        for sh_degree in 0..4 {
            for antialias in [false, true] {
                let background = DVec3::new(0.2, 0.5, 0.9);
                let options = Options { antialias, background, ..Options::default() };
                check_scene(seed * 10 + u64::from(sh_degree), sh_degree, &options);
            }
        }
    }
}

#[test]
fn coefficients_above_the_degree_in_use_change_nothing() {
    let (p, view) = random_scene(5, 20, 3);
    let options = Options { sh_degree: 1, ..Options::default() };
    let mut cut = p.clone();
    for i in 0..p.len() {
        cut.sh[i * 48 + 12..(i + 1) * 48].fill(0.0);
    }
    let (a, b) = (render(&p, &view, &options), render(&cut, &view, &Options::default()));
    assert_eq!(a.picture, b.picture);
    let g = backward(&p, &view, &options, &a, &random_loss(5, view.pixels()));
    assert!((0..p.len()).all(|i| g.parameters.sh[i * 48 + 12..(i + 1) * 48].iter().all(|&v| v == 0.0)));
}

#[test]
fn gradients_beyond_the_jacobian_limits_are_finite_differences_too() {
    let (mut p, mut view) = random_scene(7, 12, 1);
    view.translation = DVec3::new(0.0, 0.0, 1.2);
    for (i, mean) in p.means.iter_mut().enumerate() {
        // Along the image's border and well outside it, large enough to reach in.
        let turn = i as f64 * 0.52;
        *mean = view.rotation.transpose()
            * DVec3::new(1.1 * turn.cos(), 1.0 * turn.sin(), 0.1 * (i % 4) as f64 + 0.011 * i as f64);
        p.log_scales[i] = DVec3::new(-1.0, -0.6, -0.8);
        p.opacity_logits[i] = -1.0;
    }
    let options = Options::default();
    let w = random_loss(7, view.pixels());
    let r = render(&p, &view, &options);
    assert!(r.order.len() > 8);
    let g = backward(&p, &view, &options, &r, &w);
    let mut checked = 0;
    for i in 0..p.len() {
        for axis in 0..3 {
            let at = |h: f64| {
                let mut moved = p.clone();
                moved.means[i][axis] += h;
                evaluate(&moved, &view, &options, &w)
            };
            checked +=
                usize::from(agrees(&at, g.parameters.means[i][axis], 1e-2, &format!("mean {i} {axis}")));
        }
    }
    assert!(checked > 20, "{checked}");
}

#[test]
fn rotations_are_used_by_direction_and_their_gradient_has_no_radial_part() {
    let (p, view) = random_scene(9, 20, 0);
    let mut scaled = p.clone();
    scaled.rotations.iter_mut().for_each(|q| *q *= 1e3);
    let options = Options::default();
    let (a, b) = (render(&p, &view, &options), render(&scaled, &view, &options));
    assert!(a.picture.rgb.iter().zip(&b.picture.rgb).all(|(x, y)| (*x - *y).length() < 1e-12));
    let w = random_loss(9, view.pixels());
    let (ga, gb) = (backward(&p, &view, &options, &a, &w), backward(&scaled, &view, &options, &b, &w));
    for i in 0..p.len() {
        let (q, g) = (p.rotations[i], ga.parameters.rotations[i]);
        assert!(q.dot(g).abs() < 1e-9 * (1.0 + g.length()), "{i}");
        assert!((g - gb.parameters.rotations[i] * 1e3).length() < 1e-9 * (1.0 + g.length()), "{i}");
    }
}

#[test]
fn the_gaussians_are_seen_where_the_camera_projects_them() {
    // One opaque isotropic splat: the picture's alpha-weighted centroid is its projection.
    let (mut p, view) = random_scene(11, 1, 0);
    p.means[0] = view.rotation.transpose() * (DVec3::new(0.05, -0.08, 2.0) - view.translation);
    p.log_scales[0] = DVec3::splat(-2.5);
    p.opacity_logits[0] = 3.0;
    let r = render(&p, &view, &Options::default());
    let (mut sum, mut moment) = (0.0, DVec2::ZERO);
    for (i, &alpha) in r.picture.alpha.iter().enumerate() {
        sum += alpha;
        moment += alpha * DVec2::new((i % view.width) as f64 + 0.5, (i / view.width) as f64 + 0.5);
    }
    let expected = DVec2::new(0.05, -0.08) / 2.0 * view.focal + view.centre;
    assert!((moment / sum - expected).length() < 0.02, "{} {expected}", moment / sum);
    assert!(r.picture.depth.iter().filter(|&&d| d > 0.0).all(|&d| (d - 2.0).abs() < 1e-12));
}
