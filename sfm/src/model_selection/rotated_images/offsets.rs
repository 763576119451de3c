//! The likelihood of principal points of the images' own, and the two groups that it suggests.

use crate::bundle::{BundleProblem, IntrinsicsPrior, SolveOptions};
use crate::error::SfmError;
use crate::model_selection::camera::principal_point_priors;
use crate::model_selection::evidence::may_be_two_groups;
use crate::model_selection::noise::noise_in_units;
use glam::DVec2;
use scene::Progress;

/// Share of what principal points for all images would gain that two groups must gain.
/// Source: docs/decisions/06; the tests show what it tells apart.
const EXPLAINED: f64 = 0.6;
/// Ways to split the images that are handed on: on a ring with gaps several are nearly as good as
/// the best.
/// Source: chosen by hand, never measured.
const MOST_SPLITS: usize = 4;
/// Directions along which the principal points are split at first.
/// Source: chosen by hand, never measured.
const DIRECTIONS: usize = 8;

/// Twice the negative log likelihood of offsets `δ` of the images' principal points, up to a
/// constant: `δᵀ H δ − 2 gᵀ δ`.
pub(super) struct OffsetLikelihood {
    /// [n × n] blocks `xx, xy, yy`.
    information: Vec<[f64; 3]>,
    /// [2n].
    gradient: Vec<f64>,
    /// For each image the offset that it would choose by itself, pixels.
    offsets: Vec<DVec2>,
    /// 1 / variance of an offset beforehand, px⁻².
    prior: f64,
}

impl OffsetLikelihood {
    pub(super) fn measure(
        problem: &BundleProblem,
        camera: usize,
        poses: &[usize],
        progress: &Progress,
    ) -> Result<Option<Self>, SfmError> {
        let shared = &problem.cameras[camera];
        let n = shared.model.num_focals();
        let mut each = problem.clone();
        each.camera_free.iter_mut().for_each(|free| free.fill(false));
        let [prior, _] = principal_point_priors(0, shared);
        for &pose in poses {
            let index = each.cameras.len();
            each.pose_camera[pose] = index as u32;
            each.cameras.push(shared.clone());
            each.camera_free.push((0..shared.params.len()).map(|i| (n..n + 2).contains(&i)).collect());
            each.priors.extend([n, n + 1].map(|parameter| IntrinsicsPrior {
                camera: index,
                parameter,
                mean: shared.params[parameter],
                sigma: prior.sigma,
            }));
        }
        let sigma = noise_in_units(problem);
        each.observations.iter_mut().for_each(|o| o.sigma_px *= sigma);
        // One step from a solution all but ends at the next; a few more for what was an outlier.
        let options = SolveOptions::precise(6);
        let summary = each.solve(&options, progress)?;
        let information = if summary.usable { each.intrinsics_information(&options)? } else { None };
        let Some(information) = information else { return Ok(None) };
        let start = shared.principal_point();
        let cameras = &each.cameras[problem.cameras.len()..];
        let offsets: Vec<DVec2> = cameras.iter().map(|c| c.principal_point() - start).collect();
        let weight = 1.0 / (prior.sigma * prior.sigma);
        // At the solution the likelihood's slope balances the prior's: H (δ − δ₀) = −δ₀ / σ².
        let flat: Vec<f64> = offsets.iter().flat_map(|d| d.to_array()).collect();
        let rows: Vec<&[f64]> = information.chunks_exact(flat.len()).collect();
        let gradient = rows
            .iter()
            .zip(&flat)
            .map(|(row, own)| row.iter().zip(&flat).map(|(h, d)| h * d).sum::<f64>() + weight * own)
            .collect();
        let mut information = Vec::with_capacity(offsets.len().pow(2));
        for pair in rows.chunks_exact(2) {
            for x in (0..flat.len()).step_by(2) {
                let mixed = 0.5 * (pair[0][x + 1] + pair[1][x]);
                information.push([pair[0][x], mixed, pair[1][x + 1]]);
            }
        }
        Ok(Some(Self { information, gradient, offsets, prior: weight }))
    }

    fn len(&self) -> usize {
        self.offsets.len()
    }

    fn block(&self, i: usize, k: usize) -> [f64; 3] {
        self.information[i * self.offsets.len() + k]
    }

    /// `min over d` of the cost of `δᵢ = sᵢ d`, for the sums `Σ sᵢ sₖ Hᵢₖ` and `Σ sᵢ gᵢ`: what it
    /// is below that of `d = 0`.
    fn gain(&self, [xx, xy, yy]: [f64; 3], g: DVec2) -> f64 {
        let (xx, yy) = (xx + self.prior, yy + self.prior);
        let det = xx * yy - xy * xy;
        if det <= 1e-12 * xx * yy {
            return 0.0;
        }
        (yy * g.x * g.x - 2.0 * xy * g.x * g.y + xx * g.y * g.y) / det
    }

    fn sums(&self, signs: &[f64]) -> ([f64; 3], DVec2) {
        let (mut h, mut g) = ([0.0; 3], DVec2::ZERO);
        for (i, s) in signs.iter().enumerate() {
            g += *s * DVec2::new(self.gradient[2 * i], self.gradient[2 * i + 1]);
            for (k, t) in signs.iter().enumerate() {
                let block = self.block(i, k);
                (0..3).for_each(|c| h[c] += s * t * block[c]);
            }
        }
        (h, g)
    }

