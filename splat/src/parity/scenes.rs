//! Scenes, and the reference's view of them.

use crate::reference::constants::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
use crate::reference::project::Projected;
use crate::reference::{self, Rendered};
use crate::{PinholeView, RenderOptions};
use glam::{DVec3, Mat3, Quat, Vec3};
use rand::Rng;
use scene::Gaussians;

/// A Gaussian, to be pushed into a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct One {
    pub(crate) mean: Vec3,
    pub(crate) log_scale: Vec3,
    pub(crate) rotation: Quat,
    pub(crate) logit: f32,
    pub(crate) sh0: Vec3,
}

impl Default for One {
    fn default() -> Self {
        let (mean, log_scale) = (Vec3::ZERO, Vec3::splat(-2.0));
        Self { mean, log_scale, rotation: Quat::IDENTITY, logit: 1.0, sh0: Vec3::new(0.9, -0.3, 0.2) }
    }
}

pub(crate) fn of(list: &[One]) -> Gaussians {
    Gaussians {
        means: list.iter().map(|g| g.mean).collect(),
        log_scales: list.iter().map(|g| g.log_scale).collect(),
        rotations: list.iter().map(|g| g.rotation).collect(),
        opacity_logits: list.iter().map(|g| g.logit).collect(),
        sh: list.iter().flat_map(|g| g.sh0.to_array()).collect(),
        sh_degree: 0,
    }
}

/// N Gaussians of ordinary shapes around the origin, depths distinct in f32 seen from [`view`].
pub(crate) fn ordinary(seed: u64, n: usize, sh_degree: u32) -> Gaussians {
    let mut rng = scene::rng::rng(seed, "parity scene", 0);
    let mut real = |low: f32, high: f32| rng.random_range(low..high);
    let mut g = Gaussians { sh_degree, ..Gaussians::default() };
    for i in 0..n {
        let z = -0.8 + 1.6 * ((i * 7919) % n) as f32 / n as f32;
        g.means.push(Vec3::new(real(-1.1, 1.1), real(-0.9, 0.9), z));
        g.log_scales.push(Vec3::new(real(-5.0, -1.2), real(-5.0, -1.2), real(-5.0, -1.2)));
        g.rotations.push(Quat::from_xyzw(real(-1.0, 1.0), real(-1.0, 1.0), real(-1.0, 1.0), real(-1.0, 1.0)));
        g.opacity_logits.push(real(-5.0, 5.0));
        g.sh.extend((0..3 * (sh_degree as usize + 1).pow(2)).map(|_| real(-0.5, 0.5)));
    }
    g
}

/// A camera two units in front of the origin; sides that are no multiple of a tile.
pub(crate) fn view(width: usize, height: usize) -> PinholeView {
    PinholeView {
        rotation: Mat3::from_rotation_z(0.3),
        translation: Vec3::new(0.05, -0.03, 2.0),
        focal: [0.9 * width as f32, 0.92 * width as f32],
        centre: [0.5 * width as f32 + 1.3, 0.5 * height as f32 - 0.7],
        width,
        height,
        parts: crate::parts::PartPlaces::NONE,
    }
}

pub(crate) fn reference_view(v: &PinholeView) -> reference::ReferenceView {
    reference::ReferenceView {
        rotation: v.rotation.as_dmat3(),
        translation: v.translation.as_dvec3(),
        focal: glam::DVec2::new(f64::from(v.focal[0]), f64::from(v.focal[1])),
        centre: glam::DVec2::new(f64::from(v.centre[0]), f64::from(v.centre[1])),
        width: v.width,
        height: v.height,
    }
}

pub(crate) fn reference_options(o: &RenderOptions) -> reference::Options {
    reference::Options {
        near: f64::from(o.near.unwrap_or(crate::camera::DEFAULT_NEAR)),
        antialias: o.antialias,
        background: DVec3::from_array(o.background.map(f64::from)),
        sh_degree: o.sh_degree.unwrap_or(3),
    }
}

/// The reference's picture.
pub(crate) fn rendered(g: &Gaussians, v: &PinholeView, o: &RenderOptions) -> Rendered {
    reference::render(&reference::Parameters::from_gaussians(g), &reference_view(v), &reference_options(o))
}

/// Whether rounding to f32 may decide a cut-off of the pixel (skip, clamp or stop) the other way.
pub(crate) fn undecided(r: &Rendered, v: &PinholeView) -> Vec<bool> {
    let near = |value: f64, limit: f64, band: f64| (value / limit - 1.0).abs() < band;
    let pixel = |i: usize| {
        let p = glam::DVec2::new((i % v.width) as f64 + 0.5, (i / v.width) as f64 + 0.5);
        let mut t = 1.0;
        for g in r.order.iter().filter_map(|&i| r.projected[i]) {
            let power = power(&g, p);
            let alpha = g.opacity * (-power).exp();
            // An exponent is a difference of large numbers where the Gaussian is steep.
            let steep = 1.0 + g.conic.x.max(g.conic.z) * (g.xy - p).length_squared() / (1.0 + power.abs());
            let band = 2e-5 * steep.min(1e4);
            // Nothing is drawn where the exponent is below 0, which it can only come to be by the
            // rounding of its terms.
            let negative = power < 2e-6 * terms(&g, p);
            if near(alpha, MIN_ALPHA, band) || near(alpha, MAX_ALPHA, 1e-4) || negative {
                return true;
            }
            let alpha = alpha.min(MAX_ALPHA);
            if power >= 0.0 && alpha >= MIN_ALPHA {
                if near(t * (1.0 - alpha), MIN_TRANSMITTANCE, 1e-3) {
                    return true;
                }
                if t * (1.0 - alpha) < MIN_TRANSMITTANCE {
                    break;
                }
                t *= 1.0 - alpha;
            }
        }
        false
    };
    (0..v.width * v.height).map(pixel).collect()
}

/// The magnitudes of the three terms that make up [`power`].
fn terms(g: &Projected, p: glam::DVec2) -> f64 {
    let d = g.xy - p;
    0.5 * (g.conic.x * d.x * d.x + g.conic.z * d.y * d.y) + (g.conic.y * d.x * d.y).abs()
}

fn power(g: &Projected, p: glam::DVec2) -> f64 {
    let d = g.xy - p;
    0.5 * (g.conic.x * d.x * d.x + g.conic.z * d.y * d.y) + g.conic.y * d.x * d.y
}
