//! project backward and Adam, fused: screen gradients → parameters.
//! in: sums of [`super::rasterise::Backward`] by pair. out: parameters and moments moved one step, or plain gradients.
//!
//! Adam (Kingma and Ba 2015) runs on each Gaussian's own clock: a step counts only where the Gaussian was visible, so
//! that the others keep parameters and moments as they are instead of drifting on stale momentum.

use super::sort::Bins;
use super::project::{
    CULLED, CameraConstants, LOG_SCALE_LIMIT, Parameters, Projection, camera_rows, colour, dot3,
    project_lanes, twice,
};
use super::rasterise::SUMS;
use super::sh;
use super::simd::{Simd, array, simd_kernel};
use crate::backend::{LearningRates, Scores};
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, OPACITY, ROTATION};
use glam::Vec3;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const LN_BETA1: f32 = -0.105_360_516;
const LN_BETA2: f32 = -0.001_000_500_3;
const EPSILON: f32 = 1e-15;
/// Moments below this are set to zero, so that no denormal numbers slow the loop.
const TINY_MOMENT: f32 = 1e-18;
const TINY_SQUARE: f32 = 1e-30;

/// A shared pointer to planes of which every task touches its own Gaussians.
#[derive(Clone, Copy)]
pub struct SharedPlane(pub *mut f32);
// Each task reads and writes a range of its own.
unsafe impl Send for SharedPlane {}
unsafe impl Sync for SharedPlane {}

/// What densification and pruning are decided by, summed over steps.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Statistics {
    /// Σ |dL/dxy| in units of half the image, over the steps in which the Gaussian was visible (or what [`Scores`] says).
    pub gradient: Vec<f32>,
    /// In how many steps it was visible.
    pub visible: Vec<f32>,
    /// Greatest Σ over pixels of T α in a step.
    pub weight: Vec<f32>,
    /// Greatest radius on the screen, as a fraction of the image's larger side.
    pub radius: Vec<f32>,
}

impl Statistics {
    /// Forgets everything, for `n` Gaussians.
    pub fn reset(&mut self, n: usize) {
        let n = crate::model::padded(n);
        for plane in [&mut self.gradient, &mut self.visible, &mut self.weight, &mut self.radius] {
            plane.clear();
            plane.resize(n, 0.0);
        }
    }
}

/// Pointers into a [`crate::model::Model`] for one range of Gaussians.
#[derive(Clone, Copy)]
pub struct SharedModel {
    /// Parameters, first and second moments.
    pub geometry: [[SharedPlane; GEOMETRY]; 3],
    /// Parameters, first and second moments.
    pub sh: [SharedPlane; 3],
    /// Clocks.
    pub steps: SharedPlane,
    /// Gradient sum, visible count, weight, radius.
    pub statistics: [SharedPlane; 4],
}

/// What the kernel does with the gradients.
#[derive(Clone, Copy)]
pub enum Sink {
    /// An Adam step.
    Adam(LearningRates),
    /// Writes them where the parameters' pointers point to.
    Gradients,
}

/// Arguments of [`optimise`].
pub struct Optimise<'a> {
    /// The parameters as they were in forward (each Gaussian is read before it is written).
    pub parameters: Parameters,
    /// Where results go.
    pub shared: SharedModel,
    /// The camera.
    pub camera: &'a CameraConstants,
    /// The view's pairs.
    pub bins: &'a Bins,
    /// Depth keys of forward.
    pub keys: &'a [u32],
    /// Sums by pair.
    pub sums: &'a [[f32; SUMS]],
    /// First Gaussian, a multiple of 16.
    pub start: usize,
    /// One after the last.
    pub end: usize,
    /// Adam or gradients.
    pub sink: Sink,
    /// Added to dL/dlogit of visible Gaussians, times sigmoid'.
    pub opacity_penalty: f32,
    /// Added to dL/dscale of visible Gaussians.
    pub scale_penalty: f32,
    /// What the statistics score Gaussians by.
    pub scores: Scores,
    /// Out: Gaussians whose gradient was not finite.
    pub non_finite: usize,
}

