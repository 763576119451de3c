//! The image formation as a whole: project, sh, sort and rasterise chained, forward and backward.

use super::project::{Geometry, Projected, project, project_backward};
use super::rasterise::{Picture, rasterise, rasterise_backward};
use super::sh::{sh, sh_backward};
use super::sort::sort;
use super::{Options, Parameters, PoseGradient, View};
use glam::{DVec2, DVec3};

/// A picture and what it was made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rendered {
    /// \[N\] on the screen; nothing where culled.
    pub projected: Vec<Option<Projected>>,
    /// \[N\] rgb as seen from the camera (black where culled).
    pub colours: Vec<DVec3>,
    /// Indices of the Gaussians that are seen, nearest first.
    pub order: Vec<usize>,
    /// Colour, alpha and depth.
    pub picture: Picture,
}

/// ∂L/∂[`Picture`], all row-major [H × W].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImageGradient {
    /// With respect to the colour.
    pub rgb: Vec<DVec3>,
    /// With respect to alpha.
    pub alpha: Vec<f64>,
    /// With respect to the expected depth.
    pub depth: Vec<f64>,
}

impl ImageGradient {
    /// A loss that looks at the colour only.
    pub fn of_colour(rgb: Vec<DVec3>) -> Self {
        Self { alpha: vec![0.0; rgb.len()], depth: vec![0.0; rgb.len()], rgb }
    }
}

/// ∂L/∂ everything that can be moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// With respect to the Gaussians.
    pub parameters: Parameters,
    /// With respect to the camera.
    pub pose: PoseGradient,
    /// \[N\] with respect to the centre on the screen, a px: its norm drives densification (Kerbl 2023, section 5.2).
    pub xy: Vec<DVec2>,
    /// \[N\] the same with absolute values summed over pixels (AbsGS).
    pub xy_abs: Vec<DVec2>,
    /// \[N\] in how many pixels the Gaussian is composited.
    pub pixels: Vec<u32>,
}

/// Geometry of Gaussian `i`.
pub fn geometry(p: &Parameters, i: usize) -> Geometry {
    Geometry {
        mean: p.means[i],
        log_scale: p.log_scales[i],
        rotation: p.rotations[i],
        logit: p.opacity_logits[i],
    }
}

/// What the camera sees.
pub fn render(p: &Parameters, view: &View, options: &Options) -> Rendered {
    let projected: Vec<_> = (0..p.len()).map(|i| project(&geometry(p, i), view, options)).collect();
    let position = view.position();
    let colour = |i: usize| match projected[i] {
        Some(_) => sh(p.sh_of(i), options.sh_degree, p.means[i], position),
        None => DVec3::ZERO,
    };
    let colours: Vec<_> = (0..p.len()).map(colour).collect();
    let order = sort(&projected);
    let picture = rasterise(&projected, &colours, &order, view, options.background);
    Rendered { projected, colours, order, picture }
}

/// From ∂L/∂picture to ∂L/∂parameters and ∂L/∂pose.
pub fn backward(
    p: &Parameters,
    view: &View,
    options: &Options,
    r: &Rendered,
    d: &ImageGradient,
) -> Gradients {
    let on_screen = rasterise_backward(&r.projected, &r.colours, &r.order, view, options.background, d);
    let mut parameters = Parameters::zeros_like(p);
    let mut pose = PoseGradient::default();
    let (position, stride) = (view.position(), p.sh_stride());
    for &i in &r.order {
        let (g, pose_i) = project_backward(&geometry(p, i), view, options, &on_screen.projected[i]);
        let d_sh = &mut parameters.sh[i * stride..(i + 1) * stride];
        let through_colour =
            sh_backward(p.sh_of(i), options.sh_degree, p.means[i], position, on_screen.colours[i], d_sh);
        parameters.means[i] = g.mean + through_colour;
        parameters.log_scales[i] = g.log_scale;
        parameters.rotations[i] = g.rotation;
        parameters.opacity_logits[i] = g.logit;
        pose += pose_i;
        // The camera stands at −Rᵀ t; its motion by v in its own frame moves it by −Rᵀ v in the world.
        pose.translation += view.rotation * through_colour;
    }
    let xy = on_screen.projected.iter().map(|g| g.xy).collect();
    Gradients { parameters, pose, xy, xy_abs: on_screen.xy_abs, pixels: on_screen.pixels }
}
