//! The parameters in training: planes of f32, Adam's moments beside them.
//!
//! ```
//! use splat::model::Model;
//!
//! let model = Model::from_gaussians(&scene::Gaussians::default());
//! assert_eq!((model.len, model.sh.len()), (0, 0));
//! ```

use glam::{Quat, Vec3};
use scene::Gaussians;
use scene::morton::morton_order;
use serde::{Deserialize, Serialize};

/// Planes are padded to a multiple of this, so that a vector load never leaves them, values.
/// Source: the widest vectors (AVX-512) hold so many.
pub(crate) const LANE_PAD: usize = 16;

/// Highest degree of the spherical harmonics. Source: Kerbl et al. 2023.
pub(crate) const MAX_SH_DEGREE: u32 = 3;

/// Number of geometric parameters of a Gaussian. Source: Kerbl et al. 2023: 3 + 3 + 4 + 1.
pub const GEOMETRY: usize = 11;

/// First plane of the mean (x, y, z). Source: the order of [`Model::row`], as for the following.
pub(crate) const MEAN: usize = 0;
/// First plane of the logarithms of the scales (x, y, z).
pub(crate) const LOG_SCALE: usize = 3;
/// First plane of the quaternion (w, x, y, z).
pub(crate) const ROTATION: usize = 6;
/// Plane of the opacity logit.
pub(crate) const OPACITY: usize = 10;

/// Geometric parameters: plane p of Gaussian i is `planes[p][i]`.
pub type Planes = [Vec<f32>; GEOMETRY];

/// N Gaussians in training. Invariant: every plane has `padded(len)` entries, every SH array `len ·
/// 3K`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// Number of Gaussians.
    pub len: usize,
    /// Spherical-harmonic degree held (0 to 3).
    pub sh_degree: u32,
    /// Mean, log-scale, quaternion, logit.
    pub geometry: Planes,
    /// First moments of the geometry.
    pub geometry_m: Planes,
    /// Second moments of the geometry.
    pub geometry_v: Planes,
    /// [N × K × 3] spherical harmonics, coefficient-major.
    pub sh: Vec<f32>,
    /// Second moments of the constant harmonic by channel (plane c is channel c), which size the
    /// steps of all harmonics.
    pub sh_v: [Vec<f32>; 3],
    /// Steps in which the Gaussian was visible, that is Adam's clock.
    pub steps: Vec<f32>,
    /// The part of each Gaussian (0: the body), as many as there are Gaussians; none where nothing
    /// moves.
    #[serde(default)]
    pub part: Vec<u8>,
}

/// `n` rounded up to whole vectors.
pub(crate) fn padded(n: usize) -> usize {
    n.div_ceil(LANE_PAD) * LANE_PAD
}

/// Groups of `k` values in another order; nothing of nothing. A cycle of the permutation at a time,
/// so that no copy is needed.
fn permute<T: Copy>(values: &mut [T], order: &[usize], k: usize) {
    if values.is_empty() {
        return;
    }
    let mut done = vec![false; order.len()];
    let mut first_of_cycle = Vec::with_capacity(k);
    for start in 0..order.len() {
        if done[start] || order[start] == start {
            continue;
        }
        first_of_cycle.clear();
        first_of_cycle.extend_from_slice(&values[start * k..(start + 1) * k]);
        let mut to = start;
        while order[to] != start {
            let from = order[to];
            values.copy_within(from * k..(from + 1) * k, to * k);
            done[to] = true;
            to = from;
        }
        values[to * k..(to + 1) * k].copy_from_slice(&first_of_cycle);
        done[to] = true;
    }
}

/// Keeps the groups of `k` values whose indices are in `order`, which ascends; nothing of nothing.
fn compact<T: Copy>(values: &mut Vec<T>, order: &[u32], k: usize) {
    if values.is_empty() {
        return;
    }
    for (to, &from) in order.iter().enumerate() {
        let from = from as usize * k;
        values.copy_within(from..from + k, to * k);
    }
    values.truncate(order.len() * k);
}

impl Model {
    /// From Gaussians, moments zero.
    pub fn from_gaussians(g: &Gaussians) -> Self {
        let mut model = Self { sh_degree: g.sh_degree, ..Self::default() };
        let k = g.sh_coefficients() * 3;
        for i in 0..g.len() {
            model.push(
                &Self::row(g.means[i], g.log_scales[i], g.rotations[i], g.opacity_logits[i]),
                &g.sh[i * k..(i + 1) * k],
            );
        }
        model.pad();
        model
    }

