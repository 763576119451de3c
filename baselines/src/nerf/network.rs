//! The networks of a field, evaluated for samples of rays, and back.

use super::encoding::{encode, encode_backward, encoded};
use crate::mlp::logistic;
use crate::stack::{Entering, LayerPlan, Stack, StackLayers};

/// Octaves of a position. Source: Mildenhall et al. 2020, section 5.1.
pub(super) const POSITION_OCTAVES: usize = 10;
/// Octaves of a direction. Source: Mildenhall et al. 2020, section 5.1.
pub(super) const DIRECTION_OCTAVES: usize = 4;
/// Octaves of a time. Source: D-NeRF's published program.
pub(super) const TIME_OCTAVES: usize = 10;
/// Layers before the density. Source: Mildenhall et al. 2020, appendix A; Pumarola et al. 2021,
/// section 4.
pub(super) const TRUNK: usize = 8;
/// Layer that reads the position again. Source: Mildenhall et al. 2020, appendix A.
pub(super) const SKIP: usize = 5;
/// Values of an encoded direction.
pub(super) const ENCODED_DIRECTION: usize = 3 * encoded(DIRECTION_OCTAVES);

/// The networks' shapes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NerfNetworks {
    /// Density and colour.
    pub(super) radiance: Stack,
    /// From a time back to time 0 (D-NeRF).
    pub(super) deformation: Option<Stack>,
    /// Column of the density among the outputs of layer [`TRUNK`].
    pub(super) density: usize,
}

/// Parameters of both, or their transposes.
#[derive(Clone, Copy, Debug)]
pub(super) struct NerfWeights<'a> {
    pub(super) radiance: &'a [f32],
    /// Empty where nothing is deformed.
    pub(super) deformation: &'a [f32],
}

/// A ray in the frame of the field's cube, which is [−1, 1]³.
#[derive(Clone, Debug)]
pub(super) struct NerfRay {
    pub(super) origin: [f32; 3],
    /// As long as a unit of the normalised frame is there.
    pub(super) direction: [f32; 3],
    pub(super) encoded: [f32; ENCODED_DIRECTION],
    pub(super) time: f32,
}

/// Activations of both networks for a block of samples.
#[derive(Clone, Debug, Default)]
pub(super) struct NerfLayers {
    pub(super) radiance: StackLayers,
    deformation: StackLayers,
    of_deformation: Vec<f32>,
}

impl NerfNetworks {
    /// Of so many units a layer.
    pub(super) fn new(width: usize, deformed: bool) -> Self {
        let trunk: Vec<LayerPlan> = (0..TRUNK)
            .map(|layer| LayerPlan {
                taken: if layer == 0 { 0 } else { width },
                input: (layer == 0 || layer == SKIP).then_some(0),
                outputs: width,
                relu: true,
            })
            .collect();
        let position = 3 * encoded(POSITION_OCTAVES);
        let head = [
            LayerPlan::after(width, width + 1, false),
            LayerPlan { input: Some(1), ..LayerPlan::after(width, width / 2, true) },
            LayerPlan::after(width / 2, 3, false),
        ];
        let radiance = Stack::new(&[position, ENCODED_DIRECTION], &[&trunk[..], &head].concat());
        let moved = [&trunk[..], &[LayerPlan::after(width, 3, false)]].concat();
        let deformation = deformed.then(|| Stack::new(&[position + encoded(TIME_OCTAVES)], &moved));
        Self { radiance, deformation, density: width }
    }

    /// Products of weights and sums for one sample, forward.
    pub(super) fn operations(&self) -> usize {
        self.radiance.operations() + self.deformation.as_ref().map_or(0, Stack::operations)
    }

