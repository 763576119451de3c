//! The production code against the reference and finite differences.

use super::gradient::{NerfPass, NerfSums, SightedRay};
use super::network::{SKIP, TRUNK};
use super::reference::{Affine, ReferenceNerf, sizes};
use super::*;
use crate::rays::Sighting;
use rand::Rng as _;

fn small_field(deformed: bool) -> Nerf {
    let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades: 1 };
    let shape = NerfShape {
        width: 32,
        samples: [8, 8],
        rays: 20,
        ..NerfShape::with_near(domain, 0.0, deformed, false)
    };
    let mut field = Nerf::new(shape, 5);
    // Gradients large enough that differences of losses show them.
    field.weights[..2 - usize::from(deformed)].iter_mut().flatten().for_each(|w| *w *= 1.6);
    if deformed {
        // High octaves would show how f32 rounds the places that positions are moved to.
        for (layer, first) in [(0, 0), (SKIP, 32)] {
            let (place, _) = field.networks.radiance.places(layer);
            let inputs = first + 33..first + 63;
            inputs.for_each(|i| (0..32).for_each(|o| field.weights[0][place(i, o)] = 0.0));
        }
    }
    field
}

/// Rays of times 0 to 1 and their samples.
fn rays(field: &Nerf, count: usize, each: usize) -> (Vec<SightedRay>, Vec<f32>) {
    let mut rng = rng(5, "test rays", 0);
    let (mut all, mut depths) = (Vec::new(), Vec::new());
    for r in 0..count {
        let origin =
            Vec3::from(rng.random::<[f32; 3]>().map(|v| (v * 256.0).floor() / 1024.0)) - Vec3::Z * 3.0;
        let ray = Ray { origin, direction: Vec3::Z, time: r as f32 / count as f32 };
        let (local, reach) = field.local(&ray).unwrap();
        reach.stratified(each, &mut || rng.random(), &mut depths);
        let sighting = Sighting { ray, colour: rng.random(), background: rng.random() };
        all.push(SightedRay { ray: local, reach, sighting });
    }
    // Exact in f32: what is compared is not the rounding of places.
    depths.iter_mut().for_each(|t| *t = (*t * 1024.0).round() / 1024.0);
    (all, depths)
}

fn gradients(field: &Nerf, pass: usize, rays: &[SightedRay], depths: &[f32]) -> NerfSums {
    let second = field.networks.deformation.as_ref().unwrap_or(&field.networks.radiance);
    let transposed =
        [field.networks.radiance.transposed(&field.weights[0]), second.transposed(&field.weights[1])];
    let mut sums =
        NerfSums { gradients: field.weights.each_ref().map(|w| vec![0.0; w.len()]), ..NerfSums::default() };
    let weight = 1.0 / rays.len() as f32;
    let all = NerfPass { field, transposed: &transposed, weight };
    all.pass(pass, rays, depths, &mut Default::default(), &mut sums);
    sums
}

