//! NeRF and D-NeRF against their twins in torch.

use super::depths::{Reach, refine, weights};
use super::gradient::{NerfBuffers, NerfPass, NerfSums, SightedRay};
use super::reference::sizes;
use super::*;
use crate::composite::compose;
use crate::rays::Sighting;
use crate::stack::Stack;
use crate::twin_tests::{STEPS, Twin, directions, formula};

const COUNT: usize = 20;
const EACH: usize = 8;
const WIDTH: usize = 32;

/// The field of the script.
pub(super) fn field(deformed: bool) -> Nerf {
    let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades: 1 };
    let paper = NerfShape::with_near(domain, 0.0, deformed, false);
    // With the rates of a time limit, which are those of its end in the trainings.
    let shape = NerfShape { width: WIDTH, samples: [EACH, EACH], rays: COUNT, budget: true, ..paper };
    let mut field = Nerf::new(shape, 0);
    let second = field.networks.deformation.as_ref().unwrap_or(&field.networks.radiance);
    let inputs = if deformed { 84 } else { 63 };
    field.weights = [affine(200, &field.networks.radiance, 63, false), affine(300, second, inputs, deformed)];
    if deformed {
        for (layer, first) in [(0, 0), (network::SKIP, WIDTH)] {
            let (place, _) = field.networks.radiance.places(layer);
            for i in first + 33..first + 63 {
                (0..WIDTH).for_each(|o| field.weights[0][place(i, o)] = 0.0);
            }
        }
    }
    field
}

fn affine(seed: u64, stack: &Stack, position: usize, deformation: bool) -> Vec<f32> {
    let mut all = vec![0.0; stack.parameters()];
    for (k, (inputs, outputs)) in sizes(WIDTH, position, deformation).into_iter().enumerate() {
        let (bound, seed) = (1.6 / (inputs as f32).sqrt(), seed + 2 * k as u64);
        let (place, bias) = stack.places(k);
        for (at, value) in formula(seed, inputs * outputs).into_iter().enumerate() {
            all[place(at / outputs, at % outputs)] = value * bound;
        }
        bias.zip(formula(seed + 1, outputs)).for_each(|(b, value)| all[b] = value * bound);
    }
    all
}

/// The rays of a step of the script.
pub(super) fn rays(step: u64) -> Vec<SightedRay> {
    let places = formula(4000 + step, 2 * COUNT);
    let ray = |(r, towards): (usize, Vec3)| {
        let [x, y] = [0, 1].map(|a| (places[2 * r + a] * 512.0).floor() / 1024.0);
        let mut encoded = [0.0; ENCODED_DIRECTION];
        encode(&towards.to_array(), DIRECTION_OCTAVES, &mut encoded);
        let time = r as f32 / COUNT as f32;
        let local = NerfRay { origin: [x, y, -3.0], direction: [0.0, 0.0, 1.0], encoded, time };
        let colour = [0.0, 1.0, 2.0].map(|c| 0.5 + 0.4 * (3.0 * x + c + 2.0 * y).sin());
        let ray = Ray { origin: Vec3::new(x, y, -3.0), direction: Vec3::Z, time };
        let sighting = Sighting { ray, colour, background: [0.25; 3] };
        SightedRay { ray: local, reach: Reach { near: 2.0, far: 4.0, inverse: false }, sighting }
    };
    directions(5000 + step, COUNT).into_iter().enumerate().map(ray).collect()
}

fn empty(field: &Nerf) -> NerfSums {
    NerfSums { gradients: field.weights.each_ref().map(|w| vec![0.0; w.len()]), ..NerfSums::default() }
}

fn transposed(field: &Nerf) -> [Vec<f32>; 2] {
    let second = field.networks.deformation.as_ref().unwrap_or(&field.networks.radiance);
    [field.networks.radiance.transposed(&field.weights[0]), second.transposed(&field.weights[1])]
}

