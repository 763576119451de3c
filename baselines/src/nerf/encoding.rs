//! The positional encoding (Mildenhall et al. 2020, equation 4): a number, then sines and cosines
//! of it in octaves.

use std::f32::consts::PI;

/// Values that a number of `octaves` becomes.
pub(super) const fn encoded(octaves: usize) -> usize {
    1 + 2 * octaves
}

/// Encodes the coordinates into the front of a row: themselves, then by octave and coordinate the
/// sine and the cosine of `2^octave π` times it.
pub(super) fn encode(coordinates: &[f32], octaves: usize, row: &mut [f32]) {
    let (own, waves) = row.split_at_mut(coordinates.len());
    own.copy_from_slice(coordinates);
    let mut waves = waves.as_chunks_mut::<2>().0.iter_mut();
    for octave in 0..octaves {
        let scale = (1u32 << octave) as f32;
        for (&x, wave) in coordinates.iter().zip(&mut waves) {
            // In half turns from the nearest whole turn: exact.
            let turns = x * scale * 0.5;
            let (sine, cosine) = ((turns - turns.round()) * 2.0 * PI).sin_cos();
            *wave = [sine, cosine];
        }
    }
}

/// The gradient of the coordinates from that of an encoded row.
pub(super) fn encode_backward<const N: usize>(row: &[f32], of_row: &[f32], octaves: usize) -> [f32; N] {
    let mut sum: [f32; N] = std::array::from_fn(|a| of_row[a]);
    let waves = row[N..].as_chunks::<2>().0.iter().zip(of_row[N..].as_chunks::<2>().0);
    for (index, ([sine, cosine], [of_sine, of_cosine])) in waves.take(N * octaves).enumerate() {
        let scale = (1u32 << (index / N)) as f32 * PI;
        sum[index % N] += scale * (of_sine * cosine - of_cosine * sine);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_agree_with_f64_and_gradients_with_differences() {
        let octaves = 10;
        let mut row = vec![9.0; 3 * encoded(octaves) + 1];
        let of_row: Vec<f32> = (0..row.len()).map(|i| (i as f32 * 0.7).sin()).collect();
        for x in [[0.3f32, -0.99, 0.111], [0.0, 1.0, -1.0], [0.71, -0.5, 3.25]] {
            encode(&x, octaves, &mut row);
            let truth = |x: [f64; 3]| {
                let mut all = x.to_vec();
                for k in 0..octaves {
                    for x in x {
                        let angle = 2f64.powi(k as i32) * std::f64::consts::PI * x;
                        all.extend([angle.sin(), angle.cos()]);
                    }
                }
                all
            };
            let x = x.map(f64::from);
            for (ours, truth) in row.iter().zip(truth(x)) {
                assert!((f64::from(*ours) - truth).abs() < 1e-6, "{ours} {truth}");
            }
            let gradient = encode_backward::<3>(&row, &of_row, octaves);
            for a in 0..3 {
                let loss = |h: f64| {
                    let mut moved = x;
                    moved[a] += h;
                    let terms = truth(moved).into_iter().zip(&of_row);
                    terms.map(|(v, &g)| v * f64::from(g)).sum::<f64>()
                };
                let slope = (loss(1e-6) - loss(-1e-6)) / 2e-6;
                assert!((f64::from(gradient[a]) - slope).abs() < 1e-4 * 512.0 * 3.0, "{gradient:?} {slope}");
            }
        }
        assert_eq!(row[3 * encoded(octaves)], 9.0, "what lies behind stays");
    }
}
