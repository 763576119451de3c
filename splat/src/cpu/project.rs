//! project: Gaussian i → screen.
//! in: means, log-scales, quaternions (w x y z), logits as planes \[11\]\[N\]; camera.
//! out: `records` \[N\] of [`Record`], `keys` \[N\] depth bits or [`CULLED`].
//!
//! `Σ' = J W Σ Wᵀ Jᵀ + 0.3 I` (Zwicker et al., EWA splatting, 2002; the 0.3 px² low-pass: Kerbl et al. 2023).

use super::sh;
use super::simd::{Simd, array, simd_kernel};
use crate::model::{GEOMETRY, LOG_SCALE, MEAN, Model, OPACITY, ROTATION};
use crate::{PinholeView, RenderOptions};
use glam::Vec3;

/// Variance of the screen-space low-pass, px².
pub const LOW_PASS: f32 = 0.3;
/// `log2(255)`: alpha below 1/255 is not drawn.
pub const LOG2_255: f32 = 7.994_353_4;
/// Key of a Gaussian that touches no tile.
pub const CULLED: u32 = u32::MAX;
/// Bounds of log-scales, so that everything stays finite.
pub const LOG_SCALE_LIMIT: f32 = 20.0;

/// A Gaussian on the screen. Exponents are of base 2: `alpha = 2^(log2_opacity − power)`,
/// `power = half_xx dx² + xy dx dy + half_yy dy²`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Record {
    /// Centre, pixels.
    pub x: f32,
    /// Centre, pixels.
    pub y: f32,
    /// Half the conic's xx, times log2 e.
    pub half_xx: f32,
    /// The conic's xy, times log2 e.
    pub xy: f32,
    /// Half the conic's yy, times log2 e.
    pub half_yy: f32,
    /// Base-2 logarithm of the opacity.
    pub log2_opacity: f32,
    /// Colour, at least 0.
    pub rgb: [f32; 3],
    /// Camera z.
    pub depth: f32,
    /// Half the width of the box around the ellipse `alpha ≥ 1/255`, pixels.
    pub extent_x: f32,
    /// Half its height.
    pub extent_y: f32,
    /// conic xy / yy: the chord at `dx` is centred on `dy = −slope dx`.
    pub slope: f32,
    /// (Half the height of the chord at dx = 0)², px².
    pub chord: f32,
    /// det conic / yy²: half the height of the chord at `dx` is `√(chord − bend dx²)`.
    pub bend: f32,
    /// −dx of the ellipse's highest point, that is `extent_y · xy / xx`.
    pub tilt: f32,
}

impl Record {
    /// Fills the last four fields from the others.
    pub fn with_chords(mut self) -> Self {
        let (a, b, c) = (2.0 * self.half_xx, self.xy, 2.0 * self.half_yy);
        let reach = 2.0 * (self.log2_opacity + LOG2_255);
        self.slope = b / c;
        self.chord = reach / c;
        self.bend = (a * c - b * b).max(0.0) / (c * c);
        self.tilt = b / a * self.extent_y;
        self
    }
}

/// The camera as the kernels use it.
#[derive(Clone, Copy, Debug)]
pub struct CameraConstants {
    /// Rows of the rotation `cam_from_world`.
    pub r: [[f32; 3]; 3],
    /// Translation.
    pub t: [f32; 3],
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels.
    pub centre: [f32; 2],
    /// Lower limits of x/z and y/z in the Jacobian.
    pub low: [f32; 2],
    /// Upper limits of x/z and y/z in the Jacobian.
    pub high: [f32; 2],
    /// Camera centre, world.
    pub position: Vec3,
    /// Width and height, pixels.
    pub size: [f32; 2],
    /// Near plane.
    pub near: f32,
    /// Whether opacity is scaled with the low-pass.
    pub antialias: bool,
    /// Spherical-harmonic degree in use.
    pub sh_degree: u32,
}

impl CameraConstants {
    /// Of a view.
    pub fn new(view: &PinholeView, options: &RenderOptions, near: f32, sh_degree: u32) -> Self {
        let m = view.rotation;
        let size = [view.width as f32, view.height as f32];
        let margin = |a: usize| 0.15 * size[a] / view.focal[a];
        let limit = |a: usize, edge: f32| (edge - view.centre[a]) / view.focal[a];
        Self {
            r: [m.row(0).to_array(), m.row(1).to_array(), m.row(2).to_array()],
            t: view.translation.to_array(),
            focal: view.focal,
            centre: view.centre,
            low: [limit(0, 0.0) - margin(0), limit(1, 0.0) - margin(1)],
            high: [limit(0, size[0]) + margin(0), limit(1, size[1]) + margin(1)],
            position: view.position(),
            size,
            near,
            antialias: options.antialias,
            sh_degree,
        }
    }
}

/// Where the parameters lie: raw, because the optimiser writes them in place, each task its own Gaussians.
#[derive(Clone, Copy)]
pub struct Parameters {
    geometry: [*const f32; GEOMETRY],
    sh: *const f32,
    /// SH values of one Gaussian.
    pub sh_stride: usize,
    len: usize,
}
// Tasks read only what no other task writes.
unsafe impl Send for Parameters {}
unsafe impl Sync for Parameters {}

