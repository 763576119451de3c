//! Agisoft Metashape's cameras (`File > Export > Export Cameras`, Agisoft XML).
//!
//! Camera axes are x right, y down, z forward. Pixels: `f x' + cx + width / 2`, with affinity `b1 =
//! fx − fy`; tangential coefficients stand the other way round than OpenCV's (Metashape Pro user
//! manual, appendix D, camera models).

use super::imported::{ImportedPoses, add, brown, numbers, refuse_distortion, rotation};
use crate::io::error::{IoError, read_text};
use crate::io::transforms::WORLD_FROM_TRANSFORMS;
use crate::io::{safe_name, write_atomic};
use crate::sim3::Sim3;
use crate::{Camera, Pose, Reconstruction};
use glam::{DMat3, DVec3};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

pub(super) fn read(path: &Path) -> Result<ImportedPoses, IoError> {
    parse(path, &read_text(path)?)
}

/// Parses the content of a file of Metashape's cameras. `path` names the file in messages.
pub fn parse(path: &Path, text: &str) -> Result<ImportedPoses, IoError> {
    let document = Document::parse(text)
        .map_err(|e| IoError::format(path, format!("expected XML that Metashape exports: {e}")))?;
    let Some(chunk) = document.descendants().find(|n| n.has_tag_name("chunk")) else {
        return Err(IoError::format(path, "expected a chunk of cameras as Metashape exports them"));
    };
    let mut sensors = BTreeMap::new();
    for sensor in chunk.descendants().filter(|n| n.has_tag_name("sensor")) {
        if let (Some(id), Some(camera)) = (sensor.attribute("id"), sensor_camera(path, sensor)?) {
            sensors.insert(id, camera);
        }
    }
    let frames = Frames::of(path, chunk)?;
    let mut model = Reconstruction::default();
    for camera in chunk.descendants().filter(|n| n.has_tag_name("camera")) {
        let Some(matrix) = child_text(camera, "transform") else { continue }; // not aligned
        let label = camera.attribute("label").unwrap_or_default();
        let v = numbers(path, label, matrix)?;
        let Some(sensor) = camera.attribute("sensor_id").and_then(|id| sensors.get(id)) else {
            return Err(IoError::format(path, format!("{label}: its sensor has no calibration")));
        };
        if v.len() != 16 {
            return Err(IoError::format(path, format!("{label}: expected 16 numbers, found {}", v.len())));
        }
        let rows = [0, 1, 2, 4, 5, 6, 8, 9, 10].map(|i| v[i]);
        let local_from_camera = rotation(path, label, &rows)?;
        let pose = Pose::from_centre(local_from_camera.conjugate(), DVec3::new(v[3], v[7], v[11]));
        let file_from_local = frames.file_from_local(camera.attribute("component_id"));
        let pose = frames.world_from_file.transform_pose(&file_from_local.transform_pose(&pose));
        add(path, &mut model, label, sensor.clone(), pose)?;
    }
    Ok(ImportedPoses::of(model, frames.world_from_file))
}

/// Where components and the chunk lie in the file's frame, and that in the world.
struct Frames {
    components: BTreeMap<String, Sim3>,
    chunk: Sim3,
    world_from_file: Sim3,
}

impl Frames {
    /// Coordinates on the globe are millions of metres: there the chunk's own are taken, of which
    /// nothing says what is up.
    fn of(path: &Path, chunk: Node<'_, '_>) -> Result<Self, IoError> {
        let reference = child_text(chunk, "reference").unwrap_or_default();
        let global = ["GEOGCS", "GEOCCS", "PROJCS"].iter().any(|c| reference.contains(c));
        let mut found =
            Self { components: BTreeMap::new(), chunk: Sim3::IDENTITY, world_from_file: Sim3::IDENTITY };
        if global {
            return Ok(found);
        }
        let mut known = false;
        if let Some(node) = chunk.children().find(|n| n.has_tag_name("transform")) {
            (found.chunk, known) = (similarity(path, node)?, true);
        }
        for component in chunk.descendants().filter(|n| n.has_tag_name("component")) {
            if let (Some(id), Some(node)) =
                (component.attribute("id"), component.children().find(|n| n.has_tag_name("transform")))
            {
                known = true;
                found.components.insert(id.to_owned(), similarity(path, node)?);
            }
        }
        if known {
            found.world_from_file = WORLD_FROM_TRANSFORMS;
        }
        Ok(found)
    }

    fn file_from_local(&self, component: Option<&str>) -> Sim3 {
        component.and_then(|id| self.components.get(id)).copied().unwrap_or(self.chunk)
    }
}

/// The numbers of a child, where there is one.
fn child_numbers(path: &Path, node: Node<'_, '_>, name: &str) -> Result<Option<Vec<f64>>, IoError> {
    child_text(node, name).map(|t| numbers(path, name, t)).transpose()
}

