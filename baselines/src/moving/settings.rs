//! What 4DGS is told: Wu et al. 2024's settings, and where docs/decisions/19 has others.

use super::hexplane::Smoothness;
use crate::adam::AdamSettings;

/// How moving Gaussians begin and are trained.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MovingSettings {
    pub(super) first: FirstGaussians,
    /// Units of the perceptron's first layer. Source: Wu et al. 2024's settings for synthetic
    /// scenes.
    pub(super) width: usize,
    /// Source: Wu et al. 2024's settings: total variation, L1 of planes of time; smoothness in
    /// time: docs/decisions/19 (theirs: 1e-3).
    pub(super) smoothness: Smoothness,
    /// Share of the schedule in which nothing moves. Source: docs/decisions/19 (Wu et al. 2024:
    /// 3,000 of 20,000 steps).
    pub(super) at_rest: f64,
    /// Which photos are seen when.
    pub(super) opening: TimeOpening,
    /// Positions from which pictures have half, and full resolution; a quarter before.
    /// Source: docs/decisions/13, about as for splats that stand still.
    pub(super) resolutions: [f64; 2],
    /// Smallest side of a photo that is halved, pixels. Source: chosen by hand.
    pub(super) smallest: usize,
    /// Rounds of densification, evenly until `growth_end`. Source: chosen by hand.
    pub(super) rounds: u32,
    /// Position at which the number of Gaussians stays. Source: Wu et al. 2024 (half of the steps).
    pub(super) growth_end: f64,
    /// By which share their number grows in a round, up to the most in the last.
    /// Source: the first become the most in all rounds.
    pub(super) growth: f64,
    /// Rounds with which degrees of the harmonics begin. Source: chosen by hand.
    pub(super) degrees: [u32; 3],
    /// Weight of D-SSIM. Source: Wu et al. 2024's settings (L1 alone).
    pub(super) lambda_dssim: f32,
    /// Times that a time limit lets each photo be seen, at most. Source: docs/decisions/19.
    pub(super) passes: f64,
    /// Step sizes of planes and of the perceptron at the start. Source: Wu et al. 2024's settings.
    pub(super) rates: [f64; 2],
    /// What they fall to, as a factor. Source: as above.
    pub(super) fall: f64,
    /// Steps of the authors' schedule: shorter ones have larger step sizes. Source: as above.
    pub(super) steps: f64,
    /// Largest factor for that. Source: docs/decisions/19.
    pub(super) largest_factor: f64,
    /// Source: Kingma and Ba 2015; Wu et al. 2024's program.
    pub(super) adam: AdamSettings,
}

/// The Gaussians at the start where there is no cloud.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FirstGaussians {
    /// How many. Source: chosen by hand: a fifth lie in the object.
    pub(super) count: usize,
    /// Standard deviation in mean distances of neighbours. Source: chosen by hand.
    pub(super) size: f32,
    /// Logit of the opacity. Source: Kerbl et al. 2023 (0.1).
    pub(super) logit: f32,
}

/// Photos come in from the middle of the time to both ends: Gaussians follow what moves. Seen all
/// at once, each moment leaves its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TimeOpening {
    /// Share of the photos that are seen at the start. Source: docs/decisions/19.
    pub(super) first: f64,
    /// Position from which all are seen. Source: docs/decisions/19.
    pub(super) until: f64,
}

impl Default for MovingSettings {
    fn default() -> Self {
        Self {
            first: FirstGaussians { count: 5_000, size: 0.4, logit: -2.2 },
            width: 64,
            smoothness: Smoothness { space: 2e-4, time: 1.0, still: 1e-4 },
            at_rest: 0.02,
            opening: TimeOpening { first: 0.1, until: 0.5 },
            resolutions: [0.2, 0.5],
            smallest: 64,
            rounds: 12,
            growth_end: 0.6,
            growth: 0.15,
            degrees: [4, 6, 8],
            lambda_dssim: 0.0,
            passes: 150.0,
            rates: [1.6e-3, 1.6e-4],
            fall: 0.01,
            steps: 20_000.0,
            largest_factor: 10.0,
            adam: AdamSettings { betas: [0.9, 0.999], epsilon: 1e-15 },
        }
    }
}
