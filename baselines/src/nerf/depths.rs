//! Where rays are sampled: stratified, then by what the coarse pass saw.

use crate::composite::opacity;

/// Weight of a stretch that holds nothing, so that each can be drawn.
/// Source: D-NeRF's program, as NeRF's.
const LEAST: f32 = 1e-5;

/// A stretch of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach {
    pub(super) near: f32,
    pub(super) far: f32,
    /// Whether samples lie evenly in the inverse of the distance.
    pub(super) inverse: bool,
}

impl Reach {
    /// The distance at a share of the way.
    fn at(&self, share: f32) -> f32 {
        if self.inverse {
            1.0 / ((1.0 - share) / self.near + share / self.far)
        } else {
            self.near + (self.far - self.near) * share
        }
    }

    /// One distance in each of `count` equal parts, at an `offset` ∈ [0, 1) in it.
    pub(super) fn stratified(&self, count: usize, offset: &mut dyn FnMut() -> f32, out: &mut Vec<f32>) {
        for i in 0..count {
            let offset = offset();
            out.push(self.at((i as f32 + offset) / count as f32));
        }
    }

    /// Length of the stretch that each sample stands for: to the next one.
    pub(super) fn steps<'a>(&'a self, depths: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        let next = depths[1..].iter().copied().chain([self.far.max(depths[depths.len() - 1])]);
        next.zip(depths).map(|(next, t)| next - t)
    }
}

/// Draws `count` distances by the weights that the samples at `depths` have, each between the
/// middles to its neighbours and at an `offset` ∈ [0, 1) in its share, and adds all of them,
/// sorted, to `out`.
pub(super) fn refine(
    depths: &[f32],
    weights: &[f32],
    count: usize,
    offset: &mut dyn FnMut() -> f32,
    out: &mut Vec<f32>,
) {
    let begin = out.len();
    out.extend_from_slice(depths);
    let middles: Vec<f32> = depths.windows(2).map(|d| 0.5 * (d[0] + d[1])).collect();
    let inner = &weights[1..weights.len() - 1];
    let total: f32 = inner.iter().map(|w| w + LEAST).sum();
    let (mut bin, mut below) = (0, 0.0);
    for i in 0..count {
        let offset = offset();
        let wanted = (i as f32 + offset) / count as f32 * total;
        while bin + 1 < inner.len() && below + inner[bin] + LEAST < wanted {
            below += inner[bin] + LEAST;
            bin += 1;
        }
        let share = ((wanted - below) / (inner[bin] + LEAST)).clamp(0.0, 1.0);
        out.push(middles[bin] + (middles[bin + 1] - middles[bin]) * share);
    }
    out[begin..].sort_by(f32::total_cmp);
}

/// Weights of a ray's samples in its colour.
pub(super) fn weights(
    densities: impl Iterator<Item = f32>,
    steps: impl Iterator<Item = f32>,
    out: &mut Vec<f32>,
) {
    let mut transmittance = 1.0;
    out.clear();
    out.extend(densities.zip(steps).map(|(density, dt)| {
        let weight = transmittance * opacity(density, dt);
        transmittance -= weight;
        weight
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn samples_are_one_a_part_and_go_where_the_weight_is() {
        let mut rng = scene::rng::rng(1, "depths", 0);
        for inverse in [false, true] {
            let reach = Reach { near: 2.0, far: 6.0, inverse };
            let mut depths = Vec::new();
            reach.stratified(16, &mut || rng.random(), &mut depths);
            for (i, &t) in depths.iter().enumerate() {
                let (low, high) = (reach.at(i as f32 / 16.0), reach.at((i + 1) as f32 / 16.0));
                assert!((low..=high).contains(&t), "{low} {t} {high}");
            }
            let steps: Vec<f32> = reach.steps(&depths).collect();
            assert!((steps.iter().sum::<f32>() + depths[0] - 6.0).abs() < 1e-5);
            let mut weights = [0.0; 16];
            weights[9] = 0.7;
            let mut all = Vec::new();
            refine(&depths, &weights, 100, &mut || rng.random(), &mut all);
            assert!(all.is_sorted() && all.len() == 116);
            let (low, high) = (0.5 * (depths[8] + depths[9]), 0.5 * (depths[9] + depths[10]));
            let near = all.iter().filter(|t| (low..=high).contains(t)).count();
            assert!(near > 95, "{near}");
        }
    }

    #[test]
    fn rays_that_saw_nothing_are_drawn_evenly() {
        let depths: Vec<f32> = (0..8).map(|i| i as f32).collect();
        let mut all = Vec::new();
        refine(&depths, &[0.0; 8], 6, &mut || 0.5, &mut all);
        assert!(all.is_sorted() && all.len() == 14 && all.iter().all(|t| t.is_finite()));
        assert!((all[13] - 7.0).abs() < 1e-6);
    }
}
