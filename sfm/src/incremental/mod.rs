//! Incremental mapping: one image after the other, adjusted as the model grows (Schönberger & Frahm, CVPR 2016).

use serde::{Deserialize, Serialize};

/// Largest reprojection error of a sighting that is kept, pixels.
const MAX_REPROJECTION_PX: f64 = 4.0;
/// Smallest triangulation angle of a point that is kept, degrees.
const MIN_ANGLE_DEG: f64 = 1.5;
/// Fewest inliers with which an image is registered.
const MIN_INLIERS: usize = 15;

/// Configuration of the mapper.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MapperConfig {
    /// Largest reprojection error of a sighting that is kept, pixels
    #[arg(long, default_value_t = MAX_REPROJECTION_PX, help_heading = "Structure from motion")]
    pub max_reprojection_px: f64,
    /// Smallest triangulation angle of a point that is kept, degrees
    #[arg(long, default_value_t = MIN_ANGLE_DEG, help_heading = "Structure from motion")]
    pub min_angle_deg: f64,
    /// Fewest point sightings with which an image is registered
    #[arg(long, default_value_t = MIN_INLIERS, help_heading = "Structure from motion")]
    pub min_sightings: usize,
}

impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            max_reprojection_px: MAX_REPROJECTION_PX,
            min_angle_deg: MIN_ANGLE_DEG,
            min_sightings: MIN_INLIERS,
        }
    }
}
