//! Depths by stereo joined with depths of another origin, say those of a splat.
//!
//! Stereo is the more exact of the two, but not where a face is seen much aslant, and on a blank
//! face it finds what is behind: there the other counts, unless the photos say otherwise.

use crate::correlation::{Patch, PlaneAt, Sight, costs};
use crate::depths::DenseDepths;
use crate::field::PinholeLens;
use crate::level::LevelImage;
use scene::PosedPhoto;

/// Which of two depths counts.
struct JoinLimits {
    /// Where the other is seen more aslant it counts: cosine of the angle between the ray and the
    /// normal. Source: docs/decisions/16.
    least_cosine: f32,
    /// Where the other lies before the depth by stereo by more than this share of it, stereo may
    /// have looked through a blank face. Source: docs/decisions/16.
    seen_through: f32,
    /// It has not where its plane is by so much more alike in the photos: one minus the
    /// correlation. Source: docs/decisions/16.
    clearly_better: f32,
    /// Pixels to either side by which the slope of the other is told. Source: a patch is 11 wide.
    slope_px: usize,
}

/// The values in force.
const LIMITS: JoinLimits =
    JoinLimits { least_cosine: 0.3, seen_through: 0.02, clearly_better: 0.2, slope_px: 2 };

/// Depths by stereo and the photos they come from.
pub struct DepthJoin<'a> {
    depths: &'a DenseDepths,
    images: Vec<LevelImage>,
}

impl<'a> DepthJoin<'a> {
    /// Of these views.
    pub fn new(depths: &'a DenseDepths, views: &[PosedPhoto]) -> Self {
        let level = depths.settings.first_level(views);
        Self { depths, images: views.iter().map(|v| LevelImage::new(v, level)).collect() }
    }

    /// The depths of a view joined with `other`, of the pixels of its field ([rows × columns],
    /// camera z, scene units; nothing is known where it is not positive): those by stereo, but the
    /// others where these know nothing, where the others are seen much aslant, or where they lie
    /// well before them and the photos do not contradict.
    pub fn joined(&self, view: usize, other: &[f32]) -> Vec<f32> {
        let sights = self.sights(view);
        let own = self.depths.fields[view].depth.iter().enumerate();
        let joined = own.zip(other).map(|((i, &own), &z)| match (own > 0.0, z > 0.0) {
            (false, false) => 0.0,
            (false, true) => z,
            (true, true) if self.is_aslant(view, i, other) => z,
            (true, true)
                if z < own * (1.0 - LIMITS.seen_through) && !self.refutes(view, i, other, &sights) =>
            {
                z
            }
            (true, _) => own,
        });
        joined.collect()
    }

    fn sights(&self, view: usize) -> Vec<Sight<'_>> {
        let pairs = self.depths.pairs[view].iter();
        pairs.map(|p| Sight { image: &self.images[p.view], map: p.there }).collect()
    }

    /// Whether the surface that `other` knows is seen much aslant.
    fn is_aslant(&self, view: usize, i: usize, other: &[f32]) -> bool {
        let field = &self.depths.fields[view];
        let (x, y) = field.place(i);
        let row = sloped(other, field.width, i, [x as f32 + 0.5, y as f32 + 0.5]).row;
        let lens = PinholeLens::of(&field.camera);
        let cosine = lens.normal(row).normalize_or_zero().dot(lens.ray(x, y).normalize());
        cosine < LIMITS.least_cosine
    }

    /// Whether the photos are clearly more alike on the plane by stereo than on the other's.
    fn refutes(&self, view: usize, i: usize, other: &[f32], sights: &[Sight]) -> bool {
        let (field, settings) = (&self.depths.fields[view], &self.depths.settings);
        let (x, y) = field.place(i);
        let patch = Patch::new(&self.images[view], x, y, settings.sigma_grey, settings.noise_at(0));
        let Some(patch) = patch else { return false };
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let row = PinholeLens::of(&field.camera).row(field.normal[i]);
        let d = field.depth[i] * (row[0] * pixel[0] + row[1] * pixel[1] + row[2]);
        let own = PlaneAt { pixel, depth: field.depth[i], row: row.map(|v| v / d) };
        let there = sloped(other, field.width, i, pixel);
        let [own, there] = [own, there].map(|plane| likeness(&patch, &plane, sights, settings.best));
        there - own > LIMITS.clearly_better
    }
}

/// The plane of a depth of a map and of those beside it.
fn sloped(depth: &[f32], width: usize, i: usize, pixel: [f32; 2]) -> PlaneAt {
    let (far, column) = (LIMITS.slope_px, i % width);
    let across = slope(depth, i, (column >= far).then(|| i - far), (column + far < width).then_some(i + far));
    let down = slope(depth, i, i.checked_sub(far * width), Some(i + far * width));
    let constant = 1.0 / depth[i] - across * pixel[0] - down * pixel[1];
    PlaneAt { pixel, depth: depth[i], row: [across, down, constant] }
}

/// Of the inverse depth, in which a plane is linear however much aslant it is seen; 0 where a
/// neighbour is unknown or on another surface.
fn slope(depth: &[f32], i: usize, low: Option<usize>, high: Option<usize>) -> f32 {
    let [low, high] = [low, high].map(|j| depth.get(j?).copied().filter(|z| *z > 0.0));
    let (Some(low), Some(high)) = (low, high) else { return 0.0 };
    let change = 1.0 / high - 1.0 / low;
    let bend = (1.0 / high + 1.0 / low - 2.0 / depth[i]).abs();
    // A jump on one side bends as much as it changes.
    let on_plane = bend < 0.5 * change.abs().max(LIMITS.seen_through / depth[i]);
    if on_plane { change / (2 * LIMITS.slope_px) as f32 } else { 0.0 }
}

/// One minus the correlation: the mean of the views in which it is least.
fn likeness(patch: &Patch, plane: &PlaneAt, sights: &[Sight], best: usize) -> f32 {
    let mut all = vec![0.0; sights.len()];
    costs(patch, plane, sights, &mut all);
    all.sort_unstable_by(f32::total_cmp);
    let best = best.clamp(1, all.len().max(1));
    all.iter().take(best).sum::<f32>() / best as f32
}
