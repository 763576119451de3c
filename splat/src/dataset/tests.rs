//! The normalised frame.

use super::*;
use scene::{Pose, ScenePoint};

/// A capture whose numbers are `unit` times those of a ring of cameras about (5, −3, 8).
fn capture(unit: f64, radius: f64, points: usize) -> Reconstruction {
    let middle = DVec3::new(5.0, -3.0, 8.0);
    let image = |id: u32| {
        let (s, c) = (f64::from(id) / 8.0 * std::f64::consts::TAU).sin_cos();
        let eye = middle + DVec3::new(c, s, 0.0) * radius;
        let pose = Pose::look_at(eye * unit, (middle + DVec3::X * 3.0) * unit, DVec3::Z);
        (id, PosedImage { id, camera: 1, name: format!("{id}.png"), pose, observations: Vec::new() })
    };
    let point = |k: u64| {
        let place = middle + DVec3::new(3.0, 0.1 * k as f64, 0.0);
        (k, ScenePoint { position: place * unit, rgb: [0; 3], error_px: 0.5, track: Vec::new() })
    };
    Reconstruction {
        cameras: [(1, Camera::centred(1, CameraModel::Pinhole, 64, 48, 50.0))].into(),
        images: (0..8).map(image).collect(),
        points: (0..points as u64).map(point).collect(),
    }
}

/// Views and points of a model in the normalised frame.
fn normalised(model: &Reconstruction) -> (NormalisedFrame, Vec<PinholeView>, Vec<Vec3>) {
    let n = NormalisedFrame::of(model);
    let views = model.images.values().map(|i| n.view(&model.cameras[&1], &i.pose)).collect();
    (n, views, model.points.values().map(|p| n.point(p.position)).collect())
}

#[test]
fn scenes_of_any_unit_have_the_same_normalised_views_and_points() {
    let (_, first, places) = normalised(&capture(1.0, 2.0, 9));
    for unit in [1e-6, 1.0, 1e6] {
        let (n, views, points) = normalised(&capture(unit, 2.0, 9));
        assert!((n.scale * 2.0 * unit - 1.0).abs() < 1e-9, "unit {unit:e}: {n:?}");
        assert!((n.centre / unit - DVec3::new(5.0, -3.0, 8.0)).length() < 1e-9, "unit {unit:e}: {n:?}");
        for (view, same) in views.iter().zip(&first) {
            assert!((view.position().length() - 1.0).abs() < 1e-6, "unit {unit:e}: {view:?}");
            assert!((view.translation - same.translation).length() < 1e-6, "unit {unit:e}: {view:?}");
            assert!(view.rotation.abs_diff_eq(same.rotation, 1e-6), "unit {unit:e}: {view:?}");
            assert_eq!((view.focal, view.centre), (same.focal, same.centre));
        }
        for (point, same) in points.iter().zip(&places) {
            assert!((*point - *same).length() < 1e-6, "unit {unit:e}: {point} should be {same}");
        }
    }
}

/// A point is seen in the same pixel before and after, at a depth in the normalised unit.
#[test]
fn a_normalised_view_sees_what_the_camera_saw() {
    let model = capture(1e6, 2.0, 9);
    let (n, views, points) = normalised(&model);
    for (view, image) in views.iter().zip(model.images.values()) {
        for (x, point) in points.iter().zip(model.points.values()) {
            let (seen, truth) = (view.rotation * *x + view.translation, image.pose.transform(point.position));
            let pixel = |a: usize| view.focal[a] * seen[a] / seen.z + view.centre[a];
            let expected = model.cameras[&1].project(truth).unwrap();
            assert!((f64::from(pixel(0)) - expected.x).abs() < 1e-3, "{} {expected}", pixel(0));
            assert!((f64::from(pixel(1)) - expected.y).abs() < 1e-3, "{} {expected}", pixel(1));
            assert!((f64::from(seen.z) / (truth.z * n.scale) - 1.0).abs() < 1e-5);
        }
    }
}

#[test]
fn cameras_at_one_place_are_measured_by_the_points_and_nothing_at_all_by_itself() {
    for unit in [1e-6, 1.0, 1e6] {
        // Of nine points the middle one is 0.4 beside what the cameras look at, 3 away.
        let (n, _, points) = normalised(&capture(unit, 1e-9, 9));
        assert!((n.scale * unit * 9.16f64.sqrt() - 1.0).abs() < 1e-6, "unit {unit:e}: {n:?}");
        let mut distances: Vec<f32> = points.iter().map(|p| p.length()).collect();
        distances.sort_by(f32::total_cmp);
        assert!((distances[4] - 1.0).abs() < 1e-5, "{distances:?}");
    }
    let (n, views, _) = normalised(&capture(1.0, 0.0, 0));
    assert!(n.scale.is_finite() && n.scale > 0.0 && views.iter().all(|v| v.translation.is_finite()));
    assert_eq!(NormalisedFrame::of(&Reconstruction::default()).scale, 1.0);
}

#[test]
fn gaussians_come_back_from_the_normalised_frame_as_they_were() {
    let world = Gaussians {
        means: vec![Vec3::new(5e6, -3e6, 9e6), Vec3::new(4e6, -3.5e6, 8e6)],
        log_scales: vec![Vec3::new(11.0, 12.0, 13.0), Vec3::splat(10.0)],
        rotations: vec![glam::Quat::IDENTITY; 2],
        opacity_logits: vec![0.5; 2],
        sh: vec![0.1; 6],
        sh_degree: 0,
    };
    let n = NormalisedFrame::of(&capture(1e6, 2.0, 9));
    let inner = n.normalise(world.clone());
    assert!((inner.means[0] - Vec3::new(0.0, 0.0, 0.5)).length() < 1e-6, "{:?}", inner.means);
    assert!((inner.log_scales[1] - Vec3::splat(10.0 - 2e6f32.ln())).length() < 1e-5);
    let back = n.denormalise(inner);
    for i in 0..2 {
        assert!((back.means[i] - world.means[i]).length() < 2.0, "{:?}", back.means);
        assert!((back.log_scales[i] - world.log_scales[i]).length() < 1e-5, "{:?}", back.log_scales);
    }
}
