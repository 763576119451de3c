//! Poses that came with the input, beside the frames that they are about.

use crate::triangulation::angle_between;
use glam::DVec3;
use scene::{Camera, Frame, FrameSet, Pose, Reconstruction};
use std::collections::{BTreeMap, BTreeSet};

/// An image is matched with the one nearest to each of these angles from it, degrees, as with
/// neighbours alone a video has no baselines; and with as many nearest ones.
/// Source: chosen by hand, never measured.
const FARTHER_DEG: [f64; 5] = [6.0, 10.0, 15.0, 22.0, 30.0];

/// The posed frames of a set; all lists are in their order.
pub(super) struct GivenPoses {
    pub frames: FrameSet,
    /// Numbers of the images in the model.
    pub ids: Vec<u32>,
    pub cameras: Vec<Camera>,
    /// For each frame the index of its camera.
    pub camera_of: Vec<usize>,
    pub poses: Vec<Pose>,
}

impl GivenPoses {
    /// The frames whose names the model's images bear.
    pub(super) fn of(frames: &FrameSet, model: &Reconstruction) -> Self {
        let by_name: BTreeMap<&str, u32> = model.images.values().map(|i| (i.name.as_str(), i.id)).collect();
        let posed: Vec<Frame> =
            frames.frames.iter().filter(|f| by_name.contains_key(f.name.as_str())).cloned().collect();
        let ids: Vec<u32> = posed.iter().map(|f| by_name[f.name.as_str()]).collect();
        let cameras: Vec<Camera> = model.cameras.values().cloned().collect();
        let of_image = ids.iter().map(|id| model.images[id].camera);
        let camera_of =
            of_image.map(|camera| cameras.iter().position(|c| c.id == camera).unwrap_or(0)).collect();
        let poses = ids.iter().map(|id| model.images[id].pose).collect();
        Self { frames: FrameSet { frames: posed, ..frames.clone() }, ids, cameras, camera_of, poses }
    }
}

/// Pairs of images whose directions of view differ by at most `widest`, radians: of each its
/// nearest and some farther ones, lower index first.
pub(super) fn neighbours(poses: &[Pose], widest: f64) -> Vec<(usize, usize)> {
    let axes: Vec<DVec3> = poses.iter().map(|p| p.rotation.conjugate() * DVec3::Z).collect();
    let centres: Vec<DVec3> = poses.iter().map(Pose::centre).collect();
    let mean = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
    let extent = centres.iter().map(|c| c.distance(mean)).fold(1e-300, f64::max);
    let mut pairs = BTreeSet::new();
    for a in 0..poses.len() {
        // Cameras side by side look the same way: then the distance tells which are near.
        let mut others: Vec<(f64, usize)> = Vec::new();
        for b in (0..poses.len()).filter(|&b| b != a) {
            let distance = centres[a].distance(centres[b]) / extent;
            others.push((angle_between(axes[a], axes[b]) + 0.1 * distance, b));
        }
        others.retain(|(far, _)| *far <= widest);
        others.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let farther = FARTHER_DEG.map(f64::to_radians).into_iter();
        let farther = farther.filter_map(|angle| {
            others.iter().min_by(|x, y| (x.0 - angle).abs().total_cmp(&(y.0 - angle).abs()))
        });
        let partners = others.iter().take(FARTHER_DEG.len()).chain(farther);
        pairs.extend(partners.map(|&(_, b)| (a.min(b), a.max(b))));
    }
    pairs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::WIDEST_ANGLE;

    #[test]
    fn images_are_paired_with_their_neighbours_and_with_some_farther_ones() {
        let ring = |n: usize| -> Vec<Pose> {
            let angle = |k: usize| k as f64 / n as f64 * std::f64::consts::TAU;
            let eye = |a: f64| DVec3::new(3.0 * a.cos(), 3.0 * a.sin(), 0.4);
            (0..n).map(|k| Pose::look_at(eye(angle(k)), DVec3::ZERO, DVec3::Z)).collect()
        };
        let pairs = neighbours(&ring(144), WIDEST_ANGLE);
        assert!(pairs.iter().all(|(a, b)| a < b) && pairs.len() < 144 * 10);
        let steps = |(a, b): &(usize, usize)| (b - a).min(144 - (b - a));
        assert!((1..=2).all(|s| pairs.iter().filter(|p| steps(p) == s).count() == 144));
        assert!(pairs.iter().any(|p| steps(p) >= 11), "nothing far enough to triangulate by");
        assert!(neighbours(&ring(1), WIDEST_ANGLE).is_empty() && neighbours(&[], WIDEST_ANGLE).is_empty());
        // Opposite sides of an object share nothing; cameras side by side are told apart by their
        // places.
        assert!(neighbours(&ring(2), WIDEST_ANGLE).is_empty());
        let side = |k: i32| {
            let eye = DVec3::new(f64::from(k), 0.0, 0.0);
            Pose::look_at(eye, eye + DVec3::Y, DVec3::Z)
        };
        let row = neighbours(&(0..40).map(side).collect::<Vec<_>>(), WIDEST_ANGLE);
        assert!((0..39).all(|k| row.contains(&(k, k + 1))) && row.len() < 400);
    }
}
