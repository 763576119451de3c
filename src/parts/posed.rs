//! A splat whose parts stand where their joints put them.

use super::record::{labels, read_moving};
use anyhow::{Context as _, Result};
use scene::{Camera, Gaussians, Pose};
use sfm::Articulation;
use splat::{DeviceConfig, RenderOptions, RenderOutput, Renderer};
use std::path::Path;

/// Parts and their splat.
pub struct MovingSplat {
    renderer: Renderer,
    parts: Articulation,
    /// Angles at which joints are held, degrees.
    held: Vec<Option<f64>>,
}

impl MovingSplat {
    /// That of a folder with a record of parts and a splat `gaussians` of them, if it is one.
    pub(crate) fn open(folder: &Path, device: &DeviceConfig, gaussians: &Gaussians) -> Result<Option<Self>> {
        let Some(parts) = read_moving(folder, gaussians)? else { return Ok(None) };
        let (renderer, _) = Renderer::on(device, gaussians, labels(&parts))?;
        let held = vec![None; parts.parts.len()];
        Ok(Some(Self { renderer, parts, held }))
    }

    /// When a photo was taken, in [0, 1]: the first at 0, the last at 1.
    pub(crate) fn time_of(&self, name: &str) -> f32 {
        let number = self.parts.number(name).unwrap_or(0);
        (number as f64 / self.last_frame()) as f32
    }

    /// Holds joints, by the number of their part from 1 on, at angles in degrees.
    pub(crate) fn hold(&mut self, joints: &[(usize, f64)]) -> Result<()> {
        let count = self.held.len();
        for &(number, angle) in joints {
            let joint = number.checked_sub(1).and_then(|k| self.held.get_mut(k));
            *joint.with_context(|| format!("there is no part {number}; there are {count}"))? = Some(angle);
        }
        Ok(())
    }

    fn last_frame(&self) -> f64 {
        self.parts.frames.len().max(2) as f64 - 1.0
    }

    /// Renders a view as it is at a time.
    pub(crate) fn render(
        &mut self,
        camera: &Camera,
        pose: &Pose,
        time: f32,
        options: &RenderOptions,
    ) -> Result<RenderOutput> {
        let frame = f64::from(time) * self.last_frame();
        let parts = self.parts.parts.iter().zip(&self.held);
        self.renderer.part_poses =
            parts.map(|(part, held)| part.pose(held.unwrap_or_else(|| part.angle_deg(frame)))).collect();
        Ok(self.renderer.render(camera, pose, options)?)
    }
}