    /// The geometric parameters of one Gaussian in the order of the planes.
    pub(crate) fn row(mean: Vec3, log_scale: Vec3, q: Quat, logit: f32) -> [f32; GEOMETRY] {
        [mean.x, mean.y, mean.z, log_scale.x, log_scale.y, log_scale.z, q.w, q.x, q.y, q.z, logit]
    }

    /// As Gaussians, in the same frame.
    pub(crate) fn to_gaussians(&self) -> Gaussians {
        let n = 0..self.len;
        Gaussians {
            means: n.clone().map(|i| self.mean(i)).collect(),
            log_scales: n.clone().map(|i| self.vector(LOG_SCALE, i)).collect(),
            rotations: n.map(|i| self.rotation(i)).collect(),
            opacity_logits: self.geometry[OPACITY][..self.len].to_vec(),
            sh: self.sh.clone(),
            sh_degree: self.sh_degree,
        }
    }

    /// The same of a model that is not needed any more.
    pub(crate) fn into_gaussians(mut self) -> Gaussians {
        let sh = std::mem::take(&mut self.sh);
        Gaussians { sh, ..self.to_gaussians() }
    }

    /// Gives up the moments: no step follows.
    pub(crate) fn forget_moments(&mut self) {
        (self.geometry_m, self.geometry_v) = (Planes::default(), Planes::default());
        self.sh_v = Default::default();
    }

