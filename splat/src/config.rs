//! What training can be told.
//!
//! ```
//! use splat::TrainConfig;
//! use splat::config::parse_duration;
//!
//! let time_limit = Some(parse_duration("1.5m")?);
//! let config = TrainConfig { time_limit, ..TrainConfig::default() };
//! assert_eq!(config.time_limit, Some(90.0));
//! # Ok::<(), String>(())
//! ```

use crate::device::DeviceConfig;
use crate::model::MAX_SH_DEGREE;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use clap::{Args, ValueEnum};
use scene::clock::LimitClock;
use scene::flag::between;
use serde::{Deserialize, Serialize};

/// How much time to spend for how much quality: presets of [`TrainConfig`].
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A first look
    Draft,
    /// Good enough to judge a capture
    Fast,
    /// The default
    Balanced,
    /// As good as it gets here
    Best,
}

impl Quality {
    /// The flags this preset places before the typed ones.
    pub fn flags(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Draft => &[("iterations", "500"), ("max-gaussians", "30000"), ("sh-degree", "2")],
            Self::Fast => &[("iterations", "1500"), ("max-gaussians", "60000")],
            Self::Balanced => &[],
            Self::Best => &[("iterations", "15000"), ("max-gaussians", "400000")],
        }
    }
}

/// Training of the Gaussians. The defaults are the preset `balanced`.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainConfig {
    /// Training steps; one view each
    #[arg(long, value_parser = between::<u32>(0, 1_000_000_000), default_value_t = Self::default().iterations, help_heading = "Splat")]
    pub iterations: u32,
    /// Time for training (90, 60s, 5m, 1h): the schedule fits itself into it and --iterations
    /// is not used
    #[arg(long, value_parser = parse_duration, value_name = "TIME", help_heading = "Splat")]
    pub time_limit: Option<f64>,
    /// What --time-limit counts: wall time, or the processor time of all threads divided by their
    /// number, so that what else the machine does takes nothing away (for comparisons; of no use on
    /// a graphics card)
    #[arg(long, default_value = "wall", value_name = "CLOCK", help_heading = "Splat",
          value_parser = PossibleValuesParser::new(LimitClock::NAMES).try_map(|name| name.parse::<LimitClock>()))]
    pub limit_clock: LimitClock,
    /// Never more Gaussians than this
    #[arg(long, value_parser = between::<usize>(1, 1 << 30), default_value_t = Self::default().max_gaussians, help_heading = "Splat")]
    pub max_gaussians: usize,
    /// Highest spherical-harmonic degree, 0 to 3
    #[arg(long, default_value_t = MAX_SH_DEGREE, help_heading = "Splat",
          value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_SH_DEGREE)))]
    pub sh_degree: u32,
    /// Weight of D-SSIM against L1, in [0, 1] (3DGS paper: 0.2)
    #[arg(long, value_parser = between::<f32>(0.0, 1.0), default_value_t = Self::default().lambda_dssim, help_heading = "Splat")]
    pub lambda_dssim: f32,
    /// Begin at 1/2^N of the resolution
    #[arg(long, default_value_t = Self::default().coarse_levels, help_heading = "Splat",
          value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_COARSE_LEVELS)))]
    pub coarse_levels: u32,
    /// Factor on every learning rate
    #[arg(long, value_parser = between::<f32>(1e-6, 1e6), default_value_t = 1.0, help_heading = "Splat")]
    pub learning_rate: f32,
    /// Scale opacity with the 2D low-pass (Mip-Splatting), against aliasing
    #[arg(long, help_heading = "Splat")]
    pub antialias: bool,
    /// Keep Gaussians as large as what the views sample (Mip-Splatting's 3D filter): from nearer
    /// than the photos any viewer shows them better, from where they were taken a little softer
    #[arg(long, help_heading = "Splat")]
    pub smoothing: bool,
    /// Move the training views to where the splat shows what their photos show
    #[arg(long, value_enum, default_value_t = PoseRefinement::Auto, help_heading = "Splat")]
    pub refine_poses: PoseRefinement,
    /// Steps between checkpoints (0: only when stopped)
    #[arg(long, default_value_t = Self::default().checkpoint_every, help_heading = "Splat")]
    pub checkpoint_every: u32,
    /// Seed of all randomness (the command line has one for all stages)
    #[arg(skip)]
    pub seed: u64,
    /// Where to train.
    #[command(flatten)]
    pub device: DeviceConfig,
    /// Seconds of the time limit that went by before training began, such as for loading the
    /// images.
    #[arg(skip)]
    #[serde(skip)]
    pub seconds_gone: f64,
}

