//! The light of a scene, and the scene in another light.

use crate::colour::{linear, srgb};
use crate::fit::Brightness;
use crate::lamp::{Lamp, found};
use crate::shadows::ShadowMap;
use crate::solid::{Ball, SolidSplat};
use crate::surface::{Appearance, SeenSurface};
use glam::DVec3;
use rayon::prelude::*;
use scene::gaussians::SH_C0;
use scene::sh::sh_basis;
use scene::{Cancelled, Gaussians, Pose, PosedPhoto, Progress};

/// How the light is used.
struct LightLimits {
    /// A lamp that explains less is none: gain. Source: docs/decisions/23.
    least_gain: f64,
    /// This share of what the model does not explain stays. Source: docs/decisions/23.
    kept: f64,
    /// Rounds of the albedo. Source: chosen by hand, never measured.
    rounds: u32,
    /// Pixels a side of a shadow map. Source: chosen by hand, never measured.
    side: u32,
}

/// The values in force.
const LIMITS: LightLimits = LightLimits { least_gain: 0.05, kept: 0.4, rounds: 10, side: 400 };

/// Why the light is not known.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LightError {
    /// No Gaussian is seen by enough photos.
    #[error("no place of the object is seen by five photos")]
    Unseen,
    /// The photos are not told by a lamp beside the camera.
    #[error(
        "the photos do not tell where the lamp is: no lamp beside the camera explains how the object's \
         brightness changes. The lamp must go round the object as it is filmed: an object on a \
         turntable before a lamp that stands still, or a lamp on the camera"
    )]
    NoLamp,
    /// The user asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The light of a scene.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// The lamp.
    pub lamp: Lamp,
    ball: Ball,
    surface: SeenSurface,
    /// By side of a Gaussian, linear: what it would show in the lamp's full light and no other.
    albedo: Vec<[f64; 3]>,
}

impl Lighting {
    /// From photos without distortion; the lamp and the camera did not move against each other.
    pub fn solve(solid: &SolidSplat, photos: &[PosedPhoto], progress: &Progress) -> Result<Self, LightError> {
        let ball = solid.ball().ok_or(LightError::Unseen)?;
        let surface = SeenSurface::of(solid, photos, progress)?;
        let brightness = Brightness::new(solid, ball, &surface, photos, progress)?;
        let lamp = found(&brightness.ok_or(LightError::Unseen)?).ok_or(LightError::NoLamp)?;
        if !(lamp.gain > LIMITS.least_gain) {
            return Err(LightError::NoLamp);
        }
        let albedo = albedo(solid, ball, (&surface, photos), &lamp, progress)?;
        Ok(Self { lamp, ball, surface, albedo })
    }

    /// The Gaussians as a view shows them if the lamp were elsewhere (`towards`: unit, camera
    /// frame), of spherical-harmonic degree 0. Those that are no surface are as they were.
    pub fn relit(&self, solid: &SolidSplat, pose: &Pose, towards: DVec3) -> Gaussians {
        let g = solid.gaussians;
        let [old, new] = [self.lamp.towards, towards].map(|towards| self.shadows(solid, pose, towards));
        let colours = (0..g.len()).into_par_iter().flat_map_iter(|i| {
            let shown = colour_towards(g, i, pose.centre());
            let place = solid.place(i);
            let side = self.surface.side(i, place, pose.centre());
            let normal = self.surface.normal(side);
            let [before, after] = [&old, &new].map(|map| self.lamp.ambient + map.light(place, normal));
            [0, 1, 2].map(|c| {
                if normal == DVec3::ZERO || self.surface.seen[side].is_empty() {
                    return shown[c];
                }
                let unexplained = linear(shown[c]) - self.albedo[side][c] * before;
                srgb(self.albedo[side][c] * after + LIMITS.kept * unexplained)
            })
        });
        let sh = colours.map(|v| (v as f32 - 0.5) / SH_C0).collect();
        Gaussians { sh, sh_degree: 0, ..g.clone() }
    }

    fn shadows(&self, solid: &SolidSplat, pose: &Pose, towards: DVec3) -> ShadowMap {
        ShadowMap::new(solid, self.ball, pose.rotation.inverse() * towards, LIMITS.side)
    }
}

/// What suits best what the photos show of each Gaussian.
fn albedo(
    solid: &SolidSplat,
    ball: Ball,
    (surface, photos): (&SeenSurface, &[PosedPhoto]),
    lamp: &Lamp,
    progress: &Progress,
) -> Result<Vec<[f64; 3]>, Cancelled> {
    // In the order of the observations.
    let mut light: Vec<Vec<f32>> = surface.seen.iter().map(|s| Vec::with_capacity(s.len())).collect();
    progress.begin("albedo", photos.len());
    for (view, photo) in photos.iter().enumerate() {
        let towards = photo.pose.rotation.inverse() * lamp.towards;
        let map = ShadowMap::new(solid, ball, towards, LIMITS.side);
        light.par_iter_mut().enumerate().for_each(|(i, light)| {
            if surface.seen[i].get(light.len()).is_some_and(|next| next.view as usize == view) {
                light.push((lamp.ambient + map.light(solid.place(i / 2), surface.normal(i))) as f32);
            }
        });
        progress.tick()?;
    }
    let each = surface.seen.par_iter().zip(&light);
    Ok(each.map(|(seen, light)| [0, 1, 2].map(|c| albedo_of(seen, light, c))).collect())
}

/// Least squares of a channel by the light; a clipped photo only says "at least white".
fn albedo_of(seen: &[Appearance], light: &[f32], channel: usize) -> f64 {
    let mut albedo = 0.0;
    for _ in 0..LIMITS.rounds {
        let (mut products, mut squares) = (0.0, f64::MIN_POSITIVE);
        for (seen, light) in seen.iter().zip(light.iter().map(|l| f64::from(*l))) {
            let shown = f64::from(seen.rgb[channel]);
            let bright = if seen.is_clipped() { shown.max(albedo * light) } else { shown };
            products += light * bright;
            squares += light * light;
        }
        albedo = products / squares;
    }
    albedo
}

/// What a Gaussian shows an eye, sRGB.
fn colour_towards(g: &Gaussians, i: usize, eye: DVec3) -> [f64; 3] {
    let basis = sh_basis((g.means[i].as_dvec3() - eye).normalize_or_zero());
    let count = g.sh_coefficients();
    let own = &g.sh[3 * i * count..3 * (i + 1) * count];
    [0, 1, 2].map(|c| {
        let sum: f64 = basis.iter().zip(own.chunks(3)).map(|(y, k)| y * f64::from(k[c])).sum();
        (0.5 + sum).max(0.0)
    })
}
