//! RealityScan's (RealityCapture's) "internal and external camera parameters", a `.csv`.
//!
//! Focal length and principal point are in millimetres of a film that is 36 mm wide along the
//! longer side. Angles are degrees: the camera-to-world rotation with OpenGL axes is `R_z(−heading)
//! R_x(pitch) R_y(roll)` in a world with z up.

use super::imported::{GL_FROM_CV, ImportedPoses, add, brown, refuse_distortion, size_of};
use crate::io::error::{IoError, read_text};
use crate::io::transforms::WORLD_FROM_TRANSFORMS;
use crate::{Pose, Reconstruction};
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;
use std::path::Path;

/// Width of the film, millimetres. Source: the format.
const FILM_MM: f64 = 36.0;
/// Columns without which there is no camera.
const NEEDED: [&str; 7] = ["x", "y", "alt", "heading", "pitch", "roll", "f"];

pub(super) fn read(path: &Path, images: &Path) -> Result<ImportedPoses, IoError> {
    let text = read_text(path)?;
    let mut lines = text.lines().filter(|l| !l.trim().is_empty());
    let header: Vec<&str> =
        lines.next().unwrap_or_default().trim_start_matches('#').split(',').map(str::trim).collect();
    if header.first() != Some(&"name") || NEEDED.iter().any(|n| !header.contains(n)) {
        let message = format!(
            "expected the columns name,{}: export \"internal/external camera parameters\"",
            NEEDED.join(",")
        );
        return Err(IoError::format(path, message));
    }
    let mut model = Reconstruction::default();
    for line in lines {
        let mut cells = line.split(',').map(str::trim);
        let name = cells.next().unwrap_or_default();
        let values: Option<BTreeMap<&str, f64>> = header[1..]
            .iter()
            .zip(cells)
            .map(|(n, c)| Some((*n, c.parse().ok().filter(|v: &f64| v.is_finite())?)))
            .collect();
        let Some(values) = values.filter(|v| v.len() + 1 == header.len()) else {
            let message = format!("{name}: expected {} numbers", header.len() - 1);
            return Err(IoError::format(path, message));
        };
        let v = |n: &str| values.get(n).copied().unwrap_or(0.0);
        let angle = |n: &str| v(n).to_radians();
        refuse_distortion(path, "a camera with k3 or k4", &[v("k3"), v("k4")])?;
        let size = size_of(path, images, name)?;
        let [w, h] = size.map(f64::from);
        let px = w.max(h) / FILM_MM;
        let focal = v("f") * px;
        let intrinsics = [focal, focal, v("px") * px + w / 2.0, v("py") * px + h / 2.0];
        let camera = brown(size, intrinsics, [v("k1"), v("k2"), v("t1"), v("t2")]);
        let file_from_gl = DQuat::from_rotation_z(-angle("heading"))
            * DQuat::from_rotation_x(angle("pitch"))
            * DQuat::from_rotation_y(angle("roll"));
        let cam_from_file = (file_from_gl * GL_FROM_CV).conjugate();
        let pose = Pose::from_centre(cam_from_file, DVec3::new(v("x"), v("y"), v("alt")));
        add(path, &mut model, name, camera, WORLD_FROM_TRANSFORMS.transform_pose(&pose))?;
    }
    Ok(ImportedPoses::of(model, WORLD_FROM_TRANSFORMS))
}

#[cfg(test)]
mod tests {
    use super::super::imported::looks_along_x;
    use super::*;
    use crate::io::test_folder;

    #[test]
    fn a_camera_that_faces_east_and_level_looks_along_x() {
        let dir = test_folder("realityscan");
        image::RgbImage::new(200, 100).save(dir.join("a.png")).unwrap();
        let path = dir.join("cameras.csv");
        let header = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";
        let row = |name: &str| format!("{header}\n{name},1,2,3,90,90,0,18,3.6,-1.8,0.1,0,0,0,0,0.01\n");
        std::fs::write(&path, row("a.png")).unwrap();
        let found = read(&path, &dir).unwrap();
        looks_along_x(&found.model, &found.world_from_file);
        let camera = &found.model.cameras[&1];
        assert_eq!(camera.params, [100.0, 100.0, 120.0, 40.0, 0.1, 0.0, 0.0, 0.01]);
        std::fs::write(&path, row("absent.png")).unwrap();
        assert!(read(&path, &dir).unwrap_err().to_string().contains("absent.png"));
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        assert!(read(&path, &dir).unwrap_err().to_string().contains("heading"));
    }
}
