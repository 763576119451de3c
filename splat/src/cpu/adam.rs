//! project backward and Adam, fused: screen gradients → parameters.
//! in: sums of [`super::rasterise::Backward`] by pair. out: parameters and moments moved one step,
//! or plain gradients.
//!
//! Adam (Kingma and Ba 2015; colours: `reference/adam.rs`) runs on each Gaussian's own clock: a
//! step counts only where the Gaussian was visible, so that the others keep parameters and moments
//! as they are instead of drifting on stale momentum.

use super::dispatch::simd_kernel;
use super::model_part::{AdamPart, GradientSink, ModelPart, PART};
use super::project::{CULLED, Projection, colour_of, cross, next_part, project_lanes};
use super::project_backward::geometry_gradient;
use super::rasterise::SUMS;
use super::sh;
use super::simd::{Simd, array};
use super::sort::Bins;
use crate::camera::{CameraConstants, PartCameras};
use crate::model::{GEOMETRY, LANE_PAD, LOG_SCALE, MEAN, OPACITY, ROTATION};
use crate::parts::{PartPull, PartPulls};
use crate::reference::constants::{BETAS, EPSILON};
use glam::Vec3;
use scene::sh::SH_COUNT;
use std::sync::Mutex;

/// Moments below these are set to zero, so that no denormal numbers slow the loop: first and second
/// moments. Source: chosen by hand, never measured; the steps that they are part of are below 1e-3
/// of the rate.
const TINY: [f32; 2] = [1e-18, 1e-30];
/// Gradients from here on count as not finite. Source: their squares must stay below the greatest
/// f32, 3.4e38.
const HUGE: f32 = 1e18;

/// Arguments of [`adam`].
pub(super) struct Adam<'a> {
    /// The Gaussians.
    pub(super) part: ModelPart<'a>,
    /// The camera, as the body and the parts see it.
    pub(super) cameras: &'a PartCameras,
    /// The view's pairs.
    pub(super) bins: &'a Bins,
    /// Depth keys of forward.
    pub(super) keys: &'a [u32],
    /// Sums by pair.
    pub(super) sums: &'a [[f32; SUMS]],
    /// Out: what pulls at moving parts, by groups of [`PART`] Gaussians; empty where nothing moves.
    pub(super) pulls: &'a [Mutex<PartPulls>],
    /// Out: Gaussians whose gradient was not finite.
    pub(super) non_finite: usize,
}

/// Fetches what a block will read from places that no pattern foretells: its pairs' sums, and the
/// colours of Gaussians that are seen among others that are not.
#[inline(always)]
fn fetch_ahead<S: Simd>(a: &Adam, block: usize) {
    let used = (a.cameras.body().sh_degree as usize + 1).pow(2) * 3 * size_of::<f32>();
    for i in block..(block + S::LANES).min(a.part.count) {
        let number = a.part.first + i;
        let positions = a.bins.positions_of(number);
        if a.keys[number] == CULLED || positions.is_empty() {
            continue;
        }
        for &position in positions {
            let sums: *const [f32; SUMS] = &raw const a.sums[position as usize];
            S::prefetch(sums.cast());
            S::prefetch(sums.wrapping_add(1).cast::<u8>().wrapping_sub(1));
        }
        let first = a.part.sh.as_ptr().wrapping_add(i * a.part.sh_stride).cast::<u8>();
        // Cache lines are as long as the widest vectors.
        (0..used).step_by(LANE_PAD * size_of::<f32>()).for_each(|at| S::prefetch(first.wrapping_add(at)));
    }
}

