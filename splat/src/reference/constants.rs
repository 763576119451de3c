//! Numbers of the image formation, the loss and the optimiser, which every backend has.

/// Added to both variances on the screen, px². Source: Kerbl 2023 (a splat is at least about a
/// pixel wide).
pub(crate) const LOW_PASS: f64 = 0.3;
/// Log-scales are held within ± this, natural logarithm of scene units. Source: fourth powers of
/// `exp` of it are finite in f32.
pub(crate) const MAX_LOG_SCALE: f64 = 20.0;
/// How far beyond the image's border the linearisation is followed, in widths or heights of the
/// image. Source: Kerbl 2023.
pub(crate) const JACOBIAN_MARGIN: f64 = 0.15;
/// Near plane where nothing else is asked for, normalised scene units. Source: chosen by hand,
/// never measured.
pub(crate) const DEFAULT_NEAR: f64 = 0.01;
/// Smallest opacity that is drawn. Source: Kerbl 2023, appendix C (one level of 8 bits).
pub(crate) const MIN_ALPHA: f64 = 1.0 / 255.0;
/// Largest α of one Gaussian. Source: Kerbl 2023, appendix C.
pub(crate) const MAX_ALPHA: f64 = 0.99;
/// Compositing stops before the transmittance falls below this. Source: Kerbl 2023, appendix C.
pub(crate) const MIN_TRANSMITTANCE: f64 = 1e-4;

/// Decay of Adam's mean gradient and mean squared gradient. Source: Kingma & Ba 2015, algorithm 1.
pub(crate) const BETAS: [f64; 2] = [0.9, 0.999];
/// Keeps Adam's quotient finite. Source: chosen by hand, never measured.
pub(crate) const EPSILON: f64 = 1e-15;
