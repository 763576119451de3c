//! How well a lamp explains what the photos show.

use crate::shadows::ShadowMap;
use crate::solid::{Ball, SolidSplat};
use crate::surface::{Appearance, SeenSurface};
use crate::trial::{Trial, sphere};
use glam::DVec3;
use rayon::prelude::*;
use scene::{Cancelled, Pose, PosedPhoto, Progress};

/// Parts of the object: octants. Source: 2³.
pub(crate) const GROUPS: usize = 8;

/// What is compared.
struct FitLimits {
    /// Gaussians, at most. Source: chosen by hand, never measured.
    gaussians: usize,
    /// Photos that see one, at least. Source: chosen by hand, never measured.
    photos: usize,
    /// Directions in which shadows are known: 12° apart. Source: derived, 4π / 300.
    directions: usize,
    /// Directions that count for one: cosine of the angle between, 18°. Source: derived, half as
    /// far again as they are apart.
    near_cosine: f64,
    /// Pixels a side of their maps. Source: chosen by hand, never measured.
    side: u32,
    /// Squared error of a photo that is as good as none, linear light: half a dark grey level.
    /// Source: derived.
    noise: f64,
}

/// The values in force.
const LIMITS: FitLimits =
    FitLimits { gaussians: 3000, photos: 5, directions: 300, near_cosine: 0.951, side: 128, noise: 1e-6 };

/// Green light of some Gaussians in all photos, and which light reaches them.
pub(crate) struct Brightness<'a> {
    surface: &'a SeenSurface,
    poses: Vec<Pose>,
    chosen: Vec<usize>,
    group: Vec<usize>,
    directions: Vec<DVec3>,
    /// [directions × chosen]
    lit: Vec<Vec<f32>>,
}

impl<'a> Brightness<'a> {
    /// `None` where no Gaussian is seen often enough.
    pub(crate) fn new(
        solid: &SolidSplat,
        ball: Ball,
        surface: &'a SeenSurface,
        photos: &[PosedPhoto],
        progress: &Progress,
    ) -> Result<Option<Self>, Cancelled> {
        let enough = |i: &usize| {
            let seen = surface.seen[*i].len() >= LIMITS.photos;
            seen && solid.is_opaque(*i / 2) && surface.normal(*i) != DVec3::ZERO
        };
        let able: Vec<usize> = (0..surface.seen.len()).filter(enough).collect();
        if able.is_empty() {
            return Ok(None);
        }
        let chosen: Vec<usize> =
            able.iter().step_by(able.len().div_ceil(LIMITS.gaussians)).copied().collect();
        let directions = sphere(LIMITS.directions);
        progress.begin("shadows", directions.len());
        let lit = directions.par_iter().map(|&d| {
            let map = ShadowMap::new(solid, ball, d, LIMITS.side);
            let row = chosen.iter().map(|&i| {
                let normal = surface.normal(i);
                // From behind every place lies in its own shadow, which says nothing of others.
                if normal.dot(d) > 0.0 { map.lit_before(solid.place(i / 2), normal) as f32 } else { f32::NAN }
            });
            progress.tick().map(|()| row.collect())
        });
        let lit = lit.collect::<Result<_, _>>()?;
        let group = chosen.iter().map(|&i| octant(solid.place(i / 2) - ball.centre)).collect();
        let poses = photos.iter().map(|p| p.pose).collect();
        Ok(Some(Self { surface, poses, chosen, group, directions, lit }))
    }

    /// Observations that are compared.
    pub(crate) fn count(&self) -> f64 {
        self.chosen.iter().map(|&i| self.unclipped(i).count()).sum::<usize>() as f64
    }

    /// Minus twice the logarithm of the likelihood, by part of the object, with the albedo and the
    /// noise that suit each Gaussian best; without a trial, of a colour that never changes.
    pub(crate) fn errors(&self, trial: Option<&Trial>) -> [f64; GROUPS] {
        let lamps: Vec<Option<LampInView>> = self.lamps(trial);
        let ambient = trial.map_or(1.0, |t| t.ambient);
        let mut sums = [0.0; GROUPS];
        for (k, &i) in self.chosen.iter().enumerate() {
            let [mut cc, mut cm, mut mm, mut n] = [0.0; 4];
            for seen in self.unclipped(i) {
                let light = lamps[seen.view as usize].as_ref().map_or(0.0, |lamp| self.light(lamp, k));
                let (c, m) = (f64::from(seen.rgb[1]), ambient + light);
                cc += c * c;
                cm += c * m;
                mm += m * m;
                n += 1.0;
            }
            if n == 0.0 {
                continue;
            }
            let left = (cc - cm * cm / mm.max(f64::MIN_POSITIVE)).max(0.0);
            sums[self.group[k]] += n * (left / n + LIMITS.noise).ln();
        }
        sums
    }

    /// What tells of the light: a clipped photo says too little.
    fn unclipped(&self, i: usize) -> impl Iterator<Item = &Appearance> {
        self.surface.seen[i].iter().filter(|seen| !seen.is_clipped())
    }

    /// Light of the lamp on one of the chosen.
    fn light(&self, lamp: &LampInView, k: usize) -> f64 {
        let cosine = self.surface.normal(self.chosen[k]).dot(lamp.towards);
        if !(cosine > 0.0) {
            return 0.0;
        }
        let (mut lit, mut weight) = (0.0, 0.0);
        for &(d, w) in &lamp.near {
            let share = f64::from(self.lit[d][k]);
            if !share.is_nan() {
                lit += w * share;
                weight += w;
            }
        }
        if weight > 0.0 { cosine * lit / weight } else { cosine }
    }

    fn lamps(&self, trial: Option<&Trial>) -> Vec<Option<LampInView>> {
        let lamps = self.poses.iter().map(|pose| {
            let towards = pose.rotation.inverse() * trial?.towards;
            Some(LampInView { towards, near: nearest(&self.directions, towards) })
        });
        lamps.collect()
    }
}

/// The lamp when a photo was taken.
struct LampInView {
    /// World frame.
    towards: DVec3,
    /// Directions of the table near to it, and their weights.
    near: Vec<(usize, f64)>,
}

/// Weights fall smoothly to nothing, so that errors are a smooth function of the direction.
fn nearest(directions: &[DVec3], towards: DVec3) -> Vec<(usize, f64)> {
    let weights = directions.iter().map(|d| d.dot(towards) - LIMITS.near_cosine);
    weights.enumerate().filter(|(_, w)| *w > 0.0).map(|(k, w)| (k, w * w)).collect()
}

fn octant(p: DVec3) -> usize {
    usize::from(p.x > 0.0) | usize::from(p.y > 0.0) << 1 | usize::from(p.z > 0.0) << 2
}
