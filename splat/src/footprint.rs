//! How large a pixel is in the scene.

use crate::dataset::Dataset;
use crate::init::focus;
use crate::quantile::median;
use crate::view::PinholeView;

/// Points of the sparse cloud that are looked at, at most. Source: chosen by hand; a median is
/// sought.
const POINTS: usize = 500;
/// Outside of this, normalised units, it says nothing of step sizes: pictures of a few pixels, or
/// points that are all wrong.
/// Source: chosen by hand around the pixels of fox and temple_ring, 3e-3 and 7e-4
/// (docs/decisions/12).
const RANGE: std::ops::RangeInclusive<f32> = 1e-5..=1e-2;

/// Width of a pixel at the depth of the scene, normalised units: the median of z / f over the
/// training views and those points of the sparse cloud that they have in their pictures; without
/// any, of the distance from what the cameras look at.
///
/// What a picture tells of a place it tells in pixels, so this is what steps of positions are
/// measured in.
pub(crate) fn footprint(dataset: &Dataset) -> f32 {
    let points: Vec<_> = dataset.points.iter().filter(|(p, _)| p.is_finite()).collect();
    let some = points.iter().step_by(points.len().div_ceil(POINTS).max(1));
    let views: Vec<_> = dataset.views.iter().filter(|v| !v.held_out).map(|v| v.view).collect();
    let mut sizes: Vec<f32> = Vec::new();
    for (x, _) in some {
        for view in &views {
            let c = view.camera_point(*x);
            if view.sees(c) {
                sizes.push(c.z / focal(view));
            }
        }
    }
    if sizes.is_empty() {
        let distance =
            focus(&dataset.views.iter().collect::<Vec<_>>()).map_or(1.0, |(_, distance)| distance as f32);
        sizes.extend(views.iter().map(|view| distance / focal(view)));
    }
    let finite = sizes.iter().filter(|s| s.is_finite()).map(|s| f64::from(*s));
    median(finite.collect()).map_or(*RANGE.start(), |s| s as f32).clamp(*RANGE.start(), *RANGE.end())
}

/// Geometric mean of the focal lengths, pixels.
fn focal(view: &PinholeView) -> f32 {
    (view.focal[0].abs() * view.focal[1].abs()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{AlphaMode, NormalisedFrame, View};
    use glam::{DVec3, Vec3};
    use scene::{Camera, CameraModel, Pose};

    /// Eight cameras of `focal` pixels at distance 1 around the origin, the first held out, and
    /// some points.
    fn capture(focal: f64, points: &[Vec3]) -> Dataset {
        let normalisation = NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 };
        let camera = Camera::centred(1, CameraModel::Pinhole, 640, 480, focal);
        let view = |k: usize| {
            let (s, c) = (k as f64 / 8.0 * std::f64::consts::TAU).sin_cos();
            let pose = Pose::look_at(DVec3::new(c, s, 0.0), DVec3::ZERO, DVec3::Z);
            let view = normalisation.view(&camera, &pose);
            let levels = Vec::new();
            View { name: format!("{k}.png"), camera: camera.clone(), pose, view, levels, held_out: k == 0 }
        };
        let points = points.iter().map(|p| (*p, [0; 3])).collect();
        Dataset {
            views: (0..8).map(view).collect(),
            points,
            normalisation,
            alpha: AlphaMode::Transparent,
            articulation: None,
        }
    }

    #[test]
    fn a_pixel_is_as_wide_as_depth_over_focal_length() {
        for focal in [300.0, 600.0, 1200.0] {
            let about = |points: &[Vec3]| f64::from(footprint(&capture(focal, points))) * focal;
            assert!((about(&[Vec3::ZERO]) - 1.0).abs() < 1e-5);
            // What the cameras look at stands in for points, also where there is none that tells
            // anything.
            assert!((about(&[]) - 1.0).abs() < 1e-5);
            assert!((about(&[Vec3::NAN, Vec3::new(0.0, 0.0, 90.0)]) - 1.0).abs() < 1e-5);
            // A point beside the ring's middle is nearer for as many cameras as it is farther for.
            let around: Vec<Vec3> =
                (0..2000).map(|i| Vec3::new((i as f32).sin(), (i as f32).cos(), 0.0) * 0.1).collect();
            assert!((about(&around) - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn what_no_capture_can_mean_is_limited() {
        assert_eq!(footprint(&capture(2.0, &[Vec3::ZERO])), *RANGE.end());
        assert_eq!(footprint(&capture(1e9, &[Vec3::ZERO])), *RANGE.start());
        assert!(RANGE.contains(&footprint(&capture(f64::NAN, &[Vec3::ZERO]))));
        let none = Dataset { views: Vec::new(), ..capture(500.0, &[]) };
        assert!(RANGE.contains(&footprint(&none)));
    }
}
