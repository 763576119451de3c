//! Which places a lamp at infinity meets.

use crate::solid::{Ball, SolidSplat};
use glam::DVec3;
use scene::{Camera, CameraModel, Pose};

/// How shadows are told.
struct ShadowLimits {
    /// The lamp looks from so many radii away: parallel within 3°. Source: derived, 1/20 rad.
    away: f64,
    /// A place is moved out along its normal by this share of the radius: centres of Gaussians lie
    /// behind the surface that they make. Source: chosen by hand on the test bed's case 4.
    out: f64,
    /// What lies nearer than this behind the surface is lit, share of the radius. Source: as `out`.
    bias: f64,
}

/// The values in force.
const LIMITS: ShadowLimits = ShadowLimits { away: 20.0, out: 0.03, bias: 0.02 };

/// The surface as a lamp sees it.
#[derive(Clone, Debug)]
pub(crate) struct ShadowMap {
    camera: Camera,
    pose: Pose,
    depth: Vec<Option<f64>>,
    /// World frame, unit, from the object to the lamp.
    towards: DVec3,
    radius: f64,
}

impl ShadowMap {
    /// `towards`: unit, from the object to the lamp, world frame; `side`: pixels.
    pub(crate) fn new(solid: &SolidSplat, ball: Ball, towards: DVec3, side: u32) -> Self {
        let away = LIMITS.away * ball.radius;
        let eye = ball.centre + away * towards;
        let pose = Pose::look_at(eye, ball.centre, towards.any_orthonormal_vector());
        // The ball just fits.
        let focal = 0.5 * f64::from(side) * (LIMITS.away * LIMITS.away - 1.0).sqrt();
        let camera = Camera::centred(0, CameraModel::Pinhole, side, side, focal);
        let depth = solid.depth(&camera, &pose);
        Self { camera, pose, depth, towards, radius: ball.radius }
    }

    /// Light from the lamp at a place with a normal (unit): Lambert's cosine, less what is in the
    /// way; 0 to 1.
    pub(crate) fn light(&self, place: DVec3, normal: DVec3) -> f64 {
        let cosine = normal.dot(self.towards);
        if cosine > 0.0 { cosine * self.lit_before(place, normal) } else { 0.0 }
    }

    /// The share of the lamp's rays that reach a place, 0 to 1.
    pub(crate) fn lit_before(&self, place: DVec3, normal: DVec3) -> f64 {
        self.lit(place + LIMITS.out * self.radius * normal)
    }

    /// The share of 3 × 3 rays.
    fn lit(&self, place: DVec3) -> f64 {
        let p = self.pose.transform(place);
        let Some(pixel) = self.camera.project(p) else { return 1.0 };
        let side = i64::from(self.camera.width);
        let [x, y] = [pixel.x.floor() as i64, pixel.y.floor() as i64];
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
        let free = around.filter(|&[x, y]| {
            let inside = (0..side).contains(&x) && (0..side).contains(&y);
            let behind = |z: f64| p.z > z + LIMITS.bias * self.radius;
            !(inside && self.depth[(y * side + x) as usize].is_some_and(behind))
        });
        free.count() as f64 / 9.0
    }
}
