//! A solid texture with structure at every scale, so that features are found near and far.

use glam::DVec3;

/// A number in [0, 1) for a lattice point.
fn lattice(x: i32, y: i32, z: i32, seed: u32) -> f64 {
    let mut h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77) ^ seed;
    h = (h ^ (z as u32).wrapping_mul(0xc2b2_ae3d)).wrapping_mul(0x27d4_eb2f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    f64::from(h ^ (h >> 15)) / 4_294_967_296.0
}

/// Value noise in [0, 1]: lattice values, smoothly interpolated.
fn noise(x: DVec3, seed: u32) -> f64 {
    let cell = x.floor();
    let f = x - cell;
    let w = f * f * (DVec3::splat(3.0) - 2.0 * f);
    let (i, j, k) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let edge = |dj: i32, dk: i32| {
        mix(
            lattice(i, j.wrapping_add(dj), k.wrapping_add(dk), seed),
            lattice(i.wrapping_add(1), j.wrapping_add(dj), k.wrapping_add(dk), seed),
            w.x,
        )
    };
    mix(mix(edge(0, 0), edge(1, 0), w.y), mix(edge(0, 1), edge(1, 1), w.y), w.z)
}

/// Linear colour in [0, 1] at a point of the surface: six octaves of noise (cells of 1/2 to 1/64
/// unit) for the brightness, slow ones for the hue.
pub(super) fn colour(x: DVec3, seed: u32) -> DVec3 {
    let mut brightness = 0.0;
    let (mut frequency, mut amplitude, mut total) = (2.0, 1.0, 0.0);
    for octave in 0..6 {
        brightness +=
            amplitude * (noise(x * frequency + DVec3::splat(17.3), seed.wrapping_add(octave)) - 0.5);
        total += amplitude * 0.29; // standard deviation of uniform values
        frequency *= 2.0;
        amplitude *= 0.85;
    }
    let level = (0.5 + 0.42 * brightness / (total * 0.45)).clamp(0.03, 1.0);
    let hue =
        DVec3::new(noise(x * 1.7, seed ^ 0x51), noise(x * 1.7, seed ^ 0x52), noise(x * 1.7, seed ^ 0x53));
    level * (DVec3::splat(0.45) + 0.55 * hue)
}

fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}
