//! project: Gaussian i → screen.
//! in: means, log-scales, quaternions (w x y z), logits as planes \[11\]\[N\]; camera.
//! out: `records` \[N\] of [`Record`], `keys` \[N\] depth bits or [`CULLED`].
//!
//! `Σ' = J W Σ Wᵀ Jᵀ + 0.3 I` (Zwicker et al., EWA splatting, 2002; the 0.3 px² low-pass: Kerbl et
//! al. 2023).

use super::dispatch::simd_kernel;
use super::sh;
use super::simd::{Simd, array};
use crate::camera::{CameraConstants, PartCameras};
use crate::model::{GEOMETRY, LANE_PAD, LOG_SCALE, MEAN, Model, OPACITY, ROTATION};
use crate::reference::constants::{LOW_PASS, MAX_LOG_SCALE, MIN_ALPHA};
use scene::sh::SH_COUNT;
use std::f32::consts::LOG2_E;

/// `log2(255)`: alpha below 1/255 is not drawn. Source: derived.
pub(super) const LOG2_255: f32 = 7.994_353_4;
/// Key of a Gaussian that touches no tile. Source: no depth has these bits.
pub(crate) const CULLED: u32 = u32::MAX;

/// A Gaussian on the screen. Exponents are of base 2: `alpha = 2^(log2_opacity − power)`,
/// `power = half_xx dx² + xy dx dy + half_yy dy²`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct Record {
    /// Centre, pixels.
    pub(crate) x: f32,
    /// Centre, pixels.
    pub(crate) y: f32,
    /// Half the conic's xx, times log2 e.
    pub(crate) half_xx: f32,
    /// The conic's xy, times log2 e.
    pub(crate) xy: f32,
    /// Half the conic's yy, times log2 e.
    pub(crate) half_yy: f32,
    /// Base-2 logarithm of the opacity.
    pub(crate) log2_opacity: f32,
    /// Colour, at least 0.
    pub(crate) rgb: [f32; 3],
    /// Camera z.
    pub(crate) depth: f32,
    /// Half the width of the box around the ellipse `alpha ≥ 1/255`, pixels.
    pub(crate) extent_x: f32,
    /// Half its height.
    pub(crate) extent_y: f32,
    /// conic xy / yy: the chord at `dx` is centred on `dy = −slope dx`.
    pub(crate) slope: f32,
    /// (Half the height of the chord at dx = 0)², px².
    pub(crate) chord: f32,
    /// det conic / yy²: half the height of the chord at `dx` is `√(chord − bend dx²)`.
    pub(crate) bend: f32,
    /// −dx of the ellipse's highest point, that is `extent_y · xy / xx`.
    pub(crate) tilt: f32,
}

impl Record {
    /// Fills the last four fields from the others.
    pub(crate) fn with_chords(mut self) -> Self {
        let (a, b, c) = (2.0 * self.half_xx, self.xy, 2.0 * self.half_yy);
        let reach = 2.0 * (self.log2_opacity + LOG2_255);
        self.slope = b / c;
        self.chord = reach / c;
        self.bend = (a * c - b * b).max(0.0) / (c * c);
        self.tilt = b / a * self.extent_y;
        self
    }
}

/// What forward and backward both need of a vector of Gaussians.
pub(crate) struct Projection<S: Simd> {
    /// Camera frame.
    pub(crate) xc: [S; 3],
    /// 1 / z.
    pub(crate) inv_z: S,
    /// x/z and y/z limited.
    pub(crate) limited: [S; 2],
    /// Where the limits did not bind.
    pub(crate) free: [S::Mask; 2],
    /// Rotation matrix of the Gaussian, row-major.
    pub(crate) rotation: [[S; 3]; 3],
    /// Unit quaternion.
    pub(crate) q: [S; 4],
    /// 1 / norm of the quaternion (0 for a zero norm).
    pub(crate) inv_norm: S,
    /// Standard deviations.
    pub(crate) scale: [S; 3],
    /// J W.
    pub(crate) jw: [[S; 3]; 2],
    /// J W R S.
    pub(crate) jwm: [[S; 3]; 2],
    /// Σ' (xx, xy, yy).
    pub(crate) cov: [S; 3],
    /// Σ'⁻¹ (xx, xy, yy).
    pub(crate) conic: [S; 3],
    /// det(Σ' without the low-pass).
    pub(crate) sharp: S,
    /// Opacity, scaled if `antialias`.
    pub(crate) opacity: S,
    /// sigmoid(logit).
    pub(crate) sigmoid: S,
    /// Centre, pixels.
    pub(crate) xy: [S; 2],
    /// Whether it may be drawn.
    pub(crate) valid: S::Mask,
}

