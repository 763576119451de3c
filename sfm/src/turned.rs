//! Photos that were turned by half a turn on their way here.
//!
//! A camera that was held both ways up, its pictures turned upright by some program that kept no trace of it, has one
//! sensor but two principal points: mirrored about the image centre. Nothing else betrays it, for the pictures look
//! alike. The sightings do: with a principal point for each image, two groups appear.

use crate::SfmError;
use crate::bundle::{BundleObservation, BundleProblem, IntrinsicsPrior, Loss, SolveOptions};
use crate::selection::{noise, principal_point_priors};
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Camera, CameraModel, Pose, Progress, TwoViewGeometry};

/// Images of a camera below which two groups cannot be told from noise.
const FEWEST_IMAGES: usize = 6;
/// Images of a camera beyond which the joint information is too large a matrix.
const MOST_IMAGES: usize = 300;
/// Twice the gain in log likelihood for each image and in all that makes two groups worth a trial.
const GAIN_PER_IMAGE: f64 = 4.0;
const GAIN: f64 = 100.0;
/// Share of what principal points for all images would gain that two groups must gain.
const EXPLAINED: f64 = 0.7;
/// Directions along which the principal points are split at first.
const DIRECTIONS: usize = 8;

/// A pixel of the turned image.
pub fn turn_pixel(camera: &Camera, pixel: DVec2) -> DVec2 {
    DVec2::new(f64::from(camera.width), f64::from(camera.height)) - pixel
}

/// The pose of the turned camera.
pub fn turn_pose(pose: &Pose) -> Pose {
    let turn = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0);
    Pose { rotation: (turn * pose.rotation).normalize(), translation: turn * pose.translation }
}

/// The camera of the turned image: principal point mirrored, tangential distortion of the other sign.
pub fn turn_camera(camera: &Camera) -> Camera {
    let mut turned = camera.clone();
    let n = camera.model.num_focals();
    let p = turn_pixel(camera, camera.principal_point());
    turned.params[n..n + 2].copy_from_slice(&p.to_array());
    if camera.model == CameraModel::Opencv {
        turned.params[n + 4..].iter_mut().for_each(|p| *p = -*p);
    }
    turned
}

/// The geometry of a pair of which the first, the second or both images are turned.
pub fn turn_geometry(geometry: &mut TwoViewGeometry, cameras: [&Camera; 2], turned: [bool; 2]) {
    let of_pixels = |i: usize| {
        let (w, h) = (f64::from(cameras[i].width), f64::from(cameras[i].height));
        let matrix = DMat3::from_cols(-DVec3::X, -DVec3::Y, DVec3::new(w, h, 1.0));
        if turned[i] { matrix } else { DMat3::IDENTITY }
    };
    let of_rays = |i: usize| {
        if turned[i] { DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)) } else { DMat3::IDENTITY }
    };
    // Each of these matrices is its own inverse.
    geometry.f = geometry.f.map(|f| of_pixels(1).transpose() * f * of_pixels(0));
    geometry.h = geometry.h.map(|h| of_pixels(1) * h * of_pixels(0));
    geometry.e = geometry.e.map(|e| of_rays(1) * e * of_rays(0));
    geometry.b_from_a = geometry.b_from_a.map(|pose| {
        let own = if turned[1] { turn_pose(&pose) } else { pose };
        let before = if turned[0] { turn_pose(&Pose::IDENTITY) } else { Pose::IDENTITY };
        own.compose(&before)
    });
}

/// The same adjustment with some images turned.
pub fn turn_problem(problem: &BundleProblem, turned: &[bool]) -> BundleProblem {
    let mut result = problem.clone();
    for (pose, _) in result.poses.iter_mut().zip(turned).filter(|(_, t)| **t) {
        *pose = turn_pose(pose);
    }
    let turn = |o: &mut BundleObservation| {
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        o.pixel = turn_pixel(camera, o.pixel);
    };
    result.observations.iter_mut().filter(|o| turned[o.pose as usize]).for_each(turn);
    result
}

/// Which poses of an adjusted problem are likely those of images that were turned; `None` where one principal point a
/// camera does as well. The larger group of a camera counts as not turned.
///
/// Every image gets a principal point `c + δᵢ` of its own. Their joint information, after poses and points are
/// eliminated, says what any assignment of signs `δᵢ = ±d` costs; the best one is found by local search.
pub fn suspect(
    problem: &BundleProblem,
    fixed: &[bool],
    progress: &Progress,
) -> Result<Option<Vec<bool>>, SfmError> {
    let mut turned = vec![false; problem.poses.len()];
    for (camera, held) in fixed.iter().enumerate() {
        let of_camera = |&p: &usize| problem.pose_camera[p] as usize == camera;
        let poses: Vec<usize> = (0..problem.poses.len()).filter(of_camera).collect();
        if *held || !(FEWEST_IMAGES..=MOST_IMAGES).contains(&poses.len()) {
            continue;
        }
        let Some(quadratic) = Quadratic::measure(problem, camera, &poses, progress)? else { continue };
        for (&pose, negative) in poses.iter().zip(quadratic.split()) {
            turned[pose] = negative;
        }
    }
    Ok(turned.contains(&true).then_some(turned))
}

