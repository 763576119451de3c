//! glTF 2.0 binary (`.glb`) with the extension KHR_gaussian_splatting: log scales, opacity in [0,
//! 1], rotations x y z w, harmonics as `SH_DEGREE_l_COEF_n`. glTF has y up.

use super::item::{Item, push, turn_upright, unit};
use crate::Gaussians;
use crate::gaussians::SH_C0;
use crate::io::bytes::ByteReader;
use crate::io::error::IoError;
use crate::io::write_atomic;
use glam::{Quat, Vec3};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::Path;

/// The magic numbers of the file and of its chunks. Source: glTF 2.0, section 4.4.
const MAGIC: u32 = 0x4654_6c67; // "glTF"
/// See [`MAGIC`]. Source: glTF 2.0, section 4.4.3.
const JSON: u32 = 0x4e4f_534a;
/// See [`MAGIC`]. Source: glTF 2.0, section 4.4.3.
const BIN: u32 = 0x004e_4942;
const EXTENSION: &str = "KHR_gaussian_splatting";

/// Attribute names of the harmonics, in coefficient order.
fn sh_names(degree: u32) -> impl Iterator<Item = String> {
    (0..=degree).flat_map(|l| (0..=2 * l).map(move |n| format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{n}")))
}

/// Accessors, views and bytes while they grow.
#[derive(Default)]
struct Builder {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Builder {
    fn add(&mut self, name: &str, kind: &str, count: usize, values: impl Iterator<Item = f32>) {
        let offset = self.bin.len();
        self.bin.extend(values.flat_map(f32::to_le_bytes));
        self.views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": self.bin.len() - offset}));
        let view = self.views.len() - 1;
        self.accessors.push(json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind}));
        self.attributes.insert(name.into(), json!(self.accessors.len() - 1));
    }
}

/// Writes a `.glb` with one splat primitive and a `COLOR_0` for viewers that only know points.
pub fn write_splat_glb(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    if g.is_empty() {
        return Err(IoError::format(path, "glTF cannot hold an empty splat"));
    }
    let mut g = g.clone();
    turn_upright(&mut g);
    let (n, k) = (g.len(), g.sh_coefficients());
    let low = g.means.iter().fold(Vec3::INFINITY, |a, &m| a.min(m));
    let high = g.means.iter().fold(Vec3::NEG_INFINITY, |a, &m| a.max(m));
    let mut b = Builder::default();
    b.add("POSITION", "VEC3", n, g.means.iter().flat_map(|m| m.to_array()));
    b.accessors[0]["min"] = json!(low.to_array());
    b.accessors[0]["max"] = json!(high.to_array());
    let colours = (0..n).map(|i| (i, Vec3::from_slice(&g.sh[i * k * 3..]) * SH_C0 + 0.5));
    let rgba = colours.map(|(i, rgb)| rgb.clamp(Vec3::ZERO, Vec3::ONE).extend(g.opacity(i)));
    b.add("COLOR_0", "VEC4", n, rgba.flat_map(|c| c.to_array()));
    b.add(&format!("{EXTENSION}:SCALE"), "VEC3", n, g.log_scales.iter().flat_map(|s| s.to_array()));
    b.add(&format!("{EXTENSION}:ROTATION"), "VEC4", n, g.rotations.iter().flat_map(|&q| unit(q).to_array()));
    b.add(&format!("{EXTENSION}:OPACITY"), "SCALAR", n, (0..n).map(|i| g.opacity(i)));
    for (c, name) in sh_names(g.sh_degree).enumerate() {
        let triples = (0..n).map(|i| &g.sh[(i * k + c) * 3..][..3]);
        b.add(&name, "VEC3", n, triples.flatten().copied());
    }
    let extension = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance", "projection": "perspective"});
    let document = json!({
        "asset": {"version": "2.0", "generator": "sat-recon"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"mode": 0, "attributes": b.attributes, "extensions": {EXTENSION: extension}}]}],
        "buffers": [{"byteLength": b.bin.len()}],
        "bufferViews": b.views,
        "accessors": b.accessors,
    });
    write_chunks(path, &document, &b.bin)
}

/// A binary glTF file of its two chunks; the length of `bin` is a multiple of four.
pub(in crate::io) fn write_chunks(path: &Path, document: &Value, bin: &[u8]) -> Result<(), IoError> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + bin.len();
    let Ok(total) = u32::try_from(total) else {
        return Err(IoError::format(path, ".glb holds at most 4 GiB; use .ply or .spz"));
    };
    write_atomic(path, |w| {
        for v in [MAGIC, 2, total, text.len() as u32, JSON] {
            w.write_all(&v.to_le_bytes())?;
        }
        w.write_all(&text)?;
        w.write_all(&(bin.len() as u32).to_le_bytes())?;
        w.write_all(&BIN.to_le_bytes())?;
        w.write_all(bin)
    })
}

/// A parsed `.glb`.
struct Glb<'a> {
    path: &'a Path,
    document: Value,
    bin: &'a [u8],
}