/// Whether training moves its views.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseRefinement {
    /// If that explains enough of what the photos show otherwise
    #[default]
    Auto,
    /// In any case
    On,
    /// Never
    Off,
}

/// Most halvings of the resolution at the start. Source: at 1/16 a picture of a megapixel has 60 ×
/// 60 pixels.
pub(crate) const MAX_COARSE_LEVELS: u32 = 4;

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            // A few minutes on two cores (docs/benchmarks.md, splats by preset).
            iterations: 4000,
            time_limit: None,
            limit_clock: LimitClock::Wall,
            // 150,000 kept lego400 from gaining between one and five minutes (docs/decisions/13).
            max_gaussians: 300_000,
            sh_degree: MAX_SH_DEGREE,
            // Kerbl et al. 2023.
            lambda_dssim: 0.2,
            // Full resolution throughout loses 0.3 dB (docs/decisions/13).
            coarse_levels: 2,
            learning_rate: 1.0,
            antialias: false,
            smoothing: false,
            refine_poses: PoseRefinement::Auto,
            // Half a minute to a minute of work.
            checkpoint_every: 1000,
            seed: 0,
            device: DeviceConfig::default(),
            seconds_gone: 0.0,
        }
    }
}

/// Seconds from `90`, `60s`, `1.5m` or `2h`.
pub fn parse_duration(text: &str) -> Result<f64, String> {
    let (number, unit) = match text.trim().strip_suffix(['s', 'm', 'h']) {
        Some(number) => (number, text.trim().chars().last()),
        None => (text.trim(), None),
    };
    let factor = match unit {
        Some('m') => 60.0,
        Some('h') => 3600.0,
        _ => 1.0,
    };
    match number.parse::<f64>().map(|value| value * factor) {
        Ok(seconds) if seconds.is_finite() && seconds > 0.0 => Ok(seconds),
        _ => Err(format!("{text:?} is not a duration such as 90, 60s, 5m or 1h")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        train: TrainConfig,
    }

    #[test]
    fn the_defaults_of_the_command_line_are_those_of_the_library() {
        let parsed = Cli::try_parse_from(["x"]).unwrap().train;
        assert_eq!(parsed, TrainConfig::default());
    }

    #[test]
    fn every_preset_is_understood_by_the_command_line() {
        for quality in Quality::value_variants() {
            let mut arguments = vec!["x".to_owned()];
            for (flag, value) in quality.flags() {
                arguments.extend([format!("--{flag}"), (*value).to_owned()]);
            }
            assert!(Cli::try_parse_from(&arguments).is_ok(), "{quality:?}");
        }
    }

    #[test]
    fn durations_have_units_and_nonsense_is_refused() {
        assert_eq!(parse_duration("60s"), Ok(60.0));
        assert_eq!(parse_duration("1.5m"), Ok(90.0));
        assert_eq!(parse_duration("2h"), Ok(7200.0));
        assert_eq!(parse_duration("45"), Ok(45.0));
        for bad in ["", "s", "-3", "0", "NaN", "inf", "5d", "1e308h"] {
            assert!(parse_duration(bad).is_err(), "{bad:?}");
        }
    }
}