    /// Density and colour of each sample; the samples of `rays` lie at `depths`, as many a ray.
    pub(super) fn evaluate(
        &self,
        weights: NerfWeights,
        rays: &[NerfRay],
        depths: &[f32],
        layers: &mut NerfLayers,
    ) {
        let each = depths.len() / rays.len();
        self.radiance.reserve(depths.len(), &mut layers.radiance);
        self.deform(weights.deformation, rays, depths, layers);
        let moves = layers.deformation.outputs.last();
        let width = self.deformation.as_ref().map_or(1, |d| d.width(TRUNK));
        let [positions, directions] = &mut layers.radiance.inputs[..] else { return };
        let rows = positions.chunks_exact_mut(self.radiance.input_width(0));
        for (i, (row, &t)) in rows.zip(depths).enumerate() {
            let ray = &rays[i / each];
            let mut p = ray.at(t);
            if let Some(moves) = moves.filter(|_| ray.time != 0.0) {
                p.iter_mut().zip(&moves[i * width..]).for_each(|(p, m)| *p += m);
            }
            encode(&p, POSITION_OCTAVES, row);
        }
        let rows = directions.chunks_exact_mut(self.radiance.input_width(1));
        for (i, row) in rows.take(depths.len()).enumerate() {
            row[..ENCODED_DIRECTION].copy_from_slice(&rays[i / each].encoded);
        }
        self.radiance.forward(weights.radiance, &mut layers.radiance);
    }

    /// How far each sample is moved: the outputs of the deformation network.
    fn deform(&self, weights: &[f32], rays: &[NerfRay], depths: &[f32], layers: &mut NerfLayers) {
        let Some(network) = &self.deformation else { return };
        let each = depths.len() / rays.len();
        network.reserve(depths.len(), &mut layers.deformation);
        let rows = layers.deformation.inputs[0].chunks_exact_mut(network.input_width(0));
        for (i, (row, &t)) in rows.zip(depths).enumerate() {
            let ray = &rays[i / each];
            encode(&ray.at(t), POSITION_OCTAVES, row);
            encode(&[ray.time], TIME_OCTAVES, &mut row[3 * encoded(POSITION_OCTAVES)..]);
        }
        network.forward(weights, &mut layers.deformation);
    }

    /// Density of a sample that was evaluated.
    pub(super) fn density(&self, layers: &NerfLayers, sample: usize) -> f32 {
        let width = self.radiance.width(TRUNK);
        layers.radiance.outputs[TRUNK][sample * width + self.density].max(0.0)
    }

    /// Colour of a sample that was evaluated.
    pub(super) fn colour(&self, layers: &NerfLayers, sample: usize) -> [f32; 3] {
        let width = self.radiance.width(TRUNK + 2);
        let row = &layers.radiance.outputs[TRUNK + 2][sample * width..];
        [0, 1, 2].map(|c| logistic(row[c]))
    }

    /// Outputs of the last layer as stored.
    pub(super) fn colour_width(&self) -> usize {
        self.radiance.width(TRUNK + 2)
    }

    /// From the gradients of the last layer's outputs and of the densities (before the rectifier)
    /// to those of the parameters, which are added.
    pub(super) fn backward(
        &self,
        transposed: NerfWeights,
        rays: &[NerfRay],
        layers: &mut NerfLayers,
        (of_colours, of_densities): (&[f32], &[f32]),
        (of_radiance, of_deformation): (&mut [f32], &mut [f32]),
    ) {
        let entering = [Entering { layer: TRUNK, column: self.density, values: of_densities }];
        let given = (of_colours, &entering[..]);
        let wanted = self.deformation.is_some();
        self.radiance.backward(transposed.radiance, &mut layers.radiance, given, of_radiance, wanted);
        let Some(network) = &self.deformation else { return };
        let (samples, width) = (of_densities.len(), network.width(TRUNK));
        let sums = &mut layers.of_deformation;
        sums.clear();
        sums.resize(layers.deformation.outputs[TRUNK].len(), 0.0);
        let encoded_width = self.radiance.input_width(0);
        let rows = layers.radiance.inputs[0].chunks_exact(encoded_width);
        let rows = rows.zip(layers.radiance.of_inputs[0].chunks_exact(encoded_width));
        for (i, (sum, (row, of_row))) in sums.chunks_exact_mut(width).zip(rows).take(samples).enumerate() {
            if rays[i * rays.len() / samples].time != 0.0 {
                sum[..3].copy_from_slice(&encode_backward::<3>(row, of_row, POSITION_OCTAVES));
            }
        }
        let given = (&sums[..], &[][..]);
        network.backward(transposed.deformation, &mut layers.deformation, given, of_deformation, false);
    }
}

impl NerfRay {
    /// The place at a distance.
    pub(super) fn at(&self, t: f32) -> [f32; 3] {
        [0, 1, 2].map(|a| self.origin[a] + t * self.direction[a])
    }
}