/// Fetches what a block will read from places that no pattern foretells: its pairs' sums, and the colours of Gaussians that are seen
/// among others that are not.
#[inline(always)]
fn fetch_ahead<S: Simd>(a: &Optimise, block: usize) {
    const LINE: usize = 64;
    let used = (a.camera.sh_degree as usize + 1).pow(2) * 3 * size_of::<f32>();
    for i in block..(block + S::LANES).min(a.end) {
        let [begin, end] = a.bins.ranges[i];
        if a.keys[i] == CULLED || begin == end {
            continue;
        }
        for &position in &a.bins.positions[begin as usize..end as usize] {
            let sums: *const [f32; SUMS] = &raw const a.sums[position as usize];
            S::prefetch(sums.cast());
            S::prefetch(sums.wrapping_add(1).cast::<u8>().wrapping_sub(1));
        }
        for plane in &a.shared.sh {
            let first = plane.0.wrapping_add(i * a.parameters.sh_stride).cast::<u8>();
            (0..used).step_by(LINE).for_each(|at| S::prefetch(first.wrapping_add(at)));
        }
    }
}

#[inline(always)]
fn optimise_generic<S: Simd>(a: &mut Optimise) {
    let mut lanes = [[0.0f32; 16]; SUMS];
    for block in (a.start..a.end).step_by(S::LANES) {
        fetch_ahead::<S>(a, block + S::LANES);
        let mut alive = [0.0f32; 16];
        let mut any = false;
        for lane in 0..S::LANES.min(a.end - block) {
            let i = block + lane;
            let [begin, end] = a.bins.ranges[i];
            if a.keys[i] == CULLED || begin == end {
                continue;
            }
            let mut total = [0.0f32; SUMS];
            for &position in &a.bins.positions[begin as usize..end as usize] {
                for (t, s) in total.iter_mut().zip(&a.sums[position as usize]) {
                    *t += s;
                }
            }
            if total.iter().any(|v| !v.is_finite()) {
                a.non_finite += 1;
                continue;
            }
            // Touched no pixel, or none that counts: it must not drift on former steps' momentum.
            if total[9] <= 0.0 || total[..9].iter().all(|&v| v == 0.0) {
                continue;
            }
            for (column, t) in lanes.iter_mut().zip(total) {
                column[lane] = t;
            }
            alive[lane] = 1.0;
            any = true;
        }
        if any {
            unsafe { optimise_block::<S>(a, block, &lanes, &alive) };
        }
    }
}

