//! Losses of a ray's colour.

/// Huber's loss of a colour, which grows linearly from the error `linear_from`: its mean over the
/// channels, and its gradient.
pub(crate) fn huber(shown: [f32; 3], truth: [f32; 3], linear_from: f32) -> (f32, [f32; 3]) {
    let (mut loss, mut gradient) = (0.0, [0.0; 3]);
    for c in 0..3 {
        let e = shown[c] - truth[c];
        let size = e.abs();
        loss += if size < linear_from { 0.5 * e * e } else { linear_from * (size - 0.5 * linear_from) };
        gradient[c] = e.clamp(-linear_from, linear_from) / 3.0;
    }
    (loss / 3.0, gradient)
}

/// Mean squared error of a colour, and its gradient.
pub(crate) fn mean_square(shown: [f32; 3], truth: [f32; 3]) -> (f32, [f32; 3]) {
    let e = [0, 1, 2].map(|c| shown[c] - truth[c]);
    (e.map(|e| e * e).iter().sum::<f32>() / 3.0, e.map(|e| 2.0 * e / 3.0))
}

/// Mean squared error of a colour.
pub(crate) fn square_error(shown: [f32; 3], truth: [f32; 3]) -> f64 {
    (0..3).map(|c| f64::from(shown[c] - truth[c]).powi(2)).sum::<f64>() / 3.0
}
