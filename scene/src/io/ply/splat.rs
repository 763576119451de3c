//! Splats as the 3D Gaussian splatting paper's viewers and tools keep them (Kerbl et al. 2023).

use super::Ply;
use crate::Gaussians;
use crate::io::error::{IoError, read_file};
use crate::io::write_atomic;
use glam::{Quat, Vec3};
use std::io::{self, Write};
use std::path::Path;

/// Columns before the higher spherical-harmonic coefficients, in the order they are read here.
const FIXED: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];
/// Infinite opacity logits and scales (some tools write them) become this finite extreme.
/// Source: derived, exp(±40) and sigmoid(±40) are 0, 1 or beyond any scene in f32.
const EXTREME: f64 = 40.0;

/// Reads a splat by property names: any order, any encoding, extra properties skipped. `f_rest_*`
/// may be absent or hold degree 1, 2 or 3, channel-major.
pub fn read_splat_ply(path: &Path) -> Result<Gaussians, IoError> {
    decode_splat_ply(&Ply::parse(path, &read_file(path)?)?)
}

/// The Gaussians of a parsed file.
pub(crate) fn decode_splat_ply(ply: &Ply) -> Result<Gaussians, IoError> {
    let path = ply.path;
    let rest_count = count_rest(ply)?;
    let names: Vec<String> = (0..rest_count).map(|i| format!("f_rest_{i}")).collect();
    let wanted: Vec<&str> = FIXED.iter().copied().chain(names.iter().map(String::as_str)).collect();
    let rest = rest_count / 3;
    let sh_degree = ((rest + 1) as f64).sqrt() as u32 - 1;
    let mut g = Gaussians { sh_degree, ..Default::default() };
    ply.rows("vertex", &wanted, |i, v| {
        if let Some(column) = v.iter().enumerate().position(|(c, x)| !acceptable(c, *x)) {
            return Err(IoError::not_finite(path, format!("property '{}' of vertex {i}", wanted[column])));
        }
        let bounded = [6, 7, 8, 9].map(|c| v[c].clamp(-EXTREME, EXTREME) as f32);
        g.means.push(Vec3::from_array([0, 1, 2].map(|c| v[c] as f32)));
        g.opacity_logits.push(bounded[0]);
        g.log_scales.push(Vec3::new(bounded[1], bounded[2], bounded[3]));
        g.rotations.push(Quat::from_array([11, 12, 13, 10].map(|c| v[c] as f32)));
        g.sh.extend([3, 4, 5].map(|c| v[c] as f32));
        for k in 0..rest {
            g.sh.extend([14 + k, 14 + rest + k, 14 + 2 * rest + k].map(|c| v[c] as f32));
        }
        Ok(())
    })?;
    Ok(g)
}

/// Finite, or an infinity that has a meaning: opacity (column 6) of both signs, scale (7 to 9) of
/// zero.
fn acceptable(column: usize, value: f64) -> bool {
    value.is_finite()
        || (column == 6 && value.is_infinite())
        || ((7..10).contains(&column) && value == f64::NEG_INFINITY)
}

fn count_rest(ply: &Ply) -> Result<usize, IoError> {
    let Some(vertex) = ply.element("vertex") else {
        return Err(IoError::format(ply.path, "expected an element 'vertex' in the PLY header, found none"));
    };
    if let Some(missing) = FIXED.iter().find(|name| !vertex.has(name)) {
        return Err(IoError::format(
            ply.path,
            format!(
                "expected a 3D Gaussian splat, but the vertices have no property '{missing}'; is it a mesh or point cloud?"
            ),
        ));
    }
    let n = (0..).take_while(|i| vertex.has(&format!("f_rest_{i}"))).count();
    match n {
        0 | 9 | 24 | 45 => Ok(n),
        _ => Err(IoError::format(
            ply.path,
            format!("expected 0, 9, 24 or 45 f_rest properties (degree 0 to 3), found {n}"),
        )),
    }
}

/// Writes a splat in the 3DGS order (`x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*`),
/// binary little-endian, `f_rest_*` channel-major, rotations w x y z.
pub fn write_splat_ply(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    g.validate().map_err(|message| IoError::format(path, message))?;
    write_atomic(path, |w| write_to(w, g))
}

/// The same into memory.
pub fn encode_splat_ply(g: &Gaussians) -> Result<Vec<u8>, String> {
    g.validate()?;
    let mut bytes = Vec::new();
    write_to(&mut bytes, g).map_err(|e| e.to_string())?;
    Ok(bytes)
}

