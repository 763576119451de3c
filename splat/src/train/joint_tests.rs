//! Training of a scene one part of which turns.

use super::*;
use crate::dataset::{Joint, MovingParts};

/// Views; the part turns by so many degrees from each to the next.
const VIEWS: usize = 60;
const TURN_DEG: f64 = 2.0;

/// A ball of blobs, and beside it a plate of them that is part 1.
fn turning() -> (Gaussians, Vec<u8>) {
    let mut g = truth();
    let mut rng = scene::rng::rng(9, "plate", 0);
    g.means.iter_mut().for_each(|m| *m *= 0.5);
    let body = g.len();
    for i in 0..8 {
        for j in 0..8 {
            let place = |k: i32| 0.3 + 0.05 * k as f32;
            g.means.push(Vec3::new(place(i), 0.05 * (j as f32 - 3.5), 0.0));
            g.log_scales.push(Vec3::new(-3.4, -3.4, -5.0));
            g.rotations.push(Quat::IDENTITY);
            g.opacity_logits.push(2.0);
            g.sh.extend((0..3).map(|_| rng.random_range(-1.2f32..1.2)));
        }
    }
    let parts = (0..g.len()).map(|i| u8::from(i >= body)).collect();
    (g, parts)
}

fn true_angle(view: usize) -> f64 {
    (TURN_DEG * view as f64).to_radians()
}

/// The true pictures, with angles as tracks would give them: wrong at first by up to `wrong_deg`.
fn captured(wrong_deg: f64) -> Dataset {
    let (g, part) = turning();
    let mut dataset = pictures_of(&g, VIEWS, true, [64, 48]);
    let angle = |k: usize| {
        let early = (1.0 - k as f64 / 20.0).max(0.0);
        true_angle(k) + early * wrong_deg.to_radians()
    };
    let joint = Joint {
        axis: DVec3::X,
        place: DVec3::ZERO,
        angles: (0..VIEWS).map(true_angle).collect(),
        sigmas: vec![0.1; VIEWS],
        unsure: [0.0; 2],
    };
    let mut moving = MovingParts {
        joints: vec![joint],
        of_points: part.clone(),
        times: (0..VIEWS).map(|k| k as f64).collect(),
        gaussians: Vec::new(),
    };
    dataset.place_parts(moving.clone());
    let mut backend = CpuBackend::default();
    backend.upload(Model { part, ..Model::from_gaussians(&g) }, Statistics::default()).unwrap();
    for view in &mut dataset.views {
        let picture = backend.render(&view.view, &RenderOptions::default()).unwrap();
        let alpha = &picture.alpha.data;
        let straight = |(i, v): (usize, &f32)| (v / alpha[i / 3].max(1e-3) * 255.0).round() as u8;
        view.levels = crate::dataset::pyramid(Pixels {
            width: 64,
            height: 48,
            rgb: picture.rgb.data.iter().enumerate().map(straight).collect(),
            mask: Some(alpha.iter().map(|a| (a * 255.0).round() as u8).collect()),
        });
    }
    moving.joints[0].angles = (0..VIEWS).map(angle).collect();
    dataset.place_parts(moving);
    dataset
}

/// RMS of the errors of angles but for the offset of all, degrees.
fn error_deg(angles: &[f64]) -> f64 {
    let errors: Vec<f64> = angles.iter().enumerate().map(|(k, a)| a - true_angle(k)).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let square = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / errors.len() as f64;
    square.sqrt().to_degrees()
}

#[test]
fn angles_are_found_where_tracks_had_them_wrong() {
    let dataset = captured(8.0);
    let given = &dataset.articulation.as_ref().unwrap().joints[0].angles;
    let before = error_deg(given);
    let result = train(&dataset, &config(600), None, &Progress::silent()).unwrap();
    let moved = result.moving.unwrap();
    let after = error_deg(&moved.joints[0].angles);
    assert!(before > 1.5 && after < before / 3.0, "{before:.2}° before, {after:.2}° after");
    assert_eq!(moved.gaussians.iter().sum::<usize>(), result.gaussians.len());
    assert!(moved.gaussians.iter().all(|&n| n > 30), "{:?}", moved.gaussians);
}

#[test]
fn a_scene_that_moves_is_learnt_as_well_as_one_that_stands_still() {
    let dataset = captured(0.0);
    let result = train(&dataset, &config(500), None, &Progress::silent()).unwrap();
    let moved = result.moving.as_ref().unwrap();
    let labels = (0..).zip(&moved.gaussians).flat_map(|(p, &n)| std::iter::repeat_n(p, n));
    let device = crate::DeviceConfig::default();
    let (mut renderer, _) = crate::Renderer::on(&device, &result.gaussians, labels.collect()).unwrap();
    let psnr = |renderer: &mut crate::Renderer, moves: bool| {
        let mut sum = (0.0, 0.0);
        for (k, view) in dataset.views.iter().enumerate().filter(|(_, v)| v.held_out) {
            let angle = if moves { moved.joints[0].angles[k] } else { 0.0 };
            let turn = glam::DQuat::from_rotation_x(angle);
            renderer.part_poses = vec![Pose::new(turn, DVec3::ZERO)];
            let image = renderer.render(&view.camera, &view.pose, &result.render).unwrap().rgb;
            let pixels = &view.levels[0];
            for (i, v) in image.data.iter().enumerate() {
                let alpha = f32::from(pixels.mask.as_ref().unwrap()[i / 3]) / 255.0;
                sum.0 += f64::from(v - alpha * f32::from(pixels.rgb[i]) / 255.0).powi(2);
                sum.1 += 1.0;
            }
        }
        -10.0 * f64::log10(sum.0 / sum.1)
    };
    let (moving, still) = (psnr(&mut renderer, true), psnr(&mut renderer, false));
    assert!(moving > 27.0 && moving > still + 5.0, "{moving:.2} dB moving, {still:.2} dB at rest");
}

#[test]
fn an_axis_that_was_wrong_is_turned_as_far_as_its_deviation_lets_it() {
    let off_deg = |sigma_deg: f64| {
        let mut dataset = captured(0.0);
        let mut moving = dataset.articulation.take().unwrap();
        moving.joints[0].axis = glam::DQuat::from_rotation_z(10f64.to_radians()) * DVec3::X;
        moving.joints[0].unsure = [sigma_deg.to_radians(), 0.0];
        dataset.place_parts(moving);
        let result = train(&dataset, &config(600), None, &Progress::silent()).unwrap();
        result.moving.unwrap().joints[0].axis.cross(DVec3::X).length().asin().to_degrees()
    };
    let (sure, unsure) = (off_deg(0.0), off_deg(10.0));
    assert!((sure - 10.0).abs() < 1e-6 && unsure < 3.0, "{sure}° and {unsure}° off");
}
