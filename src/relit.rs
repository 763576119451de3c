//! Pictures of a splat in another light: `render --light`.

use crate::args::RenderArgs;
use crate::outcome::Outcome;
use crate::pictures::Pictures;
use anyhow::{Context, Result, bail};
use glam::DVec3;
use lighting::{Lighting, SolidSplat, direction};
use scene::{Camera, Gaussians, Pose, PosedPhoto, Progress};
use splat::{DeviceConfig, Pixels, RenderOptions, RenderOutput, Renderer};

/// A lamp that is less sure is doubtful, degrees. Source: chosen by hand, never measured.
const MOST_DEVIATION_DEG: f64 = 20.0;

/// A splat and the light that it stands in.
pub(crate) struct Relit<'a> {
    gaussians: Gaussians,
    antialias: bool,
    lighting: Lighting,
    /// The new lamp, camera frame.
    towards: DVec3,
    device: &'a DeviceConfig,
}

impl<'a> Relit<'a> {
    /// The light of a run, from the photos that its splat was trained on.
    pub(crate) fn of(
        args: &'a RenderArgs,
        (pictures, config): (&Pictures, &splat::DatasetConfig),
        [azimuth, elevation]: [f64; 2],
        progress: &Progress,
    ) -> Result<Self> {
        let Pictures::Splat(_, gaussians) = pictures else {
            bail!("--light needs a splat without moving parts, such as a run with --method 3dgs trains");
        };
        let dataset = crate::evaluate::load_dataset(&args.run.join("undistorted"), config, progress)?;
        let antialias = crate::pictures::trained_with_antialias(&args.run)?;
        // Half the size is enough: light changes slowly along a surface.
        let views = dataset.training_views().into_iter().filter_map(|v| {
            let view = &dataset.views[v];
            let pixels = view.levels.get(1).or(view.levels.first())?;
            let camera = view.camera.scaled(pixels.width as u32, pixels.height as u32);
            Some(LitView { camera, pose: view.pose, pixels })
        });
        let views: Vec<LitView> = views.collect();
        let photos: Vec<PosedPhoto> = views.iter().map(LitView::photo).collect();
        let solid = SolidSplat { gaussians, antialias };
        let lighting = Lighting::solve(&solid, &photos, progress)
            .with_context(|| format!("{} cannot be shown in another light", args.run.display()))?;
        let towards = direction(azimuth, elevation);
        Ok(Self { gaussians: gaussians.clone(), antialias, lighting, towards, device: &args.device })
    }

    /// A view in the new light.
    pub(crate) fn render(&self, camera: &Camera, pose: &Pose, background: [f32; 3]) -> Result<RenderOutput> {
        let solid = SolidSplat { gaussians: &self.gaussians, antialias: self.antialias };
        let relit = self.lighting.relit(&solid, pose, self.towards);
        let (mut renderer, _) = Renderer::on(self.device, &relit, Vec::new())?;
        renderer.antialias = self.antialias;
        Ok(renderer.render(camera, pose, &RenderOptions { background, ..RenderOptions::default() })?)
    }

    /// Doubtful where the lamp's direction is hardly told.
    pub(crate) fn outcome(&self) -> Outcome {
        let sure = self.lighting.lamp.deviation_deg < MOST_DEVIATION_DEG;
        if sure { Outcome::Done } else { Outcome::Doubtful }
    }

    /// Where the lamp was.
    pub(crate) fn sentence(&self) -> String {
        let lamp = &self.lighting.lamp;
        let [azimuth, elevation] = lamp.angles_deg();
        let doubt = match self.outcome() {
            Outcome::Done => "",
            _ => "; doubtful: too little of the object tells the lamp's direction",
        };
        format!(
            "filmed with a lamp {azimuth:.0}° to the camera's right and {elevation:.0}° above it (± \
             {:.0}°), and {:.0} % of its light from all around{doubt}",
            lamp.deviation_deg,
            100.0 * lamp.ambient
        )
    }
}

/// A photo at the size at which it is compared.
struct LitView<'a> {
    camera: Camera,
    pose: Pose,
    pixels: &'a Pixels,
}

impl LitView<'_> {
    fn photo(&self) -> PosedPhoto<'_> {
        let mask = self.pixels.mask.as_deref();
        PosedPhoto { camera: &self.camera, pose: self.pose, rgb: &self.pixels.rgb, mask }
    }
}
