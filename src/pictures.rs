//! What renders the pictures of a run: its splat, or the field of another method.

use crate::parts::MovingSplat;
use crate::record::SplatSummary;
use crate::times::Times;
use anyhow::{Context, Result, bail};
use baselines::{Accelerator, TrainedField};
use scene::{Camera, Gaussians, Pose};
use splat::{DeviceConfig, RenderOptions, RenderOutput, Renderer};
use std::path::Path;

/// Quality of pictures in a page, of 100. Source: chosen by hand, never measured.
pub(crate) const JPEG_QUALITY: u8 = 85;

/// The file of a field in a run folder.
pub(crate) const FIELD: &str = "field.bin";

/// What renders the pictures of a run.
pub enum Pictures {
    /// A splat.
    Splat(Box<Renderer>, Gaussians),
    /// A splat whose parts move.
    Parts(Box<MovingSplat>),
    /// A field, and when its photos were taken.
    Field(Box<TrainedField>, Times),
}

impl Pictures {
    /// Of what a run has trained, and where it renders, in words.
    pub fn open(run: &Path, device: &DeviceConfig) -> Result<(Self, String)> {
        let field = run.join(FIELD);
        if field.is_file() {
            let by = Accelerator::open(device)?;
            let field = TrainedField::read(&field, &by)?;
            let words = format!("{} ({})", by.name(), field.method().name());
            return Ok((Self::Field(Box::new(field), Times::read(run)?), words));
        }
        let gaussians = scene::io::ply::read_splat_ply(&run.join("splat.ply"))?;
        if let Some(moving) = MovingSplat::open(run, device, &gaussians)? {
            return Ok((Self::Parts(Box::new(moving)), "processor (moving parts)".to_owned()));
        }
        let (mut renderer, chosen) = Renderer::on(device, &gaussians, Vec::new())?;
        renderer.antialias = trained_with_antialias(run)?;
        Ok((Self::Splat(Box::new(renderer), gaussians), chosen.sentences().choice))
    }

    /// When a photo was taken, in [0, 1]; 0 where nothing moves.
    pub fn time_of(&self, name: &str) -> f32 {
        match self {
            Self::Splat(..) => 0.0,
            Self::Parts(moving) => moving.time_of(name),
            Self::Field(_, times) => times.of_view(name),
        }
    }

    /// Holds joints, by the number of their part, at angles in degrees.
    pub(crate) fn hold_joints(&mut self, joints: &[(usize, f64)]) -> Result<()> {
        match self {
            Self::Parts(moving) => moving.hold(joints),
            _ if joints.is_empty() => Ok(()),
            _ => bail!(
                "nothing has a joint here; give the folder that sat-recon parts wrote, such as OUT/parts"
            ),
        }
    }

    /// Renders a view as it is at a time.
    pub fn render(
        &mut self,
        camera: &Camera,
        pose: &Pose,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput> {
        let options = RenderOptions { background, ..RenderOptions::default() };
        match self {
            Self::Splat(renderer, _) => Ok(renderer.render(camera, pose, &options)?),
            Self::Parts(moving) => moving.render(camera, pose, time, &options),
            Self::Field(field, _) => Ok(field.render(camera, pose, time, background)?),
        }
    }
}

/// Whether the splat of a run was trained with --antialias.
pub(crate) fn trained_with_antialias(out: &Path) -> Result<bool> {
    let trained = crate::stage::last::<SplatSummary>(out, "train")?;
    Ok(trained.is_some_and(|finished| finished.value.antialias))
}

/// The splat of a run folder; an error that says what to do where there is none.
pub(crate) fn need_splat(run: &Path) -> Result<Gaussians> {
    let splat = run.join("splat.ply");
    if run.join(FIELD).is_file() {
        bail!(
            "{} has a field and no splat; 'render' shows it, all else needs a run with --method 3dgs",
            run.display()
        );
    }
    if !splat.is_file() {
        bail!("{} is missing; give the output folder of a run that trained a splat", splat.display());
    }
    scene::io::read_splat_ply(&splat).with_context(|| format!("cannot read {}", splat.display()))
}
