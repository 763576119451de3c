//! The visual hull: what the mattes of the training views leave room for.

use crate::dataset::{MATTE_MARGIN_PX, View, shrink};
use crate::model::Model;
use crate::view::PinholeView;
use glam::Vec3;
use rayon::prelude::*;
use std::borrow::Cow;

/// How a hull is told from mattes. Numbers without a source were chosen by hand, never measured.
struct HullRules {
    /// Coverage (of 255) below which a pixel of a matte shows only background: 3 %.
    empty: u8,
    /// Level of the outlines (1: half the resolution): mattes and poses are no more exact.
    level: usize,
    /// Views with a matte from which a hull is told.
    least_views: usize,
    /// Views that may contradict a place before it counts as outside: mattes lose a rod here and
    /// there.
    few: usize,
    /// The same as a share of those that see it, one in so many. Source: docs/decisions/13: with
    /// one in 20 an array went that a tenth of the mattes had lost; without pruning pictures are
    /// the same.
    one_in: usize,
}

/// See [`HullRules`].
const RULES: HullRules = HullRules { empty: 8, level: 1, least_views: 8, few: 2, one_in: 3 };

/// The silhouette of one view, widened.
struct Silhouette {
    view: PinholeView,
    covered: Vec<bool>,
}

/// Silhouettes of all views that have a matte, to ask whether a place can belong to the object.
///
/// A place outside the visual hull (Laurentini 1994) is seen before the background by some view. A
/// few such views prove nothing, so a place is outside when more than 2 and more than a third
/// of the views that have it in their picture show background there.
pub(crate) struct VisualHull {
    silhouettes: Vec<Silhouette>,
}

impl VisualHull {
    /// From the mattes of `views`; `None` where fewer than eight have one.
    pub(crate) fn of<'a>(views: impl Iterator<Item = &'a View>) -> Option<Self> {
        let silhouettes: Vec<Silhouette> = views.filter_map(Silhouette::of).collect();
        (silhouettes.len() >= RULES.least_views).then_some(Self { silhouettes })
    }

    /// Whether too many views show background at `x` (frame of the views).
    fn excludes(&self, x: Vec3) -> bool {
        let (mut seen, mut empty) = (0, 0);
        for covered in self.silhouettes.iter().filter_map(|s| s.covers(x)) {
            seen += 1;
            empty += usize::from(!covered);
        }
        empty > RULES.few && empty * RULES.one_in > seen
    }

    /// Removes Gaussians of the body whose centre the hull excludes; returns how many. None where
    /// that would leave nothing. Where moving parts stand is not known well enough to judge them.
    pub(crate) fn prune(&self, model: &mut Model) -> usize {
        let all = (0..model.len as u32).into_par_iter();
        let keep: Vec<u32> = all
            .filter(|&i| model.part_of(i as usize) > 0 || !self.excludes(model.mean(i as usize)))
            .collect();
        model.keep(&keep)
    }
}

impl Silhouette {
    fn of(view: &View) -> Option<Self> {
        let level = RULES.level;
        let pixels = match view.levels.get(level) {
            Some(pixels) => Cow::Borrowed(pixels),
            None => Cow::Owned(shrink(&view.levels[0], level as u32)),
        };
        let mask = pixels.mask.as_ref()?;
        let (w, h) = (pixels.width, pixels.height);
        let margin = MATTE_MARGIN_PX >> RULES.level;
        let mut covered = vec![false; w * h];
        for i in (0..w * h).filter(|i| mask[*i] >= RULES.empty) {
            let (x, y) = (i % w, i / w);
            for row in y.saturating_sub(margin)..(y + margin + 1).min(h) {
                covered[row * w + x.saturating_sub(margin)..row * w + (x + margin + 1).min(w)].fill(true);
            }
        }
        Some(Self { view: view.view.at_level(level as u32), covered })
    }

    /// Whether the silhouette covers `x`; `None` outside the picture.
    fn covers(&self, x: Vec3) -> Option<bool> {
        let view = &self.view;
        let c = view.camera_point(x);
        if c.z <= 0.0 {
            return None;
        }
        let [px, py] = view.pixel(c);
        view.contains([px, py]).then(|| self.covered[py as usize * view.width + px as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{NormalisedFrame, Pixels};
    use glam::{DVec3, Quat};
    use scene::{Camera, CameraModel, Gaussians, Pose};

    /// Views from a ring of radius 1 of a ball of radius `radius` at the origin; every `blind`-th
    /// matte is empty.
    fn views(count: usize, radius: f64, blind: usize) -> Vec<View> {
        let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 60.0);
        let normalisation = NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 };
        let view = |k: usize| {
            let angle = k as f64 / count as f64 * std::f64::consts::TAU;
            let eye = DVec3::new(angle.cos(), angle.sin(), 0.3).normalize();
            let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
            let reach = 60.0 * radius / (1.0 - radius * radius).sqrt();
            let mask = (0..64 * 48)
                .map(|i| {
                    let (x, y) = (f64::from(i % 64) + 0.5 - 32.0, f64::from(i / 64) + 0.5 - 24.0);
                    if !k.is_multiple_of(blind) && x.hypot(y) < reach { 255 } else { 0 }
                })
                .collect();
            let full = Pixels { width: 64, height: 48, rgb: vec![90; 64 * 48 * 3], mask: Some(mask) };
            View {
                name: format!("{k:03}.png"),
                camera: camera.clone(),
                pose,
                view: normalisation.view(&camera, &pose),
                levels: crate::dataset::pyramid(full),
                held_out: false,
            }
        };
        (0..count).map(view).collect()
    }

    fn model(means: Vec<Vec3>) -> Model {
        let n = means.len();
        Model::from_gaussians(&Gaussians {
            means,
            log_scales: vec![Vec3::splat(-4.0); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![0.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        })
    }

    #[test]
    fn what_lies_outside_the_silhouettes_goes_and_what_lies_in_them_stays() {
        let inside = vec![Vec3::ZERO, Vec3::new(0.15, 0.0, 0.05), Vec3::new(0.0, -0.19, 0.0)];
        let outside = vec![Vec3::new(0.33, 0.0, 0.0), Vec3::new(0.0, 0.1, 0.31), Vec3::new(-0.2, 0.25, 0.0)];
        let hull = VisualHull::of(views(40, 0.2, 99).iter()).unwrap();
        let mut gaussians = model(inside.iter().chain(&outside).copied().collect());
        assert_eq!(hull.prune(&mut gaussians), outside.len());
        assert_eq!((0..gaussians.len).map(|i| gaussians.mean(i)).collect::<Vec<_>>(), inside);
        assert_eq!(hull.prune(&mut model(outside)), 0, "something must be left");
    }

    #[test]
    fn a_quarter_of_the_views_that_lost_the_object_does_not_empty_the_hull_and_half_does() {
        let (few, many) = (views(40, 0.2, 4), views(40, 0.2, 2));
        assert!(!VisualHull::of(few.iter()).unwrap().excludes(Vec3::ZERO));
        assert!(VisualHull::of(many.iter()).unwrap().excludes(Vec3::ZERO));
        assert!(VisualHull::of(few[..7].iter()).is_none());
        let mut bare = views(40, 0.2, 99);
        bare.iter_mut().for_each(|v| v.levels.iter_mut().for_each(|l| l.mask = None));
        assert!(VisualHull::of(bare.iter()).is_none());
    }
}
