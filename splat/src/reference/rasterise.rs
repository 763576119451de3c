//! rasterise: Gaussians in order of depth → picture.
//!
//! in: \[N\] [`Projected`], \[N\] rgb, order, background · out: rgb [H × W], alpha [H × W], depth
//! [H × W]
//!
//! ```text
//! for each pixel centre p, T = 1, for each Gaussian i in order:
//!   d = xy_i − p;  power = ½ (c_xx dx² + c_yy dy²) + c_xy dx dy;  α = min(0.99, o exp(−power))
//!   skip if power < 0 or α < 1/255;  stop if T (1 − α) < 1e-4
//!   C += T α rgb;  D += T α z;  T ← T (1 − α)
//! rgb = C + T background;  alpha = 1 − T;  depth = D / (1 − T), 0 where nothing is seen
//! ```
//! Kerbl 2023, eq. 3 and appendix C; backward by ∂C/∂α_i = T_i c_i − S_i / (1 − α_i) with S_i what
//! lies behind i.

use super::constants::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
use super::parameters::ReferenceView;
use super::project::Projected;
use glam::{DVec2, DVec3};

/// A picture, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ReferencePicture {
    /// [H × W] colour over the background.
    pub(crate) rgb: Vec<DVec3>,
    /// [H × W] 1 − T.
    pub(crate) alpha: Vec<f64>,
    /// [H × W] expected camera z, scene units; 0 where alpha is 0.
    pub(crate) depth: Vec<f64>,
}

/// ∂L/∂[`ReferencePicture`], all row-major [H × W].
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ImageGradient {
    /// With respect to the colour.
    pub(crate) rgb: Vec<DVec3>,
    /// With respect to alpha.
    pub(crate) alpha: Vec<f64>,
    /// With respect to the expected depth.
    pub(crate) depth: Vec<f64>,
}

impl ImageGradient {
    /// A loss that looks at the colour only.
    pub(crate) fn of_colour(rgb: Vec<DVec3>) -> Self {
        Self { alpha: vec![0.0; rgb.len()], depth: vec![0.0; rgb.len()], rgb }
    }
}

/// What one Gaussian does to one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Contribution {
    /// Which Gaussian.
    pub(crate) gaussian: usize,
    /// α.
    pub(crate) alpha: f64,
    /// Whether α was held at 0.99.
    pub(crate) clamped: bool,
    /// Transmittance in front of it.
    pub(crate) transmittance: f64,
    /// xy − p, px.
    pub(crate) offset: DVec2,
    /// exp(−power).
    pub(crate) falloff: f64,
}

/// What the pixel with its centre at `p` is composited from, front to back, and the transmittance
/// behind.
pub(crate) fn contributions(
    projected: &[Option<Projected>],
    order: &[usize],
    p: DVec2,
) -> (Vec<Contribution>, f64) {
    let mut list = Vec::new();
    let mut transmittance = 1.0;
    for (i, g) in order.iter().filter_map(|&i| projected[i].map(|g| (i, g))) {
        let d = g.xy - p;
        let power = 0.5 * (g.conic.x * d.x * d.x + g.conic.z * d.y * d.y) + g.conic.y * d.x * d.y;
        let falloff = (-power).exp();
        let alpha = (g.opacity * falloff).min(MAX_ALPHA);
        if power < 0.0 || alpha.is_nan() || alpha < MIN_ALPHA {
            continue;
        }
        if transmittance * (1.0 - alpha) < MIN_TRANSMITTANCE {
            break;
        }
        let clamped = g.opacity * falloff > MAX_ALPHA;
        list.push(Contribution { gaussian: i, alpha, clamped, transmittance, offset: d, falloff });
        transmittance *= 1.0 - alpha;
    }
    (list, transmittance)
}

fn pixel_centre(i: usize, view: &ReferenceView) -> DVec2 {
    DVec2::new((i % view.width) as f64 + 0.5, (i / view.width) as f64 + 0.5)
}