/// Depths that are exact in f32.
pub(super) fn exact_depths() -> Vec<f32> {
    let mut all = formula(6000, COUNT * EACH);
    all.iter_mut().for_each(|t| *t = ((*t + 1.0) * 1024.0).floor() / 1024.0 + 2.0);
    all.chunks_exact_mut(EACH).for_each(|ray| ray.sort_by(f32::total_cmp));
    all
}

fn colours(field: &Nerf, rays: &[SightedRay], depths: &[f32]) -> Vec<f32> {
    let plain: Vec<NerfRay> = rays.iter().map(|r| r.ray.clone()).collect();
    let mut layers = network::NerfLayers::default();
    field.networks.evaluate(field.parts(&field.weights, 1), &plain, depths, &mut layers);
    let each = |(r, depths): (usize, &[f32])| {
        let samples = rays[r].reach.steps(depths).enumerate().map(|(i, dt)| {
            let sample = r * EACH + i;
            (field.networks.density(&layers, sample), dt, 0.0, field.networks.colour(&layers, sample))
        });
        compose(samples, rays[r].sighting.background).rgb
    };
    depths.chunks_exact(EACH).enumerate().flat_map(each).collect()
}

/// Gradients of both passes through the rays of a step.
pub(super) fn step(field: &Nerf, rays: &[SightedRay]) -> NerfSums {
    let (mut sums, mut buffers, transposed) = (empty(field), NerfBuffers::default(), transposed(field));
    let pass = NerfPass { field, transposed: &transposed, weight: 1.0 / COUNT as f32 };
    let (mut first, mut second, mut shares) = (Vec::new(), Vec::new(), Vec::new());
    rays.iter().for_each(|r| r.reach.stratified(EACH, &mut || 0.5, &mut first));
    pass.pass(0, rays, &first, &mut buffers, &mut sums);
    for (r, depths) in first.chunks_exact(EACH).enumerate() {
        let densities = (0..EACH).map(|i| field.networks.density(&buffers.layers, r * EACH + i));
        weights(densities, rays[r].reach.steps(depths), &mut shares);
        refine(depths, &shares, EACH, &mut || 0.5, &mut second);
    }
    pass.pass(1, rays, &second, &mut buffers, &mut sums);
    sums
}

#[test]
fn colours_gradients_and_trainings_agree_with_the_twins_in_torch() {
    for (name, deformed) in [("nerf", false), ("d-nerf", true)] {
        let (mut field, twin) = (field(deformed), Twin::of(name));
        let (first, depths) = (rays(0), exact_depths());
        let (mut sums, back) = (empty(&field), transposed(&field));
        let pass = NerfPass { field: &field, transposed: &back, weight: 1.0 / COUNT as f32 };
        pass.pass(1, &first, &depths, &mut NerfBuffers::default(), &mut sums);
        twin.forward(&colours(&field, &first, &depths), sums.loss / COUNT as f64);
        twin.gradients(&|name, at| gradient(&field, &sums, name, at));
        let mut curve = Vec::new();
        for number in 0..STEPS as u32 {
            let sums = step(&field, &rays(u64::from(number)));
            curve.push(sums.loss / COUNT as f64);
            field.descend(&[sums], StepPlace { step: number, position: 1.0, seed: 0 });
        }
        twin.curve(&curve);
    }
}

/// A gradient by the script's name: w, b of the radiance, v, c of the deformation.
fn gradient(field: &Nerf, sums: &NerfSums, name: &str, at: usize) -> f32 {
    let (kind, k) = name.split_at(1);
    let k: usize = k.parse().unwrap();
    let deformed = field.shape.deformed;
    let moves = matches!(kind, "v" | "c");
    let part = if deformed { usize::from(moves) } else { 1 };
    let stack = if moves { field.networks.deformation.as_ref().unwrap() } else { &field.networks.radiance };
    let (place, bias) = stack.places(k);
    let outputs = sizes(WIDTH, if moves { 84 } else { 63 }, moves)[k].1;
    let all = &sums.gradients[part];
    if matches!(kind, "w" | "v") { all[place(at / outputs, at % outputs)] } else { all[bias.start + at] }
}
