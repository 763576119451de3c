//! Volume rendering along a ray (Max 1995; Mildenhall et al. 2020, equation 3), forward and
//! backward.

/// Transmittance below which a ray ends. Source: Müller et al. 2022, appendix E.
pub(crate) const OPAQUE: f32 = 1e-4;

/// What a ray shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct RayColour {
    /// Colour, over the background.
    pub(crate) rgb: [f32; 3],
    /// What is left of the background.
    pub(crate) transmittance: f32,
    /// Mean distance of what is seen, weighted with how much of it.
    pub(crate) distance: f32,
}

/// Opacity of a stretch.
#[inline(always)]
pub(crate) fn opacity(density: f32, dt: f32) -> f32 {
    1.0 - (-density * dt).exp()
}

/// How many of a ray's samples are seen: up to the one that makes it opaque.
pub(crate) fn seen(densities: impl Iterator<Item = f32>, steps: impl Iterator<Item = f32>) -> usize {
    let (mut transmittance, mut count) = (1.0, 0);
    for (density, dt) in densities.zip(steps) {
        if transmittance < OPAQUE {
            break;
        }
        transmittance *= 1.0 - opacity(density, dt);
        count += 1;
    }
    count
}

/// Colours over a background, weighted with the opacity of what lies before.
pub(crate) fn compose(
    samples: impl Iterator<Item = (f32, f32, f32, [f32; 3])>,
    background: [f32; 3],
) -> RayColour {
    let mut out = RayColour { transmittance: 1.0, ..RayColour::default() };
    for (density, dt, t, rgb) in samples {
        let weight = out.transmittance * opacity(density, dt);
        out.rgb.iter_mut().zip(rgb).for_each(|(sum, v)| *sum += weight * v);
        out.distance += weight * t;
        out.transmittance -= weight;
    }
    out.rgb.iter_mut().zip(background).for_each(|(sum, v)| *sum += out.transmittance * v);
    out
}

/// A sample of the backward pass: density, step and colour in; their gradients out.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Traced {
    pub(crate) density: f32,
    pub(crate) dt: f32,
    pub(crate) rgb: [f32; 3],
    pub(crate) of_density: f32,
    pub(crate) of_rgb: [f32; 3],
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The gradients of densities and colours from that of the ray's colour.
pub(crate) fn compose_backward(samples: &mut [Traced], background: [f32; 3], of_ray: [f32; 3]) {
    let mut transmittance = 1.0;
    for s in samples.iter_mut() {
        let weight = transmittance * opacity(s.density, s.dt);
        s.of_rgb = of_ray.map(|g| g * weight);
        // Kept for the way back: the transmittance behind.
        transmittance -= weight;
        s.of_density = transmittance;
    }
    let mut behind = transmittance * dot(of_ray, background);
    for s in samples.iter_mut().rev() {
        let after = s.of_density;
        s.of_density = s.dt * (after * dot(of_ray, s.rgb) - behind);
        behind += dot(s.of_rgb, s.rgb);
    }
}