/// The picture. `projected` and `colours` \[N\], `order` as [`super::sort`] gives it.
pub(crate) fn rasterise(
    projected: &[Option<Projected>],
    colours: &[DVec3],
    order: &[usize],
    view: &ReferenceView,
    background: DVec3,
) -> ReferencePicture {
    let mut picture = ReferencePicture::default();
    for i in 0..view.pixels() {
        let (list, transmittance) = contributions(projected, order, pixel_centre(i, view));
        let (mut rgb, mut depth) = (DVec3::ZERO, 0.0);
        for c in &list {
            let weight = c.transmittance * c.alpha;
            rgb += weight * colours[c.gaussian];
            depth += weight * projected[c.gaussian].map_or(0.0, |g| g.depth);
        }
        let alpha = 1.0 - transmittance;
        picture.rgb.push(rgb + transmittance * background);
        picture.alpha.push(alpha);
        picture.depth.push(if list.is_empty() { 0.0 } else { depth / alpha });
    }
    picture
}

/// ∂L/∂ what [`rasterise`] takes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RasteriseGradient {
    /// \[N\] with respect to the projected Gaussians.
    pub(crate) projected: Vec<Projected>,
    /// \[N\] with respect to their colours.
    pub(crate) colours: Vec<DVec3>,
    /// \[N\] in how many pixels the Gaussian is composited.
    pub(crate) pixels: Vec<u32>,
}

/// From `d` = ∂L/∂[`ReferencePicture`] to the derivatives with respect to the Gaussians on the
/// screen.
pub(crate) fn rasterise_backward(
    projected: &[Option<Projected>],
    colours: &[DVec3],
    order: &[usize],
    view: &ReferenceView,
    background: DVec3,
    d: &ImageGradient,
) -> RasteriseGradient {
    let n = projected.len();
    let mut gradient = RasteriseGradient {
        projected: vec![Projected::default(); n],
        colours: vec![DVec3::ZERO; n],
        pixels: vec![0; n],
    };
    for i in 0..view.pixels() {
        let (list, transmittance) = contributions(projected, order, pixel_centre(i, view));
        let alpha = 1.0 - transmittance;
        let total: f64 = list.iter().map(|c| c.transmittance * c.alpha * depth_of(projected, c)).sum();
        // depth = D / alpha
        let (d_depth, d_alpha) = if list.is_empty() {
            (0.0, 0.0)
        } else {
            (d.depth[i] / alpha, d.alpha[i] - d.depth[i] * total / (alpha * alpha))
        };
        // What lies behind the present Gaussian, back to front.
        let (mut behind_rgb, mut behind_depth) = (transmittance * background, 0.0);
        for c in list.iter().rev() {
            let (rgb, z) = (colours[c.gaussian], depth_of(projected, c));
            let weight = c.transmittance * c.alpha;
            gradient.colours[c.gaussian] += weight * d.rgb[i];
            gradient.projected[c.gaussian].depth += weight * d_depth;
            gradient.pixels[c.gaussian] += 1;
            let remaining = 1.0 - c.alpha;
            let dl_dalpha = d.rgb[i].dot(c.transmittance * rgb - behind_rgb / remaining)
                + d_depth * (c.transmittance * z - behind_depth / remaining)
                + d_alpha * transmittance / remaining;
            behind_rgb += weight * rgb;
            behind_depth += weight * z;
            if !c.clamped {
                add_alpha(&mut gradient, projected, c, dl_dalpha);
            }
        }
    }
    gradient
}

fn depth_of(projected: &[Option<Projected>], c: &Contribution) -> f64 {
    projected[c.gaussian].map_or(0.0, |g| g.depth)
}

/// α = o exp(−power): its derivatives with respect to opacity, conic and centre.
fn add_alpha(
    gradient: &mut RasteriseGradient,
    projected: &[Option<Projected>],
    c: &Contribution,
    dl_dalpha: f64,
) {
    let Some(g) = projected[c.gaussian] else { return };
    let out = &mut gradient.projected[c.gaussian];
    let d = c.offset;
    out.opacity += dl_dalpha * c.falloff;
    let d_power = -dl_dalpha * c.alpha;
    out.conic += d_power * DVec3::new(0.5 * d.x * d.x, d.x * d.y, 0.5 * d.y * d.y);
    out.xy += d_power * DVec2::new(g.conic.x * d.x + g.conic.y * d.y, g.conic.y * d.x + g.conic.z * d.y);
}
