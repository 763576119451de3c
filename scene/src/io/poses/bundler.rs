//! Bundler's `bundle.out` (v0.3, Snavely et al. 2006), as Bundler, VisualSFM, COLMAP and Metashape
//! write it.
//!
//! `P = R X + t` with y up and z backward, `p = −P / P_z`, pixels `f (1 + k1 |p|² + k2 |p|⁴) p`
//! from the middle of the image, y up. The names of the images stand in a list beside it.

use super::imported::{GL_FROM_CV, ImportedPoses, add, numbers, rotation, size_of};
use crate::io::error::{IoError, read_text};
use crate::sim3::Sim3;
use crate::{Camera, CameraModel, Pose, Reconstruction};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Lines a camera takes: `f k1 k2`, three rows of R, t. Source: the format.
const LINES: usize = 5;

pub(super) fn read(path: &Path, images: &Path) -> Result<ImportedPoses, IoError> {
    let names = read_list(path)?;
    let text = read_text(path)?;
    let mut lines = text.lines().filter(|l| !l.starts_with('#') && !l.trim().is_empty());
    let counts = numbers(path, "the number of cameras", lines.next().unwrap_or_default())?;
    let cameras = counts.first().map_or(0, |n| *n as usize);
    if cameras > names.len() {
        let message = format!("{cameras} cameras, but its list names {} images", names.len());
        return Err(IoError::format(path, message));
    }
    let mut model = Reconstruction::default();
    for name in names.iter().take(cameras) {
        let rows: Vec<&str> = lines.by_ref().take(LINES).collect();
        let v = numbers(path, name, &rows.join(" "))?;
        if v.len() != 15 {
            return Err(IoError::format(path, format!("{name}: expected 15 numbers, found {}", v.len())));
        }
        if v[0] == 0.0 {
            continue; // Bundler could not place it.
        }
        let size = size_of(path, images, name)?;
        let mut camera = Camera::centred(1, CameraModel::Radial, size[0], size[1], v[0]);
        (camera.params[3], camera.params[4], camera.has_prior_focal) = (v[1], v[2], true);
        let gl_from_file = rotation(path, name, &v[3..12])?;
        let t = DVec3::from_slice(&v[12..]);
        let pose = Pose::new(GL_FROM_CV * gl_from_file, GL_FROM_CV * t);
        add(path, &mut model, name, camera, pose)?;
    }
    Ok(ImportedPoses::of(model, Sim3::IDENTITY))
}

/// The list of images: `NAME.list.txt`, `list.txt`, `bundle.list.txt`, or `list.txt` a folder
/// above; a line may hold more behind the name.
fn read_list(path: &Path) -> Result<Vec<String>, IoError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let places: [PathBuf; 5] = [
        path.with_extension("out.list.txt"),
        path.with_extension("list.txt"),
        folder.join("list.txt"),
        folder.join("bundle.list.txt"),
        folder.join("../list.txt"),
    ];
    let Some(list) = places.iter().find(|p| p.is_file()) else {
        return Err(IoError::format(path, "the list of its images, list.txt, must lie beside it"));
    };
    let text = read_text(list)?;
    let names = text.lines().filter_map(|l| Some(l.split_whitespace().next()?.to_owned()));
    Ok(names.collect())
}

#[cfg(test)]
mod tests {
    use super::super::imported::looks_along_x;
    use super::*;
    use crate::io::test_folder;

    #[test]
    fn cameras_look_backward_and_the_unplaced_are_left_out() {
        let dir = test_folder("bundler");
        image::RgbImage::new(200, 100).save(dir.join("b.png")).unwrap();
        let path = dir.join("bundle.out");
        let unplaced = "0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n";
        // Right is −y, up is z, backward is −x; t = −R (1, 2, 3).
        let placed = "150 0.1 -0.2\n0 -1 0\n0 0 1\n-1 0 0\n2 -3 1\n";
        std::fs::write(&path, format!("# Bundle file v0.3\n2 0\n{unplaced}{placed}")).unwrap();
        assert!(read(&path, &dir).unwrap_err().to_string().contains("list.txt"));
        std::fs::write(dir.join("list.txt"), "a.png\nb.png 0 150\n").unwrap();
        let found = read(&path, &dir).unwrap();
        looks_along_x(&found.model, &found.world_from_file);
        assert_eq!(found.model.images[&1].name, "b.png");
        assert_eq!(found.model.cameras[&1].params, [150.0, 100.0, 50.0, 0.1, -0.2]);
        // A point ahead and to the left, above: p = (x, y) / z in Bundler's axes.
        let pixel = found.model.cameras[&1].project(DVec3::new(-0.1, -0.2, 1.0)).unwrap();
        let factor = 1.0 + 0.1 * 0.05 - 0.2 * 0.0025;
        let expected = glam::DVec2::new(100.0 - 15.0 * factor, 50.0 - 30.0 * factor);
        assert!(pixel.distance(expected) < 1e-9, "{pixel} {expected}");
        std::fs::write(&path, "# Bundle file v0.3\n3 0\n").unwrap();
        assert!(read(&path, &dir).unwrap_err().to_string().contains("names 2 images"));
    }
}
