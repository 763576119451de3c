//! From Gaussians to images.

use crate::backend::Backend;
use crate::dataset::Normalisation;
use crate::decision::Decision;
use crate::device::{BackendChoice, DeviceConfig};
use crate::error::SplatError;
use crate::model::Model;
use crate::statistics::Statistics;
use crate::view::{RenderOptions, RenderOutput};
use glam::DVec3;
use scene::{Camera, Gaussians, Pose};

/// Renders many views of the same Gaussians.
pub struct Renderer {
    backend: Box<dyn Backend>,
    frame: Normalisation,
    /// Whether the Gaussians were trained with [`RenderOptions::antialias`]: then every picture has it.
    pub antialias: bool,
}

impl Renderer {
    /// On the processor; see [`Renderer::on`].
    pub fn new(gaussians: &Gaussians) -> Result<Self, SplatError> {
        let device = DeviceConfig { backend: BackendChoice::Cpu, ..DeviceConfig::default() };
        Ok(Self::on(&device, gaussians)?.0)
    }

    /// Prepares the Gaussians, in a frame in which their spread is 1, so that scenes of any unit render alike; says where
    /// they will be rendered.
    pub fn on(device: &DeviceConfig, gaussians: &Gaussians) -> Result<(Self, Decision), SplatError> {
        gaussians.validate().map_err(SplatError::InvalidGaussians)?;
        let frame = spread(gaussians);
        let (mut backend, decision) = crate::device::open(device)?;
        let model = Model::from_gaussians(&frame.to_normalised(gaussians.clone()));
        backend.upload(model, Statistics::default())?;
        Ok((Self { backend, frame, antialias: false }, decision))
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
        let view = self.frame.view(camera, pose);
        let antialias = options.antialias || self.antialias;
        let mut out = self.backend.render(&view, &RenderOptions { near, antialias, ..*options })?;
        let unit = (1.0 / self.frame.scale) as f32;
        out.depth.data.iter_mut().for_each(|z| *z *= unit);
        Ok(out)
    }
}

/// Renders one view.
pub fn render_view(
    gaussians: &Gaussians,
    camera: &Camera,
    pose: &Pose,
    options: &RenderOptions,
) -> Result<RenderOutput, SplatError> {
    Renderer::new(gaussians)?.render(camera, pose, options)
}

/// Median centre and median distance from it.
fn spread(g: &Gaussians) -> Normalisation {
    let median = |mut values: Vec<f64>| -> f64 {
        values.retain(|v| v.is_finite());
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    };
    let axis = |a: usize| median(g.means.iter().map(|m| f64::from(m[a])).collect());
    let centre = DVec3::new(axis(0), axis(1), axis(2));
    let distance = median(g.means.iter().map(|m| m.as_dvec3().distance(centre)).collect());
    Normalisation { centre, scale: if distance > 0.0 { 1.0 / distance } else { 1.0 } }
}
