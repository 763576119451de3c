//! glTF files in the making: buffers, what lies where in them, and meshes.

use crate::geometry::Mesh;
use glam::{DVec3, Vec3};
use serde_json::{Value, json};

/// Target of buffers with the corners of triangles. Source: glTF 2.0, 5.11.5.
const ELEMENTS: u32 = 34_963;
/// Numbers are f32. Source: glTF 2.0, 3.6.2.2.
pub(super) const FLOAT: u32 = 5126;

/// A vector's numbers, f32.
pub(super) fn bytes_of(v: DVec3) -> impl Iterator<Item = u8> {
    v.as_vec3().to_array().into_iter().flat_map(f32::to_le_bytes)
}

/// glTF's vertex colours are linear light, 16 bits so that dark tones survive.
fn linear(srgb: u8) -> u16 {
    let v = f64::from(srgb) / 255.0;
    let linear = if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    (linear * 65_535.0).round() as u16
}

/// A glTF file in the making.
#[derive(Default)]
pub(super) struct GltfBuilder {
    pub(super) bin: Vec<u8>,
    pub(super) views: Vec<Value>,
    pub(super) accessors: Vec<Value>,
}

impl GltfBuilder {
    /// Target of buffers with vertices. Source: glTF 2.0, as for the numbers below.
    pub(super) const VERTICES: u32 = 34_962;

    /// Adds bytes, for the buffer's `target` if they are no picture.
    pub(super) fn view(&mut self, bytes: Vec<u8>, target: Option<u32>) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.bin.extend(bytes);
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// Adds numbers that `accessor` describes, for the buffer's `target` if they belong to a mesh.
    pub(super) fn accessor(&mut self, bytes: Vec<u8>, target: Option<u32>, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.view(bytes, target));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds places and normals: the attributes of a primitive.
    pub(super) fn shape(&mut self, mesh: &Mesh, normals: &[DVec3]) -> Value {
        let (n, mut attributes) = (mesh.vertices.len(), json!({}));
        let low = mesh.vertices.iter().fold(Vec3::INFINITY, |a, v| a.min(v.as_vec3()));
        let high = mesh.vertices.iter().fold(Vec3::NEG_INFINITY, |a, v| a.max(v.as_vec3()));
        let accessor = json!({"componentType": FLOAT, "count": n, "type": "VEC3", "min": low.to_array(), "max": high.to_array()});
        let positions = mesh.vertices.iter().flat_map(|v| bytes_of(*v)).collect();
        attributes["POSITION"] = json!(self.accessor(positions, Some(Self::VERTICES), accessor));
        // Vertices without a normal get one that is at least a direction.
        let normals = normals.iter().map(|n| n.try_normalize().unwrap_or(DVec3::Z));
        let accessor = json!({"componentType": FLOAT, "count": n, "type": "VEC3"});
        let normals = normals.flat_map(bytes_of).collect();
        attributes["NORMAL"] = json!(self.accessor(normals, Some(Self::VERTICES), accessor));
        attributes
    }

    /// Adds sRGB of each vertex.
    pub(super) fn colours(&mut self, colors: &[[u8; 3]]) -> usize {
        let colours = colors.iter().map(|c| [linear(c[0]), linear(c[1]), linear(c[2]), u16::MAX]);
        let colours = colours.flat_map(|c| c.map(u16::to_le_bytes).concat()).collect();
        let accessor =
            json!({"componentType": 5123, "normalized": true, "count": colors.len(), "type": "VEC4"});
        self.accessor(colours, Some(Self::VERTICES), accessor)
    }

    /// Adds the corners of the triangles.
    pub(super) fn triangles(&mut self, mesh: &Mesh) -> usize {
        let corners = mesh.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let accessor = json!({"componentType": 5125, "count": mesh.triangles.len() * 3, "type": "SCALAR"});
        self.accessor(corners, Some(ELEMENTS), accessor)
    }
}
