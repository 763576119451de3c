//! From Gaussians to images.
//!
//! ```
//! use glam::{DVec3, Quat, Vec3};
//! use scene::{Camera, CameraModel, Gaussians, Pose};
//! use splat::{RenderOptions, Renderer};
//!
//! let ball = Gaussians {
//!     means: vec![Vec3::ZERO],
//!     log_scales: vec![Vec3::splat(-1.0)],
//!     rotations: vec![Quat::IDENTITY],
//!     opacity_logits: vec![5.0],
//!     sh: vec![1.0; 3],
//!     sh_degree: 0,
//! };
//! let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 60.0);
//! let pose = Pose::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, -DVec3::Y);
//! let picture = Renderer::new(&ball)?.render(&camera, &pose, &RenderOptions::default())?;
//! let centre = 24 * 64 + 32;
//! assert!(picture.alpha.data[centre] > 0.9 && picture.alpha.data[0] < 0.1);
//! # Ok::<(), splat::SplatError>(())
//! ```

use crate::backend::Backend;
use crate::dataset::NormalisedFrame;
use crate::device::{BackendChoice, DeviceConfig};
use crate::error::SplatError;
use crate::model::Model;
use crate::quantile::median;
use crate::statistics::Statistics;
use crate::view::{PinholeView, RenderOptions, RenderOutput};
use glam::DVec3;
use scene::{Camera, Decision, Gaussians, Pose};

/// Renders many views of the same Gaussians.
pub struct Renderer {
    backend: Box<dyn Backend>,
    frame: NormalisedFrame,
    /// Where moving parts stand, `body_from_part_at_rest` for each; the others are at rest.
    pub part_poses: Vec<Pose>,
    /// Whether the Gaussians were trained with [`RenderOptions::antialias`]: then every picture has
    /// it.
    pub antialias: bool,
}

impl Renderer {
    /// On the processor; see [`Renderer::on`].
    pub fn new(gaussians: &Gaussians) -> Result<Self, SplatError> {
        let device = DeviceConfig { backend: BackendChoice::Cpu, ..DeviceConfig::default() };
        Ok(Self::on(&device, gaussians, Vec::new())?.0)
    }

    /// Prepares the Gaussians, in a frame in which their spread is 1, so that scenes of any unit
    /// render alike; says where they will be rendered. `part`: the part that each belongs to (0:
    /// the body), empty where nothing moves; what moves is rendered on the processor.
    pub fn on(
        device: &DeviceConfig,
        gaussians: &Gaussians,
        part: Vec<u8>,
    ) -> Result<(Self, Decision), SplatError> {
        gaussians.validate().map_err(SplatError::InvalidGaussians)?;
        let frame = spread(gaussians);
        let (mut backend, decision) = crate::device::open(&device.for_parts(!part.is_empty()))?;
        let model = Model { part, ..Model::from_gaussians(&frame.normalise(gaussians.clone())) };
        backend.upload(model, Statistics::default())?;
        Ok((Self { backend, frame, part_poses: Vec::new(), antialias: false }, decision))
    }

    /// Renders a view; the camera must be PINHOLE, SIMPLE_PINHOLE or without distortion.
    pub fn render(
        &mut self,
        camera: &Camera,
        pose: &Pose,
        options: &RenderOptions,
    ) -> Result<RenderOutput, SplatError> {
        if camera.distortion().iter().any(|&k| k != 0.0) {
            let name = "the view".to_owned();
            return Err(SplatError::NotPinhole { name, camera: camera.id, model: camera.model.name() });
        }
        let near = options.near.map(|n| n * self.frame.scale as f32);
        let parts = self.part_poses.iter().map(|motion| self.frame.part_place(motion)).collect();
        let view = PinholeView { parts, ..self.frame.view(camera, pose) };
        let antialias = options.antialias || self.antialias;
        let mut out = self.backend.render(&view, &RenderOptions { near, antialias, ..*options })?;
        let unit = (1.0 / self.frame.scale) as f32;
        out.depth.data.iter_mut().for_each(|z| *z *= unit);
        Ok(out)
    }
}

/// Median centre and median distance from it.
fn spread(g: &Gaussians) -> NormalisedFrame {
    let finite = |values: &mut dyn Iterator<Item = f64>| median(values.filter(|v| v.is_finite()).collect());
    let [x, y, z] = [0, 1, 2].map(|a| finite(&mut g.means.iter().map(|m| f64::from(m[a]))).unwrap_or(0.0));
    let centre = DVec3::new(x, y, z);
    let distance = finite(&mut g.means.iter().map(|m| m.as_dvec3().distance(centre))).unwrap_or(0.0);
    NormalisedFrame { centre, scale: if distance > 0.0 { 1.0 / distance } else { 1.0 } }
}
