//! The same fields written from the papers' equations in f64, one sample at a time: what the
//! production code is tested against.

use super::Nerf;
use super::gradient::SightedRay;
use super::network::{DIRECTION_OCTAVES, POSITION_OCTAVES, SKIP, TIME_OCTAVES, TRUNK};
use crate::stack::Stack;

/// A layer: weights [output][input], and biases.
#[derive(Clone, Debug)]
pub(super) struct Affine {
    pub(super) weights: Vec<Vec<f64>>,
    pub(super) bias: Vec<f64>,
}

/// Parameters in f64: the layers of the trunk and what follows.
#[derive(Clone, Debug)]
pub(super) struct ReferenceNerf {
    pub(super) radiance: Vec<Affine>,
    pub(super) deformation: Option<Vec<Affine>>,
    /// Units of a layer.
    width: usize,
}

/// Inputs and outputs of the layers of the networks, padding left out; `place` is where an input of
/// the reference lies among those of the stored layer.
pub(super) fn sizes(width: usize, position: usize, deformation: bool) -> Vec<(usize, usize)> {
    let mut all = vec![(position, width)];
    all.extend((1..TRUNK).map(|l| (if l == SKIP { width + position } else { width }, width)));
    if deformation {
        all.push((width, 3));
    } else {
        all.extend([(width, width + 1), (width + 27, width / 2), (width / 2, 3)]);
    }
    all
}

fn affine(stack: &Stack, parameters: &[f32], sizes: &[(usize, usize)]) -> Vec<Affine> {
    let mut layers = Vec::new();
    for (l, &(inputs, outputs)) in sizes.iter().enumerate() {
        let (place, bias) = stack.places(l);
        let row = |o| (0..inputs).map(|i| f64::from(parameters[place(i, o)])).collect();
        layers.push(Affine {
            weights: (0..outputs).map(row).collect(),
            bias: bias.take(outputs).map(|b| f64::from(parameters[b])).collect(),
        });
    }
    layers
}

/// The encoding of numbers, in the order of the production code.
fn waves(x: &[f64], octaves: usize) -> Vec<f64> {
    let mut all = x.to_vec();
    for k in 0..octaves {
        for x in x {
            let angle = 2f64.powi(k as i32) * std::f64::consts::PI * x;
            all.extend([angle.sin(), angle.cos()]);
        }
    }
    all
}

impl Affine {
    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let rows = self.weights.iter().zip(&self.bias);
        rows.map(|(w, b)| w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b).collect()
    }
}

fn trunk(layers: &[Affine], input: &[f64]) -> Vec<f64> {
    let mut x = input.to_vec();
    for (l, layer) in layers[..TRUNK].iter().enumerate() {
        if l == SKIP {
            x.extend_from_slice(input);
        }
        x = layer.apply(&x).into_iter().map(|v| v.max(0.0)).collect();
    }
    x
}

impl ReferenceNerf {
    /// Of what a pass of a field reads.
    pub(super) fn new(field: &Nerf, pass: usize) -> Self {
        let parts = field.parts(&field.weights, pass);
        let (width, networks) = (field.shape.width, &field.networks);
        Self {
            radiance: affine(&networks.radiance, parts.radiance, &sizes(width, 63, false)),
            deformation: networks
                .deformation
                .as_ref()
                .map(|stack| affine(stack, parts.deformation, &sizes(width, 84, true))),
            width,
        }
    }

    /// Density and colour.
    fn at(&self, p: [f64; 3], direction: [f64; 3], time: f64) -> (f64, [f64; 3]) {
        let mut p = p;
        if let Some(layers) = self.deformation.as_ref().filter(|_| time != 0.0) {
            let input = [waves(&p, POSITION_OCTAVES), waves(&[time], TIME_OCTAVES)].concat();
            let moved = layers[TRUNK].apply(&trunk(layers, &input));
            (0..3).for_each(|a| p[a] += moved[a]);
        }
        let layers = &self.radiance;
        let latent = layers[TRUNK].apply(&trunk(layers, &waves(&p, POSITION_OCTAVES)));
        let input = [&latent[..self.width], &waves(&direction, DIRECTION_OCTAVES)].concat();
        let hidden: Vec<f64> = layers[TRUNK + 1].apply(&input).into_iter().map(|v| v.max(0.0)).collect();
        let rgb = layers[TRUNK + 2].apply(&hidden);
        (latent[self.width].max(0.0), [0, 1, 2].map(|c| 1.0 / (1.0 + (-rgb[c]).exp())))
    }

    /// Colours of rays sampled at `depths`, as many a ray, and the mean squared error.
    pub(super) fn loss(&self, rays: &[SightedRay], depths: &[f32], unit: f64) -> (Vec<[f64; 3]>, f64) {
        let (mut colours, mut loss) = (Vec::new(), 0.0);
        let each = depths.len() / rays.len();
        for (r, depths) in rays.iter().zip(depths.chunks_exact(each)) {
            let (mut through, mut rgb) = (1.0f64, [0.0; 3]);
            let direction = r.sighting.ray.direction.to_array().map(f64::from);
            for (i, &t) in depths.iter().enumerate() {
                let next = depths.get(i + 1).copied().unwrap_or(r.reach.far);
                let p = [0, 1, 2]
                    .map(|a| f64::from(r.ray.origin[a]) + f64::from(t) * f64::from(r.ray.direction[a]));
                let (density, colour) = self.at(p, direction, f64::from(r.ray.time));
                let alpha = 1.0 - (-density * f64::from(next - t) * unit).exp();
                (0..3).for_each(|c| rgb[c] += through * alpha * colour[c]);
                through *= 1.0 - alpha;
            }
            for (c, rgb) in rgb.iter_mut().enumerate() {
                *rgb += through * f64::from(r.sighting.background[c]);
                loss += (*rgb - f64::from(r.sighting.colour[c])).powi(2) / 3.0;
            }
            colours.push(rgb);
        }
        (colours, loss / rays.len() as f64)
    }
}