/// The camera's rotation in every lane.
#[inline(always)]
pub(crate) fn camera_rows<S: Simd>(c: &CameraConstants) -> [[S; 3]; 3] {
    array!(a in 3 => array!(k in 3 => S::splat(c.r[a][k])))
}

/// `2 v`.
#[inline(always)]
pub(crate) fn twice<S: Simd>(v: S) -> S {
    v.add(v)
}

/// The rotation matrix of a unit quaternion (w, x, y, z).
#[inline(always)]
fn rotation_matrix<S: Simd>(q: [S; 4]) -> [[S; 3]; 3] {
    let [w, x, y, z] = q;
    let one = S::splat(1.0);
    let (xx, yy, zz) = (x.mul(x), y.mul(y), z.mul(z));
    let (xy, xz, yz) = (x.mul(y), x.mul(z), y.mul(z));
    let (wx, wy, wz) = (w.mul(x), w.mul(y), w.mul(z));
    [
        [one.sub(twice(yy.add(zz))), twice(xy.sub(wz)), twice(xz.add(wy))],
        [twice(xy.add(wz)), one.sub(twice(xx.add(zz))), twice(yz.sub(wx))],
        [twice(xz.sub(wy)), twice(yz.add(wx)), one.sub(twice(xx.add(yy)))],
    ]
}

/// `a · b` for vectors of three.
#[inline(always)]
pub(crate) fn dot3<S: Simd>(a: [S; 3], b: [S; 3]) -> S {
    a[0].fma(b[0], a[1].fma(b[1], a[2].mul(b[2])))
}

/// `a × b`.
#[inline(always)]
pub(super) fn cross<S: Simd>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    array!(k in 3 => {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i].mul(b[j]).sub(a[j].mul(b[i]))
    })
}

