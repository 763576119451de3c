//! What a user can say about the mapper.

use scene::flag::between;
use serde::{Deserialize, Serialize};

/// How a model is made from verified pairs.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapperChoice {
    /// Image by image; where that leaves images out, all at once too, and the better model is taken
    #[default]
    Auto,
    /// Image by image
    Incremental,
    /// All rotations, then all positions at once
    Global,
}

/// Configuration of the mapper.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MapperConfig {
    /// Largest reprojection error of an observation that is kept, pixels
    #[arg(long, value_parser = between::<f64>(0.01, 1e4), default_value_t = Self::default().max_reprojection_px, help_heading = "Mapping")]
    pub max_reprojection_px: f64,
    /// Smallest triangulation angle of a point that is kept, degrees
    #[arg(long, value_parser = between::<f64>(0.0, 90.0), default_value_t = Self::default().min_angle_deg, help_heading = "Mapping")]
    pub min_angle_deg: f64,
    /// Fewest point observations with which an image is registered
    #[arg(long, value_parser = between::<usize>(3, 1_000_000), default_value_t = Self::default().min_observations, help_heading = "Mapping")]
    pub min_observations: usize,
    /// Smallest share of an image's observations that must agree with its pose
    #[arg(long, value_parser = between::<f64>(0.0, 1.0), default_value_t = Self::default().min_observation_ratio, help_heading = "Mapping")]
    pub min_observation_ratio: f64,
    /// How a model is made from verified pairs
    #[arg(long, value_enum, default_value_t = MapperChoice::Incremental, help_heading = "Mapping")]
    pub mapper: MapperChoice,
    /// How many first pairs are tried before the best model is taken
    #[arg(long, value_parser = between::<usize>(1, 1000), default_value_t = Self::default().starts, help_heading = "Mapping")]
    pub starts: usize,
}

impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            max_reprojection_px: 4.0,
            min_angle_deg: 1.5,
            min_observations: 15,
            min_observation_ratio: 0.25,
            mapper: MapperChoice::Incremental,
            starts: 3,
        }
    }
}
