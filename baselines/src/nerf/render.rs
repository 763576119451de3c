//! Pictures: coarse samples, then fine ones.

use super::Nerf;
use super::depths::{Reach, refine, weights};
use super::network::{NerfLayers, NerfRay};
use crate::FieldError;
use crate::composite::{RayColour, compose};
use crate::rays::Ray;

/// What gives colour and density of each sample of rays, in a pass (0: coarse, 1: fine).
pub(super) type NerfShader<'a> =
    dyn FnMut(usize, &[NerfRay], &[f32]) -> Result<Vec<[f32; 4]>, FieldError> + 'a;

impl Nerf {
    /// Colours, transmittances and distances of rays, about `group` samples at a time.
    pub(super) fn trace(
        &self,
        (rays, group): (&[Ray], usize),
        background: [f32; 3],
        out: &mut [RayColour],
        shade: &mut NerfShader,
    ) -> Result<(), FieldError> {
        let inside: Vec<(usize, NerfRay, Reach)> = rays
            .iter()
            .enumerate()
            .filter_map(|(i, ray)| self.local(ray).map(|(ray, reach)| (i, ray, reach)))
            .collect();
        for o in out.iter_mut() {
            *o = RayColour { rgb: background, transmittance: 1.0, distance: 0.0 };
        }
        let (mut shares, [coarse, fine], unit) = (Vec::new(), self.shape.samples, self.unit());
        for group in inside.chunks((group / (coarse + fine)).max(1)) {
            let plain: Vec<NerfRay> = group.iter().map(|(_, ray, _)| ray.clone()).collect();
            let (mut first, mut second) = (Vec::new(), Vec::new());
            group.iter().for_each(|(.., reach)| reach.stratified(coarse, &mut || 0.5, &mut first));
            let shaded = shade(0, &plain, &first)?;
            let each = first.chunks_exact(coarse).zip(shaded.chunks_exact(coarse));
            for ((.., reach), (depths, shaded)) in group.iter().zip(each) {
                let steps = reach.steps(depths).map(|dt| dt * unit);
                weights(shaded.iter().map(|s| s[3]), steps, &mut shares);
                refine(depths, &shares, fine, &mut || 0.5, &mut second);
            }
            let shaded = shade(1, &plain, &second)?;
            let each = second.chunks_exact(coarse + fine).zip(shaded.chunks_exact(coarse + fine));
            for ((pixel, _, reach), (depths, shaded)) in group.iter().zip(each) {
                let samples = reach.steps(depths).zip(depths).zip(shaded);
                let samples =
                    samples.map(|((dt, &t), &[r, g, b, density])| (density, dt * unit, t, [r, g, b]));
                out[*pixel] = compose(samples, background);
            }
        }
        Ok(())
    }

    /// Colours and densities by this processor.
    pub(super) fn shade(
        &self,
        pass: usize,
        rays: &[NerfRay],
        depths: &[f32],
        layers: &mut NerfLayers,
    ) -> Vec<[f32; 4]> {
        self.networks.evaluate(self.parts(&self.weights, pass), rays, depths, layers);
        let shaded = (0..depths.len()).map(|i| {
            let [r, g, b] = self.networks.colour(layers, i);
            [r, g, b, self.networks.density(layers, i)]
        });
        shaded.collect()
    }
}
