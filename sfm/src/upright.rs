//! Which way is up, by what is vertical in the pictures: edges of furniture, doors and buildings.
//!
//! The images of parallel lines meet in one point (Hartley & Zisserman 2004, section 8.6): the
//! plane through a line and the camera holds the line's direction, so the direction that is up lies
//! across the normals of all planes of vertical lines. Which lines are vertical is not known: the
//! direction across most normals is taken (RANSAC), near that of cameras held level, if it leaves
//! few of the nearly vertical lines out.

use crate::circular::vertical_lines::{Segment, edges_along, plane_of};
use crate::error::SfmError;
use crate::sift::load_luma;
use crate::solvers::linalg::{moments, symmetric_eigen};
use glam::DVec3;
use rand::Rng as _;
use rayon::prelude::*;
use scene::up::level_up;
use scene::{FrameSet, Progress, Reconstruction};

/// The direction that is up for vertical lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VerticalDirection {
    /// Unit vector, world frame.
    pub up: DVec3,
    /// Lines that agree on it.
    pub agreeing: usize,
    /// Lines that are nearly vertical for cameras held level.
    pub lines: usize,
}

/// How vertical lines are looked for.
struct LineSearch {
    /// Most pictures that are looked at.
    pictures: usize,
    /// Lines that lean more for cameras held level are no candidates, radians.
    most_lean: f64,
    /// Lines this near to a direction agree on it, radians.
    near: f64,
    /// Least share of the candidates that agree, and least number of them.
    least: (f64, usize),
    /// Pairs of lines that are tried.
    trials: usize,
}

/// Source: chosen by hand. Things stand askew by a degree or two, hands hold cameras level to five.
/// Nearly half of 83 lines that leant at random agreed on a direction (the test below).
const SEARCH: LineSearch =
    LineSearch { pictures: 24, most_lean: 0.12, near: 0.006, least: (0.6, 12), trials: 500 };

/// The direction that is up by the vertical lines in the photos of a model; `None` where there are
/// few, or they do not agree.
///
/// # Errors
/// If a photo cannot be read, or the user asked to stop.
pub fn vertical_direction(
    model: &Reconstruction,
    frames: &FrameSet,
    progress: &Progress,
) -> Result<Option<VerticalDirection>, SfmError> {
    let Some(level) = level_up(model.images.values().map(|i| &i.pose)) else { return Ok(None) };
    let step = model.images.len().div_ceil(SEARCH.pictures).max(1);
    let looked_at: Vec<_> = model.images.values().step_by(step).collect();
    progress.begin("vertical lines", looked_at.len());
    let found: Result<Vec<Vec<DVec3>>, SfmError> = looked_at
        .par_iter()
        .map(|image| {
            progress.tick()?;
            let frame = frames.frames.iter().find(|f| f.name == image.name);
            let (Some(frame), Some(camera)) = (frame, model.cameras.get(&image.camera)) else {
                return Ok(Vec::new());
            };
            let up = image.pose.rotation * level;
            let segments: Vec<Segment> = edges_along(load_luma(frame)?, up.x.abs() > up.y.abs());
            let rays = |s: &Segment| s.points.iter().map(|p| camera.ray(*p)).collect();
            let planes = segments.iter().filter_map(|s| plane_of(rays(s)));
            let exact = planes.filter(|(_, sigma)| *sigma < SEARCH.near);
            Ok(exact.map(|(normal, _)| image.pose.rotation.conjugate() * normal).collect())
        })
        .collect();
    let normals: Vec<DVec3> = found?.into_iter().flatten().collect();
    Ok(across_most(&normals, level))
}

