//! A mesh whose parts turn on joints, as binary glTF with an animation.

use super::error::IoError;
use super::gltf_builder::{FLOAT, GltfBuilder};
use super::splats::write_chunks;
use crate::geometry::Mesh;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
use std::path::Path;

/// A part of the object, as it is at rest.
#[derive(Clone, Debug)]
pub struct MovingMesh {
    /// What its node is called.
    pub name: String,
    /// At rest, with colours of its vertices.
    pub mesh: Mesh,
    /// What it turns on; `None`: the body.
    pub hinge: Option<Hinge>,
}

/// A joint and how it turned.
#[derive(Clone, Debug)]
pub struct Hinge {
    /// Direction of the axis, unit.
    pub axis: DVec3,
    /// A place on it.
    pub place: DVec3,
    /// Angles, radians, one for each time; 0 at rest.
    pub angles: Vec<f64>,
}

/// Writes the parts: a node for each, which for a joint stands in its place and whose rotation the
/// animation `motion` turns. `times_s`: when the angles were, seconds, ascending. All stand below a
/// node that is rotated by 180° about x, because glTF has y up. Parts without triangles are left
/// out.
pub fn write_moving_glb(path: &Path, parts: &[MovingMesh], times_s: &[f64]) -> Result<(), IoError> {
    let mut b = GltfBuilder::default();
    let (mut nodes, mut meshes) = (vec![json!({"rotation": [1, 0, 0, 0]})], Vec::new());
    let (mut children, mut channels, mut samplers) = (Vec::new(), Vec::new(), Vec::new());
    let moves = parts.iter().any(|p| p.hinge.is_some()) && !times_s.is_empty();
    let times = moves.then(|| add_times(&mut b, times_s));
    for part in parts.iter().filter(|p| !p.mesh.triangles.is_empty()) {
        part.mesh.validate().map_err(|m| IoError::format(path, format!("no usable mesh: {m}")))?;
        meshes.push(json!({"primitives": [primitive(&mut b, &part.mesh)]}));
        let mesh = meshes.len() - 1;
        children.push(nodes.len());
        let (Some(hinge), Some(times)) = (&part.hinge, times) else {
            nodes.push(json!({"name": part.name, "mesh": mesh}));
            continue;
        };
        if hinge.angles.len() != times_s.len() {
            return Err(IoError::format(path, "a joint has another number of angles than there are times"));
        }
        let place = hinge.place.as_vec3();
        let own = nodes.len();
        nodes.push(json!({"name": part.name, "translation": place.to_array(), "children": [own + 1]}));
        nodes.push(json!({"mesh": mesh, "translation": (-place).to_array()}));
        channels.push(json!({"sampler": samplers.len(), "target": {"node": own, "path": "rotation"}}));
        samplers.push(json!({"input": times, "output": add_turns(&mut b, hinge)}));
    }
    nodes[0]["children"] = json!(children);
    let material = json!({
        "doubleSided": true,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
    });
    let mut document = json!({
        "asset": {"version": "2.0", "generator": "sat-recon"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [material],
        "buffers": [{"byteLength": b.bin.len()}],
        "bufferViews": b.views,
        "accessors": b.accessors,
    });
    if !channels.is_empty() {
        document["animations"] = json!([{"name": "motion", "channels": channels, "samplers": samplers}]);
    }
    write_chunks(path, &document, &b.bin)
}

fn primitive(b: &mut GltfBuilder, mesh: &Mesh) -> Value {
    let mut attributes = b.shape(mesh, &mesh.normals());
    if !mesh.colors.is_empty() {
        attributes["COLOR_0"] = json!(b.colours(&mesh.colors));
    }
    json!({"attributes": attributes, "indices": b.triangles(mesh), "material": 0})
}

fn add_times(b: &mut GltfBuilder, times_s: &[f64]) -> usize {
    let times: Vec<f32> = times_s.iter().map(|&t| t as f32).collect();
    let (first, last) = (times[0], times[times.len() - 1]);
    let accessor = json!({
        "componentType": FLOAT, "count": times.len(), "type": "SCALAR", "min": [first], "max": [last],
    });
    b.accessor(times.iter().flat_map(|t| t.to_le_bytes()).collect(), None, accessor)
}

/// Quaternions (x, y, z, w) about the axis, of which each takes the short way from the one before.
fn add_turns(b: &mut GltfBuilder, hinge: &Hinge) -> usize {
    let mut before = DQuat::IDENTITY;
    let turns = hinge.angles.iter().map(|&angle| {
        let turn = DQuat::from_axis_angle(hinge.axis, angle);
        before = if turn.dot(before) < 0.0 { -turn } else { turn };
        before.as_quat().to_array()
    });
    let bytes = turns.flatten().flat_map(f32::to_le_bytes).collect();
    let accessor = json!({"componentType": FLOAT, "count": hinge.angles.len(), "type": "VEC4"});
    b.accessor(bytes, None, accessor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::test_folder;

    fn triangle(name: &str, hinge: Option<Hinge>) -> MovingMesh {
        let mesh = Mesh {
            vertices: vec![DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2]],
            colors: vec![[9, 99, 199]; 3],
        };
        MovingMesh { name: name.to_owned(), mesh, hinge }
    }

    fn hinge(angles: Vec<f64>) -> Option<Hinge> {
        Some(Hinge { axis: DVec3::Z, place: DVec3::new(0.5, 0.0, 2.0), angles })
    }

    #[test]
    fn another_reader_finds_the_nodes_and_the_turns() {
        let path = test_folder("moving_glb").join("a.glb");
        let parts = [triangle("body", None), triangle("part1", hinge(vec![0.0, 1.0, 2.5, 4.0]))];
        write_moving_glb(&path, &parts, &[0.0, 0.5, 1.0, 2.0]).unwrap();
        let data = std::fs::read(&path).unwrap();
        let file = gltf::Gltf::from_slice(&data).unwrap(); // with its validation
        let blob = file.blob.clone().unwrap();
        // The root, the body, the hinge and the mesh that hangs on it.
        let children: Vec<usize> = file.nodes().map(|n| n.children().count()).collect();
        assert_eq!(children, [2, 0, 1, 0]);
        assert!(data.windows(7).any(|w| w == b"\"part1\""));
        let animation = file.animations().next().unwrap();
        let channel = animation.channels().next().unwrap();
        assert_eq!(channel.target().node().index(), 2);
        let reader = channel.reader(|_| Some(&blob));
        assert_eq!(reader.read_inputs().unwrap().collect::<Vec<f32>>(), [0.0, 0.5, 1.0, 2.0]);
        let Some(gltf::animation::util::ReadOutputs::Rotations(turns)) = reader.read_outputs() else {
            panic!("no rotations")
        };
        let turns: Vec<glam::Quat> = turns.into_f32().map(glam::Quat::from_array).collect();
        for (turn, angle) in turns.iter().zip([0.0f32, 1.0, 2.5, 4.0]) {
            let moved = *turn * glam::Vec3::X;
            assert!(moved.distance(glam::Vec3::new(angle.cos(), angle.sin(), 0.0)) < 1e-6, "{moved}");
        }
        assert!(turns.windows(2).all(|w| w[0].dot(w[1]) > 0.0), "the short way");
    }

    #[test]
    fn a_body_alone_has_no_animation_and_wrong_angles_are_refused() {
        let path = test_folder("moving_glb_still").join("a.glb");
        write_moving_glb(&path, &[triangle("body", None)], &[]).unwrap();
        let file = gltf::Gltf::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!((file.animations().count(), file.meshes().count()), (0, 1));
        let wrong = [triangle("part1", hinge(vec![0.0]))];
        let said = write_moving_glb(&path, &wrong, &[0.0, 1.0]).unwrap_err().to_string();
        assert!(said.contains("another number of angles"), "{said}");
    }
}
