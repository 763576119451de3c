//! Triangle meshes to PLY, OBJ and binary glTF.

use super::error::IoError;
use super::gltf_builder::{GltfBuilder, bytes_of};
use super::splats::write_chunks;
use super::write_atomic;
use crate::geometry::{Mesh, TexturedMesh};
use glam::{DVec2, DVec3};
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// Quality of textures, of 100. Source: chosen by hand, never measured.
const JPEG_QUALITY: u8 = 92;

/// What a mesh shows beside its shape.
enum Paint<'a> {
    Nothing,
    /// sRGB of each vertex.
    Vertices(&'a [[u8; 3]]),
    /// A picture and each vertex' place in it, y down.
    Texture {
        uvs: &'a [DVec2],
        jpeg: Vec<u8>,
    },
}

/// Writes a mesh with its normals and, if it has them, colours; the ending says the format: `.ply`
/// (binary) and `.obj` in the mesh's frame, or `.glb` (its node is rotated by 180° about x, like
/// splats, because glTF has y up).
pub fn write_mesh(path: &Path, mesh: &Mesh) -> Result<(), IoError> {
    mesh.validate().map_err(|m| IoError::format(path, format!("no usable mesh: {m}")))?;
    let paint = if mesh.colors.is_empty() { Paint::Nothing } else { Paint::Vertices(&mesh.colors) };
    match ending(path).as_str() {
        "ply" => write_ply(path, mesh),
        "glb" => write_glb(path, mesh, &mesh.normals(), &paint),
        "obj" => write_obj(path, mesh, &mesh.normals(), &paint),
        _ => Err(IoError::format(path, "a mesh is written as .ply, .glb or .obj")),
    }
}

/// Writes a mesh with its texture, which is JPEG: `.glb` with the texture inside and no light but
/// that of the photos (`KHR_materials_unlit`), or `.obj` with a `.mtl` and a `.jpg` beside it.
pub fn write_textured_mesh(path: &Path, textured: &TexturedMesh) -> Result<(), IoError> {
    let mesh = &textured.mesh;
    mesh.validate().map_err(|m| IoError::format(path, format!("no usable mesh: {m}")))?;
    let n = mesh.vertices.len();
    if textured.uvs.len() != n || textured.normals.len() != n {
        return Err(IoError::format(path, "a vertex has no normal or no place in the texture"));
    }
    let mut jpeg = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY);
    let written = textured.texture.write_with_encoder(encoder);
    written.map_err(|e| IoError::format(path, format!("the texture cannot be written: {e}")))?;
    let paint = Paint::Texture { uvs: &textured.uvs, jpeg };
    match ending(path).as_str() {
        "glb" => write_glb(path, mesh, &textured.normals, &paint),
        "obj" => write_obj(path, mesh, &textured.normals, &paint),
        _ => Err(IoError::format(path, "a mesh with a texture is written as .glb or .obj")),
    }
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
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