    /// Trades moments and clocks with `other`, of as many Gaussians.
    pub(crate) fn swap_moments(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.geometry_m, &mut other.geometry_m);
        std::mem::swap(&mut self.geometry_v, &mut other.geometry_v);
        std::mem::swap(&mut self.sh_v, &mut other.sh_v);
        std::mem::swap(&mut self.steps, &mut other.steps);
    }

    /// Moments and clocks of zero for the Gaussians of this one, in a model without anything else;
    /// zeros take no memory until they are written.
    pub(crate) fn fresh_moments(&self) -> Self {
        let zeros = vec![0.0; padded(self.len)];
        Self {
            geometry_m: std::array::from_fn(|_| zeros.clone()),
            geometry_v: std::array::from_fn(|_| zeros.clone()),
            sh_v: std::array::from_fn(|_| zeros.clone()),
            steps: zeros,
            ..Self::default()
        }
    }

    /// SH values of one Gaussian, 3K.
    pub(crate) fn sh_stride(&self) -> usize {
        (self.sh_degree as usize + 1).pow(2) * 3
    }

    /// Mean of Gaussian `i`.
    pub(crate) fn mean(&self, i: usize) -> Vec3 {
        self.vector(MEAN, i)
    }

    /// The part of Gaussian `i`; 0: the body.
    #[inline(always)]
    pub(crate) fn part_of(&self, i: usize) -> u8 {
        self.part.get(i).copied().unwrap_or(0)
    }

    /// The quaternion of Gaussian `i`, of any norm.
    pub(crate) fn rotation(&self, i: usize) -> Quat {
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| self.geometry[ROTATION + k][i]);
        Quat::from_xyzw(x, y, z, w)
    }

    /// Three planes from `first` on, of Gaussian `i`.
    fn vector(&self, first: usize, i: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|k| self.geometry[first + k][i]))
    }

    /// Appends a Gaussian with zero moments. [`Model::pad`] must follow before the next step.
    fn push(&mut self, row: &[f32; GEOMETRY], sh: &[f32]) {
        for (p, &value) in row.iter().enumerate() {
            for (plane, value) in [
                (&mut self.geometry[p], value),
                (&mut self.geometry_m[p], 0.0),
                (&mut self.geometry_v[p], 0.0),
            ] {
                plane.truncate(self.len);
                plane.push(value);
            }
        }
        for plane in self.sh_v.iter_mut().chain([&mut self.steps]) {
            plane.truncate(self.len);
            plane.push(0.0);
        }
        self.sh.extend_from_slice(sh);
        self.len += 1;
    }

    /// Appends Gaussians with zero moments; SH are those of `parents` (present Gaussians).
    pub(crate) fn append(&mut self, rows: &[([f32; GEOMETRY], usize)]) {
        let k = self.sh_stride();
        // Exactly what is needed: vectors that double hold up to as much again.
        let room = padded(self.len + rows.len());
        self.planes_mut().for_each(|plane| plane.reserve_exact(room.saturating_sub(plane.len())));
        self.sh.reserve_exact(rows.len() * k);
        for (row, parent) in rows {
            let sh: Vec<f32> = self.sh[parent * k..(parent + 1) * k].to_vec();
            self.push(row, &sh);
            if !self.part.is_empty() {
                self.part.push(self.part[*parent]);
            }
        }
        self.pad();
    }

    /// Puts the Gaussians into `order`, indices into the present ones, each once. In place, as
    /// [`Model::keep`] does.
    pub(crate) fn reorder(&mut self, order: &[usize]) {
        let k = self.sh_stride();
        self.planes_mut().for_each(|plane| permute(plane, order, 1));
        permute(&mut self.part, order, 1);
        permute(&mut self.sh, order, k);
    }

    /// Puts neighbours in space beside each other. What a tile shows lies together then, and what a
    /// view does not see does, too: a step of many Gaussians waits for memory.
    pub(crate) fn sort_in_space(&mut self) {
        let places: Vec<Vec3> = (0..self.len).map(|i| self.mean(i)).collect();
        self.reorder(&morton_order(&places));
    }

    /// Keeps the Gaussians in `order`, which ascends, unless there are none; returns how many were
    /// removed. In place: a copy of the harmonics would be the peak of a run's memory.
    pub(crate) fn keep(&mut self, order: &[u32]) -> usize {
        let removed = self.len - order.len();
        if removed == 0 || order.is_empty() {
            return 0;
        }
        debug_assert!(order.windows(2).all(|pair| pair[0] < pair[1]), "the order must ascend");
        let k = self.sh_stride();
        self.planes_mut().for_each(|plane| compact(plane, order, 1));
        compact(&mut self.part, order, 1);
        compact(&mut self.sh, order, k);
        self.len = order.len();
        self.pad();
        removed
    }

    /// Raises (new coefficients zero) or lowers the spherical-harmonic degree.
    pub(crate) fn set_sh_degree(&mut self, degree: u32) {
        let old = self.sh_stride();
        self.sh_degree = degree.min(MAX_SH_DEGREE);
        let new = self.sh_stride();
        if new == old {
            return;
        }
        let mut grown = vec![0.0; self.len * new];
        for (to, from) in grown.chunks_exact_mut(new).zip(self.sh.chunks_exact(old)) {
            let n = old.min(new);
            to[..n].copy_from_slice(&from[..n]);
        }
        self.sh = grown;
    }

    /// Forgets the moments of Gaussian `i`.
    pub(crate) fn reset_moments(&mut self, i: usize) {
        let planes = self.geometry_m.iter_mut().chain(&mut self.geometry_v).chain(&mut self.sh_v);
        planes.chain([&mut self.steps]).for_each(|plane| plane[i] = 0.0);
    }

    fn pad(&mut self) {
        let n = padded(self.len);
        self.planes_mut().for_each(|plane| plane.resize(n, 0.0));
    }

    /// All planes: parameters, moments and clocks.
    fn planes_mut(&mut self) -> impl Iterator<Item = &mut Vec<f32>> {
        let moments = self.geometry_m.iter_mut().chain(&mut self.geometry_v).chain(&mut self.sh_v);
        self.geometry.iter_mut().chain(moments).chain([&mut self.steps])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussian `i` has `i` in all that it has.
    fn numbered(n: usize) -> Model {
        let numbers = |k: usize| (0..n).flat_map(|i| vec![i as f32; k]).collect::<Vec<f32>>();
        let mut model = Model { len: n, sh_degree: 1, sh: numbers(12), ..Model::default() };
        model.part = (0..n as u8).collect();
        model.planes_mut().for_each(|plane| *plane = numbers(1));
        model.pad();
        model
    }

    /// The numbers of the Gaussians, the same in all that they have.
    fn numbers(model: &mut Model) -> Vec<u8> {
        for (i, &number) in model.part.clone().iter().enumerate() {
            let value = f32::from(number);
            assert!(model.planes_mut().all(|plane| plane[i] == value));
            assert!(model.sh[i * 12..(i + 1) * 12].iter().all(|&v| v == value));
        }
        assert_eq!((model.part.len(), model.sh.len()), (model.len, 12 * model.len));
        assert!(model.geometry.iter().all(|plane| plane.len() == padded(model.len)));
        model.part.clone()
    }

    #[test]
    fn all_that_a_gaussian_has_stays_together() {
        let mut model = numbered(40);
        model.reorder(&(0..40).map(|i| i * 7 % 40).collect::<Vec<_>>());
        assert_eq!(numbers(&mut model)[..4], [0, 7, 14, 21]);
        assert_eq!(model.keep(&(0..40).step_by(2).collect::<Vec<_>>()), 20);
        assert_eq!(numbers(&mut model)[..4], [0, 14, 28, 2]);
        model.sort_in_space();
        assert_eq!(numbers(&mut model), (0..40).step_by(2).collect::<Vec<u8>>());
        model.forget_moments();
        assert_eq!(model.keep(&[3, 5]), 18, "without moments");
        assert_eq!(model.keep(&[]), 0, "some stay");
        assert_eq!(model.part, [6, 10]);
    }
}
