//! Scenes of any unit, read from files as [`Dataset::load`] reads them.

use super::*;
use crate::dataset::DatasetConfig;
use scene::{PosedImage, Reconstruction, ScenePoint};

/// Where the origin of the test scene lies in the world, in units of the scene's radius.
const CENTRE: DVec3 = DVec3::new(3.0, -2.0, 1.0);

/// The cameras and points of a dataset in a world of another unit and origin.
fn model_in_unit(dataset: &Dataset, unit: f64) -> Reconstruction {
    let world = |x: DVec3| (x + CENTRE) * unit;
    let image = |(k, view): (usize, &View)| {
        let pose = Pose::from_centre(view.pose.rotation, world(view.pose.centre()));
        let (id, name) = (k as u32 + 1, view.name.clone());
        (id, PosedImage { id, camera: view.camera.id, name, pose, observations: Vec::new() })
    };
    let point = |(k, (x, rgb)): (usize, &(Vec3, [u8; 3]))| {
        let position = world(x.as_dvec3());
        (k as u64, ScenePoint { position, rgb: *rgb, error_px: 0.5, track: Vec::new() })
    };
    let camera = dataset.views[0].camera.clone();
    Reconstruction {
        cameras: [(camera.id, camera)].into(),
        images: dataset.views.iter().enumerate().map(image).collect(),
        points: dataset.points.iter().enumerate().map(point).collect(),
    }
}

/// Saves the photos, and loads them with the model in every unit.
fn loaded_in_units(name: &str, photos: &Dataset, units: &[f64]) -> Vec<Dataset> {
    let folder = folder(name);
    std::fs::create_dir_all(&folder).unwrap();
    for view in &photos.views {
        let (pixels, [w, h]) = (&view.levels[0], SIZE);
        let path = folder.join(&view.name);
        image::save_buffer(path, &pixels.rgb, w, h, image::ExtendedColorType::Rgb8).unwrap();
    }
    let config = DatasetConfig { test_every: Some(6), ..DatasetConfig::default() };
    let load = |unit: &f64| {
        let model = model_in_unit(photos, *unit);
        Dataset::load(&folder, None, &model, &config, &Progress::silent()).unwrap()
    };
    let loaded = units.iter().map(load).collect();
    std::fs::remove_dir_all(&folder).unwrap();
    loaded
}

/// A unit that is a power of two changes no digit of any number, so that nothing may differ but the
/// exponent: training in one unit is training in the other, bit for bit.
#[test]
fn a_scene_in_another_unit_becomes_the_same_gaussians_in_that_unit() {
    let units = [1.0, f64::from(2.0f32.powi(-20)), f64::from(2.0f32.powi(20))];
    let datasets = loaded_in_units("powers", &dataset(12, false), &units);
    let run = |d: &Dataset| train(d, &config(200), None, &Progress::silent()).unwrap();
    let one = run(&datasets[0]);
    assert!(one.gaussians.len() > 80 && held_out_psnr(&datasets[0], &one) > 22.0);
    for (unit, dataset) in units.into_iter().zip(&datasets) {
        assert_eq!(dataset.points, datasets[0].points, "unit {unit:e}");
        for (view, same) in dataset.views.iter().zip(&datasets[0].views) {
            assert_eq!((view.view, view.held_out), (same.view, same.held_out), "unit {unit:e}");
        }
        let (other, unit) = (run(dataset), unit as f32);
        let moved: Vec<Vec3> = one.gaussians.means.iter().map(|m| *m * unit).collect();
        assert_eq!(other.gaussians.means, moved, "unit {unit:e}");
        assert_eq!(other.gaussians.rotations, one.gaussians.rotations, "unit {unit:e}");
        assert_eq!(other.gaussians.opacity_logits, one.gaussians.opacity_logits, "unit {unit:e}");
        assert_eq!(other.gaussians.sh, one.gaussians.sh, "unit {unit:e}");
        for (scale, first) in other.gaussians.log_scales.iter().zip(&one.gaussians.log_scales) {
            let error = (*scale - *first - Vec3::splat(unit.ln())).abs().max_element();
            assert!(error < 1e-5, "unit {unit:e}: {scale} should be {first} + {}", unit.ln());
        }
        let near = [&other, &one].map(|r| r.render.near.unwrap());
        assert_eq!(near[0], near[1] * unit);
    }
}

/// Rounding differs there, and every rounding leads to other Gaussians; but not to worse ones.
#[test]
fn scenes_of_any_unit_train_alike() {
    let units = [1e-6, 1.0, 1e6];
    let datasets = loaded_in_units("units", &dataset(12, false), &units);
    let psnr = |d: &Dataset| held_out_psnr(d, &train(d, &config(200), None, &Progress::silent()).unwrap());
    let [small, one, large] = [0, 1, 2].map(|k| psnr(&datasets[k]));
    assert!((small - one).abs() < 0.1 && (large - one).abs() < 0.1, "{small} {one} {large}");
}