/// dL/d(geometry) of a block from the pair sums, without colour's part of dL/dmean.
#[inline(always)]
fn geometry_gradient<S: Simd>(
    c: &CameraConstants,
    p: &Projection<S>,
    sums: &[S; SUMS],
    penalties: [f32; 2],
    log_scales: [S; 3],
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
        let low_pass = S::splat(super::project::LOW_PASS);
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
    let limit = S::splat(LOG_SCALE_LIMIT);
    let d_scale = array!(k in 3 => {
        let column = dot3([d_m[0][k], d_m[1][k], d_m[2][k]], [p.rotation[0][k], p.rotation[1][k], p.rotation[2][k]]);
        column.add(S::splat(penalties[1])).mul(p.scale[k]).keep(log_scales[k].abs().lt(limit))
    });
    let d_r = array!(j in 3 => array!(k in 3 => d_m[j][k].mul(p.scale[k])));
    let d_q = quaternion_gradient(p, &d_r);
    let d_mean = mean_gradient(c, p, [gx, gy], &d_jw);
    let slope = one.sub(p.sigmoid);
    let d_logit = v.mul(slope).add(S::splat(penalties[0]).mul(p.sigmoid).mul(slope));
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

#[inline(always)]
unsafe fn optimise_block<S: Simd>(
    a: &mut Optimise,
    block: usize,
    lanes: &[[f32; 16]; SUMS],
    alive: &[f32; 16],
) {
    let p = unsafe { project_lanes::<S>(&a.parameters, block, a.camera) };
    let mut sums = [S::splat(0.0); SUMS];
    for (sum, lane) in sums.iter_mut().zip(lanes) {
        *sum = unsafe { S::load(lane.as_ptr()) };
    }
    let log_scales = array!(k in 3 => unsafe { a.parameters.lanes::<S>(LOG_SCALE + k, block) });
    let penalties = [a.opacity_penalty, a.scale_penalty];
    let mut gradient = geometry_gradient::<S>(a.camera, &p, &sums, penalties, log_scales);
    let alive = unsafe { S::load(alive.as_ptr()) }.ge(S::splat(0.5));
    let mut finite = alive;
    for g in gradient {
        finite = S::and(finite, g.abs().lt(S::splat(1e18)));
    }
    let corrections = match a.sink {
        Sink::Adam(_) => unsafe { bias_corrections::<S>(a.shared.steps.0.add(block)) },
        Sink::Gradients => [S::splat(1.0); 2],
    };
    let mut correction = [[1.0f32; 16]; 2];
    for (lanes, c) in correction.iter_mut().zip(corrections) {
        unsafe { c.store(lanes.as_mut_ptr()) };
    }
    // Colours move only where the shape does: a Gaussian is left as it is, or takes the whole step.
    let mut by_direction = [[0.0f32; 16]; 3];
    for lane in (0..S::LANES).filter(|lane| S::bits(finite) & (1 << lane) != 0) {
        let rgb = [lanes[6][lane], lanes[7][lane], lanes[8][lane]];
        let g = unsafe { colour_step(a, block + lane, rgb, [correction[0][lane], correction[1][lane]]) };
        for (plane, value) in by_direction.iter_mut().zip(g.to_array()) {
            plane[lane] = value;
        }
    }
    for (k, plane) in by_direction.iter().enumerate() {
        let part = unsafe { S::load(plane.as_ptr()) };
        gradient[MEAN + k] = gradient[MEAN + k].add(part);
        finite = S::and(finite, part.abs().lt(S::splat(1e18)));
    }
    let lost = S::bits(alive) & !S::bits(finite);
    a.non_finite += lost.count_ones() as usize;
    match a.sink {
        Sink::Gradients => {
            for (plane, g) in a.shared.geometry[0].iter().zip(gradient) {
                unsafe { g.keep(finite).store(plane.0.add(block)) };
            }
        }
        Sink::Adam(rates) => unsafe {
            adam_block::<S>(a, block, &gradient, finite, corrections, &rates);
            note_statistics::<S>(a, block, &p, &sums, finite);
        },
    }
}

/// `1 / (1 − β₁ᵗ)` and `1 / (1 − β₂ᵗ)` of the step that the clocks are about to take.
/// # Safety
/// `clock` points to LANES values.
#[inline(always)]
unsafe fn bias_corrections<S: Simd>(clock: *const f32) -> [S; 2] {
    let one = S::splat(1.0);
    let t = unsafe { S::load(clock) }.add(one);
    let c1 = one.sub(t.mul(S::splat(LN_BETA1)).exp());
    let c2 = one.sub(t.mul(S::splat(LN_BETA2)).exp());
    [one.div(c1), one.div(c2)]
}

#[inline(always)]
unsafe fn adam_block<S: Simd>(
    a: &Optimise,
    block: usize,
    gradient: &[S; GEOMETRY],
    on: S::Mask,
    [c1, c2]: [S; 2],
    rates: &LearningRates,
) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    unsafe {
        let clock = a.shared.steps.0.add(block);
        let t = S::load(clock).add(one);
        S::select(on, t, S::load(clock)).store(clock);
        for (k, &g) in gradient.iter().enumerate() {
            let rate = match k {
                0..LOG_SCALE => rates.mean,
                LOG_SCALE..ROTATION => rates.log_scale,
                ROTATION..OPACITY => rates.rotation,
                _ => rates.opacity,
            };
            let [value, m, v] = array!(s in 3 => a.shared.geometry[s][k].0.add(block));
            let g = g.keep(on);
            let m1 = S::load(m).mul(S::splat(BETA1)).add(g.mul(S::splat(1.0 - BETA1)));
            let v1 = S::load(v).mul(S::splat(BETA2)).add(g.mul(g).mul(S::splat(1.0 - BETA2)));
            let m1 = m1.keep(m1.abs().ge(S::splat(TINY_MOMENT)));
            let v1 = v1.keep(v1.ge(S::splat(TINY_SQUARE)));
            let step = m1.mul(c1).div(v1.mul(c2).sqrt().add(S::splat(EPSILON))).mul(S::splat(rate));
            let moved = S::load(value).sub(S::select(on, step, zero));
            moved.store(value);
            S::select(on, m1, S::load(m)).store(m);
            S::select(on, v1, S::load(v)).store(v);
        }
    }
}

