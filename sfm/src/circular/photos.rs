//! Turns in photos whose order is not known: a seed from three images that match each other, growth by what is seen.

use super::MotionInput;
use super::initialize::seed::{KEYS, KeyPair, Seed, seeds, triples};
use super::model::{AxisModel, CircularContext};
use super::motion::CircularMotion;
use super::register::{observed_points, resect_angle};
use crate::SfmError;
use crate::incremental::resection::{FOCAL_FACTORS, visible};
use glam::DVec2;
use scene::{Camera, TwoViewGeometry, TwoViewKind};
use std::collections::HashMap;
use std::f64::consts::PI;

/// Triples of images that are tried.
const TRIPLES: usize = 4;
/// Images registered between two adjustments.
const ADJUST_EVERY: usize = 3;
/// Share of the images with which a model is good enough.
const ENOUGH: f64 = 0.9;

/// The turn that grows from some triple of images, with as many images as any of those tried; `None` where none does.
pub(crate) fn from_photos(job: &MotionInput<'_>) -> Result<Option<AxisModel>, SfmError> {
    let guess = job.cameras[0].mean_focal();
    let known = job.known[0].fixed || job.known[0].focal_sigma.is_some();
    let focals: Vec<f64> =
        if known { vec![guess] } else { FOCAL_FACTORS.iter().map(|f| f * guess).collect() };
    let patterns = triples();
    let mut best: Option<AxisModel> = None;
    for (images, pairs) in triples_of(job) {
        job.progress.check()?;
        let found = seeds(&pairs, 3, &patterns, &focals, guess, known);
        let mut model: Option<(f64, AxisModel, Vec<Camera>)> = None;
        for seed in &found {
            let Some((cameras, turn)) = start(job, seed, images) else { continue };
            let context = CircularContext { starts: &cameras, ..job.context(&[]) };
            let mut trial = AxisModel::new(job.input, cameras.clone(), turn);
            if !trial.settle_with(&context, 3, 200, 2)? {
                continue;
            }
            let score = trial.agreement(job.input);
            if model.as_ref().is_none_or(|(s, ..)| score > *s) {
                model = Some((score, trial, cameras));
            }
        }
        let Some((_, mut model, cameras)) = model else { continue };
        let context = CircularContext { starts: &cameras, ..job.context(&[]) };
        model.grow_photos(&context)?;
        let registered = model.state.registered_count();
        if best.as_ref().is_none_or(|b| registered > b.state.registered_count()) {
            best = Some(model);
        }
        if registered as f64 >= ENOUGH * job.input.keypoints.len() as f64 {
            break;
        }
    }
    Ok(best.filter(|b| b.state.registered_count() > 3))
}

fn start(job: &MotionInput<'_>, seed: &Seed, images: [usize; 3]) -> Option<(Vec<Camera>, CircularMotion)> {
    let mut cameras = job.cameras.to_vec();
    if !job.known[0].fixed {
        let focals = cameras[0].model.num_focals();
        cameras[0].params[..focals].fill(seed.focal);
    }
    let mut angles = vec![None; job.input.keypoints.len()];
    for (image, angle) in images.into_iter().zip(seed.angles) {
        angles[image] = Some(angle);
    }
    Some((cameras, CircularMotion::new(seed.direction(), seed.place(), angles)?))
}

/// Images that match each other best, three at a time, with their matches.
fn triples_of(job: &MotionInput<'_>) -> Vec<([usize; 3], Vec<KeyPair>)> {
    let useful = |g: &&TwoViewGeometry| {
        !matches!(g.kind, TwoViewKind::Panoramic | TwoViewKind::Watermark | TwoViewKind::Degenerate)
    };
    let pairs: HashMap<(usize, usize), &TwoViewGeometry> =
        job.input.geometries.iter().filter(useful).map(|g| ((g.a, g.b), g)).collect();
    let strength = |a: usize, b: usize| pairs.get(&(a.min(b), a.max(b))).map_or(0, |g| g.inliers.len());
    let mut found: Vec<(usize, [usize; 3])> = Vec::new();
    for &(a, b) in pairs.keys() {
        for c in b + 1..job.input.keypoints.len() {
            let weakest = strength(a, b).min(strength(b, c)).min(strength(a, c));
            if weakest >= job.input.config.min_observations {
                found.push((weakest, [a, b, c]));
            }
        }
    }
    found.sort_unstable_by_key(|(n, t)| (std::cmp::Reverse(*n), *t));
    let mut used: Vec<usize> = Vec::new();
    let mut chosen = Vec::new();
    for (_, t) in found {
        if chosen.len() < TRIPLES && t.iter().all(|i| !used.contains(i)) {
            used.extend(t);
            let matches = |i: usize, k: usize| key_pair(job, pairs[&(t[i], t[k])], [i, k]);
            chosen.push((t, vec![matches(0, 1), matches(1, 2), matches(0, 2)]));
        }
    }
    chosen
}

fn key_pair(job: &MotionInput<'_>, g: &TwoViewGeometry, keys: [usize; 2]) -> KeyPair {
    const { assert!(KEYS >= 3) };
    let camera = &job.cameras[0];
    let ideal = |image: usize, feature: u32| -> DVec2 {
        camera.unproject(job.input.keypoints[image][feature as usize]) * camera.mean_focal()
    };
    KeyPair { keys, points: g.inliers.iter().map(|m| [ideal(g.a, m[0]), ideal(g.b, m[1])]).collect() }
}

impl AxisModel {
    /// `Σ max(0, 1 − e²/T²)` over all observations.
    pub fn agreement(&self, input: &crate::incremental::state::MappingInput<'_>) -> f64 {
        let limit = input.config.max_reprojection_px;
        self.state.errors(input).iter().map(|e| (1.0 - (e / limit).powi(2)).max(0.0)).sum()
    }

    /// Registers image after image, those that see most of the model first, at the angle that their observations agree on.
    fn grow_photos(&mut self, context: &CircularContext<'_>) -> Result<(), SfmError> {
        let least = context.input.config.min_observations;
        let images = context.input.keypoints.len();
        let mut tried = vec![0usize; images];
        let mut since = 0usize;
        loop {
            context.progress.check()?;
            let mut ranked: Vec<(usize, usize)> = (0..images)
                .filter(|&i| self.turn.angles[i].is_none())
                .map(|i| (visible(&self.state, context.input, i).len(), i))
                .filter(|&(n, i)| n >= least && n > tried[i])
                .collect();
            ranked.sort_unstable_by_key(|&(n, i)| (std::cmp::Reverse(n), i));
            let next = ranked.into_iter().find_map(|(n, image)| {
                tried[image] = n;
                let seen = observed_points(self, context, image);
                let camera = &self.state.cameras[context.input.camera_of[image]];
                let found = resect_angle(camera, &self.turn.axis, &seen, 0.0, PI);
                let good = found.inliers >= least && found.inliers * 3 >= found.asked;
                good.then_some((image, found.angle))
            });
            let Some((image, angle)) = next else {
                if since == 0 {
                    return Ok(());
                }
                since = 0;
                self.settle_with(context, 2, 100, self.freedom_by_range())?;
                continue;
            };
            self.register(image, angle);
            self.state.grow_image(context.input, image);
            since += 1;
            if since.is_multiple_of(ADJUST_EVERY)
                && !self.settle_with(context, 1, 60, self.freedom_by_range())?
            {
                return Ok(());
            }
        }
    }
}
