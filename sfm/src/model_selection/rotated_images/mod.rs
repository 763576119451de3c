//! Photos that were rotated by 180° on their way here.
//!
//! A camera that was held both ways up, its pictures turned upright by some program that kept no trace of it, has one
//! sensor but two principal points: mirrored about the image centre. Nothing else betrays it, for the pictures look
//! alike. The observations do: with a principal point for each image, two groups appear.

mod windows;

use crate::bundle::{BundleObservation, BundleProblem, IntrinsicsPrior, RobustLoss, SolveOptions};
use crate::model_selection::camera::principal_point_priors;
use crate::model_selection::noise::noise_in_units;
use crate::{Knowledge, SfmError};
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Camera, CameraModel, Pose, Progress, TwoViewGeometry};

/// Images of a camera below which two groups cannot be told from noise.
const FEWEST_IMAGES: usize = 6;
/// Images of a camera beyond which they are asked in windows.
const JOINT_IMAGES: usize = 100;
/// Twice the gain in log likelihood for each image and in all that makes two groups worth a trial.
const GAIN_PER_IMAGE: f64 = 4.0;
const GAIN: f64 = 100.0;
/// Share of what principal points for all images would gain that two groups must gain.
const EXPLAINED: f64 = 0.6;
/// Ways to split the images that are handed on: on a ring with gaps several are nearly as good as the best.
const MOST_SPLITS: usize = 4;
const NEARLY_AS_GOOD: f64 = 0.9;
/// Directions along which the principal points are split at first.
const DIRECTIONS: usize = 8;

/// How many of `images` images are asked together.
pub(crate) fn group_size(images: usize) -> usize {
    if images > JOINT_IMAGES { windows::WINDOW } else { images }
}

/// A pixel of the rotated image.
pub(crate) fn rotate_pixel(camera: &Camera, pixel: DVec2) -> DVec2 {
    DVec2::new(f64::from(camera.width), f64::from(camera.height)) - pixel
}

/// The pose of the rotated camera.
pub(crate) fn rotate_pose(pose: &Pose) -> Pose {
    let turn = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0);
    Pose { rotation: (turn * pose.rotation).normalize(), translation: turn * pose.translation }
}

/// The camera of the rotated image: principal point mirrored, tangential distortion of the other sign.
pub(crate) fn rotate_camera(camera: &Camera) -> Camera {
    let mut rotated = camera.clone();
    let n = camera.model.num_focals();
    let p = rotate_pixel(camera, camera.principal_point());
    rotated.params[n..n + 2].copy_from_slice(&p.to_array());
    if camera.model == CameraModel::Opencv {
        rotated.params[n + 4..].iter_mut().for_each(|p| *p = -*p);
    }
    rotated
}

/// The geometry of a pair of which the first, the second or both images are rotated.
pub(crate) fn rotate_geometry(geometry: &mut TwoViewGeometry, cameras: [&Camera; 2], rotated: [bool; 2]) {
    let of_pixels = |i: usize| {
        let (w, h) = (f64::from(cameras[i].width), f64::from(cameras[i].height));
        let matrix = DMat3::from_cols(-DVec3::X, -DVec3::Y, DVec3::new(w, h, 1.0));
        if rotated[i] { matrix } else { DMat3::IDENTITY }
    };
    let of_rays = |i: usize| {
        if rotated[i] { DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)) } else { DMat3::IDENTITY }
    };
    // Each of these matrices is its own inverse.
    geometry.f = geometry.f.map(|f| of_pixels(1).transpose() * f * of_pixels(0));
    geometry.h = geometry.h.map(|h| of_pixels(1) * h * of_pixels(0));
    geometry.e = geometry.e.map(|e| of_rays(1) * e * of_rays(0));
    geometry.b_from_a = geometry.b_from_a.map(|pose| {
        let own = if rotated[1] { rotate_pose(&pose) } else { pose };
        let before = if rotated[0] { rotate_pose(&Pose::IDENTITY) } else { Pose::IDENTITY };
        own.compose(&before)
    });
}

/// The same adjustment with some images rotated.
pub(crate) fn rotate_problem(problem: &BundleProblem, rotated: &[bool]) -> BundleProblem {
    let mut result = problem.clone();
    for (pose, _) in result.poses.iter_mut().zip(rotated).filter(|(_, t)| **t) {
        *pose = rotate_pose(pose);
    }
    let turn = |o: &mut BundleObservation| {
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        o.pixel = rotate_pixel(camera, o.pixel);
    };
    result.observations.iter_mut().filter(|o| rotated[o.pose as usize]).for_each(turn);
    result
}

