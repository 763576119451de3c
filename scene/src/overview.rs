//! How a model is shown: turned upright, moved to the origin, scaled to a known size.

use crate::sim3::Sim3;
use crate::up::level_up;
use crate::{PosedImage, Reconstruction, Ring};
use glam::{DMat3, DQuat, DVec2, DVec3};

/// The farthest camera centre lies so far from the origin of the shown frame.
/// Source: derived, so that cameras and their frusta stay inside [−1, 1].
const REACH: f64 = 0.9;
/// Depth of a camera's drawn frustum, as a share of the distance of the farthest camera centre.
/// Source: chosen by hand, never measured.
const FRUSTUM_DEPTH: f64 = 0.09;

/// A frame in which z is up and all cameras lie in [−1, 1]³.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overview {
    /// From the world into the shown frame.
    pub shown_from_world: Sim3,
    /// Distance of the farthest camera centre from the middle, world units.
    reach: f64,
}

impl Overview {
    /// About the ring's centre and axis where the cameras stand on one, else about the mean of the
    /// centres and the direction that is up for level cameras.
    pub fn of(model: &Reconstruction, ring: Option<&Ring>) -> Self {
        let centres: Vec<DVec3> = model.images.values().map(|i| i.pose.centre()).collect();
        let mean = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
        let middle = ring.map_or(mean, |r| r.centre);
        let level = level_up(model.images.values().map(|i| &i.pose));
        let up = ring.map(|r| r.axis).or(level).unwrap_or(DVec3::Z);
        let (x, y) = up.any_orthonormal_pair();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, up).transpose());
        let reach = centres.iter().map(|c| c.distance(middle)).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let scale = REACH / reach;
        Self { shown_from_world: Sim3 { scale, rotation, translation: -scale * (rotation * middle) }, reach }
    }

    /// Centre of a camera and the four corners of its image plane, shown frame; `None` where it has
    /// no intrinsics.
    pub fn frustum(&self, model: &Reconstruction, image: &PosedImage) -> Option<[DVec3; 5]> {
        let camera = model.cameras.get(&image.camera)?;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let world_from_camera = image.pose.inverse();
        let depth = self.reach * FRUSTUM_DEPTH;
        let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(x, y)| {
            world_from_camera.transform(camera.unproject(DVec2::new(x, y)).extend(1.0) * depth)
        });
        let [a, b, c, d] = corners;
        Some([image.pose.centre(), a, b, c, d].map(|p| self.shown_from_world.transform(p)))
    }
}

/// Moves the median of the points (of the camera centres, where there are none) to the origin and
/// scales the median distance of the camera centres from it to `radius`.
pub fn centred(model: &Reconstruction, radius: f64) -> Sim3 {
    let centres: Vec<DVec3> = model.images.values().map(|i| i.pose.centre()).collect();
    let points: Vec<DVec3> = model.points.values().map(|p| p.position).collect();
    let centre = median_point(if points.is_empty() { &centres } else { &points });
    let distance = quantile(centres.iter().map(|c| c.distance(centre)).collect(), 0.5);
    let distance = distance.filter(|r| *r > 0.0 && r.is_finite()).unwrap_or(radius);
    let scale = radius / distance;
    Sim3 { scale, translation: -scale * centre, ..Sim3::IDENTITY }
}

/// Distances of the points from the first camera that `low` and `high` (shares) of them stay below;
/// `None` without points.
pub fn depth_range(model: &Reconstruction, low: f64, high: f64) -> Option<[f64; 2]> {
    let first = model.images.values().next().map_or(DVec3::ZERO, |i| i.pose.centre());
    let depths: Vec<f64> = model.points.values().map(|p| p.position.distance(first)).collect();
    Some([quantile(depths.clone(), low)?, quantile(depths, high)?])
}

/// The value that a share of the values stays below (nearest rank, downwards); `None` of none.
pub fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let index = (values.len().checked_sub(1)? as f64 * share) as usize;
    values.sort_unstable_by(f64::total_cmp);
    values.get(index).copied()
}

fn median_point(points: &[DVec3]) -> DVec3 {
    let medians = [0, 1, 2].map(|axis| quantile(points.iter().map(|p| p[axis]).collect(), 0.5));
    DVec3::from_array(medians.map(|m| m.unwrap_or(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{SyntheticOptions, synthetic_scene};

    #[test]
    fn cameras_and_their_frusta_lie_in_the_unit_cube_whatever_the_units_are() {
        let options = SyntheticOptions { num_points: 50, num_cameras: 8, ..Default::default() };
        let model = synthetic_scene(&options, 3).truth;
        for scale in [1e-6, 1.0, 1e6] {
            let model = Sim3 { scale, ..Sim3::IDENTITY }.transform_reconstruction(&model);
            let overview = Overview::of(&model, None);
            let corners = model.images.values().filter_map(|i| overview.frustum(&model, i)).flatten();
            let far = corners.map(|c| c.abs().max_element()).fold(0.0, f64::max);
            assert!((0.3..1.0).contains(&far), "{scale}: {far}");
        }
    }

    #[test]
    fn a_centred_model_has_its_cameras_at_the_radius() {
        let options = SyntheticOptions { num_points: 50, num_cameras: 9, ..Default::default() };
        let model = synthetic_scene(&options, 3).truth;
        let moved = centred(&model, 16.0).transform_reconstruction(&model);
        let distances = moved.images.values().map(|i| i.pose.centre().length()).collect();
        assert!((quantile(distances, 0.5).unwrap() - 16.0).abs() < 1e-9);
        let [near, far] = depth_range(&moved, 0.02, 0.98).unwrap();
        assert!(0.0 < near && near < far);
    }

    #[test]
    fn quantiles_are_values_of_the_list() {
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 0.95), Some(2.0));
        assert_eq!(quantile(vec![], 0.5), None);
    }
}