impl Parameters {
    /// Of a model, which must stay as long as these pointers are used.
    pub fn of(model: &Model) -> Self {
        Self {
            geometry: std::array::from_fn(|p| model.geometry[p].as_ptr()),
            sh: model.sh.as_ptr(),
            sh_stride: model.sh_stride(),
            len: model.len,
        }
    }

    /// Values `i .. i + LANES` of plane `p`.
    /// # Safety
    /// `i + LANES` is within the padded planes and nobody else writes them now.
    #[inline(always)]
    pub unsafe fn lanes<S: Simd>(&self, p: usize, i: usize) -> S {
        unsafe { S::load(self.geometry[p].add(i)) }
    }

    /// Mean of Gaussian `i`.
    /// # Safety
    /// `i < len` and nobody else writes it now.
    #[inline(always)]
    pub unsafe fn mean(&self, i: usize) -> Vec3 {
        debug_assert!(i < self.len);
        let at = |p: usize| unsafe { *self.geometry[MEAN + p].add(i) };
        Vec3::new(at(0), at(1), at(2))
    }

    /// Spherical harmonics of Gaussian `i`.
    /// # Safety
    /// As for [`Parameters::mean`]; the slice must be dropped before they are written.
    #[inline(always)]
    pub unsafe fn sh<'a>(&self, i: usize) -> &'a [f32] {
        debug_assert!(i < self.len);
        unsafe { std::slice::from_raw_parts(self.sh.add(i * self.sh_stride), self.sh_stride) }
    }
}

/// What forward and backward both need of a vector of Gaussians.
pub struct Projection<S: Simd> {
    /// Camera frame.
    pub xc: [S; 3],
    /// 1 / z.
    pub inv_z: S,
    /// x/z and y/z limited.
    pub limited: [S; 2],
    /// Where the limits did not bind.
    pub free: [S::Mask; 2],
    /// Rotation matrix of the Gaussian, row-major.
    pub rotation: [[S; 3]; 3],
    /// Unit quaternion.
    pub q: [S; 4],
    /// 1 / norm of the quaternion (0 for a zero norm).
    pub inv_norm: S,
    /// Standard deviations.
    pub scale: [S; 3],
    /// J W.
    pub jw: [[S; 3]; 2],
    /// J W R S.
    pub jwm: [[S; 3]; 2],
    /// Σ' (xx, xy, yy).
    pub cov: [S; 3],
    /// Σ'⁻¹ (xx, xy, yy).
    pub conic: [S; 3],
    /// det(Σ' without the low-pass).
    pub sharp: S,
    /// Opacity, scaled if `antialias`.
    pub opacity: S,
    /// sigmoid(logit).
    pub sigmoid: S,
    /// Centre, pixels.
    pub xy: [S; 2],
    /// Whether it may be drawn.
    pub valid: S::Mask,
}

/// The camera's rotation in every lane.
#[inline(always)]
pub fn camera_rows<S: Simd>(c: &CameraConstants) -> [[S; 3]; 3] {
    array!(a in 3 => array!(k in 3 => S::splat(c.r[a][k])))
}

/// `2 v`.
#[inline(always)]
pub fn twice<S: Simd>(v: S) -> S {
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
pub fn dot3<S: Simd>(a: [S; 3], b: [S; 3]) -> S {
    a[0].fma(b[0], a[1].fma(b[1], a[2].mul(b[2])))
}

/// `a × b`.
#[inline(always)]
fn cross<S: Simd>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    array!(k in 3 => {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i].mul(b[j]).sub(a[j].mul(b[i]))
    })
}

