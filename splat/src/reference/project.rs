//! project: Gaussian → screen.
//!
//! in: mean μ, log-scales, quaternion q, opacity logit · out: [`Projected`] or nothing where it cannot be seen.
//!
//! ```text
//! x = R μ + t                          camera frame; nothing where z < near
//! xy = (fx x/z + cx, fy y/z + cy)      px
//! M = R(q/|q|) diag(exp(log_scale))    Σ = M Mᵀ, world frame
//! J = [fx/z 0 −fx u/z; 0 fy/z −fy v/z] Jacobian of xy at x (Zwicker 2002, eq. 29), u = x/z and v = y/z held where
//!                                      they are at most 15 % of the image beyond its border (Kerbl 2023)
//! Σ' = J R Σ Rᵀ Jᵀ + 0.3 I             px²; the 0.3 keeps a splat at least about a pixel wide (Kerbl 2023)
//! conic = Σ'⁻¹                         px⁻²
//! o = sigmoid(logit) · ρ               ρ = 1, or √(det(Σ' − 0.3 I) / det Σ') with antialiasing (Yu 2024)
//! ```
//! With a = Mᵀ Rᵀ j₀ and b = Mᵀ Rᵀ j₁ (j the rows of J): Σ' − 0.3 I = [a·a a·b; a·b b·b], and its determinant is
//! |a × b|², which unlike the difference of products loses nothing for needles.

use super::{Options, PoseGradient, View};
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, DVec4};

/// Added to both variances on the screen, px².
pub const LOW_PASS: f64 = 0.3;
/// Log-scales are held within ± this.
pub const MAX_LOG_SCALE: f64 = 20.0;
/// How far beyond the image's border the linearisation is followed, in widths or heights of the image.
pub const JACOBIAN_MARGIN: f64 = 0.15;
/// Smallest opacity that is drawn.
pub const MIN_ALPHA: f64 = 1.0 / 255.0;

/// What the rasteriser needs to know of a Gaussian, without its colour; also the gradient with respect to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Projected {
    /// Centre, px.
    pub xy: DVec2,
    /// Σ'⁻¹ as (xx, xy, yy), px⁻².
    pub conic: DVec3,
    /// Camera z, scene units.
    pub depth: f64,
    /// Opacity after antialiasing.
    pub opacity: f64,
}

impl Projected {
    /// Half the sides of the exact bounding box of { alpha ≥ 1/255 }, px: √(2 ln(255 o) Σ'_xx), √(2 ln(255 o) Σ'_yy).
    pub fn half_extent(&self) -> DVec2 {
        let p = (self.opacity / MIN_ALPHA).ln();
        let det = self.conic.x * self.conic.z - self.conic.y * self.conic.y;
        DVec2::new((2.0 * p * self.conic.z / det).sqrt(), (2.0 * p * self.conic.x / det).sqrt())
    }
}

/// The parameters that decide where a Gaussian is seen; also the gradient with respect to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// μ, world frame.
    pub mean: DVec3,
    /// Logarithms of the standard deviations.
    pub log_scale: DVec3,
    /// Local to world, any norm.
    pub rotation: DQuat,
    /// Opacity logit.
    pub logit: f64,
}

/// Values of the forward pass that the backward pass needs again.
struct Forward {
    x: DVec3,
    /// x/z and y/z held within the margin, and whether each is free to move.
    uv: DVec2,
    free: [bool; 2],
    scale: DVec3,
    unit: DQuat,
    m: DMat3,
    j: [DVec3; 2],
    t: [DVec3; 2],
    a: DVec3,
    b: DVec3,
    det_sharp: f64,
    det: f64,
    sigmoid: f64,
    out: Projected,
}

/// The Gaussian on the screen; `None` where it is nearer than `near`, not finite, or more transparent than 1/255.
pub fn project(g: &Geometry, view: &View, options: &Options) -> Option<Projected> {
    forward(g, view, options).map(|f| f.out)
}

fn forward(g: &Geometry, view: &View, options: &Options) -> Option<Forward> {
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
    seen.then_some(Forward { x, uv, free, scale, unit, m, j, t, a, b, det_sharp, det, sigmoid, out })
}

