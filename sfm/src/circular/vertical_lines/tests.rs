//! Lines of drawn rooms.

use super::*;
use glam::{DQuat, DVec2};

const TRUTH_DEG: f64 = 8.0;

/// A camera that looks down by some degrees on a turn about an axis that is thought to lean by
/// `thought_deg`.
fn seen(thought_deg: f64) -> (Camera, CircularMotion) {
    let camera = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 520.0);
    let lean = thought_deg.to_radians();
    let up = DVec3::new(0.0, -lean.cos(), -lean.sin());
    (camera, CircularMotion::new(up, DVec3::new(0.0, 0.0, 2.0), vec![Some(0.0), Some(0.1)]).unwrap())
}

/// The image of a line through a point at depth 3 seen at `pixel`, along `up` turned by some
/// degrees in the image.
fn line(camera: &Camera, pixel: DVec2, askew_deg: f64) -> Segment {
    let truth = TRUTH_DEG.to_radians();
    let up = DQuat::from_rotation_z(askew_deg.to_radians()) * DVec3::new(0.0, -truth.cos(), -truth.sin());
    let from = camera.ray(pixel) * 3.0;
    let at = |k: i32| camera.project(from + up * 0.01 * f64::from(k));
    Segment { points: (-30..30).filter_map(at).collect() }
}

fn vertical(camera: &Camera) -> Vec<Segment> {
    let left = [(15.0, 110.0), (60.0, 120.0), (90.0, 300.0), (160.0, 330.0)];
    let right = [(500.0, 200.0), (560.0, 140.0), (600.0, 320.0), (440.0, 340.0)];
    let places = left.iter().chain(&right);
    places.map(|&(x, y)| line(camera, DVec2::new(x, y), 0.0)).collect()
}

#[test]
fn vertical_lines_among_others_show_how_the_camera_looks_down() {
    let (camera, turn) = seen(TRUTH_DEG + 0.8);
    let mut lines = vertical(&camera);
    let others = [(30.0, 3.1), (130.0, -2.4), (470.0, 1.7), (530.0, -3.6), (620.0, 2.6)];
    lines.extend(others.iter().map(|&(x, askew)| line(&camera, DVec2::new(x, 230.0), askew)));
    let found = elevation(&lines, &camera, &turn).expect("eight vertical lines agree");
    let error = found.angle.to_degrees() - TRUTH_DEG;
    assert!(error.abs() < 0.1 && found.sigma.to_degrees() < 0.3, "{error}° {found:?}");
}

#[test]
fn lines_that_do_not_agree_or_stand_on_one_side_show_nothing() {
    let (camera, turn) = seen(TRUTH_DEG);
    let askew = [(60.0, 3.5), (120.0, -2.9), (500.0, 2.2), (560.0, -4.1), (600.0, 1.6)];
    let lines: Vec<Segment> =
        askew.iter().map(|&(x, askew)| line(&camera, DVec2::new(x, 240.0), askew)).collect();
    assert_eq!(elevation(&lines, &camera, &turn), None);
    let right: Vec<Segment> = vertical(&camera).into_iter().filter(|s| s.points[0].x > 320.0).collect();
    assert_eq!(elevation(&right, &camera, &turn), None);
    assert_eq!(elevation(&[], &camera, &turn), None);
}

#[test]
fn edges_of_a_picture_are_found_and_noise_and_flat_ones_are_not() {
    let mut picture = scene::FloatImage::zeros(160, 120, 1);
    assert!(edges::straight_edges(&picture).is_empty());
    for y in 0..120 {
        for x in 0..160 {
            // A step that leans by a tenth, with a soft edge.
            let off = x as f32 + 0.5 - 70.0 - 0.1 * (y as f32 + 0.5 - 60.0);
            picture.data[y * 160 + x] = 0.3 + 0.2 / (1.0 + (-2.0 * off).exp());
        }
    }
    let found = edges::straight_edges(&picture);
    assert_eq!(found.len(), 1);
    let [first, last] = [found[0].points[0], *found[0].points.last().unwrap()];
    let lean = (last.x - first.x) / (last.y - first.y);
    assert!((lean - 0.1).abs() < 0.005 && last.y - first.y > 100.0, "{first} {last}");
    picture.data.fill(f32::NAN);
    assert!(edges::straight_edges(&picture).is_empty());
}
