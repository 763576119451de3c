//! What a user can say about sizes in the scene.

use scene::flag::between;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Configuration of the scale.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ScaleConfig {
    /// A length that is known: between the points marked by --length-ends, else the longest
    /// distance between two points of the object. The model is in metres then
    #[arg(long, value_parser = between::<f64>(1e-6, 1e9), value_name = "METRES", conflicts_with_all = ["tag_size", "known_distance"], help_heading = "Scale")]
    pub known_length: Option<f64>,
    /// Where the two ends of --known-length are in an image of OUT/images: its name and two pixels,
    /// as `a.jpg,120,340,800,355`. Needed for two images or more, in the same order of the ends
    #[arg(long, value_name = "IMAGE,X,Y,X,Y", requires = "known_length", help_heading = "Scale")]
    pub length_ends: Vec<LengthEnds>,
    /// Side of the black square of tags that lie in the scene, AprilTag 36h11 or ArUco 4x4_50, each
    /// number once. The model is in metres then
    #[arg(long, value_parser = between::<f64>(1e-6, 1e9), value_name = "METRES", conflicts_with = "known_distance", help_heading = "Scale")]
    pub tag_size: Option<f64>,
}

/// Both ends of a length in an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LengthEnds {
    /// Name of the image.
    pub image: String,
    /// The ends, pixels from the upper left edge.
    pub pixels: [[f64; 2]; 2],
}

impl FromStr for LengthEnds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts: Vec<&str> = text.rsplitn(5, ',').collect();
        let image = if parts.len() == 5 { parts.pop() } else { None };
        let numbers = parts.iter().filter_map(|n| n.trim().parse::<f64>().ok());
        let numbers: Vec<f64> = numbers.filter(|n| n.is_finite()).collect();
        match (image, &numbers[..]) {
            (Some(image), &[y1, x1, y0, x0]) if !image.is_empty() => {
                Ok(Self { image: image.to_owned(), pixels: [[x0, y0], [x1, y1]] })
            }
            _ => Err(format!("`{text}` is not an image and four numbers, as `a.jpg,120,340,800,355`")),
        }
    }
}