fn similarity(path: &Path, node: Node<'_, '_>) -> Result<Sim3, IoError> {
    let [turn, shift, scale] =
        ["rotation", "translation", "scale"].map(|name| child_numbers(path, node, name));
    let (turn, shift, scale) = (turn?, shift?, scale?);
    let wrong = || IoError::format(path, "expected a rotation, a translation and a scale of a transform");
    let rotation = match turn.as_deref() {
        Some(v) if v.len() == 9 => rotation(path, "transform", v)?,
        None => glam::DQuat::IDENTITY,
        _ => return Err(wrong()),
    };
    let translation = match shift.as_deref() {
        Some(&[x, y, z]) => DVec3::new(x, y, z),
        None => DVec3::ZERO,
        _ => return Err(wrong()),
    };
    let scale = scale.map_or(Some(1.0), |s| s.first().copied()).filter(|s| *s > 0.0).ok_or_else(wrong)?;
    Ok(Sim3 { scale, rotation, translation })
}

fn child_text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    node.children().find(|n| n.has_tag_name(name))?.text()
}

/// The adjusted calibration of a sensor, else its first.
fn sensor_camera(path: &Path, sensor: Node<'_, '_>) -> Result<Option<Camera>, IoError> {
    let all: Vec<Node> = sensor.children().filter(|n| n.has_tag_name("calibration")).collect();
    let adjusted = all.iter().find(|n| n.attribute("class") == Some("adjusted"));
    let Some(&calibration) = adjusted.or(all.first()) else { return Ok(None) };
    let kind = sensor.attribute("type").unwrap_or("frame");
    if kind != "frame" {
        return Err(IoError::UnsupportedCamera { path: path.into(), model: kind.to_owned() });
    }
    let number = |name: &str| -> Result<f64, IoError> {
        Ok(child_numbers(path, calibration, name)?.and_then(|v| v.first().copied()).unwrap_or(0.0))
    };
    let resolution = calibration.children().find(|n| n.has_tag_name("resolution"));
    let resolution = resolution.or_else(|| sensor.children().find(|n| n.has_tag_name("resolution")));
    let size = ["width", "height"]
        .map(|side| resolution.and_then(|n| n.attribute(side)?.parse::<u32>().ok()).unwrap_or(0));
    let f = number("f")?;
    refuse_distortion(
        path,
        "frame with k3, k4, p3, p4 or b2",
        &[number("k3")?, number("k4")?, number("p3")?, number("p4")?, number("b2")?],
    )?;
    let centre = [number("cx")? + f64::from(size[0]) / 2.0, number("cy")? + f64::from(size[1]) / 2.0];
    let distortion = [number("k1")?, number("k2")?, number("p2")?, number("p1")?];
    Ok(Some(brown(size, [f + number("b1")?, f, centre[0], centre[1]], distortion)))
}

/// Writes cameras and poses for `File > Import > Import Cameras`. The images are to be added to the
/// chunk first; Metashape knows them by their names without ending.
pub fn write_metashape(path: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let mut sensors = String::new();
    for camera in model.cameras.values() {
        sensors += &sensor_xml(camera);
    }
    let mut cameras = String::new();
    let file_from_world = WORLD_FROM_TRANSFORMS.inverse();
    for image in model.images.values() {
        let name = safe_name(&image.name).map_err(IoError::name(path))?;
        let pose = file_from_world.transform_pose(&image.pose);
        let turn = DMat3::from_quat(pose.rotation.conjugate());
        let rows = [0, 1, 2].map(|r| turn.row(r).extend(pose.centre()[r]).to_array());
        let numbers: Vec<String> = rows.as_flattened().iter().map(f64::to_string).collect();
        let label = escaped(&Path::new(name).with_extension("").to_string_lossy());
        cameras += &format!(
            "      <camera id=\"{}\" sensor_id=\"{}\" component_id=\"0\" label=\"{label}\">\n        \
             <transform>{} 0 0 0 1</transform>\n      </camera>\n",
            image.id,
            image.camera,
            numbers.join(" ")
        );
    }
    write_atomic(path, |w| {
        write!(
            w,
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\">\n  \
             <chunk label=\"Chunk 1\" enabled=\"true\">\n    <sensors>\n{sensors}    </sensors>\n    \
             <components active_id=\"0\">\n      <component id=\"0\" label=\"Component 1\">\n        \
             <transform>\n          <rotation locked=\"false\">1 0 0 0 1 0 0 0 1</rotation>\n          \
             <translation locked=\"false\">0 0 0</translation>\n          \
             <scale locked=\"false\">1</scale>\n        </transform>\n      </component>\n    \
             </components>\n    <cameras>\n{cameras}    </cameras>\n    \
             <reference>LOCAL_CS[\"Local Coordinates (m)\",LOCAL_DATUM[\"Local Datum\",0],\
             UNIT[\"metre\",1,AUTHORITY[\"EPSG\",\"9001\"]]]</reference>\n  </chunk>\n</document>\n"
        )
    })
}

