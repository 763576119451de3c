//! A mesh with a picture on it.

use super::Mesh;
use glam::{DVec2, DVec3};
use image::RgbImage;

/// A mesh whose vertices have places in a picture. Where charts of the picture meet, vertices of
/// one place in space are several.
#[derive(Clone, Debug, PartialEq)]
pub struct TexturedMesh {
    /// The triangles; colours are not used.
    pub mesh: Mesh,
    /// Unit normal of each vertex, or zero; those of one place in space are the same.
    pub normals: Vec<DVec3>,
    /// Place of each vertex in the picture, in [0, 1]: x to the right, y down.
    pub uvs: Vec<DVec2>,
    /// sRGB; what the photos show, with their light.
    pub texture: RgbImage,
}
