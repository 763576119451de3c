//! project backward: ∂L/∂[`Projected`] → ∂L/∂[`GaussianGeometry`] and ∂L/∂pose, through the
//! equations of [`super::project`].

use super::constants::{LOW_PASS, MAX_LOG_SCALE};
use super::derivatives::PoseGradient;
use super::parameters::{GaussianGeometry, Options, ReferenceView};
use super::project::{ForwardValues, Projected, forward, rotation_matrix};
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, DVec4};

/// From `d` = ∂L/∂[`Projected`] to ∂L/∂[`GaussianGeometry`] and ∂L/∂pose (the colour's part of both
/// is in [`super::sh`]). All zero where [`super::project::project`] gives nothing.
pub(crate) fn project_backward(
    g: &GaussianGeometry,
    view: &ReferenceView,
    options: &Options,
    d: &Projected,
) -> (GaussianGeometry, PoseGradient) {
    let Some(f) = forward(g, view, options) else {
        let zero = GaussianGeometry {
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
    let gradient = GaussianGeometry {
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
fn conic_backward(f: &ForwardValues, options: &Options, d: &Projected) -> DVec3 {
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

/// ∂L/∂q (not normalised) from ∂L/∂R; zero where q has no direction.
fn rotation_backward(q: DQuat, unit: DQuat, dr: DMat3) -> DQuat {
    let norm = q.length();
    if norm == 0.0 {
        return DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    }
    let (x, y, z, w) = (unit.x, unit.y, unit.z, unit.w);
    let (s01, s02, s12) =
        (dr.col(1)[0] + dr.col(0)[1], dr.col(2)[0] + dr.col(0)[2], dr.col(2)[1] + dr.col(1)[2]);
    let (a21, a02, a10) =
        (dr.col(1)[2] - dr.col(2)[1], dr.col(2)[0] - dr.col(0)[2], dr.col(0)[1] - dr.col(1)[0]);
    let d = 2.0
        * DVec4::new(
            y * s01 + z * s02 + w * a21 - 2.0 * x * (dr.col(1)[1] + dr.col(2)[2]),
            x * s01 + z * s12 + w * a02 - 2.0 * y * (dr.col(0)[0] + dr.col(2)[2]),
            x * s02 + y * s12 + w * a10 - 2.0 * z * (dr.col(0)[0] + dr.col(1)[1]),
            x * a21 + y * a02 + z * a10,
        );
    let unit = DVec4::from(unit);
    DQuat::from_vec4((d - unit * unit.dot(d)) / norm)
}

/// a bᵀ.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
