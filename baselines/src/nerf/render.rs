//! Pictures: coarse samples, then fine ones.

use super::Nerf;
use super::depths::{Reach, refine, weights};
use super::gradient::GROUP;
use super::network::{NerfLayers, NerfRay};
use crate::composite::{RayColour, compose};
use crate::rays::Ray;

impl Nerf {
    /// Colours, transmittances and distances of rays.
    pub(super) fn trace(&self, rays: &[Ray], background: [f32; 3], out: &mut [RayColour]) {
        let inside: Vec<(usize, NerfRay, Reach)> = rays
            .iter()
            .enumerate()
            .filter_map(|(i, ray)| self.local(ray).map(|(ray, reach)| (i, ray, reach)))
            .collect();
        for o in out.iter_mut() {
            *o = RayColour { rgb: background, transmittance: 1.0, distance: 0.0 };
        }
        let (mut layers, mut shares) = (NerfLayers::default(), Vec::new());
        let ([coarse, fine], unit) = (self.shape.samples, self.unit());
        for group in inside.chunks((GROUP / (coarse + fine)).max(1)) {
            let plain: Vec<NerfRay> = group.iter().map(|(_, ray, _)| ray.clone()).collect();
            let (mut first, mut second) = (Vec::new(), Vec::new());
            group.iter().for_each(|(.., reach)| reach.stratified(coarse, None, &mut first));
            self.networks.evaluate(self.parts(&self.weights, 0), &plain, &first, &mut layers);
            for (r, ((.., reach), depths)) in group.iter().zip(first.chunks_exact(coarse)).enumerate() {
                let densities = (0..coarse).map(|i| self.networks.density(&layers, r * coarse + i));
                weights(densities, reach.steps(depths).map(|dt| dt * unit), &mut shares);
                refine(depths, &shares, fine, None, &mut second);
            }
            self.networks.evaluate(self.parts(&self.weights, 1), &plain, &second, &mut layers);
            let each = coarse + fine;
            for (r, ((pixel, _, reach), depths)) in group.iter().zip(second.chunks_exact(each)).enumerate() {
                let samples = reach.steps(depths).zip(depths).enumerate().map(|(i, (dt, &t))| {
                    let sample = r * each + i;
                    let density = self.networks.density(&layers, sample);
                    (density, dt * unit, t, self.networks.colour(&layers, sample))
                });
                out[*pixel] = compose(samples, background);
            }
        }
    }
}