    /// For each image all images by how strongly their offsets are tied to its own, itself first.
    fn neighbours(&self) -> Vec<Vec<usize>> {
        let mut neighbours = Vec::with_capacity(self.len());
        for i in 0..self.len() {
            let mut others: Vec<(f64, usize)> = (0..self.len()).map(|k| (self.tie(i, k), k)).collect();
            others.sort_by(|a, b| (b.1 == i).cmp(&(a.1 == i)).then(b.0.total_cmp(&a.0)).then(a.1.cmp(&b.1)));
            neighbours.push(others.into_iter().map(|(_, k)| k).collect());
        }
        neighbours
    }

    /// How strongly the offset of an image is tied to that of image `k`.
    fn tie(&self, i: usize, k: usize) -> f64 {
        let ([xx, xy, yy], [x, _, y]) = (self.block(i, k), self.block(k, k));
        (xx.abs() + 2.0 * xy.abs() + yy.abs()) / (x + y).max(f64::MIN_POSITIVE).sqrt()
    }

    /// Flips images, alone and with their neighbours, while that raises the gain; the gain reached.
    fn climb(&self, signs: &mut [f64], neighbours: &[Vec<usize>]) -> f64 {
        let n = signs.len();
        let (mut h, mut g) = self.sums(signs);
        let mut best = self.gain(h, g);
        loop {
            let mut improved = false;
            for of_image in neighbours {
                // The sums after the first 1, 2, 3 … of them are flipped, one after the other.
                let (mut flipped, mut h_now, mut g_now) = (signs.to_vec(), h, g);
                let mut found = None;
                for (count, &i) in of_image.iter().take(n.div_ceil(2)).enumerate() {
                    let mut row = [0.0; 3];
                    let blocks = &self.information[i * n..(i + 1) * n];
                    for (s, block) in others(&flipped, i).zip(others(blocks, i)) {
                        (0..3).for_each(|c| row[c] += flipped[i] * s * block[c]);
                    }
                    // Row i of Σ sᵢ sₖ Hᵢₖ without the diagonal changes its sign, on both sides of
                    // the diagonal.
                    (0..3).for_each(|c| h_now[c] -= 4.0 * row[c]);
                    g_now -= 2.0 * flipped[i] * DVec2::new(self.gradient[2 * i], self.gradient[2 * i + 1]);
                    flipped[i] = -flipped[i];
                    let gain = self.gain(h_now, g_now);
                    if gain > best * (1.0 + 1e-9) + 1e-9 {
                        (best, found) = (gain, Some((count, h_now, g_now)));
                    }
                }
                if let Some((count, h_found, g_found)) = found {
                    of_image[..=count].iter().for_each(|&i| signs[i] = -signs[i]);
                    (h, g) = (h_found, g_found);
                    improved = true;
                }
            }
            if !improved {
                return best;
            }
        }
    }

    /// For each image whether it belongs to the smaller of two groups: the best ways to split them,
    /// best first; none where one group does as well.
    pub(super) fn splits(&self) -> Vec<Vec<bool>> {
        let n = self.len();
        let (h, g) = self.sums(&vec![1.0; n]);
        let alone = self.gain(h, g);
        let neighbours = self.neighbours();
        let mut found: Vec<(f64, Vec<bool>)> = Vec::new();
        for direction in 0..DIRECTIONS {
            let u = DVec2::from_angle(std::f64::consts::PI * direction as f64 / DIRECTIONS as f64);
            let along: Vec<f64> = self.offsets.iter().map(|d| d.dot(u)).collect();
            let mut sorted = along.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            for middle in [0.0, sorted[n / 4], sorted[n / 2], sorted[3 * n / 4]] {
                let mut signs: Vec<f64> =
                    along.iter().map(|a| if *a >= middle { 1.0 } else { -1.0 }).collect();
                let gain = self.climb(&mut signs, &neighbours);
                let negative = signs.iter().filter(|s| **s < 0.0).count();
                // Of two groups of a size the one without the first image is the smaller.
                let smaller =
                    if 2 * negative < n || (2 * negative == n && signs[0] > 0.0) { -1.0 } else { 1.0 };
                found.push((gain, signs.iter().map(|s| *s == smaller).collect()));
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        found.dedup_by(|a, b| a.1 == b.1);
        // What a principal point for every image would gain: if two groups are the truth, they gain
        // most of it.
        let flat = self.offsets.iter().flat_map(|d| d.to_array());
        let each: f64 = flat.zip(&self.gradient).map(|(d, g)| d * g).sum();
        found.retain(|(gain, split)| {
            let gain = gain - alone;
            gain >= EXPLAINED * (each - alone) && may_be_two_groups(gain, n) && split.contains(&true)
        });
        found.into_iter().take(MOST_SPLITS).map(|(_, split)| split).collect()
    }
}

/// All but the one at `i`.
fn others<T>(all: &[T], i: usize) -> impl Iterator<Item = &T> {
    all[..i].iter().chain(&all[i + 1..])
}