#[inline(always)]
fn adam_generic<S: Simd>(a: &mut Adam) {
    let mut lanes = [[0.0f32; LANE_PAD]; SUMS];
    for block in (0..a.part.count).step_by(S::LANES) {
        fetch_ahead::<S>(a, block + S::LANES);
        let mut alive = 0;
        for lane in 0..S::LANES.min(a.part.count - block) {
            let number = a.part.first + block + lane;
            let positions = a.bins.positions_of(number);
            if a.keys[number] == CULLED || positions.is_empty() {
                continue;
            }
            let mut total = [0.0f32; SUMS];
            for &position in positions {
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
            alive |= 1 << lane;
        }
        while alive != 0 {
            let (part, own) = next_part(a.part.of_object, a.part.first + block, alive);
            adam_block::<S>(a, block, &lanes, (part, own));
            alive &= !own;
        }
    }
}

/// The Gaussians from `block` on that are `alive`, all of one part of the object: `lanes` are their
/// sums.
#[inline(always)]
fn adam_block<S: Simd>(
    a: &mut Adam,
    block: usize,
    lanes: &[[f32; LANE_PAD]; SUMS],
    (part, alive): (u8, u32),
) {
    let camera = a.cameras.of(part);
    let mut parameters = [S::splat(0.0); GEOMETRY];
    for (value, plane) in parameters.iter_mut().zip(&a.part.geometry) {
        *value = S::read(&plane[block..]);
    }
    let p = project_lanes(&parameters, camera);
    let mut sums = [S::splat(0.0); SUMS];
    for (sum, lane) in sums.iter_mut().zip(lanes) {
        *sum = S::read(lane);
    }
    let mut gradient = geometry_gradient(camera, &p, &sums, &parameters);
    let alive: [f32; LANE_PAD] = std::array::from_fn(|lane| (alive >> lane & 1) as f32);
    let alive = S::read(&alive).ge(S::splat(0.5));
    let mut finite = alive;
    for g in gradient {
        finite = S::and(finite, g.abs().lt(S::splat(HUGE)));
    }
    let corrections = match &a.part.sink {
        GradientSink::Adam(state) => bias_corrections::<S>(&state.steps[block..]),
        GradientSink::Gradient { .. } => [S::splat(1.0); 2],
    };
    let mut correction = [1.0f32; LANE_PAD];
    corrections[1].write(&mut correction);
    // Colours move only where the shape does: a Gaussian is left as it is, or takes the whole step.
    let mut by_direction = [[0.0f32; LANE_PAD]; 3];
    for lane in (0..S::LANES).filter(|lane| S::bits(finite) & (1 << lane) != 0) {
        let rgb = [lanes[6][lane], lanes[7][lane], lanes[8][lane]];
        let step = ColourStep { camera, i: block + lane, d_rgb: rgb, correction: correction[lane] };
        let g = match camera.sh_degree {
            0 => step.take::<1>(&mut a.part),
            1 => step.take::<4>(&mut a.part),
            2 => step.take::<9>(&mut a.part),
            _ => step.take::<SH_COUNT>(&mut a.part),
        };
        for (plane, value) in by_direction.iter_mut().zip(g.to_array()) {
            plane[lane] = value;
        }
    }
    let of_shape = gradient;
    for (k, plane) in by_direction.iter().enumerate() {
        let part = S::read(plane);
        gradient[MEAN + k] = gradient[MEAN + k].add(part);
        finite = S::and(finite, part.abs().lt(S::splat(HUGE)));
    }
    if part > 0 && !a.pulls.is_empty() {
        let pull = pull::<S>(&parameters, &of_shape, &by_direction, finite);
        let group = &a.pulls[(a.part.first + block) / PART];
        let mut group = group.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        group[usize::from(part) - 1].add(&pull);
    }
    let lost = S::bits(alive) & !S::bits(finite);
    a.non_finite += lost.count_ones() as usize;
    match &mut a.part.sink {
        GradientSink::Gradient { geometry, .. } => {
            for (plane, g) in geometry.iter_mut().zip(gradient) {
                // Other lanes may be those of another part.
                let plane = &mut plane[block..];
                S::select(finite, g, S::read(plane)).write(plane);
            }
        }
        GradientSink::Adam(state) => {
            move_geometry(&mut a.part.geometry, state, block, &parameters, &gradient, finite, corrections);
            note_statistics(state, block, camera, &p, &sums, finite);
        }
    }
}

/// What pulls at a block of Gaussians of a part, where `on`: places, directions (a turn by the
/// small vector φ makes of a quaternion q the sum q + ½ (0, φ) q), colours.
#[inline(always)]
fn pull<S: Simd>(
    parameters: &[S; GEOMETRY],
    gradient: &[S; GEOMETRY],
    by_direction: &[[f32; LANE_PAD]; 3],
    on: S::Mask,
) -> PartPull {
    let half = S::splat(0.5);
    let vector = |all: &[S; GEOMETRY], first: usize| -> [S; 3] { array!(k in 3 => all[first + k]) };
    let (x, g) = (vector(parameters, MEAN), vector(gradient, MEAN));
    let (w, u) = (parameters[ROTATION], vector(parameters, ROTATION + 1));
    let (g_w, g_u) = (gradient[ROTATION], vector(gradient, ROTATION + 1));
    let (turn, own) = (cross(x, g), cross(u, g_u));
    let torque: [S; 3] = array!(k in 3 => {
        turn[k].add(half.mul(w.mul(g_u[k]).sub(g_w.mul(u[k])).add(own[k])))
    });
    let colour: [S; 3] = array!(k in 3 => S::read(&by_direction[k]));
    let sums = |v: [S; 3]| -> [f32; 3] {
        v.map(|v| {
            let mut lanes = [0.0f32; LANE_PAD];
            v.keep(on).write(&mut lanes);
            lanes[..S::LANES].iter().sum()
        })
    };
    PartPull { force: sums(g), torque: sums(torque), colour: sums(colour) }
}

/// `1 / (1 − β₁ᵗ)` and `1 / (1 − β₂ᵗ)` of the step that the clocks are about to take.
#[inline(always)]
fn bias_corrections<S: Simd>(clock: &[f32]) -> [S; 2] {
    let one = S::splat(1.0);
    let t = S::read(clock).add(one);
    let c1 = one.sub(t.mul(S::splat(BETAS[0].ln() as f32)).exp());
    let c2 = one.sub(t.mul(S::splat(BETAS[1].ln() as f32)).exp());
    [one.div(c1), one.div(c2)]
}

/// Clocks, moments and parameters of the Gaussians from `block` on, where `on`.
#[inline(always)]
fn move_geometry<S: Simd>(
    geometry: &mut [&mut [f32]; GEOMETRY],
    state: &mut AdamPart,
    block: usize,
    parameters: &[S; GEOMETRY],
    gradient: &[S; GEOMETRY],
    on: S::Mask,
    [c1, c2]: [S; 2],
) {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let clock = &mut state.steps[block..];
    let t = S::read(clock);
    S::select(on, t.add(one), t).write(clock);
    let [beta1, beta2] = BETAS.map(|beta| beta as f32);
    for (k, &g) in gradient.iter().enumerate() {
        let rate = match k {
            0..LOG_SCALE => state.rates.mean,
            LOG_SCALE..ROTATION => state.rates.log_scale,
            ROTATION..OPACITY => state.rates.rotation,
            _ => state.rates.opacity,
        };
        let (m, v) = (&mut state.geometry_m[k][block..], &mut state.geometry_v[k][block..]);
        let (m0, v0) = (S::read(m), S::read(v));
        let g = g.keep(on);
        let m1 = m0.mul(S::splat(beta1)).add(g.mul(S::splat(1.0 - beta1)));
        let v1 = v0.mul(S::splat(beta2)).add(g.mul(g).mul(S::splat(1.0 - beta2)));
        let m1 = m1.keep(m1.abs().ge(S::splat(TINY[0])));
        let v1 = v1.keep(v1.ge(S::splat(TINY[1])));
        let size = v1.mul(c2).sqrt().add(S::splat(EPSILON as f32));
        let step = m1.mul(c1).mul(size.reciprocal()).mul(S::splat(rate));
        parameters[k].sub(S::select(on, step, zero)).write(&mut geometry[k][block..]);
        S::select(on, m1, m0).write(m);
        S::select(on, v1, v0).write(v);
    }
}

#[inline(always)]
fn note_statistics<S: Simd>(
    state: &mut AdamPart,
    block: usize,
    c: &CameraConstants,
    p: &Projection<S>,
    sums: &[S; SUMS],
    on: S::Mask,
) {
    let gx = p.conic[0].mul(sums[1]).add(p.conic[1].mul(sums[2])).mul(S::splat(0.5 * c.size[0]));
    let gy = p.conic[1].mul(sums[1]).add(p.conic[2].mul(sums[2])).mul(S::splat(0.5 * c.size[1]));
    let norm = gx.fma(gx, gy.mul(gy)).sqrt();
    let (gradient, visible) = (&mut state.gradient[block..], &mut state.visible[block..]);
    S::read(gradient).add(norm.keep(on)).write(gradient);
    S::read(visible).add(S::splat(1.0).keep(on)).write(visible);
}

/// The step of a Gaussian's colours.
struct ColourStep<'a> {
    camera: &'a CameraConstants,
    /// Its number within the part of the model.
    i: usize,
    /// dL/d(colour).
    d_rgb: [f32; 3],
    /// Of the second moments, see [`bias_corrections`].
    correction: f32,
}

