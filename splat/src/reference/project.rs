//! project: Gaussian → screen.
//!
//! in: mean μ, log-scales, quaternion q, opacity logit · out: [`Projected`] or nothing where it
//! cannot be seen.
//!
//! ```text
//! x = R μ + t                          camera frame; nothing where z < near
//! xy = (fx x/z + cx, fy y/z + cy)      px
//! M = R(q/|q|) diag(exp(log_scale))    Σ = M Mᵀ, world frame
//! J = [fx/z 0 −fx u/z; 0 fy/z −fy v/z] Jacobian of xy at x (Zwicker 2002, eq. 29), u = x/z and v =
//! y/z held where
//!                                      they are at most 15 % of the image beyond its border (Kerbl
//!                                      2023)
//! Σ' = J R Σ Rᵀ Jᵀ + 0.3 I             px²; the 0.3 keeps a splat at least about a pixel wide
//! (Kerbl 2023)
//! conic = Σ'⁻¹                         px⁻²
//! o = sigmoid(logit) · ρ               ρ = 1, or √(det(Σ' − 0.3 I) / det Σ') with antialiasing (Yu
//! 2024)
//! ```
//! With a = Mᵀ Rᵀ j₀ and b = Mᵀ Rᵀ j₁ (j the rows of J): Σ' − 0.3 I = [a·a a·b; a·b b·b], and its
//! determinant is |a × b|², which unlike the difference of products loses nothing for needles.

use super::constants::{JACOBIAN_MARGIN, LOW_PASS, MAX_LOG_SCALE, MIN_ALPHA};
use super::parameters::{GaussianGeometry, Options, ReferenceView};
use glam::{DMat3, DQuat, DVec2, DVec3};

/// What the rasteriser needs to know of a Gaussian, without its colour; also the gradient with
/// respect to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Projected {
    /// Centre, px.
    pub(crate) xy: DVec2,
    /// Σ'⁻¹ as (xx, xy, yy), px⁻².
    pub(crate) conic: DVec3,
    /// Camera z, scene units.
    pub(crate) depth: f64,
    /// Opacity after antialiasing.
    pub(crate) opacity: f64,
}

impl Projected {
    /// Half the sides of the exact bounding box of { alpha ≥ 1/255 }, px: √(2 ln(255 o) Σ'_xx), √(2
    /// ln(255 o) Σ'_yy).
    pub(crate) fn half_extent(&self) -> DVec2 {
        let p = (self.opacity / MIN_ALPHA).ln();
        let det = self.conic.x * self.conic.z - self.conic.y * self.conic.y;
        DVec2::new((2.0 * p * self.conic.z / det).sqrt(), (2.0 * p * self.conic.x / det).sqrt())
    }
}

/// Values of the forward pass that the backward pass needs again.
#[cfg_attr(not(test), expect(dead_code, reason = "the backward pass is compiled for tests only"))]
pub(super) struct ForwardValues {
    pub(super) x: DVec3,
    /// x/z and y/z held within the margin, and whether each is free to move.
    pub(super) uv: DVec2,
    pub(super) free: [bool; 2],
    pub(super) scale: DVec3,
    pub(super) unit: DQuat,
    pub(super) m: DMat3,
    pub(super) j: [DVec3; 2],
    pub(super) t: [DVec3; 2],
    pub(super) a: DVec3,
    pub(super) b: DVec3,
    pub(super) det_sharp: f64,
    pub(super) det: f64,
    pub(super) sigmoid: f64,
    pub(super) out: Projected,
}

/// The Gaussian on the screen; `None` where it is nearer than `near`, not finite, or more
/// transparent than 1/255.
pub(crate) fn project(g: &GaussianGeometry, view: &ReferenceView, options: &Options) -> Option<Projected> {
    forward(g, view, options).map(|f| f.out)
}

pub(super) fn forward(
    g: &GaussianGeometry,
    view: &ReferenceView,
    options: &Options,
) -> Option<ForwardValues> {
    let x = view.rotation * g.mean + view.translation;
    if !x.is_finite() || x.z < options.near {
        return None;
    }
    let image = DVec2::new(view.width as f64, view.height as f64);
    let margin = JACOBIAN_MARGIN * image;
    let (low, high) = ((-margin - view.centre) / view.focal, (image + margin - view.centre) / view.focal);
    let uv_true = x.truncate() / x.z;
    let uv = uv_true.clamp(low, high);
    let free = [uv.x == uv_true.x, uv.y == uv_true.y];

    let (fx, fy) = (view.focal.x / x.z, view.focal.y / x.z);
    let j = [DVec3::new(fx, 0.0, -fx * uv.x), DVec3::new(0.0, fy, -fy * uv.y)];
    let t = j.map(|row| view.rotation.transpose() * row);

    let scale = g.log_scale.map(|v| v.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp());
    let unit = normalised(g.rotation);
    let m = rotation_matrix(unit) * DMat3::from_diagonal(scale);
    let (a, b) = (m.transpose() * t[0], m.transpose() * t[1]);

    let (xx, xy, yy) = (a.dot(a) + LOW_PASS, a.dot(b), b.dot(b) + LOW_PASS);
    let det_sharp = a.cross(b).length_squared();
    let det = det_sharp + LOW_PASS * (a.dot(a) + b.dot(b)) + LOW_PASS * LOW_PASS;
    let sigmoid = 1.0 / (1.0 + (-g.logit).exp());
    let rho = if options.antialias { (det_sharp / det).sqrt() } else { 1.0 };
    let out = Projected {
        xy: uv_true * view.focal + view.centre,
        conic: DVec3::new(yy, -xy, xx) / det,
        depth: x.z,
        opacity: sigmoid * rho,
    };
    let seen = out.xy.is_finite() && out.conic.is_finite() && det.is_finite() && out.opacity >= MIN_ALPHA;
    seen.then_some(ForwardValues { x, uv, free, scale, unit, m, j, t, a, b, det_sharp, det, sigmoid, out })
}

/// q/|q|; identity where the norm is zero; not a number where q is none, so that nothing is drawn.
fn normalised(q: DQuat) -> DQuat {
    let norm = q.length();
    if norm == 0.0 { DQuat::IDENTITY } else { q / norm }
}

/// Rotation matrix of a unit quaternion, written out because its derivative is taken term by term.
pub(super) fn rotation_matrix(q: DQuat) -> DMat3 {
    let (x, y, z, w) = (q.x, q.y, q.z, q.w);
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}
