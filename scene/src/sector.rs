//! A whole sector of directions of a capture, for evaluation: views between training views flatter.

use crate::Reconstruction;
use glam::{DMat3, DVec3};
use std::collections::BTreeSet;

/// Names of the images that see the object from within half of `angle`, radians, of the direction
/// from which the first image (by name) sees it. The object lies where the optical axes meet (least
/// squares); none is in the sector where they are parallel.
pub fn sector(model: &Reconstruction, angle: f64) -> BTreeSet<String> {
    let Some(focus) = focus(model) else { return BTreeSet::new() };
    let direction = |centre: DVec3| (centre - focus).normalize_or_zero();
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_unstable_by(|a, b| a.name.cmp(&b.name));
    let Some(first) = images.first().map(|image| direction(image.pose.centre())) else {
        return BTreeSet::new();
    };
    let inside = images.iter().filter(|i| direction(i.pose.centre()).angle_between(first) <= angle / 2.0);
    inside.map(|image| image.name.clone()).collect()
}

/// The point nearest to all optical axes: `Σ (I − d dᵀ) x = Σ (I − d dᵀ) c`.
fn focus(model: &Reconstruction) -> Option<DVec3> {
    let (mut left, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for image in model.images.values() {
        let axis = image.pose.rotation.conjugate() * DVec3::Z;
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        left += across;
        right += across * image.pose.centre();
    }
    // Of axes that a rounding error keeps from being parallel.
    let parallel = f64::EPSILON * (model.images.len() as f64).powi(3);
    (left.determinant() > parallel).then(|| left.inverse() * right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pose, PosedImage};

    fn ring(count: u32) -> Reconstruction {
        let mut model = Reconstruction::default();
        for id in 0..count {
            let angle = std::f64::consts::TAU * f64::from(id) / f64::from(count);
            let eye = DVec3::new(3.0 + angle.cos(), angle.sin(), 0.5);
            let pose = Pose::look_at(eye, DVec3::new(3.0, 0.0, 0.0), DVec3::Z);
            let name = format!("{id:02}.png");
            model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: Vec::new() });
        }
        model
    }

    #[test]
    fn a_sector_of_a_ring_is_centred_on_the_first_view() {
        // The ring stands half a radius above the object, so that 60 degrees there are more of it.
        let names: Vec<String> = sector(&ring(36), 60f64.to_radians()).into_iter().collect();
        assert_eq!(names, ["00.png", "01.png", "02.png", "03.png", "33.png", "34.png", "35.png"]);
    }

    #[test]
    fn without_views_or_with_one_nothing_is_held_out() {
        assert!(sector(&ring(0), 1.0).is_empty());
        assert!(sector(&ring(1), 1.0).is_empty());
    }
}
