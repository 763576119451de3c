//! The part of space that a field describes.

use glam::{DMat3, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use splat::{Dataset, View};

/// How a cube is chosen for a data set.
struct DomainSettings {
    /// Coverage (of 255) below which a pixel of a mask shows only background.
    /// Source: 3 %, as the trainer's visual hull.
    empty: u8,
    /// Factor around what masks show. Source: chosen by hand: mattes are exact to a few pixels.
    margin: f64,
    /// Half a side in distances of the cameras from what they look at, where no masks tell. Source:
    /// Müller et al. 2022's public scripts: cameras at 1.32 from a box of half a side 0.5.
    unmasked_half: f64,
    /// Cubes around cubes, each twice as large, where no masks tell. Source: as above (side × 16).
    unmasked_cascades: u32,
    /// Weight of a point one unit before the cameras against their axes, per view: decides where
    /// axes are parallel. Source: chosen by hand: small.
    prior: f64,
}

impl Default for DomainSettings {
    fn default() -> Self {
        Self { empty: 8, margin: 1.02, unmasked_half: 0.38, unmasked_cascades: 5, prior: 1e-4 }
    }
}

/// A cube, and cubes around it: cascade `k` has `2^k` times the half side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Domain {
    /// Centre, normalised frame.
    pub(crate) centre: Vec3,
    /// Half a side of the smallest cube, normalised units.
    pub(crate) half: f32,
    /// Number of cubes.
    pub(crate) cascades: u32,
}

impl Domain {
    /// Whether there can be such cubes.
    pub(crate) fn is_sane(&self) -> bool {
        let Self { centre, half, cascades } = *self;
        let most = DomainSettings::default().unmasked_cascades;
        centre.is_finite() && half.is_finite() && half > 0.0 && (1..=most).contains(&cascades)
    }

    /// Half a side of the largest cube, normalised units.
    pub(crate) fn reach(&self) -> f32 {
        self.half * (1u32 << (self.cascades - 1)) as f32
    }

    /// Around what the training views look at: what their masks show, else a share of the cameras'
    /// distance.
    pub(crate) fn of(dataset: &Dataset) -> Self {
        let settings = DomainSettings::default();
        let views: Vec<&View> = dataset.views.iter().filter(|v| !v.held_out).collect();
        let focus = focus(&views, settings.prior);
        let distances: Vec<f64> =
            views.iter().map(|v| v.view.position().as_dvec3().distance(focus)).collect();
        if dataset.is_transparent() {
            let half = views
                .iter()
                .zip(&distances)
                .map(|(view, distance)| distance * tangent_of_mask(view, focus, settings.empty))
                .fold(0.0, f64::max);
            if half.is_finite() && half > 0.0 {
                let half = (settings.margin * half) as f32;
                return Self { centre: focus.as_vec3(), half, cascades: 1 };
            }
        }
        let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
        let half = settings.unmasked_half * if mean > 0.0 { mean } else { 1.0 };
        // Where masks show nothing at all, there is nothing around the box either.
        let cascades = if dataset.is_transparent() { 1 } else { settings.unmasked_cascades };
        Self { centre: focus.as_vec3(), half: half as f32, cascades }
    }
}

/// The point nearest to the optical axes, in the sense of least squares.
fn focus(views: &[&View], prior: f64) -> DVec3 {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let (origin, axis) = (view.view.position().as_dvec3(), view.view.rotation.row(2).as_dvec3());
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        a += across + DMat3::IDENTITY * prior;
        b += across * origin + (origin + axis) * prior;
    }
    let x = a.inverse() * b;
    if x.is_finite() { x } else { DVec3::ZERO }
}

/// Largest tangent of the angle between the direction of `focus` and what a mask shows, which is
/// what it covers by `empty` at least; 0 where it shows nothing.
fn tangent_of_mask(view: &View, focus: DVec3, empty: u8) -> f64 {
    let (pixels, camera) = (&view.levels[0], &view.view);
    let towards = (focus.as_vec3() - camera.position()).normalize_or_zero();
    let mut least = 1.0f32;
    for y in 0..pixels.height {
        for x in 0..pixels.width {
            if pixels.mask.as_ref().is_none_or(|m| m[y * pixels.width + x] >= empty) {
                let d = crate::rays::direction(camera, x as f32 + 0.5, y as f32 + 0.5);
                least = least.min(d.dot(towards));
            }
        }
    }
    let cosine = f64::from(least.max(f32::EPSILON));
    (1.0 - cosine * cosine).max(0.0).sqrt() / cosine
}
