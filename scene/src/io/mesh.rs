//! Triangle meshes from PLY, OBJ and binary glTF.

use super::error::{IoError, read_file};
use super::ply::Ply;
use crate::geometry::Mesh;
use glam::{DMat4, DVec3, Mat4};
use gltf::mesh::Mode;
use std::collections::BTreeSet;
use std::path::Path;

/// Reads a mesh; the ending says the format: `.ply`, `.obj`, `.glb` (its scene, with the transforms
/// of its nodes). Polygons become fans of triangles. Colours, normals and materials are left out.
pub fn read_mesh(path: &Path) -> Result<Mesh, IoError> {
    parse_mesh(path, &read_file(path)?)
}

/// The same, of the file's content. `path` says the format and names the file in messages.
pub fn parse_mesh(path: &Path, data: &[u8]) -> Result<Mesh, IoError> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let mesh = match ending.as_str() {
        "ply" => parse_ply(path, data)?,
        "obj" => parse_obj(path, data)?,
        "glb" => parse_glb(path, data)?,
        _ => return Err(IoError::format(path, "expected a mesh that ends in .ply, .obj or .glb")),
    };
    mesh.validate().map_err(|m| IoError::format(path, format!("no usable mesh: {m}")))?;
    Ok(mesh)
}

fn parse_ply(path: &Path, data: &[u8]) -> Result<Mesh, IoError> {
    let ply = Ply::parse(path, data)?;
    let mut mesh = Mesh::default();
    ply.rows("vertex", &["x", "y", "z"], |_, v| {
        mesh.vertices.push(DVec3::from_slice(v));
        Ok(())
    })?;
    ply.lists("face", &["vertex_indices", "vertex_index"], |row, indices| {
        let whole = indices.iter().all(|i| i.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(i));
        if !whole {
            return Err(IoError::format(path, format!("face {row} names no vertices")));
        }
        let indices: Vec<u32> = indices.iter().map(|i| *i as u32).collect();
        fan(&indices, &mut mesh.triangles);
        Ok(())
    })?;
    Ok(mesh)
}

fn fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) {
    for pair in polygon.windows(2).skip(1) {
        triangles.push([polygon[0], pair[0], pair[1]]);
    }
}

/// The vertices and faces of an OBJ file, faces without texture coordinates and normals: the
/// library's numbers of those, which nothing here needs, can overflow.
fn shape_of_obj(data: &[u8]) -> Vec<u8> {
    let mut kept = Vec::with_capacity(data.len());
    for line in data.split(|b| *b == b'\n').map(<[u8]>::trim_ascii) {
        if line.starts_with(b"v") && line.get(1).is_some_and(u8::is_ascii_whitespace) {
            kept.extend_from_slice(line);
        } else if line.starts_with(b"f") {
            let words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
            for word in words {
                kept.extend_from_slice(word.split(|b| *b == b'/').next().unwrap_or_default());
                kept.push(b' ');
            }
        } else if line.starts_with(b"o") || line.starts_with(b"g") {
            kept.push(line[0]); // a new part
        }
        kept.push(b'\n');
    }
    kept
}

fn parse_obj(path: &Path, data: &[u8]) -> Result<Mesh, IoError> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..Default::default()
    };
    // Materials are another file, which is not looked for.
    let loaded = tobj::load_obj_buf(&mut shape_of_obj(data).as_slice(), &options, |_| Ok(Default::default()));
    let (models, _) = loaded.map_err(|e| IoError::format(path, format!("not a readable OBJ file: {e}")))?;
    let mut mesh = Mesh::default();
    for model in models {
        let first = mesh.vertices.len() as u32;
        let (positions, _) = model.mesh.positions.as_chunks::<3>();
        mesh.vertices.extend(positions.iter().map(|p| DVec3::from_array(p.map(f64::from))));
        let (triangles, _) = model.mesh.indices.as_chunks::<3>();
        mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i.saturating_add(first))));
    }
    Ok(mesh)
}

fn bad_glb(path: &Path, message: String) -> IoError {
    IoError::format(path, format!("not a readable binary glTF file: {message}"))
}

fn parse_glb(path: &Path, data: &[u8]) -> Result<Mesh, IoError> {
    // The library subtracts the header from the length that the file says.
    let length = data.get(8..12).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    if length < 12 {
        return Err(bad_glb(path, format!("its length is said to be {length} bytes")));
    }
    let file = gltf::Gltf::from_slice_without_validation(data).map_err(|e| bad_glb(path, e.to_string()))?;
    let blob = file.blob.as_deref().unwrap_or_default();
    let json = file.document.into_json();
    check_indices(&json).map_err(|e| bad_glb(path, e))?;
    let file = gltf::Document::from_json(json).map_err(|e| bad_glb(path, e.to_string()))?;
    for accessor in file.accessors() {
        check(&accessor, blob.len()).map_err(|e| bad_glb(path, e))?;
    }
    let mut mesh = Mesh::default();
    let scene = file.default_scene().or_else(|| file.scenes().next());
    let scene = scene.ok_or_else(|| bad_glb(path, "it has no scene".to_owned()))?;
    let mut open: Vec<(gltf::Node, DMat4)> = scene.nodes().map(|n| (n, DMat4::IDENTITY)).collect();
    let mut seen = BTreeSet::new();
    while let Some((node, parent)) = open.pop() {
        if !seen.insert(node.index()) {
            return Err(bad_glb(path, format!("node {} hangs in two places", node.index())));
        }
        let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            add(&primitive, blob, &world, &mut mesh).map_err(|e| bad_glb(path, e))?;
        }
        open.extend(node.children().map(|child| (child, world)));
    }
    Ok(mesh)
}

