//! What is measured, and how.

use scene::motion_report::Estimate;
use serde::{Deserialize, Serialize};

/// How shapes are looked for.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasureOptions {
    /// A surface belongs to a shape within this distance, share of the longest side of its box.
    pub tolerance: f64,
    /// A shape holds at least this share of the surface's area.
    pub least_share: f64,
    /// Most shapes.
    pub most_shapes: usize,
    /// Of the random choices.
    pub seed: u64,
}

/// The least box around the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OrientedBox {
    /// Its sides, the longest first, scene units.
    pub sides: [Estimate; 3],
    /// Unit vectors along them.
    pub axes: [[f64; 3]; 3],
    /// Its middle.
    pub centre: [f64; 3],
}

/// What a shape is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureKind {
    /// Flat.
    Plane,
    /// Flat with a round outline.
    Disc,
    /// Round about an axis.
    Cylinder,
}

/// A length of a shape, scene units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Size {
    /// Longer side of the least rectangle around a plane; a cylinder along its axis.
    Length(Estimate),
    /// Shorter side of the rectangle.
    Width(Estimate),
    /// Of a disc or a cylinder.
    Diameter(Estimate),
}

impl Size {
    /// The length.
    pub fn estimate(&self) -> Estimate {
        match *self {
            Self::Length(e) | Self::Width(e) | Self::Diameter(e) => e,
        }
    }

    pub(crate) fn estimate_mut(&mut self) -> &mut Estimate {
        match self {
            Self::Length(e) | Self::Width(e) | Self::Diameter(e) => e,
        }
    }
}

/// A shape on the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// What it is.
    pub kind: FeatureKind,
    /// Its middle, in the frame of the surface.
    pub centre: [f64; 3],
    /// Unit normal, outwards; of a cylinder its axis.
    pub axis: [f64; 3],
    /// Standard deviation of the axis about any direction across it, degrees.
    pub axis_deviation_deg: f64,
    /// Standard deviation of its place along the normal (across the axis), scene units.
    pub offset_deviation: f64,
    /// Its sizes.
    pub sizes: Vec<Size>,
    /// Area of the surface that belongs to it, square scene units.
    pub area: f64,
    /// Root mean square distance of that surface from it, scene units.
    pub rms: f64,
    /// Of a cylinder: angle round the axis that is there, degrees.
    pub coverage_deg: Option<f64>,
}

/// What lies between two shapes, by their places in [`Measures::features`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeatureRelation {
    /// The shapes.
    pub between: [usize; 2],
    /// Angle between their axes or normals, 0° to 90°, degrees.
    pub angle_deg: Estimate,
    /// Distance of two flat shapes that are parallel within the deviation of their angle, or within
    /// a degree, scene units.
    pub distance: Option<Estimate>,
}

/// What was measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Overall dimensions.
    pub overall: OrientedBox,
    /// The shapes, the largest area first.
    pub features: Vec<Feature>,
    /// Angles and distances between each two of the first shapes.
    pub relations: Vec<FeatureRelation>,
    /// Area of the whole surface, square scene units.
    pub area: f64,
}
