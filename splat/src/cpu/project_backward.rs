//! project backward: dL/d(sums of a Gaussian's pairs) → dL/d(geometric parameters), of a vector of
//! Gaussians. Twin of the backward half of `reference/project.rs`.

use super::project::{Projection, camera_rows, dot3, twice};
use super::rasterise::SUMS;
use super::simd::{Simd, array};
use crate::camera::CameraConstants;
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, OPACITY, ROTATION};
use crate::reference::constants::{LOW_PASS, MAX_LOG_SCALE};

/// dL/d(geometry) of a block from the pair sums, without colour's part of dL/dmean.
#[inline(always)]
pub(super) fn geometry_gradient<S: Simd>(
    c: &CameraConstants,
    p: &Projection<S>,
    sums: &[S; SUMS],
    parameters: &[S; GEOMETRY],
) -> [S; GEOMETRY] {
    let (zero, one, half) = (S::splat(0.0), S::splat(1.0), S::splat(0.5));
    let [v, vdx, vdy, vdxx, vdxy, vdyy] = [sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]];
    // Centre on the screen: power = ½ dᵀ conic d.
    let gx = zero.sub(p.conic[0].mul(vdx).add(p.conic[1].mul(vdy)));
    let gy = zero.sub(p.conic[1].mul(vdx).add(p.conic[2].mul(vdy)));
    // Conic → Σ': dΣ' = −conic · dConic · conic, with dConic = −½ Σ v d dᵀ.
    let (k0, k1, k2) = (p.conic[0], p.conic[1], p.conic[2]);
    let (h0, h1, h2) = (half.mul(vdxx), half.mul(vdxy), half.mul(vdyy));
    let (m00, m01) = (k0.mul(h0).add(k1.mul(h1)), k0.mul(h1).add(k1.mul(h2)));
    let (m10, m11) = (k1.mul(h0).add(k2.mul(h1)), k1.mul(h1).add(k2.mul(h2)));
    let mut s_xx = m00.mul(k0).add(m01.mul(k1));
    let mut s_xy = m00.mul(k1).add(m01.mul(k2));
    let mut s_yy = m10.mul(k1).add(m11.mul(k2));
    if c.antialias {
        // ln ρ = ½ (ln det Σ'_before − ln det Σ'); dL/d ln ρ = Σ v.
        let low_pass = S::splat(LOW_PASS as f32);
        let (b_xx, b_yy, b_xy) = (p.cov[0].sub(low_pass), p.cov[2].sub(low_pass), p.cov[1]);
        let det = p.sharp;
        let usable = det.ge(S::splat(1e-12));
        let scale = half.mul(v).keep(usable);
        let inverse = one.div(S::select(usable, det, one));
        s_xx = s_xx.add(scale.mul(b_yy.mul(inverse).sub(k0)));
        s_xy = s_xy.add(scale.mul(zero.sub(b_xy).mul(inverse).sub(k1)));
        s_yy = s_yy.add(scale.mul(b_xx.mul(inverse).sub(k2)));
    }
    // Σ' = A Aᵀ with A = J W R S: dA = 2 dΣ' A (symmetric form).
    let own = [s_xx, s_yy];
    let d_a = array!(r in 2 => {
        array!(k in 3 => twice(own[r].mul(p.jwm[r][k]).add(s_xy.mul(p.jwm[1 - r][k]))))
    });
    // A = (J W) M, M = R S.
    let m = array!(j in 3 => array!(k in 3 => p.rotation[j][k].mul(p.scale[k])));
    let d_jw = array!(r in 2 => array!(j in 3 => dot3(d_a[r], m[j])));
    let d_m = array!(j in 3 => {
        array!(k in 3 => p.jw[0][j].mul(d_a[0][k]).add(p.jw[1][j].mul(d_a[1][k])))
    });
    let limit = S::splat(MAX_LOG_SCALE as f32);
    let d_scale = array!(k in 3 => {
        let column = dot3([d_m[0][k], d_m[1][k], d_m[2][k]], [p.rotation[0][k], p.rotation[1][k], p.rotation[2][k]]);
        column.mul(p.scale[k]).keep(parameters[LOG_SCALE + k].abs().lt(limit))
    });
    let d_r = array!(j in 3 => array!(k in 3 => d_m[j][k].mul(p.scale[k])));
    let d_q = quaternion_gradient(p, &d_r);
    let d_mean = mean_gradient(c, p, [gx, gy], &d_jw);
    let d_logit = v.mul(one.sub(p.sigmoid));
    let mut out = [zero; GEOMETRY];
    out[MEAN..MEAN + 3].copy_from_slice(&d_mean);
    out[LOG_SCALE..LOG_SCALE + 3].copy_from_slice(&d_scale);
    out[ROTATION..ROTATION + 4].copy_from_slice(&d_q);
    out[OPACITY] = d_logit;
    out
}

/// Through the rotation matrix and the normalisation: zero along q.
#[inline(always)]
fn quaternion_gradient<S: Simd>(p: &Projection<S>, d: &[[S; 3]; 3]) -> [S; 4] {
    let [w, x, y, z] = p.q;
    let two = S::splat(2.0);
    let (a, b, c) = (d[2][1].sub(d[1][2]), d[0][2].sub(d[2][0]), d[1][0].sub(d[0][1]));
    let (e, f, g) = (d[0][1].add(d[1][0]), d[0][2].add(d[2][0]), d[1][2].add(d[2][1]));
    let g_w = two.mul(dot3([x, y, z], [a, b, c]));
    let g_x = two.mul(w.mul(a).add(y.mul(e)).add(z.mul(f)).sub(two.mul(x).mul(d[1][1].add(d[2][2]))));
    let g_y = two.mul(w.mul(b).add(x.mul(e)).add(z.mul(g)).sub(two.mul(y).mul(d[0][0].add(d[2][2]))));
    let g_z = two.mul(w.mul(c).add(x.mul(f)).add(y.mul(g)).sub(two.mul(z).mul(d[0][0].add(d[1][1]))));
    let along = g_w.mul(w).add(dot3([g_x, g_y, g_z], [x, y, z]));
    let g = [g_w, g_x, g_y, g_z];
    array!(k in 4 => g[k].sub(along.mul(p.q[k])).mul(p.inv_norm))
}

/// Through the pixel position and the Jacobian to the camera frame, then to the world.
#[inline(always)]
fn mean_gradient<S: Simd>(c: &CameraConstants, p: &Projection<S>, g: [S; 2], d_jw: &[[S; 3]; 2]) -> [S; 3] {
    let zero = S::splat(0.0);
    let rows = camera_rows::<S>(c);
    let mut camera = [zero; 3];
    for a in 0..2 {
        let f = S::splat(c.focal[a]).mul(p.inv_z);
        let d_diagonal = dot3(d_jw[a], rows[a]);
        let d_last = dot3(d_jw[a], rows[2]);
        // J_aa = f/z, J_az = −(f/z) u with u = x/z (limited).
        let u = p.xc[a].mul(p.inv_z);
        let scaled = f.mul(p.inv_z);
        camera[a] = g[a].mul(f).sub(d_last.mul(scaled).keep(p.free[a]));
        let from_jacobian = p.limited[a].mul(d_last).sub(d_diagonal);
        let from_limited = u.mul(d_last).keep(p.free[a]);
        let by_z = from_jacobian.add(from_limited).mul(scaled).sub(g[a].mul(f).mul(u));
        camera[2] = camera[2].add(by_z);
    }
    array!(k in 3 => dot3([rows[0][k], rows[1][k], rows[2][k]], camera))
}