/// Whether the accessors of all primitives exist, which the library's own check takes for granted.
fn check_indices(json: &gltf::json::Root) -> Result<(), String> {
    let primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let highest = primitives.flat_map(|p| p.attributes.values()).map(|index| index.value()).max();
    match highest {
        Some(index) if index >= json.accessors.len() => Err(format!("accessor {index} is missing")),
        _ => Ok(()),
    }
}

/// Whether all of an accessor lies in the file.
fn check(accessor: &gltf::Accessor, bytes: usize) -> Result<(), String> {
    let number = accessor.index();
    let Some(view) = accessor.view().filter(|_| accessor.sparse().is_none()) else {
        return Err(format!("accessor {number} is sparse or without data, which is not supported"));
    };
    if !matches!(view.buffer().source(), gltf::buffer::Source::Bin) {
        return Err("its data lies in another file; export it as one .glb".to_owned());
    }
    if accessor.count() == 0 {
        return Err(format!("accessor {number} has no values"));
    }
    let size = accessor.size();
    if view.stride().is_some_and(|stride| stride < size) {
        return Err(format!("the values of accessor {number} overlap"));
    }
    let step = view.stride().unwrap_or(size).max(size);
    let inside = step.checked_mul(accessor.count().saturating_sub(1)).and_then(|n| n.checked_add(size));
    let end = inside.and_then(|n| n.checked_add(accessor.offset())).unwrap_or(usize::MAX);
    let last = view.offset().saturating_add(view.length());
    if end > view.length() || last > bytes {
        return Err(format!("accessor {number} reaches beyond the file's {bytes} bytes"));
    }
    Ok(())
}