fn write_to(w: &mut impl Write, g: &Gaussians) -> io::Result<()> {
    let k = g.sh_coefficients();
    writeln!(w, "ply\nformat binary_little_endian 1.0\nelement vertex {}", g.len())?;
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec();
    names.extend((0..3).map(|i| format!("f_dc_{i}")));
    names.extend((0..3 * (k - 1)).map(|i| format!("f_rest_{i}")));
    names.extend(FIXED[6..].iter().map(|s| s.to_string()));
    names.iter().try_for_each(|name| writeln!(w, "property float {name}"))?;
    writeln!(w, "end_header")?;
    let mut row: Vec<f32> = Vec::with_capacity(names.len());
    let mut bytes = Vec::with_capacity(names.len() * 4);
    for i in 0..g.len() {
        row.clear();
        row.extend(g.means[i].to_array());
        row.extend([0.0; 3]);
        let sh = &g.sh[i * k * 3..(i + 1) * k * 3];
        row.extend(&sh[..3]);
        for channel in 0..3 {
            row.extend((1..k).map(|c| sh[c * 3 + channel]));
        }
        row.push(g.opacity_logits[i]);
        row.extend(g.log_scales[i].to_array());
        let q = g.rotations[i];
        row.extend([q.w, q.x, q.y, q.z]);
        bytes.clear();
        row.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        w.write_all(&bytes)?;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
        decode_splat_ply(&Ply::parse(path, data)?)
    }
    use crate::io::test_folder;
    use crate::rng::rng;
    use rand::Rng;

    /// Gaussians with numbers all different.
    pub(crate) fn random_gaussians(n: usize, sh_degree: u32) -> Gaussians {
        let mut r = rng(1, "gaussians", u64::from(sh_degree));
        let mut g = Gaussians { sh_degree, ..Default::default() };
        for _ in 0..n {
            let mut v = |range: f32| r.random_range(-range..range);
            g.means.push(Vec3::new(v(5.0), v(5.0), v(5.0)));
            g.log_scales.push(Vec3::new(v(2.0) - 4.0, v(2.0) - 4.0, v(2.0) - 4.0));
            g.rotations.push(Quat::from_xyzw(v(1.0), v(1.0), v(1.0), v(1.0)).normalize());
            g.opacity_logits.push(v(5.0));
            let k = g.sh_coefficients() * 3;
            g.sh.extend((0..k).map(|_| v(0.5)));
        }
        g
    }

    #[test]
    fn splats_of_every_degree_survive_bit_for_bit() {
        let dir = test_folder("splat_ply");
        for degree in 0..4 {
            let g = random_gaussians(17, degree);
            let path = dir.join("s.ply");
            write_splat_ply(&path, &g).unwrap();
            assert_eq!(read_splat_ply(&path).unwrap(), g);
        }
    }

    #[test]
    fn ascii_and_big_endian_in_any_order_with_extra_properties_and_lists_are_read() {
        let g = random_gaussians(3, 1);
        let mut names: Vec<String> = FIXED.iter().rev().map(|s| s.to_string()).collect();
        names.extend((0..9).map(|i| format!("f_rest_{i}")));
        let header = |format: &str| {
            let mut h = format!(
                "ply\r\nformat {format} 1.0\ncomment x\nelement camera 2\nproperty list uchar short a\n"
            );
            h += "element vertex 3\nproperty list uchar int junk\nproperty uchar label\n";
            names.iter().for_each(|n| h += &format!("property double {n}\n"));
            h + "end_header\n"
        };
        let value = |i: usize, name: &str| -> f64 {
            let q = g.rotations[i];
            let (kind, index) = name.rsplit_once('_').unwrap_or((name, "0"));
            let index: usize = index.parse().unwrap();
            f64::from(match kind {
                "x" => g.means[i].x,
                "y" => g.means[i].y,
                "z" => g.means[i].z,
                "f_dc" => g.sh[i * 12 + index],
                "f_rest" => g.sh[i * 12 + (index % 3 + 1) * 3 + index / 3],
                "opacity" => g.opacity_logits[i],
                "scale" => g.log_scales[i][index],
                _ => [q.w, q.x, q.y, q.z][index],
            })
        };
        let mut text = header("ascii") + "1 5\n0\n";
        let mut binary = header("binary_big_endian").into_bytes();
        binary.extend([1, 0, 5, 0]);
        for i in 0..3 {
            text += &format!("{i}{} 200", " 7".repeat(i));
            binary.push(i as u8);
            binary.extend(vec![9; 4 * i]);
            binary.push(200);
            for name in &names {
                text += &format!(" {}", value(i, name));
                binary.extend(value(i, name).to_be_bytes());
            }
            text += "\n";
        }
        assert_eq!(parse(Path::new("a.ply"), text.as_bytes()).unwrap(), g);
        assert_eq!(parse(Path::new("b.ply"), &binary).unwrap(), g);
    }

    #[test]
    fn nan_names_the_vertex_and_infinite_opacity_is_tamed() {
        let path = test_folder("splat_nan").join("s.ply");
        let mut g = random_gaussians(5, 0);
        g.opacity_logits[1] = f32::INFINITY;
        g.log_scales[2].y = f32::NEG_INFINITY;
        write_splat_ply(&path, &g).unwrap();
        let back = read_splat_ply(&path).unwrap();
        assert_eq!((back.opacity_logits[1], back.log_scales[2].y), (40.0, -40.0));
        g.means[3].z = f32::NAN;
        write_splat_ply(&path, &g).unwrap();
        let message = read_splat_ply(&path).unwrap_err().to_string();
        assert!(message.contains("'z' of vertex 3"), "{message}");
    }

    #[test]
    fn a_header_that_claims_two_gigabytes_is_refused() {
        let path = test_folder("splat_claim").join("s.ply");
        write_splat_ply(&path, &random_gaussians(5, 0)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for claim in ["40000000", "18446744073709551615"] {
            let at = bytes.windows(9).position(|w| w == b"vertex 5\n").unwrap();
            let bad = [&bytes[..at], b"vertex ", claim.as_bytes(), &bytes[at + 8..]].concat();
            let error = parse(&path, &bad).unwrap_err();
            assert!(matches!(error, IoError::Truncated { .. }), "{error}");
        }
    }

    #[test]
    fn a_mesh_is_told_from_a_splat() {
        let mesh = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
        let message = parse(Path::new("m.ply"), mesh).unwrap_err().to_string();
        assert!(message.contains("f_dc_0") && message.contains("mesh"), "{message}");
    }
}