/// Parses the first splat primitive of a `.glb`; transforms of nodes are not applied.
pub(super) fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let glb = Glb::parse(path, data)?;
    let meshes = glb.document["meshes"].as_array().into_iter().flatten();
    let mut primitives = meshes.filter_map(|m| m["primitives"].as_array()).flatten();
    let Some(primitive) = primitives.find(|p| p["extensions"].get(EXTENSION).is_some()) else {
        return Err(IoError::format(
            path,
            format!("expected a primitive with {EXTENSION}, found none; is it a mesh?"),
        ));
    };
    let attributes = &primitive["attributes"];
    let get = |name: &str, width: usize| glb.values(&attributes[name], name, width);
    let (means, n) = get("POSITION", 3)?;
    let names = ["SCALE", "ROTATION", "OPACITY"].map(|a| format!("{EXTENSION}:{a}"));
    let scales = get(&names[0], 3)?.0;
    let rotations = get(&names[1], 4)?.0;
    let opacities = get(&names[2], 1)?.0;
    let degree =
        (1..=3).take_while(|l| attributes.get(format!("{EXTENSION}:SH_DEGREE_{l}_COEF_0")).is_some()).count();
    let harmonics =
        sh_names(degree as u32).map(|s| Ok(get(&s, 3)?.0)).collect::<Result<Vec<_>, IoError>>()?;
    let lengths = [(&scales, 3), (&rotations, 4), (&opacities, 1)];
    if lengths.iter().any(|(v, w)| v.len() != n * w) || harmonics.iter().any(|h| h.len() != n * 3) {
        return Err(IoError::format(
            path,
            "the attributes of the splat differ in length; the file is damaged",
        ));
    }
    let mut g = Gaussians { sh_degree: degree as u32, ..Default::default() };
    for i in 0..n {
        let sh: Vec<f32> = harmonics.iter().flat_map(|h| h[i * 3..i * 3 + 3].iter().copied()).collect();
        let item = Item {
            mean: Vec3::from_slice(&means[i * 3..]),
            log_scale: Vec3::from_slice(&scales[i * 3..]),
            rotation: Quat::from_slice(&rotations[i * 4..]),
            opacity: opacities[i].clamp(0.0, 1.0),
            sh: &sh,
        };
        push(path, &mut g, &item)?;
    }
    turn_upright(&mut g);
    Ok(g)
}

fn number(value: &Value, key: &str) -> Option<usize> {
    value[key].as_u64().map(|n| n as usize)
}

impl<'a> Glb<'a> {
    fn parse(path: &'a Path, data: &'a [u8]) -> Result<Self, IoError> {
        let mut r = ByteReader::new(path, data);
        let (magic, version, _length) = (r.u32("a header")?, r.u32("a version")?, r.u32("a length")?);
        if (magic, version) != (MAGIC, 2) {
            return Err(IoError::format(
                path,
                "expected a binary glTF 2.0 file (.glb), found something else",
            ));
        }
        let mut chunk = |kind: u32| {
            let n = r.u32("a chunk length")? as usize;
            let found = r.u32("a chunk type")?;
            if found != kind {
                return Err(IoError::format(path, "the chunks of the .glb are not JSON and BIN"));
            }
            r.take(n, "a chunk")
        };
        let text = chunk(JSON)?;
        let bin = chunk(BIN)?;
        let document =
            serde_json::from_slice(text).map_err(|e| IoError::format(path, format!("its JSON: {e}")))?;
        Ok(Self { path, document, bin })
    }

    /// All numbers of an accessor with `width` components, as floats, and the number of elements.
    fn values(&self, index: &Value, name: &str, width: usize) -> Result<(Vec<f32>, usize), IoError> {
        let error = |what: &str| IoError::format(self.path, format!("attribute {name}: {what}"));
        let accessor = index.as_u64().and_then(|i| self.document["accessors"].get(i as usize));
        let accessor = accessor.ok_or_else(|| error("is missing"))?;
        let expected = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][width];
        if accessor["type"] != expected || accessor.get("sparse").is_some() {
            return Err(error(&format!("expected a dense accessor of type {expected}")));
        }
        let n = number(accessor, "count").ok_or_else(|| error("has no count"))?;
        let view = number(accessor, "bufferView").and_then(|i| self.document["bufferViews"].get(i));
        let view = view.ok_or_else(|| error("has no buffer view"))?;
        let kind = number(accessor, "componentType").unwrap_or(0);
        let size = match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5126 => 4,
            _ => return Err(error("has an unknown component type")),
        };
        let normalised = accessor["normalized"] == true;
        let stride = number(view, "byteStride").unwrap_or(width * size);
        let start =
            number(view, "byteOffset").unwrap_or(0).checked_add(number(accessor, "byteOffset").unwrap_or(0));
        let needed = n.saturating_sub(1).checked_mul(stride).and_then(|b| b.checked_add(width * size));
        let end = start.zip(needed).and_then(|(s, n)| s.checked_add(n)).filter(|&e| e <= self.bin.len());
        let (Some(start), Some(_), true) = (start, end, n > 0 && stride >= width * size) else {
            return Err(error("reaches beyond the file"));
        };
        let mut values = Vec::with_capacity(n * width);
        for i in 0..n {
            for c in 0..width {
                values.push(component(&self.bin[start + i * stride + c * size..], kind, normalised));
            }
        }
        Ok((values, n))
    }
}

/// A number of one of glTF's types; normalised integers become [0, 1] or [−1, 1].
fn component(b: &[u8], kind: usize, normalised: bool) -> f32 {
    let (value, max) = match kind {
        5120 => (f32::from(b[0] as i8), 127.0),
        5121 => (f32::from(b[0]), 255.0),
        5122 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32_767.0),
        5123 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65_535.0),
        _ => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    };
    if normalised { (value / max).max(-1.0) } else { value }
}