fn add(primitive: &gltf::Primitive, blob: &[u8], world: &DMat4, mesh: &mut Mesh) -> Result<(), String> {
    if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        return Ok(()); // points and lines have no surface
    }
    use gltf::accessor::{DataType, Dimensions};
    let is_number = |a: &gltf::Accessor| {
        matches!(a.data_type(), DataType::U8 | DataType::U16 | DataType::U32)
            && a.dimensions() == Dimensions::Scalar
    };
    if primitive.indices().is_some_and(|indices| !is_number(&indices)) {
        return Err("the indices of a primitive are no numbers of vertices".to_owned());
    }
    let positions = primitive.get(&gltf::Semantic::Positions);
    let is_place = |a: &gltf::Accessor| (a.data_type(), a.dimensions()) == (DataType::F32, Dimensions::Vec3);
    if positions.is_some_and(|positions| !is_place(&positions)) {
        return Err("the positions of a primitive are no points in space".to_owned());
    }
    let reader = primitive.reader(|_| Some(blob));
    let positions = reader.read_positions().ok_or("a primitive has no positions")?;
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(positions.map(|p| world.transform_point3(DVec3::from_array(p.map(f64::from)))));
    let count = mesh.vertices.len() as u32 - first;
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().map(|i| i.saturating_add(first)).collect(),
        None => (first..first + count).collect(),
    };
    match primitive.mode() {
        Mode::Triangles => mesh.triangles.extend(indices.as_chunks::<3>().0),
        Mode::TriangleFan => fan(&indices, &mut mesh.triangles),
        _ => mesh.triangles.extend(indices.windows(3).map(|t| [t[0], t[1], t[2]])),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::test_folder;
    use std::fs;

    fn written(name: &str, bytes: &[u8]) -> std::path::PathBuf {
        let path = test_folder(&format!("mesh_{}", name.replace('.', "_"))).join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty uchar red\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0\n2 0 0\n2 2 0\n0 2 0\n9 4 0 1 2 3\n";

    #[test]
    fn a_square_is_the_same_mesh_in_ply_and_obj() {
        let ply = read_mesh(&written("square.ply", PLY.as_bytes())).unwrap();
        assert_eq!(ply.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(ply.area(), 4.0);
        let obj = b"mtllib none.mtl\nv 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nf 1 2 3 4\n";
        let obj = read_mesh(&written("square.obj", obj)).unwrap();
        assert_eq!((obj.area(), obj.triangles.len()), (4.0, 2));
    }

    #[test]
    fn numbers_of_texture_coordinates_and_normals_of_an_obj_do_not_matter() {
        let square = |faces: &str| {
            let parts = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n";
            read_mesh(&written("coordinates.obj", format!("{parts}f {faces}\n").as_bytes()))
        };
        let plain = square("1 2 3 4").unwrap();
        for (vt, vn) in [("1", "1"), ("2", ""), ("", "1"), ("99", "-99"), ("x", "y")] {
            let faces = [1, 2, 3, -1].map(|v| format!("{v}/{vt}/{vn}")).join(" ");
            let mesh = square(&faces).unwrap();
            assert_eq!((&mesh.vertices, &mesh.triangles), (&plain.vertices, &plain.triangles), "{faces}");
        }
        // Twice such a number plus one is beyond 64 bits, or inside the list again.
        for far in [i64::MIN, i64::MIN + 1, i64::MAX, i64::MAX / 2 + 2] {
            let faces = [1, 2, 3, 4].map(|v| format!("{v}/{far}/{far}")).join(" ");
            assert_eq!(square(&faces).unwrap().triangles, plain.triangles, "{faces}");
        }
        assert!(square("1/1/1 2/1/1 5/1/1").is_err(), "a vertex that is not there");
    }

    /// A triangle with legs 1 and 2, moved by 5 and scaled by 3, as binary glTF; `count` of its
    /// positions as said.
    fn glb(count: u32, nodes: &str) -> Vec<u8> {
        let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0];
        let blob: Vec<u8> = positions.iter().flat_map(|v| v.to_le_bytes()).collect();
        let mut json = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":{nodes},
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"buffers":[{{"byteLength":36}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],"accessors":[{{"bufferView":0,"componentType":5126,
            "count":{count},"type":"VEC3","min":[0,0,0],"max":[1,2,0]}}]}}"#
        );
        while json.len() % 4 != 0 {
            json.push(' ');
        }
        let chunk =
            |kind: &[u8; 4], data: &[u8]| [&(data.len() as u32).to_le_bytes()[..], kind, data].concat();
        let body = [chunk(b"JSON", json.as_bytes()), chunk(b"BIN\0", &blob)].concat();
        let length = (12 + body.len() as u32).to_le_bytes();
        [&b"glTF"[..], &2_u32.to_le_bytes(), &length, &body].concat()
    }

    #[test]
    fn the_nodes_of_a_glb_move_its_triangles_and_lies_are_refused() {
        let nodes = r#"[{"translation":[5,0,0],"children":[1]},{"scale":[3,3,3],"mesh":0}]"#;
        let path = written("triangle.glb", &glb(3, nodes));
        let mesh = read_mesh(&path).unwrap();
        assert_eq!((mesh.area(), mesh.corners(0)[1]), (9.0, DVec3::new(8.0, 0.0, 0.0)));
        fs::write(&path, glb(1_000_000, nodes)).unwrap();
        assert!(read_mesh(&path).unwrap_err().to_string().contains("beyond the file"));
        let cycle = r#"[{"children":[1]},{"children":[0],"mesh":0}]"#;
        fs::write(&path, glb(3, cycle)).unwrap();
        assert!(read_mesh(&path).unwrap_err().to_string().contains("two places"));
        for (from, to, what) in [
            (r#""POSITION":0"#, r#""POSITION":9"#, "accessor 9 is missing"),
            (r#""bufferView":0"#, r#""bufferView":7"#, "bufferView"),
            (r#""mesh":0"#, r#""mesh":5"#, "mesh"),
            (r#""buffer":0"#, r#""buffer":3"#, "buffer"),
        ] {
            let mut bytes = glb(3, nodes);
            let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
            bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
            fs::write(&path, bytes).unwrap();
            let error = read_mesh(&path).unwrap_err().to_string();
            assert!(error.contains(what), "{to}: {error}");
        }
        let whole = glb(3, nodes);
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(read_mesh(&path).is_err(), "cut to {length} bytes");
        }
    }

    #[test]
    fn meshes_that_name_what_is_not_there_are_refused() {
        for (from, to) in
            [("9 4 0 1 2 3", "9 4 0 1 2 4"), ("9 4 0 1 2 3", "9 4 0 1 -2 3"), ("2 2 0", "2 nan 0")]
        {
            assert!(read_mesh(&written("bad.ply", PLY.replace(from, to).as_bytes())).is_err(), "{to}");
        }
        let huge = PLY.replace("element face 1", "element face 4000000000");
        assert!(matches!(read_mesh(&written("huge.ply", huge.as_bytes())), Err(IoError::Truncated { .. })));
        assert!(read_mesh(&written("cloud.ply", PLY.replace("9 4 0 1 2 3", "9 0").as_bytes())).is_err());
        assert!(read_mesh(&written("far.obj", b"v 0 0 0\nf 1 2 3\n")).is_err());
        assert!(read_mesh(&written("mesh.stl", b"solid")).unwrap_err().to_string().contains(".ply"));
    }
}
