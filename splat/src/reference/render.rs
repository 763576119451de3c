//! The image formation as a whole: project, sh, sort and rasterise chained, forward and backward.

use super::derivatives::PoseGradient;
use super::parameters::{Options, Parameters, ReferenceView};
use super::project::{Projected, project};
use super::project_backward::project_backward;
use super::rasterise::{ImageGradient, ReferencePicture, rasterise, rasterise_backward};
use super::sh::{sh, sh_backward};
use super::sort::sort;
use glam::{DVec2, DVec3};

/// A picture and what it was made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Rendered {
    /// \[N\] on the screen; nothing where culled.
    pub(crate) projected: Vec<Option<Projected>>,
    /// \[N\] rgb as seen from the camera (black where culled).
    pub(crate) colours: Vec<DVec3>,
    /// Indices of the Gaussians that are seen, nearest first.
    pub(crate) order: Vec<usize>,
    /// Colour, alpha and depth.
    pub(crate) picture: ReferencePicture,
}

/// ∂L/∂ everything that can be moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ReferenceGradient {
    /// With respect to the Gaussians.
    pub(crate) parameters: Parameters,
    /// With respect to the camera.
    pub(crate) pose: PoseGradient,
    /// \[N\] with respect to the centre on the screen, a px: its norm drives densification (Kerbl
    /// 2023, section 5.2).
    pub(crate) xy: Vec<DVec2>,
    /// \[N\] in how many pixels the Gaussian is composited.
    pub(crate) pixels: Vec<u32>,
}

/// What the camera sees.
pub(crate) fn render(p: &Parameters, view: &ReferenceView, options: &Options) -> Rendered {
    let projected: Vec<_> = (0..p.len()).map(|i| project(&p.geometry(i), view, options)).collect();
    let position = view.position();
    let mut colours = vec![DVec3::ZERO; p.len()];
    for i in (0..p.len()).filter(|&i| projected[i].is_some()) {
        colours[i] = sh(p.sh_of(i), options.sh_degree, p.means[i], position);
    }
    let order = sort(&projected);
    let picture = rasterise(&projected, &colours, &order, view, options.background);
    Rendered { projected, colours, order, picture }
}

/// From ∂L/∂picture to ∂L/∂parameters and ∂L/∂pose.
pub(crate) fn backward(
    p: &Parameters,
    view: &ReferenceView,
    options: &Options,
    r: &Rendered,
    d: &ImageGradient,
) -> ReferenceGradient {
    let on_screen = rasterise_backward(&r.projected, &r.colours, &r.order, view, options.background, d);
    let mut parameters = Parameters::zeros_like(p);
    let mut pose = PoseGradient::default();
    let (position, stride) = (view.position(), p.sh_stride());
    for &i in &r.order {
        let (g, pose_i) = project_backward(&p.geometry(i), view, options, &on_screen.projected[i]);
        let d_sh = &mut parameters.sh[i * stride..(i + 1) * stride];
        let through_colour =
            sh_backward(p.sh_of(i), options.sh_degree, p.means[i], position, on_screen.colours[i], d_sh);
        parameters.means[i] = g.mean + through_colour;
        parameters.log_scales[i] = g.log_scale;
        parameters.rotations[i] = g.rotation;
        parameters.opacity_logits[i] = g.logit;
        pose += pose_i;
        // The camera stands at −Rᵀ t; its motion by v in its own frame moves it by −Rᵀ v in the
        // world.
        pose.translation += view.rotation * through_colour;
    }
    let xy = on_screen.projected.iter().map(|g| g.xy).collect();
    ReferenceGradient { parameters, pose, xy, pixels: on_screen.pixels }
}
