//! A splat whose parts stand where their joints put them.

use super::RECORD;
use anyhow::{Context, Result};
use scene::{Camera, Gaussians, Pose};
use sfm::Articulation;
use splat::{BackendChoice, DeviceConfig, RenderOptions, RenderOutput, Renderer};
use std::path::Path;

/// Parts and their splat.
pub struct MovingSplat {
    renderer: Renderer,
    parts: Articulation,
}

impl MovingSplat {
    /// That of a folder with a record of parts and a splat `gaussians` of them, if it is one.
    pub(crate) fn open(folder: &Path, gaussians: &Gaussians) -> Result<Option<Self>> {
        let path = folder.join(RECORD);
        if !path.is_file() {
            return Ok(None);
        }
        let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let parts: Articulation = serde_json::from_slice(&text)
            .with_context(|| format!("{} is damaged; run sat-recon parts again", path.display()))?;
        if parts.gaussians.is_empty() {
            return Ok(None);
        }
        anyhow::ensure!(
            parts.gaussians.iter().sum::<usize>() == gaussians.len(),
            "{} belongs to another splat than the one beside it; run sat-recon parts again",
            path.display()
        );
        let device = DeviceConfig { backend: BackendChoice::Cpu, ..DeviceConfig::default() };
        let (mut renderer, _) = Renderer::on(&device, gaussians)?;
        let of_parts = (0..).zip(&parts.gaussians);
        renderer.articulate(of_parts.flat_map(|(part, &count)| std::iter::repeat_n(part, count)).collect())?;
        Ok(Some(Self { renderer, parts }))
    }

    /// When a photo was taken, in [0, 1]: the first at 0, the last at 1.
    pub(crate) fn time_of(&self, name: &str) -> f32 {
        let number = self.parts.frames.iter().position(|frame| frame == name).unwrap_or(0);
        number as f32 / self.last_frame() as f32
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
        let poses: Vec<Pose> = self.parts.parts.iter().map(|p| p.pose(p.angle_deg(frame))).collect();
        Ok(self.renderer.render_parts(camera, pose, &poses, options)?)
    }
}
