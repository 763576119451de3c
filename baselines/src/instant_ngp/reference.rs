//! The same field written from the equations in f64, one sample at a time: what the production
//! code is tested against.

use super::gradient::RayBatch;
use super::hash_grid::FEATURES;
use crate::dense::place;

/// Parameters in f64.
#[derive(Clone, Debug)]
pub(super) struct ReferenceField {
    /// Weights [input][output] of the layers of both networks.
    pub(super) density: Vec<Vec<Vec<f64>>>,
    pub(super) colour: Vec<Vec<Vec<f64>>>,
    /// [levels][entries][FEATURES]
    pub(super) tables: Vec<Vec<[f64; FEATURES]>>,
    pub(super) most_entries: usize,
}

/// Layers of packed panels as matrices.
pub(super) fn matrices(widths: &[usize], packed: &[f32]) -> Vec<Vec<Vec<f64>>> {
    let mut begin = 0;
    let mut layers = Vec::new();
    for w in widths.windows(2) {
        let (inputs, outputs) = (w[0], w[1]);
        let row = |i| (0..outputs).map(|o| f64::from(packed[begin + place(i, o, inputs)])).collect();
        layers.push((0..inputs).map(row).collect());
        begin += inputs * outputs;
    }
    layers
}

fn perceptron(layers: &[Vec<Vec<f64>>], input: &[f64]) -> Vec<f64> {
    let mut x = input.to_vec();
    for (index, layer) in layers.iter().enumerate() {
        let outputs = layer[0].len();
        x = (0..outputs)
            .map(|o| {
                let sum: f64 = x.iter().zip(layer).map(|(x, row)| x * row[o]).sum();
                if index + 1 < layers.len() { sum.max(0.0) } else { sum }
            })
            .collect();
    }
    x
}

impl ReferenceField {
    /// Trilinear interpolation between the corners of each level's cell.
    pub(super) fn encode(&self, p: [f64; 3]) -> Vec<f64> {
        let count = self.tables.len();
        let mut out = Vec::new();
        for (level, table) in self.tables.iter().enumerate() {
            let cells = 16.0 * 128f64.powf(level as f64 / (count - 1) as f64);
            let scale = cells - 1.0;
            let side = scale.ceil() as u64 + 2;
            let x = p.map(|v| v * scale + 0.5);
            let mut sum = [0.0; FEATURES];
            for corner in 0..8u64 {
                let (mut share, mut at) = (1.0, [0u64; 3]);
                for a in 0..3 {
                    let bit = corner >> a & 1;
                    let f = x[a] - x[a].floor();
                    share *= if bit == 1 { f } else { 1.0 - f };
                    at[a] = x[a].floor() as u64 + bit;
                }
                let index = if side.pow(3) as usize <= self.most_entries {
                    at[0] + side * (at[1] + side * at[2])
                } else {
                    let hash = at[0] ^ (at[1] * 2_654_435_761) ^ (at[2] * 805_459_861);
                    hash % self.most_entries as u64
                };
                for k in 0..FEATURES {
                    sum[k] += share * table[index as usize][k];
                }
            }
            out.extend(sum);
        }
        out
    }

    /// Density and colour.
    pub(super) fn at(&self, p: [f64; 3], direction: glam::DVec3) -> (f64, [f64; 3]) {
        let latent = perceptron(&self.density, &self.encode(p));
        let input: Vec<f64> = latent.iter().copied().chain(scene::sh::sh_basis(direction)).collect();
        let rgb = perceptron(&self.colour, &input);
        (latent[0].exp(), [0, 1, 2].map(|c| 1.0 / (1.0 + (-rgb[c]).exp())))
    }

    /// Colours of a batch's rays, and the mean of Huber's loss.
    pub(super) fn loss(&self, batch: &RayBatch) -> (Vec<[f64; 3]>, f64) {
        let (mut colours, mut loss) = (Vec::new(), 0.0);
        for ray in &batch.rays {
            let direction = ray.sighting.ray.direction.as_dvec3();
            let (mut through, mut rgb) = (1.0f64, [0.0; 3]);
            for i in ray.begin..ray.begin + ray.count {
                if through < 1e-4 {
                    break;
                }
                let (density, colour) = self.at(batch.points[i].map(f64::from), direction);
                let alpha = 1.0 - (-density * f64::from(batch.samples[i].dt)).exp();
                (0..3).for_each(|c| rgb[c] += through * alpha * colour[c]);
                through *= 1.0 - alpha;
            }
            for (c, rgb) in rgb.iter_mut().enumerate() {
                *rgb += through * f64::from(ray.sighting.background[c]);
                let e = (*rgb - f64::from(ray.sighting.colour[c])).abs();
                loss += if e < 0.1 { 0.5 * e * e } else { 0.1 * (e - 0.05) } / 3.0;
            }
            colours.push(rgb);
        }
        (colours, loss / batch.rays.len() as f64)
    }
}