fn write_glb(path: &Path, mesh: &Mesh, normals: &[DVec3], paint: &Paint) -> Result<(), IoError> {
    let n = mesh.vertices.len();
    let (mut b, vertices) = (GltfBuilder::default(), Some(GltfBuilder::VERTICES));
    let mut attributes = b.shape(mesh, normals);
    let mut material =
        json!({"doubleSided": true, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}});
    let mut extra = json!({});
    match paint {
        Paint::Nothing => {}
        Paint::Vertices(colors) => {
            attributes["COLOR_0"] = json!(b.colours(colors));
        }
        Paint::Texture { uvs, jpeg } => {
            let places = uvs.iter().flat_map(|uv| uv.as_vec2().to_array()).flat_map(f32::to_le_bytes);
            let accessor = json!({"componentType": 5126, "count": n, "type": "VEC2"});
            attributes["TEXCOORD_0"] = json!(b.accessor(places.collect(), vertices, accessor));
            // Photos have their light in them: other light must not be added.
            material["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
            material["extensions"] = json!({"KHR_materials_unlit": {}});
            let image = json!({"bufferView": b.view(jpeg.clone(), None), "mimeType": "image/jpeg"});
            let (linear, mipmaps, clamped) = (9729, 9987, 33_071);
            extra = json!({
                "extensionsUsed": ["KHR_materials_unlit"],
                "images": [image],
                "samplers": [{"magFilter": linear, "minFilter": mipmaps, "wrapS": clamped, "wrapT": clamped}],
                "textures": [{"source": 0, "sampler": 0}],
            });
        }
    }
    let indices = b.triangles(mesh);
    let mut document = json!({
        "asset": {"version": "2.0", "generator": "sat-recon"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [1, 0, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
        "buffers": [{"byteLength": b.bin.len()}],
        "bufferViews": b.views,
        "accessors": b.accessors,
    });
    if let (Some(document), Some(extra)) = (document.as_object_mut(), extra.as_object()) {
        document.extend(extra.clone());
    }
    write_chunks(path, &document, &b.bin)
}

/// `.obj`; colours of vertices stand behind their positions, as many programs read them.
fn write_obj(path: &Path, mesh: &Mesh, normals: &[DVec3], paint: &Paint) -> Result<(), IoError> {
    let name =
        |ending: &str| path.with_extension(ending).file_name().map(|n| n.to_string_lossy().into_owned());
    let (material, picture) = (name("mtl").unwrap_or_default(), name("jpg").unwrap_or_default());
    if let Paint::Texture { jpeg, .. } = paint {
        write_atomic(&path.with_extension("jpg"), |w| w.write_all(jpeg))?;
        write_atomic(&path.with_extension("mtl"), |w| {
            writeln!(w, "# sat-recon\nnewmtl photos\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture}")
        })?;
    }
    write_atomic(path, |w| {
        writeln!(w, "# sat-recon")?;
        if let Paint::Texture { .. } = paint {
            writeln!(w, "mtllib {material}\nusemtl photos")?;
        }
        for (i, v) in mesh.vertices.iter().enumerate() {
            write!(w, "v {} {} {}", v.x as f32, v.y as f32, v.z as f32)?;
            if let Paint::Vertices(colors) = paint {
                colors[i].iter().try_for_each(|c| write!(w, " {:.4}", f32::from(*c) / 255.0))?;
            }
            writeln!(w)?;
        }
        for n in normals {
            writeln!(w, "vn {:.5} {:.5} {:.5}", n.x, n.y, n.z)?;
        }
        if let Paint::Texture { uvs, .. } = paint {
            // Here y goes up.
            uvs.iter().try_for_each(|uv| writeln!(w, "vt {} {}", uv.x as f32, (1.0 - uv.y) as f32))?;
        }
        for triangle in &mesh.triangles {
            let corners = triangle.map(|v| v + 1).map(|v| match paint {
                Paint::Texture { .. } => format!("{v}/{v}/{v}"),
                _ => format!("{v}//{v}"),
            });
            writeln!(w, "f {}", corners.join(" "))?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{read_mesh, test_folder};
    use glam::Vec3;

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
            for name in ["a.ply", "a.glb", "a.obj", "plain.ply", "plain.glb", "plain.obj"] {
                let mut mesh = mesh.clone();
                if name.starts_with("plain") {
                    mesh.colors.clear();
                }
                write_mesh(&dir.join(name), &mesh).unwrap();
                let found = read_mesh(&dir.join(name)).unwrap();
                let upright = if name.ends_with("glb") { DVec3::new(1.0, -1.0, -1.0) } else { DVec3::ONE };
                // The reader of .obj numbers vertices in the order of their use.
                assert_eq!(found.triangles.len(), mesh.triangles.len());
                for i in 0..mesh.triangles.len() {
                    for (a, b) in found.corners(i).into_iter().zip(mesh.corners(i)) {
                        assert!((a - b * upright).length() < 1e-6 * size, "{name} {size}: {a} {b}");
                    }
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
        let said = write_mesh(&dir.join("a.stl"), &tetrahedron(1.0)).unwrap_err().to_string();
        assert!(said.contains(".glb or .obj"), "{said}");
        let colours = Mesh { colors: vec![[0; 3]], ..tetrahedron(1.0) };
        assert!(write_mesh(&dir.join("a.ply"), &colours).is_err());
        assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 0);
    }

    /// The tetrahedron with a picture of one colour a vertex.
    fn textured() -> TexturedMesh {
        let mesh = Mesh { colors: vec![], ..tetrahedron(1.0) };
        let texture = image::RgbImage::from_fn(32, 16, |x, y| image::Rgb([8 * x as u8, 16 * y as u8, 40]));
        let uvs = (0..4).map(|i| DVec2::new(0.2 * f64::from(i) + 0.1, 0.9 - 0.1 * f64::from(i))).collect();
        TexturedMesh { normals: mesh.normals(), mesh, uvs, texture }
    }

    #[test]
    fn a_texture_and_its_places_come_back_from_a_glb() {
        let path = test_folder("mesh_textured").join("a.glb");
        write_textured_mesh(&path, &textured()).unwrap();
        let data = std::fs::read(&path).unwrap();
        let file = gltf::Gltf::from_slice(&data).unwrap(); // with its validation
        let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
        let blob = file.blob.clone().unwrap();
        let reader = primitive.reader(|_| Some(&blob));
        let uvs: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
        assert_eq!(uvs[2], [0.5, 0.7]);
        let source = file.textures().next().unwrap().source().source();
        let gltf::image::Source::View { view, mime_type } = source else { panic!("not inside") };
        assert_eq!(mime_type, "image/jpeg");
        let picture = &blob[view.offset()..view.offset() + view.length()];
        let picture = image::load_from_memory(picture).unwrap().into_rgb8();
        let (found, wanted) = (picture.get_pixel(20, 10).0, textured().texture.get_pixel(20, 10).0);
        assert!(found.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) < 12), "{found:?} {wanted:?}");
        let material = primitive.material();
        assert_eq!(material.pbr_metallic_roughness().metallic_factor(), 0.0);
        assert!(file.extensions_used().any(|e| e == "KHR_materials_unlit"));
        assert_eq!(read_mesh(&path).unwrap().triangles, textured().mesh.triangles);
    }

    #[test]
    fn an_obj_names_its_material_and_that_its_picture() {
        let dir = test_folder("mesh_obj");
        write_textured_mesh(&dir.join("a.obj"), &textured()).unwrap();
        let (models, materials) = tobj::load_obj(dir.join("a.obj"), &tobj::GPU_LOAD_OPTIONS).unwrap();
        let materials = materials.unwrap();
        assert_eq!(materials[0].diffuse_texture.as_deref(), Some("a.jpg"));
        assert_eq!(models[0].mesh.material_id, Some(0));
        // The third vertex in the order of their use is the second of the mesh.
        assert!((models[0].mesh.texcoords[5] - (1.0 - 0.8)).abs() < 1e-6);
        assert!(image::open(dir.join("a.jpg")).unwrap().width() == 32);
        let mut broken = textured();
        broken.uvs.pop();
        assert!(write_textured_mesh(&dir.join("b.obj"), &broken).is_err());
        assert!(write_textured_mesh(&dir.join("b.ply"), &textured()).is_err());
    }
}
