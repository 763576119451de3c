//! Triangle meshes to PLY and binary glTF.

use super::error::IoError;
use super::splats::write_chunks;
use super::write_atomic;
use crate::geometry::Mesh;
use glam::{DVec3, Vec3};
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// Writes a mesh with its normals and, if it has them, colours; the ending says the format: `.ply`
/// (binary, in the mesh's frame) or `.glb` (its node is rotated by 180° about x, like splats,
/// because glTF has y up).
pub fn write_mesh(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
    mesh.validate().map_err(|m| IoError::format(path, format!("no usable mesh: {m}")))?;
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "ply" => write_ply(path, mesh),
        "glb" => write_glb(path, mesh),
        _ => Err(IoError::format(path, "a mesh is written as .ply or .glb")),
    }
}

fn bytes_of(v: DVec3) -> impl Iterator<Item = u8> {
    v.as_vec3().to_array().into_iter().flat_map(f32::to_le_bytes)
}

fn write_ply(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
    let normals = mesh.normals();
    write_atomic(path, |w| {
        writeln!(w, "ply\nformat binary_little_endian 1.0\ncomment sat-recon")?;
        writeln!(w, "element vertex {}", mesh.vertices.len())?;
        for name in ["x", "y", "z", "nx", "ny", "nz"] {
            writeln!(w, "property float {name}")?;
        }
        if !mesh.colors.is_empty() {
            writeln!(w, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        }
        writeln!(w, "element face {}", mesh.triangles.len())?;
        writeln!(w, "property list uchar int vertex_indices\nend_header")?;
        for (i, (vertex, normal)) in mesh.vertices.iter().zip(&normals).enumerate() {
            let row: Vec<u8> = bytes_of(*vertex).chain(bytes_of(*normal)).collect();
            w.write_all(&row)?;
            w.write_all(mesh.colors.get(i).map_or(&[], |c| &c[..]))?;
        }
        for triangle in &mesh.triangles {
            w.write_all(&[3])?;
            triangle.iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
        }
        Ok(())
    })
}

/// glTF's vertex colours are linear light, 16 bits so that dark tones survive.
fn linear(srgb: u8) -> u16 {
    let v = f64::from(srgb) / 255.0;
    let linear = if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    (linear * 65_535.0).round() as u16
}

fn write_glb(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
    let n = mesh.vertices.len();
    let (mut bin, mut views, mut accessors, mut attributes) = (Vec::new(), vec![], vec![], json!({}));
    let mut add = |bytes: Vec<u8>, target: u32, accessor: serde_json::Value| {
        views
            .push(json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": bytes.len(), "target": target}));
        bin.extend(bytes);
        let mut accessor = accessor;
        accessor["bufferView"] = json!(views.len() - 1);
        accessors.push(accessor);
        accessors.len() - 1
    };
    let (vertices, elements) = (34_962, 34_963);
    let low = mesh.vertices.iter().fold(Vec3::INFINITY, |a, v| a.min(v.as_vec3()));
    let high = mesh.vertices.iter().fold(Vec3::NEG_INFINITY, |a, v| a.max(v.as_vec3()));
    let accessor = json!({"componentType": 5126, "count": n, "type": "VEC3", "min": low.to_array(), "max": high.to_array()});
    let positions = mesh.vertices.iter().flat_map(|v| bytes_of(*v)).collect();
    attributes["POSITION"] = json!(add(positions, vertices, accessor));
    // Vertices without a normal get one that is at least a direction.
    let normals = mesh.normals().into_iter().map(|n| n.try_normalize().unwrap_or(DVec3::Z));
    let accessor = json!({"componentType": 5126, "count": n, "type": "VEC3"});
    attributes["NORMAL"] = json!(add(normals.flat_map(bytes_of).collect(), vertices, accessor));
    if !mesh.colors.is_empty() {
        let colours = mesh.colors.iter().map(|c| [linear(c[0]), linear(c[1]), linear(c[2]), u16::MAX]);
        let colours = colours.flat_map(|c| c.map(u16::to_le_bytes).concat()).collect();
        let accessor = json!({"componentType": 5123, "normalized": true, "count": n, "type": "VEC4"});
        attributes["COLOR_0"] = json!(add(colours, vertices, accessor));
    }
    let corners = mesh.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let accessor = json!({"componentType": 5125, "count": mesh.triangles.len() * 3, "type": "SCALAR"});
    let indices = add(corners, elements, accessor);
    let document = json!({
        "asset": {"version": "2.0", "generator": "sat-recon"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [1, 0, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{"doubleSided": true, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
        "buffers": [{"byteLength": bin.len()}],
        "bufferViews": views,
        "accessors": accessors,
    });
    write_chunks(path, &document, &bin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{read_mesh, test_folder};

    /// A tetrahedron of this size.
    fn tetrahedron(size: f64) -> Mesh {
        Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X * size, DVec3::Y * size, DVec3::Z * size],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            colors: vec![[255, 0, 10], [0, 128, 0], [1, 2, 3], [9, 8, 7]],
        }
    }

    #[test]
    fn meshes_come_back_at_any_size() {
        let dir = test_folder("mesh_out");
        for size in [1e-6, 1.0, 1e6] {
            let mesh = tetrahedron(size);
            for name in ["a.ply", "a.glb", "plain.ply", "plain.glb"] {
                let mut mesh = mesh.clone();
                if name.starts_with("plain") {
                    mesh.colors.clear();
                }
                write_mesh(&dir.join(name), &mesh).unwrap();
                let found = read_mesh(&dir.join(name)).unwrap();
                assert_eq!(found.triangles, mesh.triangles);
                let upright = if name.ends_with("glb") { DVec3::new(1.0, -1.0, -1.0) } else { DVec3::ONE };
                for (a, b) in found.vertices.iter().zip(&mesh.vertices) {
                    assert!((*a - *b * upright).length() < 1e-6 * size, "{name} {size}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn another_reader_finds_positions_normals_and_colours_in_a_glb() {
        let path = test_folder("mesh_glb").join("a.glb");
        write_mesh(&path, &tetrahedron(1.0)).unwrap();
        let data = std::fs::read(&path).unwrap();
        let file = gltf::Gltf::from_slice(&data).unwrap(); // with its validation
        let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|_| file.blob.as_deref());
        let normals: Vec<[f32; 3]> = reader.read_normals().unwrap().collect();
        assert!(Vec3::from(normals[0]).distance(Vec3::splat(-1.0).normalize()) < 1e-6, "{normals:?}");
        let colours: Vec<[f32; 4]> = reader.read_colors(0).unwrap().into_rgba_f32().collect();
        assert!((colours[1][1] - 0.2158).abs() < 1e-3 && colours[0][0] == 1.0, "{colours:?}"); // 128 in sRGB
    }

    #[test]
    fn what_is_no_mesh_is_not_written() {
        let dir = test_folder("mesh_none");
        assert!(
            write_mesh(&dir.join("a.ply"), &Mesh::default())
                .unwrap_err()
                .to_string()
                .contains("no triangles")
        );
        let said = write_mesh(&dir.join("a.obj"), &tetrahedron(1.0)).unwrap_err().to_string();
        assert!(said.contains(".ply or .glb"), "{said}");
        let colours = Mesh { colors: vec![[0; 3]], ..tetrahedron(1.0) };
        assert!(write_mesh(&dir.join("a.ply"), &colours).is_err());
        assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 0);
    }
}