/// Projects a vector of Gaussians from their geometric parameters.
#[inline(always)]
pub(super) fn project_lanes<S: Simd>(g: &[S; GEOMETRY], c: &CameraConstants) -> Projection<S> {
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let mu = [g[MEAN], g[MEAN + 1], g[MEAN + 2]];
    let rows = camera_rows::<S>(c);
    let xc = array!(a in 3 => dot3(rows[a], mu).add(S::splat(c.t[a])));
    let in_front = xc[2].ge(S::splat(c.near));
    let inv_z = one.div(S::select(in_front, xc[2], one));

    let raw = array!(k in 4 => g[ROTATION + k]);
    let norm2 = raw[0].fma(raw[0], raw[1].fma(raw[1], raw[2].fma(raw[2], raw[3].mul(raw[3]))));
    let has_norm = norm2.ge(S::splat(1e-30));
    let inv_norm = one.div(S::select(has_norm, norm2, one).sqrt()).keep(has_norm);
    let q = [
        S::select(has_norm, raw[0].mul(inv_norm), one),
        raw[1].mul(inv_norm),
        raw[2].mul(inv_norm),
        raw[3].mul(inv_norm),
    ];
    let rotation = rotation_matrix(q);
    let limit = S::splat(MAX_LOG_SCALE as f32);
    let scale = array!(a in 3 => g[LOG_SCALE + a].max(zero.sub(limit)).min(limit).exp());

    let ratio = [xc[0].mul(inv_z), xc[1].mul(inv_z)];
    let limited = array!(a in 2 => ratio[a].max(S::splat(c.low[a])).min(S::splat(c.high[a])));
    let free = array!(a in 2 => S::and(ratio[a].ge(S::splat(c.low[a])), S::splat(c.high[a]).ge(ratio[a])));
    let jw = array!(a in 2 => {
        let f = S::splat(c.focal[a]).mul(inv_z);
        array!(k in 3 => f.mul(rows[a][k].sub(limited[a].mul(rows[2][k]))))
    });
    let jwm = array!(r in 2 => {
        array!(k in 3 => dot3(jw[r], [rotation[0][k], rotation[1][k], rotation[2][k]]).mul(scale[k]))
    });
    let (xx, xy, yy) = (dot3(jwm[0], jwm[0]), dot3(jwm[0], jwm[1]), dot3(jwm[1], jwm[1]));
    let low_pass = S::splat(LOW_PASS as f32);
    let cov = [xx.add(low_pass), xy, yy.add(low_pass)];
    // det (A Aᵀ) = |a × b|², which loses nothing for needles, as xx yy − xy² does.
    let normal = cross(jwm[0], jwm[1]);
    let sharp = dot3(normal, normal);
    let det = low_pass.fma(xx.add(yy).add(low_pass), sharp);
    // Finite and positive; NaN and infinity fail one of the comparisons.
    let good = S::and(det.ge(S::splat(1e-20)), S::splat(1e30).ge(det));
    let inv_det = one.div(S::select(good, det, one));
    let conic = [cov[2].mul(inv_det), zero.sub(xy).mul(inv_det), cov[0].mul(inv_det)];
    let sigmoid = one.div(one.add(zero.sub(g[OPACITY]).exp()));
    let det_ratio = sharp.mul(inv_det);
    let opacity = if c.antialias { sigmoid.mul(det_ratio.sqrt()) } else { sigmoid };
    let visible = opacity.ge(S::splat(MIN_ALPHA as f32));
    // A log-scale or a logit that is not a number passes the limits above and those of exp; it must
    // not be drawn.
    let lowest = S::splat(f32::NEG_INFINITY);
    let shaped = S::and(g[LOG_SCALE + 1].ge(lowest), g[LOG_SCALE + 2].ge(lowest));
    let shaped = S::and(shaped, g[OPACITY].ge(lowest));
    let visible = S::and(visible, S::and(g[LOG_SCALE].ge(lowest), shaped));
    Projection {
        xc,
        inv_z,
        limited,
        free,
        rotation,
        q,
        inv_norm,
        scale,
        jw,
        jwm,
        cov,
        conic,
        sharp,
        opacity,
        sigmoid,
        xy: [
            ratio[0].fma(S::splat(c.focal[0]), S::splat(c.centre[0])),
            ratio[1].fma(S::splat(c.focal[1]), S::splat(c.centre[1])),
        ],
        valid: S::and(S::and(in_front, good), visible),
    }
}

/// Arguments of [`project`]: Gaussians `start .. start + keys.len()`.
pub(crate) struct Project<'a> {
    /// All Gaussians.
    pub(crate) model: &'a Model,
    /// The camera, as the body and the parts see it.
    pub(crate) cameras: &'a PartCameras,
    /// First Gaussian.
    pub(crate) start: usize,
    /// Out.
    pub(crate) records: &'a mut [Record],
    /// Out.
    pub(crate) keys: &'a mut [u32],
}

#[inline(always)]
fn project_generic<S: Simd>(a: &mut Project) {
    for block in (0..a.keys.len()).step_by(S::LANES) {
        let mut geometry = [S::splat(0.0); GEOMETRY];
        for (value, plane) in geometry.iter_mut().zip(&a.model.geometry) {
            *value = S::read(&plane[a.start + block..]);
        }
        let count = S::LANES.min(a.keys.len() - block);
        a.keys[block..block + count].fill(CULLED);
        let mut left = u32::MAX >> (u32::BITS as usize - count);
        while left != 0 {
            let (part, own) = next_part(&a.model.part, a.start + block, left);
            project_block::<S>(a, block, &geometry, part, own);
            left &= !own;
        }
    }
}