impl ColourStep<'_> {
    /// Takes it, with `USED` coefficients a channel: their number has to be known when the loops
    /// are compiled. dL/d(mean) by the direction (infinite, and no step, where it is not finite).
    #[inline(always)]
    fn take<const USED: usize>(&self, part: &mut ModelPart) -> Vec3 {
        let (degree, i) = (USED.isqrt() as u32 - 1, self.i);
        let mean = Vec3::new(part.geometry[MEAN][i], part.geometry[MEAN + 1][i], part.geometry[MEAN + 2][i]);
        let own = i * part.sh_stride..i * part.sh_stride + USED * 3;
        let coefficients = &mut part.sh[own.clone()];
        let offset = mean - self.camera.position;
        let distance = offset.length();
        let dir = offset.normalize_or_zero();
        let mut basis = [0.0; SH_COUNT];
        sh::basis(dir, degree, &mut basis);
        let rgb = colour_of::<USED>(coefficients, &basis);
        let d_rgb = array!(c in 3 => if rgb[c] > 0.0 { self.d_rgb[c] } else { 0.0 });
        let mut by_basis = [0.0; SH_COUNT];
        for (w, sh) in by_basis[..USED].iter_mut().zip(coefficients.chunks_exact(3)) {
            *w = sh[0] * d_rgb[0] + sh[1] * d_rgb[1] + sh[2] * d_rgb[2];
        }
        let g = sh::basis_gradient(dir, degree, &by_basis);
        let by_mean = if distance > 0.0 { (g - dir * g.dot(dir)) / distance } else { Vec3::ZERO };
        if !by_mean.is_finite() {
            return Vec3::INFINITY;
        }
        match &mut part.sink {
            GradientSink::Gradient { sh, .. } => {
                for (out, y) in sh[own].chunks_exact_mut(3).zip(basis) {
                    out.copy_from_slice(&array!(c in 3 => d_rgb[c] * y));
                }
            }
            GradientSink::Adam(state) => {
                let by_channel = self.by_channel(state, array!(c in 3 => basis[0] * d_rgb[c]));
                let step = array!(c in 3 => d_rgb[c] * by_channel[c]);
                let mut steps = [0.0; SH_COUNT * 3];
                for (k, to) in steps[..USED * 3].chunks_exact_mut(3).enumerate() {
                    let rate = basis[k] * if k == 0 { state.rates.sh0 } else { state.rates.sh_rest };
                    to.copy_from_slice(&array!(c in 3 => rate * step[c]));
                }
                for (value, step) in coefficients.iter_mut().zip(steps) {
                    *value -= step;
                }
            }
        }
        by_mean
    }

    /// The second moments after a gradient of the constant harmonics, and the reciprocals of what
    /// all steps of their channels are divided by.
    #[inline(always)]
    fn by_channel(&self, state: &mut AdamPart, gradient: [f32; 3]) -> [f32; 3] {
        let beta = BETAS[1] as f32;
        array!(c in 3 => {
            let kept = &mut state.sh_v[c][self.i];
            let v = *kept * beta + gradient[c] * gradient[c] * (1.0 - beta);
            *kept = if v >= TINY[1] { v } else { 0.0 };
            1.0 / ((*kept * self.correction).sqrt() + EPSILON as f32)
        })
    }
}

simd_kernel!(
    /// Gradients of a part of a model, and their step.
    pub(super) fn adam(arguments: &mut Adam) = adam_generic
);