#[test]
fn losses_and_gradients_agree_with_the_reference_and_its_finite_differences() {
    for (deformed, pass) in [(false, 0), (false, 1), (true, 1)] {
        let field = small_field(deformed);
        let (rays, depths) = rays(&field, 20, 8);
        let sums = gradients(&field, pass, &rays, &depths);
        let truth = ReferenceNerf::new(&field, pass);
        let unit = f64::from(field.unit());
        let loss = truth.loss(&rays, &depths, unit).1;
        let mean = sums.loss / rays.len() as f64;
        assert!((mean - loss).abs() < 1e-5 * loss, "{mean} {loss}");
        let slope = |change: &dyn Fn(&mut ReferenceNerf, f64)| {
            /// Short enough that hardly any rectifier switches on the way.
            const H: f64 = 1e-7;
            let at = |by: f64| {
                let mut moved = truth.clone();
                change(&mut moved, by);
                moved.loss(&rays, &depths, unit).1
            };
            (at(H) - at(-H)) / (2.0 * H)
        };
        let index = if deformed { 0 } else { pass };
        let radiance: fn(&mut ReferenceNerf) -> &mut Vec<Affine> = |r| &mut r.radiance;
        let parts = [(&field.networks.radiance, radiance, sizes(32, 63, false), index)];
        let moves: fn(&mut ReferenceNerf) -> &mut Vec<Affine> = |r| r.deformation.as_mut().unwrap();
        let deformation = field.networks.deformation.as_ref();
        let parts = parts.into_iter().chain(deformation.map(|d| (d, moves, sizes(32, 84, true), 1)));
        let mut rng = rng(5, "test places", 1);
        for (stack, layers, sizes, part) in parts {
            for (l, &(inputs, outputs)) in sizes.iter().enumerate() {
                let (place, bias) = stack.places(l);
                let ours = &sums.gradients[part];
                let mut found = Vec::new();
                for n in 0..12 {
                    // The last inputs are those that enter again.
                    let i = if n < 6 { inputs - 1 - n } else { rng.random_range(0..inputs) };
                    let o = rng.random_range(0..outputs);
                    let truth = slope(&|field, by| layers(field)[l].weights[o][i] += by);
                    found.push((f64::from(ours[place(i, o)]), truth));
                    let truth = slope(&|field, by| layers(field)[l].bias[o] += by);
                    found.push((f64::from(ours[bias.start + o]), truth));
                }
                let size = found.iter().map(|f| f.1.abs()).fold(0.0, f64::max);
                assert!(size > 0.0, "deformed {deformed}, part {part}, layer {l}: no gradient");
                for (ours, truth) in found {
                    let what = format!("deformed {deformed}, part {part}, layer {l} of {TRUNK}, {SKIP}");
                    assert!((ours - truth).abs() < 1e-4 * size, "{what}: {ours} {truth} ({size})");
                }
            }
        }
    }
}

#[test]
fn pictures_agree_with_the_reference_at_the_same_depths() {
    for deformed in [false, true] {
        let field = small_field(deformed);
        let (rays, depths) = rays(&field, 12, 8);
        let truth = ReferenceNerf::new(&field, 1).loss(&rays, &depths, f64::from(field.unit())).0;
        let plain: Vec<NerfRay> = rays.iter().map(|r| r.ray.clone()).collect();
        let mut layers = Default::default();
        field.networks.evaluate(field.parts(&field.weights, 1), &plain, &depths, &mut layers);
        for (r, (ray, depths)) in rays.iter().zip(depths.chunks_exact(8)).enumerate() {
            let samples = ray.reach.steps(depths).enumerate().map(|(i, dt)| {
                let s = r * 8 + i;
                let (density, rgb) = (field.networks.density(&layers, s), field.networks.colour(&layers, s));
                (density, dt * field.unit(), 0.0, rgb)
            });
            let shown = crate::composite::compose(samples, ray.sighting.background);
            for c in 0..3 {
                assert!((f64::from(shown.rgb[c]) - truth[r][c]).abs() < 1e-5, "{shown:?} {:?}", truth[r]);
            }
        }
    }
}

#[test]
fn at_time_0_nothing_moves_and_a_ray_beside_the_box_sees_the_background() {
    let mut field = small_field(true);
    let ray = |x: f32, time| Ray { origin: Vec3::new(x, 0.0, -3.0), direction: Vec3::Z, time };
    let show = |field: &Nerf, x, time| {
        let mut out = [Default::default()];
        let mut layers = NerfLayers::default();
        let mut shade =
            |pass: usize, rays: &[NerfRay], depths: &[f32]| Ok(field.shade(pass, rays, depths, &mut layers));
        field.trace((&[ray(x, time)], GROUP), [0.25; 3], &mut out, &mut shade).unwrap();
        out[0]
    };
    let (still, later) = (show(&field, 0.1, 0.0), show(&field, 0.1, 0.5));
    field.weights[1].iter_mut().for_each(|w| *w *= 3.0);
    assert_eq!(show(&field, 0.1, 0.0), still, "time 0 needs no deformation");
    assert_ne!(show(&field, 0.1, 0.5), later);
    let beside = show(&field, 1.5, 0.5);
    assert_eq!((beside.rgb, beside.transmittance), ([0.25; 3], 1.0));
}
