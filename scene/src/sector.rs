//! A whole sector of directions of a capture, for evaluation: views between training views flatter.

use crate::Reconstruction;
use glam::{DMat3, DVec3};
use std::collections::BTreeSet;

/// Names of the images that see the object from within half of `angle`, radians, of the direction
/// from which the first image (by name) sees it. The object lies where the optical axes meet (least
/// squares); none is in the sector where they are parallel.
pub fn sector(model: &Reconstruction, angle: f64) -> BTreeSet<String> {
    let axes = model.images.values().map(|i| (i.pose.centre(), i.pose.rotation.conjugate() * DVec3::Z));
    let Some(focus) = focus(axes) else { return BTreeSet::new() };
    let direction = |centre: DVec3| (centre - focus).normalize_or_zero();
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_unstable_by(|a, b| a.name.cmp(&b.name));
    let Some(first) = images.first().map(|image| direction(image.pose.centre())) else {
        return BTreeSet::new();
    };
    let inside = images.iter().filter(|i| direction(i.pose.centre()).angle_between(first) <= angle / 2.0);
    inside.map(|image| image.name.clone()).collect()
}

/// Determinant a view at which optical axes are parallel. Source: a spread of the axes of about
/// 0.6°.
const PARALLEL: f64 = 1e-4;

/// The point nearest to all optical axes, given as centres and unit directions: `Σ (I − d dᵀ) x =
/// Σ (I − d dᵀ) c`. None where they are parallel.
pub fn focus(axes: impl Iterator<Item = (DVec3, DVec3)>) -> Option<DVec3> {
    let (mut left, mut right, mut count) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for (centre, axis) in axes {
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        left += across;
        right += across * centre;
        count += 1.0;
    }
    (left.determinant() > PARALLEL * f64::powi(count, 3)).then(|| left.inverse() * right)
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
