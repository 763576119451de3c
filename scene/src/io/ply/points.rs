//! Coloured point clouds.

use super::Ply;
use crate::io::error::{IoError, read_file};
use crate::io::write_atomic;
use glam::{DVec3, Vec3};
use std::io::Write;
use std::path::Path;

/// A point and its sRGB colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// World frame, scene units.
    pub position: DVec3,
    /// sRGB.
    pub rgb: [u8; 3],
}

/// Reads `x y z` and, where there, `red green blue` (0 to 255; grey otherwise) of the vertices.
pub fn read_points_ply(path: &Path) -> Result<Vec<CloudPoint>, IoError> {
    parse_points_ply(path, &read_file(path)?)
}

/// The same, of the file's content. `path` names the file in messages.
pub fn parse_points_ply(path: &Path, data: &[u8]) -> Result<Vec<CloudPoint>, IoError> {
    let ply = Ply::parse(path, data)?;
    let coloured = ply.element("vertex").is_some_and(|v| ["red", "green", "blue"].iter().all(|c| v.has(c)));
    let wanted: &[&str] = if coloured { &["x", "y", "z", "red", "green", "blue"] } else { &["x", "y", "z"] };
    let mut points = Vec::new();
    ply.rows("vertex", wanted, |i, v| {
        let position = DVec3::new(v[0], v[1], v[2]);
        if !position.is_finite() {
            return Err(IoError::not_finite(path, format!("the position of vertex {i}")));
        }
        let rgb = if coloured { [v[3] as u8, v[4] as u8, v[5] as u8] } else { [128; 3] };
        points.push(CloudPoint { position, rgb });
        Ok(())
    })?;
    Ok(points)
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedPoint {
    /// World frame, scene units.
    pub position: DVec3,
    /// Unit, outwards.
    pub normal: Vec3,
    /// sRGB.
    pub rgb: [u8; 3],
}

/// Writes a coloured cloud, binary little-endian, `float x y z`, `uchar red green blue`.
pub fn write_points_ply(path: &Path, points: &[CloudPoint]) -> Result<(), IoError> {
    write_atomic(path, |w| {
        header(w, points.len(), &["x", "y", "z"])?;
        points.iter().try_for_each(|p| row(w, &p.position.as_vec3().to_array(), p.rgb))
    })
}

/// Writes a coloured cloud with normals, binary little-endian, `float x y z nx ny nz`, `uchar red
/// green blue`.
pub fn write_oriented_ply(path: &Path, points: &[OrientedPoint]) -> Result<(), IoError> {
    write_atomic(path, |w| {
        header(w, points.len(), &["x", "y", "z", "nx", "ny", "nz"])?;
        points.iter().try_for_each(|p| {
            let ([x, y, z], [nx, ny, nz]) = (p.position.as_vec3().to_array(), p.normal.to_array());
            row(w, &[x, y, z, nx, ny, nz], p.rgb)
        })
    })
}

fn header(w: &mut dyn Write, points: usize, floats: &[&str]) -> std::io::Result<()> {
    writeln!(w, "ply\nformat binary_little_endian 1.0\nelement vertex {points}")?;
    floats.iter().try_for_each(|name| writeln!(w, "property float {name}"))?;
    ["red", "green", "blue"].iter().try_for_each(|name| writeln!(w, "property uchar {name}"))?;
    writeln!(w, "end_header")
}

fn row(w: &mut dyn Write, floats: &[f32], rgb: [u8; 3]) -> std::io::Result<()> {
    floats.iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
    w.write_all(&rgb)
}
