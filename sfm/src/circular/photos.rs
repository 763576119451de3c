//! Turns in photos whose order is not known: a seed from three images that match each other, growth
//! by what is seen.

use super::initialize::best_start::{SeedCameras, best_start};
use super::initialize::seed::{AnglePattern, FocalSearch, KEYS, KeyPair, seeds};
use super::job::MotionInput;
use super::model::{AxisModel, CircularContext};
use super::register::{observed_points, resect_angle};
use crate::error::SfmError;
use crate::incremental::resection::visible;
use crate::limits::WHOLE;
use scene::{TwoViewGeometry, TwoViewKind};
use std::cmp::Reverse;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Triples of images that are tried.
/// Source: chosen by hand, never measured.
const TRIPLES: usize = 4;
/// Images registered between two adjustments.
/// Source: chosen by hand, never measured.
const ADJUST_EVERY: usize = 3;

/// The turn that grows from some triple of images, with as many images as any of those tried;
/// `None` where none does.
pub(crate) fn from_photos(job: &MotionInput<'_>) -> Result<Option<AxisModel>, SfmError> {
    let images = job.input.keypoints.len();
    let focal = FocalSearch::new(&job.cameras[0], &job.known[0]);
    let patterns = AnglePattern::Triple.angles();
    let context = job.context(&[]);
    let given = SeedCameras { cameras: job.cameras, known: &job.known[0], points_per_image: 200 };
    let mut best: Option<AxisModel> = None;
    for (triple, pairs) in triples_of(job) {
        job.progress.check()?;
        let found = seeds(&pairs, 3, &patterns, &focal);
        let start = best_start(&context, &given, &found, |seed| {
            let mut angles = vec![None; images];
            triple.iter().zip(seed.angles).for_each(|(&image, angle)| angles[image] = Some(angle));
            angles
        })?;
        let Some((mut model, cameras)) = start else { continue };
        model.grow_photos(&CircularContext { starts: &cameras, ..context.clone() })?;
        let registered = model.state.registered_count();
        if best.as_ref().is_none_or(|b| registered > b.state.registered_count()) {
            best = Some(model);
        }
        if registered as f64 >= WHOLE * images as f64 {
            break;
        }
    }
    Ok(best.filter(|b| b.state.registered_count() > 3))
}

/// Images that match each other best, three at a time, with their matches; no image twice.
fn triples_of(job: &MotionInput<'_>) -> Vec<([usize; 3], Vec<KeyPair>)> {
    let pairs: HashMap<(usize, usize), &TwoViewGeometry> =
        job.input.geometries.iter().filter(|g| is_useful(g)).map(|g| ((g.a, g.b), g)).collect();
    let mut found: Vec<(usize, [usize; 3])> = Vec::new();
    for &(a, b) in pairs.keys() {
        for c in b + 1..job.input.keypoints.len() {
            let of_pairs = [(a, b), (b, c), (a, c)].map(|p| pairs.get(&p).map_or(0, |g| g.inliers.len()));
            let weakest = of_pairs[0].min(of_pairs[1]).min(of_pairs[2]);
            if weakest >= job.input.config.min_observations {
                found.push((weakest, [a, b, c]));
            }
        }
    }
    found.sort_unstable_by_key(|(n, t)| (Reverse(*n), *t));
    let mut used: Vec<usize> = Vec::new();
    let mut chosen = Vec::new();
    for (_, t) in found {
        if chosen.len() < TRIPLES && t.iter().all(|i| !used.contains(i)) {
            used.extend(t);
            let matches = [[0, 1], [1, 2], [0, 2]].map(|[i, k]| key_pair(job, pairs[&(t[i], t[k])], [i, k]));
            chosen.push((t, matches.to_vec()));
        }
    }
    chosen
}

fn is_useful(g: &TwoViewGeometry) -> bool {
    !matches!(g.kind, TwoViewKind::Panoramic | TwoViewKind::Watermark | TwoViewKind::Degenerate)
}

fn key_pair(job: &MotionInput<'_>, g: &TwoViewGeometry, keys: [usize; 2]) -> KeyPair {
    const { assert!(KEYS >= 3) };
    let mut points = Vec::with_capacity(g.inliers.len());
    for m in &g.inliers {
        let pixels = [job.input.keypoints[g.a][m[0] as usize], job.input.keypoints[g.b][m[1] as usize]];
        points.push(pixels.map(|p| job.cameras[0].unproject(p) * job.cameras[0].mean_focal()));
    }
    KeyPair { keys, points }
}

impl AxisModel {
    /// Registers image after image, those that see most of the model first, at the angle that their
    /// observations agree on.
    fn grow_photos(&mut self, context: &CircularContext<'_>) -> Result<(), SfmError> {
        let mut tried = vec![0usize; context.input.keypoints.len()];
        let mut since = 0usize;
        loop {
            context.progress.check()?;
            let Some((image, angle)) = self.next_photo(context, &mut tried) else {
                if since == 0 {
                    return Ok(());
                }
                since = 0;
                self.settle_with(context, 2, 100, self.freedom_by_range())?;
                continue;
            };
            self.register(context, image, angle);
            since += 1;
            if since.is_multiple_of(ADJUST_EVERY)
                && !self.settle_with(context, 1, 60, self.freedom_by_range())?
            {
                return Ok(());
            }
        }
    }

    /// The image that sees most of the model and whose observations agree on an angle, with that.
    /// `tried`: how many points each saw when it was asked last.
    fn next_photo(&self, context: &CircularContext<'_>, tried: &mut [usize]) -> Option<(usize, f64)> {
        let least = context.input.config.min_observations;
        let mut ranked: Vec<(usize, usize)> = (0..tried.len())
            .filter(|&i| self.turn.angles[i].is_none())
            .map(|i| (visible(&self.state, context.input, i).len(), i))
            .filter(|&(n, i)| n >= least && n > tried[i])
            .collect();
        ranked.sort_unstable_by_key(|&(n, i)| (Reverse(n), i));
        for (n, image) in ranked {
            tried[image] = n;
            let seen = observed_points(self, context, image);
            let camera = &self.state.cameras[context.input.camera_of[image]];
            let found = resect_angle(camera, &self.turn.axis, &seen, 0.0, PI);
            if found.inliers >= least && found.inliers * 3 >= found.asked {
                return Some((image, found.angle));
            }
        }
        None
    }
}