/// The part of the first of the lanes `left` of a block that begins at a Gaussian, and which of
/// these lanes belong to it. Most blocks have one part.
#[inline(always)]
pub(super) fn next_part(of_object: &[u8], block: usize, left: u32) -> (u8, u32) {
    if of_object.is_empty() {
        return (0, left);
    }
    let part_of = |lane: u32| of_object.get(block + lane as usize).copied().unwrap_or(0);
    let part = part_of(left.trailing_zeros());
    let own = (0..LANE_PAD as u32).filter(|&lane| left & (1 << lane) != 0 && part_of(lane) == part);
    (part, own.fold(0, |bits, lane| bits | 1 << lane))
}

/// Projects those of a block's Gaussians that belong to a part: the lanes `own`.
#[inline(always)]
fn project_block<S: Simd>(a: &mut Project, block: usize, geometry: &[S; GEOMETRY], part: u8, own: u32) {
    let (c, stride) = (a.cameras.of(part), a.model.sh_stride());
    let mut lanes = [[0.0f32; LANE_PAD]; 9];
    let p = project_lanes(geometry, c);
    let bits = S::bits(p.valid) & own;
    if bits == 0 {
        return;
    }
    let [x, y] = p.xy;
    let [conic_xx, conic_xy, conic_yy] = p.conic;
    let columns = [x, y, conic_xx, conic_xy, conic_yy, p.opacity, p.cov[0], p.cov[2], p.xc[2]];
    for (lane, value) in lanes.iter_mut().zip(columns) {
        value.write(lane);
    }
    for lane in (0..S::LANES).filter(|lane| bits & (1 << lane) != 0) {
        let i = a.start + block + lane;
        let [x, y, conic_xx, conic_xy, conic_yy, opacity, cov_xx, cov_yy, depth] =
            lanes.each_ref().map(|values| values[lane]);
        let log2_opacity = opacity.log2();
        let reach = 2.0 * std::f32::consts::LN_2 * (log2_opacity + LOG2_255);
        let (extent_x, extent_y) = ((reach * cov_xx).max(0.0).sqrt(), (reach * cov_yy).max(0.0).sqrt());
        let inside =
            x + extent_x > 0.0 && x - extent_x < c.size[0] && y + extent_y > 0.0 && y - extent_y < c.size[1];
        if !inside {
            continue;
        }
        let mut basis = [0.0; SH_COUNT];
        let sh = &a.model.sh[i * stride..(i + 1) * stride];
        sh::basis((a.model.mean(i) - c.position).normalize_or_zero(), c.sh_degree, &mut basis);
        a.keys[block + lane] = depth.to_bits();
        a.records[block + lane] = Record {
            x,
            y,
            half_xx: 0.5 * LOG2_E * conic_xx,
            xy: LOG2_E * conic_xy,
            half_yy: 0.5 * LOG2_E * conic_yy,
            log2_opacity,
            rgb: colour(sh, &basis, c.sh_degree).map(|v| v.max(0.0)),
            depth,
            extent_x,
            extent_y,
            ..Record::default()
        }
        .with_chords();
    }
}

/// `0.5 + Σ Y_k sh_k`, not limited.
#[inline(always)]
pub(crate) fn colour(coefficients: &[f32], basis: &[f32; SH_COUNT], degree: u32) -> [f32; 3] {
    match degree {
        0 => colour_of::<1>(coefficients, basis),
        1 => colour_of::<4>(coefficients, basis),
        2 => colour_of::<9>(coefficients, basis),
        _ => colour_of::<SH_COUNT>(coefficients, basis),
    }
}

/// The same with `USED` coefficients a channel. Three channels and the next coefficient's first are
/// a vector of four, whose last sum nobody reads.
#[inline(always)]
pub(super) fn colour_of<const USED: usize>(coefficients: &[f32], basis: &[f32; SH_COUNT]) -> [f32; 3] {
    let sh = &coefficients[..USED * 3];
    let mut sums = [[0.0; 4]; 2];
    for k in 0..USED - 1 {
        for (sum, value) in sums[k % 2].iter_mut().zip(&sh[k * 3..k * 3 + 4]) {
            *sum += basis[k] * value;
        }
    }
    array!(c in 3 => 0.5 + sums[0][c] + sums[1][c] + basis[USED - 1] * sh[USED * 3 - 3 + c])
}

simd_kernel!(
    /// Projects a range of Gaussians.
    pub(crate) fn project(arguments: &mut Project) = project_generic
);