/// Twice the negative log likelihood of offsets `δ` of the images' principal points, up to a constant:
/// `δᵀ H δ − 2 gᵀ δ`.
struct Quadratic {
    /// [2n × 2n].
    information: Vec<f64>,
    /// [2n].
    gradient: Vec<f64>,
    /// For each image the offset that it would choose by itself, pixels.
    offsets: Vec<DVec2>,
    /// 1 / variance of an offset beforehand, px⁻².
    prior: f64,
}

impl Quadratic {
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
        let sigma = noise(problem);
        each.observations.iter_mut().for_each(|o| o.sigma_px = sigma);
        let options = SolveOptions {
            loss: Loss::Cauchy(2.0),
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
        Ok(Some(Self { information, gradient, offsets, prior: weight }))
    }

    fn len(&self) -> usize {
        self.gradient.len() / 2
    }

    fn block(&self, i: usize, k: usize) -> [f64; 3] {
        let size = self.gradient.len();
        let at = |a: usize, b: usize| self.information[(2 * i + a) * size + 2 * k + b];
        [at(0, 0), 0.5 * (at(0, 1) + at(1, 0)), at(1, 1)]
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

    /// Flips single images while that raises the gain; the gain reached.
    fn climb(&self, signs: &mut [f64]) -> f64 {
        let (mut h, mut g) = self.sums(signs);
        let mut best = self.gain(h, g);
        loop {
            let mut improved = false;
            for i in 0..signs.len() {
                // Row i of Σ sᵢ sₖ Hᵢₖ without the diagonal changes its sign, on both sides of the diagonal.
                let mut row = [0.0; 3];
                for (k, s) in signs.iter().enumerate().filter(|(k, _)| *k != i) {
                    let block = self.block(i, k);
                    (0..3).for_each(|c| row[c] += signs[i] * s * block[c]);
                }
                let flipped: [f64; 3] = std::array::from_fn(|c| h[c] - 4.0 * row[c]);
                let slope = DVec2::new(self.gradient[2 * i], self.gradient[2 * i + 1]);
                let g_flipped = g - 2.0 * signs[i] * slope;
                let gain = self.gain(flipped, g_flipped);
                if gain > best * (1.0 + 1e-9) + 1e-9 {
                    (h, g, best) = (flipped, g_flipped, gain);
                    signs[i] = -signs[i];
                    improved = true;
                }
            }
            if !improved {
                return best;
            }
        }
    }

    /// For each image whether it belongs to the smaller of two groups; none does where one group does as well.
    fn split(&self) -> Vec<bool> {
        let n = self.len();
        let together = vec![1.0; n];
        let (h, g) = self.sums(&together);
        let alone = self.gain(h, g);
        let mut best = (alone, together);
        for direction in 0..DIRECTIONS {
            let u = DVec2::from_angle(std::f64::consts::PI * direction as f64 / DIRECTIONS as f64);
            let along: Vec<f64> = self.offsets.iter().map(|d| d.dot(u)).collect();
            let mut sorted = along.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            for middle in [0.0, sorted[n / 4], sorted[n / 2], sorted[3 * n / 4]] {
                let mut signs: Vec<f64> =
                    along.iter().map(|a| if *a >= middle { 1.0 } else { -1.0 }).collect();
                let gain = self.climb(&mut signs);
                if gain > best.0 {
                    best = (gain, signs);
                }
            }
        }
        let negative = best.1.iter().filter(|s| **s < 0.0).count();
        // What a principal point for every image would gain: if two groups are the truth, they gain most of it.
        let flat = self.offsets.iter().flat_map(|d| d.to_array());
        let each: f64 = flat.zip(&self.gradient).map(|(d, g)| d * g).sum();
        let gain = best.0 - alone;
        if gain < GAIN + GAIN_PER_IMAGE * n as f64 || gain < EXPLAINED * (each - alone) {
            return vec![false; n];
        }
        let minority = if 2 * negative <= n { -1.0 } else { 1.0 };
        best.1.iter().map(|s| *s == minority).collect()
    }
}

#[cfg(test)]
mod tests;
