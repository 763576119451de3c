//! The camera as every backend's kernels use it.

use crate::parts::MOST_PARTS;
use crate::reference::constants::{self, JACOBIAN_MARGIN};
use crate::view::{PinholeView, RenderOptions};
use glam::Vec3;

/// Near plane where [`RenderOptions::near`] is open, normalised units. Source: the reference's.
pub(crate) const DEFAULT_NEAR: f32 = constants::DEFAULT_NEAR as f32;

/// The constants of a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraConstants {
    /// Rows of the rotation `cam_from_world`.
    pub(crate) r: [[f32; 3]; 3],
    /// Translation.
    pub(crate) t: [f32; 3],
    /// Focal lengths, pixels.
    pub(crate) focal: [f32; 2],
    /// Principal point, pixels.
    pub(crate) centre: [f32; 2],
    /// Lower limits of x/z and y/z in the Jacobian.
    pub(crate) low: [f32; 2],
    /// Upper limits of x/z and y/z in the Jacobian.
    pub(crate) high: [f32; 2],
    /// Camera centre, world.
    pub(crate) position: Vec3,
    /// Width and height, pixels.
    pub(crate) size: [f32; 2],
    /// Near plane.
    pub(crate) near: f32,
    /// Whether opacity is scaled with the low-pass.
    pub(crate) antialias: bool,
    /// Spherical-harmonic degree in use.
    pub(crate) sh_degree: u32,
}

/// The constants of a view for the body and for each part.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartCameras {
    count: usize,
    all: [CameraConstants; MOST_PARTS + 1],
}

impl PartCameras {
    /// Of a view of Gaussians that have spherical harmonics of degree `sh_degree`.
    pub(crate) fn new(view: &PinholeView, options: &RenderOptions, sh_degree: u32) -> Self {
        let mut all = [CameraConstants::new(view, options, sh_degree); MOST_PARTS + 1];
        for (part, camera) in (1..).zip(&mut all[1..=view.parts.len()]) {
            *camera = CameraConstants::new(&view.of_part(part), options, sh_degree);
        }
        Self { count: view.parts.len() + 1, all }
    }

    /// How many parts move.
    pub(crate) fn moving(&self) -> usize {
        self.count - 1
    }

    /// That of the body.
    pub(crate) fn body(&self) -> &CameraConstants {
        &self.all[0]
    }

    /// That of a part; the body's where nothing is told of it.
    #[inline(always)]
    pub(crate) fn of(&self, part: u8) -> &CameraConstants {
        let part = usize::from(part);
        &self.all[if part < self.count { part } else { 0 }]
    }
}

impl CameraConstants {
    /// Of a view of Gaussians that have spherical harmonics of degree `sh_degree`.
    pub(crate) fn new(view: &PinholeView, options: &RenderOptions, sh_degree: u32) -> Self {
        let m = view.rotation;
        let size = [view.width as f32, view.height as f32];
        let margin = [0, 1].map(|a| JACOBIAN_MARGIN as f32 * size[a] / view.focal[a]);
        let low = [0, 1].map(|a| (0.0 - view.centre[a]) / view.focal[a]);
        let high = [0, 1].map(|a| (size[a] - view.centre[a]) / view.focal[a]);
        Self {
            r: [m.row(0).to_array(), m.row(1).to_array(), m.row(2).to_array()],
            t: view.translation.to_array(),
            focal: view.focal,
            centre: view.centre,
            low: [low[0] - margin[0], low[1] - margin[1]],
            high: [high[0] + margin[0], high[1] + margin[1]],
            position: view.position(),
            size,
            near: options.near.unwrap_or(DEFAULT_NEAR),
            antialias: options.antialias,
            sh_degree: options.sh_degree.map_or(sh_degree, |most| most.min(sh_degree)),
        }
    }
}