fn sensor_xml(camera: &Camera) -> String {
    let (focal, centre) = (camera.focal(), camera.principal_point());
    let (w, h) = (camera.width, camera.height);
    let mut k = camera.distortion().to_vec();
    k.resize(4, 0.0);
    let values = [
        ("f", focal.y),
        ("cx", centre.x - f64::from(w) / 2.0),
        ("cy", centre.y - f64::from(h) / 2.0),
        ("b1", focal.x - focal.y),
        ("k1", k[0]),
        ("k2", k[1]),
        ("p1", k[3]),
        ("p2", k[2]),
    ];
    let values: String = values.iter().map(|(name, v)| format!("          <{name}>{v}</{name}>\n")).collect();
    let size = format!("<resolution width=\"{w}\" height=\"{h}\"/>");
    format!(
        "      <sensor id=\"{}\" label=\"camera {}\" type=\"frame\">\n        {size}\n        \
         <calibration type=\"frame\" class=\"adjusted\">\n          {size}\n{values}        \
         </calibration>\n      </sensor>\n",
        camera.id, camera.id
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::super::imported::looks_along_x;
    use super::*;
    use crate::io::test_folder;
    use crate::synthetic::{SyntheticOptions, synthetic_scene};
    use glam::DVec2;

    #[test]
    fn the_manuals_camera_model_and_transforms_are_applied() {
        let path = test_folder("metashape").join("cameras.xml");
        let text = r#"<?xml version="1.0"?><document version="1.5.0"><chunk><sensors>
          <sensor id="7" type="frame"><resolution width="640" height="480"/>
            <calibration class="initial"><f>1</f></calibration>
            <calibration class="adjusted"><f>500</f><cx>3</cx><cy>-4</cy><b1>2</b1>
              <k1>0.1</k1><k2>-0.02</k2><p1>0.003</p1><p2>-0.004</p2></calibration></sensor></sensors>
          <components><component id="0"><transform><rotation>1 0 0 0 1 0 0 0 1</rotation>
            <translation>1 2 1</translation><scale>2</scale></transform></component></components>
          <cameras><camera id="0" sensor_id="7" component_id="0" label="a&amp;b.png">
            <transform>0 0 1 0 -1 0 0 0 0 -1 0 1 0 0 0 1</transform></camera>
            <camera id="1" sensor_id="7" label="not aligned.png"/></cameras></chunk></document>"#;
        std::fs::write(&path, text).unwrap();
        let found = read(&path).unwrap();
        looks_along_x(&found.model, &found.world_from_file);
        assert_eq!(found.model.images.len(), 1);
        let camera = &found.model.cameras[&1];
        let (x, y) = (0.2, -0.3);
        let (r2, p1, p2) = (x * x + y * y, 0.003, -0.004);
        let radial = 1.0 + 0.1 * r2 - 0.02 * r2 * r2;
        let dx = x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
        let dy = y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
        let expected = DVec2::new(320.0 + 3.0 + dx * 502.0, 240.0 - 4.0 + dy * 500.0);
        let pixel = camera.project(DVec3::new(x, y, 1.0)).unwrap();
        assert!(pixel.distance(expected) < 1e-9, "{pixel} {expected}");
    }

    #[test]
    fn what_is_written_is_read_again() {
        let options = SyntheticOptions { num_points: 20, num_cameras: 5, ..Default::default() };
        let mut model = synthetic_scene(&options, 3).truth;
        model.images.values_mut().for_each(|i| i.name = format!("a & b/{}.png", i.id));
        let path = test_folder("metashape_out").join("cameras.xml");
        write_metashape(&path, &model).unwrap();
        let back = read(&path).unwrap().model;
        for (a, b) in model.images.values().zip(back.images.values()) {
            assert_eq!(b.name, format!("a & b/{}", a.id));
            assert!(a.pose.centre().distance(b.pose.centre()) < 1e-9);
            assert!(crate::pose::rotation_angle(a.pose.rotation, b.pose.rotation) < 1e-9);
            let x = DVec3::new(0.1, -0.2, 1.0);
            let [p, q] = [&model.cameras[&a.camera], &back.cameras[&b.camera]].map(|c| c.project(x).unwrap());
            assert!(p.distance(q) < 1e-9, "{p} {q}");
        }
        std::fs::write(&path, "<document><chunk/></document>").unwrap();
        assert!(read(&path).unwrap().model.images.is_empty());
    }
}
