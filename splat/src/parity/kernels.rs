//! Kernel by kernel.

use super::scenes::{ordinary, rendered, view};
use super::subject::subjects;
use crate::RenderOptions;
use crate::reference::loss::loss;
use glam::DVec3;
use rand::Rng;

fn close(found: f32, expected: f64, relative: f64, absolute: f64) -> bool {
    (f64::from(found) - expected).abs() <= relative * expected.abs() + absolute
}

#[test]
fn project_and_sh_agree_for_every_degree_with_and_without_antialiasing() {
    for mut subject in subjects() {
        for (seed, antialias) in (0..8).flat_map(|s| [(s, false), (s, true)]) {
            let g = ordinary(seed, 203, (seed % 4) as u32);
            let (v, o) = (view(75, 58), RenderOptions { antialias, ..RenderOptions::default() });
            let truth = rendered(&g, &v, &o);
            let mut both = 0;
            for (i, (seen, expected)) in subject.project(&g, &v, &o).iter().zip(&truth.projected).enumerate()
            {
                let at = format!("{} seed {seed} gaussian {i}", subject.name());
                let (Some(seen), Some(expected)) = (seen, expected) else {
                    assert!(seen.is_none() || antialias, "{at} is seen but should not be");
                    continue;
                };
                both += 1;
                let good = close(seen.xy[0], expected.xy.x, 1e-6, 1e-4)
                    && close(seen.xy[1], expected.xy.y, 1e-6, 1e-4)
                    && close(seen.depth, expected.depth, 1e-6, 1e-6)
                    && close(seen.opacity, expected.opacity, 3e-4, 1e-5);
                assert!(good, "{at}: {seen:?} should be {expected:?}");
                let size = expected.conic.x + expected.conic.z;
                for k in 0..3 {
                    assert!(
                        close(seen.conic[k], expected.conic[k], 1e-4, 1e-4 * size),
                        "{at}: {seen:?} {expected:?}"
                    );
                    assert!(
                        close(seen.rgb[k], truth.colours[i][k], 1e-5, 1e-5),
                        "{at}: {seen:?} {}",
                        truth.colours[i]
                    );
                }
            }
            assert!(both > 80, "{both}");
        }
    }
}

#[test]
fn loss_and_its_gradient_agree_with_and_without_weights() {
    for mut subject in subjects() {
        for seed in 0..7u64 {
            let size = [[33, 20], [16, 16], [5, 7], [1, 1], [70, 41], [11, 64], [19, 131]][seed as usize];
            let n = size[0] * size[1];
            let mut rng = scene::rng::rng(seed, "parity loss", 0);
            let mut random = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(0.0..1.0)).collect() };
            let byte = |v: f32| (v * 255.0).round() / 255.0;
            let x = random(n * 3);
            let [y, w] = [n * 3, n].map(|n| random(n).into_iter().map(byte).collect::<Vec<f32>>());
            let binary: Vec<f32> = w.iter().map(|&v| f32::from(u8::from(v > 0.4))).collect();
            let fraction: Vec<f32> = w.iter().map(|&v| if v > 0.4 { v } else { 0.0 }).collect();
            for (weight, lambda) in
                [(None, 0.2), (Some(&binary), 0.2), (Some(&fraction), 0.2), (None, 0.0), (None, 1.0)]
            {
                let colours = |v: &[f32]| -> Vec<DVec3> {
                    v.chunks(3)
                        .map(|c| DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])))
                        .collect()
                };
                let wide: Option<Vec<f64>> = weight.map(|w| w.iter().map(|&v| f64::from(v)).collect());
                let truth = loss(&colours(&x), &colours(&y), wide.as_deref(), size[0], f64::from(lambda));
                let (value, mse, gradient) = subject.loss(size, &x, &y, weight.map(|w| &w[..]), lambda);
                let at = format!("{} {size:?} λ {lambda} weights {}", subject.name(), weight.is_some());
                assert!(close(value, truth.loss, 1e-5, 1e-6), "{at}: {value} should be {}", truth.loss);
                assert!(close(mse, truth.mse, 1e-5, 1e-6), "{at}: {mse} should be {}", truth.mse);
                let largest = truth.gradient.iter().fold(0.0f64, |m, g| m.max(g.abs().max_element()));
                for (i, &g) in gradient.iter().enumerate() {
                    let expected = truth.gradient[i / 3][i % 3];
                    assert!(
                        close(g, expected, 1e-3, 1e-4 * largest),
                        "{at} value {i}: {g} should be {expected}"
                    );
                }
            }
        }
    }
}