#[inline(always)]
unsafe fn note_statistics<S: Simd>(
    a: &Optimise,
    block: usize,
    p: &Projection<S>,
    sums: &[S; SUMS],
    on: S::Mask,
) {
    let c = a.camera;
    unsafe {
        let [gradient, visible, weight, radius] = a.shared.statistics.map(|plane| plane.0.add(block));
        let gx = p.conic[0].mul(sums[1]).add(p.conic[1].mul(sums[2])).mul(S::splat(0.5 * c.size[0]));
        let gy = p.conic[1].mul(sums[1]).add(p.conic[2].mul(sums[2])).mul(S::splat(0.5 * c.size[1]));
        let mut norm = gx.fma(gx, gy.mul(gy)).sqrt();
        if a.scores == Scores::Error {
            norm = sums[10];
        }
        if a.scores == Scores::Magnitudes {
            const LN_2: f32 = std::f32::consts::LN_2;
            let (mx, my) = (
                sums[10].mul(S::splat(0.5 * LN_2 * c.size[0])),
                sums[11].mul(S::splat(0.5 * LN_2 * c.size[1])),
            );
            norm = mx.fma(mx, my.mul(my)).sqrt();
        }
        S::load(gradient).add(norm.keep(on)).store(gradient);
        S::load(visible).add(S::splat(1.0).keep(on)).store(visible);
        S::load(weight).max(sums[9].keep(on)).store(weight);
        let larger = p.cov[0].max(p.cov[2]).sqrt().mul(S::splat(3.0 / c.size[0].max(c.size[1])));
        S::load(radius).max(larger.keep(on)).store(radius);
    }
}

/// Spherical harmonics of Gaussian `i`: their step, and the colour's part of dL/dmean (infinite, and no step, where it is not finite).
/// # Safety
/// No other task works on `i`.
#[inline(always)]
unsafe fn colour_step(a: &Optimise, i: usize, d_rgb: [f32; 3], corrections: [f32; 2]) -> Vec3 {
    let stride = a.parameters.sh_stride;
    let degree = a.camera.sh_degree;
    let (mean, coefficients) = unsafe { (a.parameters.mean(i), a.parameters.sh(i)) };
    let offset = mean - a.camera.position;
    let distance = offset.length();
    let dir = offset.normalize_or_zero();
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(dir, degree, &mut basis);
    let rgb = colour(coefficients, &basis, degree);
    let d_rgb: [f32; 3] = std::array::from_fn(|c| if rgb[c] > 0.0 { d_rgb[c] } else { 0.0 });
    let used = (degree as usize + 1).pow(2);
    let mut by_basis = [0.0; sh::MAX_COEFFICIENTS];
    for (w, sh) in by_basis[..used].iter_mut().zip(coefficients.chunks_exact(3)) {
        *w = sh[0] * d_rgb[0] + sh[1] * d_rgb[1] + sh[2] * d_rgb[2];
    }
    let g = sh::basis_gradient(dir, degree, &by_basis);
    let by_mean = if distance > 0.0 { (g - dir * g.dot(dir)) / distance } else { Vec3::ZERO };
    if !by_mean.is_finite() {
        return Vec3::INFINITY;
    }
    unsafe {
        let slice = |s: usize| std::slice::from_raw_parts_mut(a.shared.sh[s].0.add(i * stride), used * 3);
        match a.sink {
            Sink::Gradients => {
                for (out, y) in slice(0).chunks_exact_mut(3).zip(basis) {
                    out.copy_from_slice(&d_rgb.map(|d| d * y));
                }
            }
            Sink::Adam(rates) => {
                adam_colour([slice(0), slice(1), slice(2)], &basis, d_rgb, corrections, &rates);
            }
        }
    }
    by_mean
}

#[inline(always)]
fn adam_colour(
    [value, m, v]: [&mut [f32]; 3],
    basis: &[f32; sh::MAX_COEFFICIENTS],
    d_rgb: [f32; 3],
    [c1, c2]: [f32; 2],
    rates: &LearningRates,
) {
    let mut gradient = [0.0f32; sh::MAX_COEFFICIENTS * 3];
    for (out, y) in gradient.chunks_exact_mut(3).zip(basis) {
        out.copy_from_slice(&d_rgb.map(|d| d * y));
    }
    let mut rate = [rates.sh_rest; sh::MAX_COEFFICIENTS * 3];
    rate[..3].fill(rates.sh0);
    let n = value.len().min(m.len()).min(v.len());
    for k in 0..n {
        let g = gradient[k];
        let m1 = BETA1 * m[k] + (1.0 - BETA1) * g;
        let v1 = BETA2 * v[k] + (1.0 - BETA2) * g * g;
        m[k] = if m1.abs() >= TINY_MOMENT { m1 } else { 0.0 };
        v[k] = if v1 >= TINY_SQUARE { v1 } else { 0.0 };
        value[k] -= rate[k] * (m[k] * c1) / ((v[k] * c2).sqrt() + EPSILON);
    }
}

simd_kernel!(
    /// Gradients of a range of Gaussians, and their step.
    pub fn optimise(arguments: &mut Optimise) = optimise_generic
);