/// Which poses of an adjusted problem may be those of images that were rotated: some assignments, the likeliest first;
/// none where one principal point a camera does as well. The larger group of a camera counts as not rotated.
///
/// Every image gets a principal point `c + δᵢ` of its own. Their joint information, after poses and points are
/// eliminated, says what any assignment of signs `δᵢ = ±d` costs; good ones are found by local search. More than
/// `JOINT_IMAGES` are asked in windows, for one assignment at most.
pub(crate) fn suspects(
    problem: &BundleProblem,
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Vec<Vec<bool>>, SfmError> {
    let mut found: Vec<Vec<bool>> = Vec::new();
    for (camera, known) in known.iter().enumerate() {
        let of_camera = |&p: &usize| problem.pose_camera[p] as usize == camera;
        let poses: Vec<usize> = (0..problem.poses.len()).filter(of_camera).collect();
        if known.fixed || poses.len() < FEWEST_IMAGES {
            continue;
        }
        let splits: Vec<Vec<bool>> = if poses.len() > JOINT_IMAGES {
            windows::split(problem, camera, &poses, progress)?.into_iter().collect()
        } else {
            let quadratic = OffsetLikelihood::measure(problem, camera, &poses, progress)?;
            quadratic.map(|q| q.splits()).unwrap_or_default()
        };
        // The best of this camera go with the best of the others.
        let none = vec![false; problem.poses.len()];
        found.resize(found.len().max(splits.len()), found.first().cloned().unwrap_or(none));
        for (k, rotated) in found.iter_mut().enumerate() {
            if let Some(split) = splits.get(k).or(splits.first()) {
                poses.iter().zip(split).for_each(|(&pose, &t)| rotated[pose] = t);
            }
        }
    }
    Ok(found)
}

/// Twice the negative log likelihood of offsets `δ` of the images' principal points, up to a constant:
/// `δᵀ H δ − 2 gᵀ δ`.
struct OffsetLikelihood {
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
    fn measure(
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
            let at = |k: usize| IntrinsicsPrior {
                camera: index,
                parameter: n + k,
                mean: shared.params[n + k],
                sigma: prior.sigma,
            };
            each.priors.extend([at(0), at(1)]);
        }
        let sigma = noise_in_units(problem);
        each.observations.iter_mut().for_each(|o| o.sigma_px *= sigma);
        let options = SolveOptions {
            loss: RobustLoss::Cauchy(2.0),
            max_iterations: 6,
            function_tolerance: 1e-4,
            ..SolveOptions::default()
        };
        let summary = each.solve(&options, progress)?;
        let information = if summary.usable { each.intrinsics_information(&options)? } else { None };
        let Some(information) = information else { return Ok(None) };
        let start = shared.principal_point();
        let cameras = &each.cameras[problem.cameras.len()..];
        let offsets: Vec<DVec2> = cameras.iter().map(|c| c.principal_point() - start).collect();
        let weight = 1.0 / (prior.sigma * prior.sigma);
        // At the solution the likelihood's slope balances the prior's: H (δ − δ₀) = −δ₀ / σ².
        let flat: Vec<f64> = offsets.iter().flat_map(|d| d.to_array()).collect();
        let rows = information.chunks_exact(flat.len()).zip(&flat);
        let gradient = rows
            .map(|(row, own)| row.iter().zip(&flat).map(|(h, d)| h * d).sum::<f64>() + weight * own)
            .collect();
        let at = |a: usize, b: usize| information[a * flat.len() + b];
        let block = |i: usize, k: usize| {
            let (x, y, u, v) = (2 * i, 2 * i + 1, 2 * k, 2 * k + 1);
            [at(x, u), 0.5 * (at(x, v) + at(y, u)), at(y, v)]
        };
        let n = offsets.len();
        let information = (0..n * n).map(|i| block(i / n, i % n)).collect();
        Ok(Some(Self { information, gradient, offsets, prior: weight }))
    }

    fn len(&self) -> usize {
        self.offsets.len()
    }

    fn block(&self, i: usize, k: usize) -> [f64; 3] {
        self.information[i * self.offsets.len() + k]
    }

    /// `min over d` of the cost of `δᵢ = sᵢ d`, for the sums `Σ sᵢ sₖ Hᵢₖ` and `Σ sᵢ gᵢ`: what it is below that of `d = 0`.
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
        let strength = |i: usize| self.block(i, i)[0] + self.block(i, i)[2];
        let of = |i: usize| {
            let tie = |k: usize| {
                let [xx, xy, yy] = self.block(i, k);
                (xx.abs() + 2.0 * xy.abs() + yy.abs()) / strength(k).max(f64::MIN_POSITIVE).sqrt()
            };
            let mut others: Vec<(f64, usize)> = (0..self.len()).map(|k| (tie(k), k)).collect();
            others.sort_by(|a, b| (b.1 == i).cmp(&(a.1 == i)).then(b.0.total_cmp(&a.0)).then(a.1.cmp(&b.1)));
            others.into_iter().map(|(_, k)| k).collect()
        };
        (0..self.len()).map(of).collect()
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
                    // Row i of Σ sᵢ sₖ Hᵢₖ without the diagonal changes its sign, on both sides of the diagonal.
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

    /// For each image whether it belongs to the smaller of two groups: the best ways to split them, best first; none
    /// where one group does as well.
    fn splits(&self) -> Vec<Vec<bool>> {
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
        // What a principal point for every image would gain: if two groups are the truth, they gain most of it.
        let flat = self.offsets.iter().flat_map(|d| d.to_array());
        let each: f64 = flat.zip(&self.gradient).map(|(d, g)| d * g).sum();
        let least = (GAIN + GAIN_PER_IMAGE * n as f64).max(EXPLAINED * (each - alone));
        let nearly = found.first().map_or(0.0, |(best, _)| NEARLY_AS_GOOD * (best - alone));
        found.retain(|(gain, split)| gain - alone >= least.max(nearly) && split.contains(&true));
        found.into_iter().take(MOST_SPLITS).map(|(_, split)| split).collect()
    }
}

/// All but the one at `i`.
fn others<T>(all: &[T], i: usize) -> impl Iterator<Item = &T> {
    all[..i].iter().chain(&all[i + 1..])
}

#[cfg(test)]
mod tests;