/// Projects Gaussians `i .. i + LANES`.
/// # Safety
/// `i + LANES` is within the padded planes.
#[inline(always)]
pub unsafe fn project_lanes<S: Simd>(model: &Parameters, i: usize, c: &CameraConstants) -> Projection<S> {
    macro_rules! plane {
        ($p:expr) => {
            unsafe { model.lanes::<S>($p, i) }
        };
    }
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let mu = [plane!(MEAN), plane!(MEAN + 1), plane!(MEAN + 2)];
    let rows = camera_rows::<S>(c);
    let xc = array!(a in 3 => dot3(rows[a], mu).add(S::splat(c.t[a])));
    let in_front = xc[2].ge(S::splat(c.near));
    let inv_z = one.div(S::select(in_front, xc[2], one));

    let raw = array!(k in 4 => plane!(ROTATION + k));
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
    let limit = S::splat(LOG_SCALE_LIMIT);
    let scale = array!(a in 3 => plane!(LOG_SCALE + a).max(zero.sub(limit)).min(limit).exp());

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
    let low_pass = S::splat(LOW_PASS);
    let cov = [xx.add(low_pass), xy, yy.add(low_pass)];
    // det (A Aᵀ) = |a × b|², which loses nothing for needles, as xx yy − xy² does.
    let normal = cross(jwm[0], jwm[1]);
    let sharp = dot3(normal, normal);
    let det = low_pass.fma(xx.add(yy).add(low_pass), sharp);
    // Finite and positive; NaN and infinity fail one of the comparisons.
    let good = S::and(det.ge(S::splat(1e-20)), S::splat(1e30).ge(det));
    let inv_det = one.div(S::select(good, det, one));
    let conic = [cov[2].mul(inv_det), zero.sub(xy).mul(inv_det), cov[0].mul(inv_det)];
    let sigmoid = one.div(one.add(zero.sub(plane!(OPACITY)).exp()));
    let det_ratio = sharp.mul(inv_det);
    let opacity = if c.antialias { sigmoid.mul(det_ratio.sqrt()) } else { sigmoid };
    let visible = opacity.ge(S::splat(1.0 / 255.0));
    // A log-scale or a logit that is not a number passes the limits above and those of exp; it must not be drawn.
    let lowest = S::splat(f32::NEG_INFINITY);
    let shaped = S::and(plane!(LOG_SCALE + 1).ge(lowest), plane!(LOG_SCALE + 2).ge(lowest));
    let shaped = S::and(shaped, plane!(OPACITY).ge(lowest));
    let visible = S::and(visible, S::and(plane!(LOG_SCALE).ge(lowest), shaped));
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

/// Arguments of [`project`]: Gaussians `start .. start + keys.len()`, `start` a multiple of 16.
pub struct Project<'a> {
    /// All Gaussians.
    pub parameters: Parameters,
    /// The camera.
    pub camera: &'a CameraConstants,
    /// First Gaussian.
    pub start: usize,
    /// Out.
    pub records: &'a mut [Record],
    /// Out.
    pub keys: &'a mut [u32],
}

#[inline(always)]
fn project_generic<S: Simd>(a: &mut Project) {
    let c = a.camera;
    let mut lanes = [[0.0f32; 16]; 8];
    for block in (0..a.keys.len()).step_by(S::LANES) {
        // The planes are padded to 16, a multiple of LANES.
        let p = unsafe { project_lanes::<S>(&a.parameters, a.start + block, c) };
        let bits = S::bits(p.valid);
        let count = S::LANES.min(a.keys.len() - block);
        if bits == 0 {
            a.keys[block..block + count].fill(CULLED);
            continue;
        }
        let columns = [p.xy[0], p.xy[1], p.conic[0], p.conic[1], p.conic[2], p.opacity, p.cov[0], p.cov[2]];
        for (lane, value) in lanes.iter_mut().zip(columns) {
            unsafe { value.store(lane.as_mut_ptr()) };
        }
        let mut depth = [0.0f32; 16];
        unsafe { p.xc[2].store(depth.as_mut_ptr()) };
        for lane in 0..count {
            let i = a.start + block + lane;
            let column = |k: usize| lanes[k][lane];
            let log2_opacity = column(5).log2();
            let reach = 2.0 * std::f32::consts::LN_2 * (log2_opacity + LOG2_255);
            let (extent_x, extent_y) =
                ((reach * column(6)).max(0.0).sqrt(), (reach * column(7)).max(0.0).sqrt());
            let (x, y) = (column(0), column(1));
            let inside = x + extent_x > 0.0
                && x - extent_x < c.size[0]
                && y + extent_y > 0.0
                && y - extent_y < c.size[1];
            if bits & (1 << lane) == 0 || !inside {
                a.keys[block + lane] = CULLED;
                continue;
            }
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            let (mean, sh) = unsafe { (a.parameters.mean(i), a.parameters.sh(i)) };
            sh::basis((mean - c.position).normalize_or_zero(), c.sh_degree, &mut basis);
            const LOG2_E: f32 = std::f32::consts::LOG2_E;
            a.keys[block + lane] = depth[lane].to_bits();
            a.records[block + lane] = Record {
                x,
                y,
                half_xx: 0.5 * LOG2_E * column(2),
                xy: LOG2_E * column(3),
                half_yy: 0.5 * LOG2_E * column(4),
                log2_opacity,
                rgb: colour(sh, &basis, c.sh_degree).map(|v| v.max(0.0)),
                depth: depth[lane],
                extent_x,
                extent_y,
                ..Record::default()
            }
            .with_chords();
        }
    }
}

/// `0.5 + Σ Y_k sh_k`, not limited.
#[inline(always)]
pub fn colour(coefficients: &[f32], basis: &[f32; sh::MAX_COEFFICIENTS], degree: u32) -> [f32; 3] {
    let mut rgb = [0.5; 3];
    let used = (degree as usize + 1).pow(2);
    for (y, sh) in basis[..used].iter().zip(coefficients.chunks_exact(3)) {
        for (channel, value) in rgb.iter_mut().zip(sh) {
            *channel += y * value;
        }
    }
    rgb
}

simd_kernel!(
    /// Projects a range of Gaussians.
    pub fn project(arguments: &mut Project) = project_generic
);