/// From `d` = ∂L/∂[`Projected`] to ∂L/∂[`Geometry`] and ∂L/∂pose (the colour's part of both is in [`super::sh`]).
/// All zero where [`project`] gives nothing.
pub fn project_backward(
    g: &Geometry,
    view: &View,
    options: &Options,
    d: &Projected,
) -> (Geometry, PoseGradient) {
    let Some(f) = forward(g, view, options) else {
        let zero = Geometry {
            mean: DVec3::ZERO,
            log_scale: DVec3::ZERO,
            rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
            logit: 0.0,
        };
        return (zero, PoseGradient::default());
    };
    let d_cov = conic_backward(&f, options, d);

    // Σ' = [a·a a·b; a·b b·b] + 0.3 I, a = Mᵀ t₀, b = Mᵀ t₁, t = Rᵀ j.
    let (da, db) = (2.0 * d_cov.x * f.a + d_cov.y * f.b, 2.0 * d_cov.z * f.b + d_cov.y * f.a);
    let dt = [f.m * da, f.m * db];
    let dm = outer(f.t[0], da) + outer(f.t[1], db);
    let dj = dt.map(|v| view.rotation * v);

    // xy, and J's dependence on x.
    let (z, uv) = (f.x.z, f.uv);
    let true_uv = f.x.truncate() / z;
    let d_uv = d.xy * view.focal;
    let mut dx = DVec3::new(d_uv.x, d_uv.y, -d_uv.dot(true_uv)) / z;
    dx.z += d.depth;
    for (axis, focal) in [view.focal.x, view.focal.y].into_iter().enumerate() {
        let d_row = dj[axis];
        // row = focal/z · (e_axis − u e_z)
        dx.z -= focal / (z * z) * (d_row[axis] - uv[axis] * d_row.z);
        if f.free[axis] {
            dx[axis] -= focal / (z * z) * d_row.z;
            dx.z += focal / (z * z) * uv[axis] * d_row.z;
        }
    }

    // M = R(q) diag(s)
    let r = rotation_matrix(f.unit);
    let dr = dm * DMat3::from_diagonal(f.scale);
    let mut d_log_scale = DVec3::ZERO;
    for k in 0..3 {
        if g.log_scale[k].abs() < MAX_LOG_SCALE {
            d_log_scale[k] = dm.col(k).dot(r.col(k)) * f.scale[k];
        }
    }
    let rho = f.out.opacity / f.sigmoid;
    let gradient = Geometry {
        mean: view.rotation.transpose() * dx,
        log_scale: d_log_scale,
        rotation: rotation_backward(g.rotation, f.unit, dr),
        logit: d.opacity * rho * f.sigmoid * (1.0 - f.sigmoid),
    };
    // x ← x + ω × x + v, and R ← (I + [ω]×) R: t = Rᵀ j becomes Rᵀ (j − ω × j).
    let omega = f.x.cross(dx) - f.j[0].cross(dj[0]) - f.j[1].cross(dj[1]);
    (gradient, PoseGradient { omega, translation: dx })
}

/// ∂L/∂(Σ'_xx, Σ'_xy, Σ'_yy) from the conic and the antialiased opacity; Σ'_xy counts once.
fn conic_backward(f: &Forward, options: &Options, d: &Projected) -> DVec3 {
    let c = f.out.conic;
    let q = DMat2::from_cols(DVec2::new(c.x, c.y), DVec2::new(c.y, c.z));
    let dq = DMat2::from_cols(DVec2::new(d.conic.x, d.conic.y / 2.0), DVec2::new(d.conic.y / 2.0, d.conic.z));
    let s = q * dq * q; // d(A⁻¹) = −A⁻¹ dA A⁻¹
    let mut d_cov = -DVec3::new(s.col(0).x, 2.0 * s.col(0).y, s.col(1).y);
    if options.antialias {
        // ρ² = det(Σ' − 0.3 I) / det Σ';  ∂det A/∂(xx, xy, yy) = (yy, −2 xy, xx)
        let sharp = DVec3::new(f.b.dot(f.b), -2.0 * f.a.dot(f.b), f.a.dot(f.a));
        let soft = DVec3::new(sharp.x + LOW_PASS, sharp.y, sharp.z + LOW_PASS);
        d_cov += d.opacity * f.out.opacity / 2.0 * (sharp / f.det_sharp - soft / f.det);
    }
    d_cov
}

/// q/|q|; identity where the norm is zero; not a number where q is none, so that nothing is drawn.
fn normalised(q: DQuat) -> DQuat {
    let norm = q.length();
    if norm == 0.0 { DQuat::IDENTITY } else { q / norm }
}

/// Rotation matrix of a unit quaternion, written out because its derivative is taken term by term.
fn rotation_matrix(q: DQuat) -> DMat3 {
    let (x, y, z, w) = (q.x, q.y, q.z, q.w);
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// ∂L/∂q (not normalised) from ∂L/∂R; zero where q has no direction.
fn rotation_backward(q: DQuat, unit: DQuat, dr: DMat3) -> DQuat {
    let norm = q.length();
    if norm == 0.0 {
        return DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    }
    let g = |row: usize, col: usize| dr.col(col)[row];
    let (x, y, z, w) = (unit.x, unit.y, unit.z, unit.w);
    let (s01, s02, s12) = (g(0, 1) + g(1, 0), g(0, 2) + g(2, 0), g(1, 2) + g(2, 1));
    let (a21, a02, a10) = (g(2, 1) - g(1, 2), g(0, 2) - g(2, 0), g(1, 0) - g(0, 1));
    let d = 2.0
        * DVec4::new(
            y * s01 + z * s02 + w * a21 - 2.0 * x * (g(1, 1) + g(2, 2)),
            x * s01 + z * s12 + w * a02 - 2.0 * y * (g(0, 0) + g(2, 2)),
            x * s02 + y * s12 + w * a10 - 2.0 * z * (g(0, 0) + g(1, 1)),
            x * a21 + y * a02 + z * a10,
        );
    let unit = DVec4::from(unit);
    DQuat::from_vec4((d - unit * unit.dot(d)) / norm)
}

/// a bᵀ.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