/// The direction across most of the normals that are nearly across `level`.
fn across_most(normals: &[DVec3], level: DVec3) -> Option<VerticalDirection> {
    let candidates: Vec<DVec3> =
        normals.iter().copied().filter(|n| n.dot(level).abs() < SEARCH.most_lean.sin()).collect();
    let lines = candidates.len();
    if lines < SEARCH.least.1 {
        return None;
    }
    let agreeing =
        |up: DVec3| candidates.iter().copied().filter(move |n| n.dot(up).abs() < SEARCH.near.sin());
    let mut rng = scene::rng::rng(0, "vertical lines", 0);
    let mut best = (0, level);
    for _ in 0..SEARCH.trials {
        let [a, b] = [0, 1].map(|_| candidates[rng.random_range(0..lines)]);
        // Planes that are nearly one say little about the line in which they meet.
        let Some(up) = a.cross(b).try_normalize().filter(|_| a.cross(b).length() > 0.2) else { continue };
        let up = if up.dot(level) < 0.0 { -up } else { up };
        let count = agreeing(up).count();
        if count > best.0 && up.angle_between(level) < SEARCH.most_lean {
            best = (count, up);
        }
    }
    let mut up = best.1;
    for _ in 0..5 {
        let (_, axes) = symmetric_eigen(&moments(agreeing(up).map(|n| (1.0, n))));
        let next = DVec3::from_array(axes[0]);
        up = if next.dot(level) < 0.0 { -next } else { next };
    }
    let count = agreeing(up).count();
    let (share, least) = SEARCH.least;
    let enough = count >= least && count as f64 >= share * lines as f64;
    (enough && up.angle_between(level) < SEARCH.most_lean).then_some(VerticalDirection {
        up,
        agreeing: count,
        lines,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec2};
    use image::{Luma, Rgb, RgbImage};
    use scene::{Camera, CameraModel, Frame, Pose, PosedImage};

    /// Photos of posts on a half circle, by cameras on a short arc that are all rolled by
    /// `roll_deg`; world with z up. The posts lean by `askew_deg` in all directions.
    fn photographed(roll_deg: f64, askew_deg: f64, folder: &std::path::Path) -> (Reconstruction, FrameSet) {
        let camera = Camera::centred(1, CameraModel::Pinhole, 320, 240, 260.0);
        let (mut model, mut frames) = (Reconstruction::default(), FrameSet::default());
        model.cameras.insert(1, camera.clone());
        std::fs::create_dir_all(folder).unwrap();
        for id in 1..=6_u32 {
            let (sin, cos) = (0.12 * f64::from(id)).sin_cos();
            let eye = DVec3::new(0.5 * cos, 0.5 * sin, 1.5);
            let looking = Pose::look_at(eye, DVec3::new(-4.0 * cos, -4.0 * sin, 0.9), DVec3::Z);
            let roll = DQuat::from_rotation_z(roll_deg.to_radians());
            let pose = Pose::from_centre(roll * looking.rotation, eye);
            let name = format!("{id}.png");
            let mut picture = RgbImage::from_pixel(320, 240, Rgb([90; 3]));
            for post in 0..40 {
                paint(&mut picture, &camera, &pose, post, askew_deg);
            }
            let path = folder.join(&name);
            picture.save(&path).unwrap();
            let frame = Frame { name: name.clone(), path, width: 320, height: 240, ..Frame::default() };
            frames.frames.push(frame);
            model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: vec![] });
        }
        (model, frames)
    }

    /// A bright post: every pixel by how far its ray passes from it.
    fn paint(picture: &mut RgbImage, camera: &Camera, pose: &Pose, post: i32, askew_deg: f64) {
        let (sin, cos) = (0.157 * f64::from(post)).sin_cos();
        let foot = DVec3::new(6.0 * cos, 6.0 * sin, 0.0);
        let lean = (askew_deg * (2.3 * f64::from(post)).sin()).to_radians();
        let along = DQuat::from_axis_angle(DVec3::new(cos, sin, 0.0), lean) * DVec3::Z;
        let eye = pose.centre();
        let across = along.cross(foot - eye).normalize();
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            let ray = camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            let ray = pose.rotation.conjugate() * ray;
            let ahead = ray.dot(foot - eye) > 0.0;
            // A soft edge, a pixel wide, as a lens makes it.
            let inside = 0.5 + (0.025 - ray.dot(across).abs()) * 260.0;
            if ahead && inside > 0.0 {
                let Luma([before]) = Luma([pixel.0[0]]);
                let level = 90.0 + 120.0 * inside.min(1.0);
                *pixel = Rgb([before.max(level as u8); 3]);
            }
        }
    }

    fn found(roll_deg: f64, askew_deg: f64) -> (Option<VerticalDirection>, f64) {
        let folder = std::env::temp_dir().join(format!("sfm-upright-{roll_deg}-{}", std::process::id()));
        let (model, frames) = photographed(roll_deg, askew_deg, &folder);
        let level = level_up(model.images.values().map(|i| &i.pose)).unwrap();
        let found = vertical_direction(&model, &frames, &Progress::silent()).unwrap();
        std::fs::remove_dir_all(folder).unwrap();
        (found, level.angle_between(DVec3::Z).to_degrees())
    }

    #[test]
    fn vertical_lines_say_what_is_up_where_all_cameras_are_rolled() {
        let (found, level_deg) = found(3.0, 0.0);
        let found = found.expect("posts are vertical");
        let off = found.up.angle_between(DVec3::Z).to_degrees();
        assert!(level_deg > 2.5 && off < 0.15, "{off}° instead of {level_deg}°: {found:?}");
    }

    #[test]
    fn lines_that_lean_in_all_directions_say_nothing() {
        let (found, _) = found(1.0, 6.0);
        assert_eq!(found, None);
    }
}
