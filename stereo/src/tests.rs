use super::*;
use glam::{DVec2, DVec3};
use image::{GrayImage, RgbImage};
use scene::synthetic::{TexturedScene, default_camera, orbit_pose};
use scene::{Camera, CameraModel, Pose, PosedPhoto, Progress};

/// Photos of the textured block before black, with their masks.
struct Shot {
    scene: TexturedScene,
    camera: Camera,
    poses: Vec<Pose>,
    photos: Vec<RgbImage>,
    masks: Vec<GrayImage>,
}

impl Shot {
    fn new(unit: f64, views: usize, width: u32) -> Self {
        let scene = TexturedScene { unit, ground: false, background: [0; 3], seed: 3, ..Default::default() };
        let camera = default_camera(CameraModel::SimplePinhole, width, width * 3 / 4);
        let poses: Vec<Pose> =
            (0..views).map(|i| orbit_pose(0.4 + 0.14 * i as f64, 0.35, 4.0 * unit)).collect();
        let photos = poses.iter().map(|p| scene.render(&camera, p)).collect();
        let masks = poses.iter().map(|p| scene.render_mask(&camera, p)).collect();
        Self { scene, camera, poses, photos, masks }
    }

    fn views(&self) -> Vec<PosedPhoto<'_>> {
        (0..self.poses.len())
            .map(|i| PosedPhoto {
                camera: &self.camera,
                pose: self.poses[i],
                rgb: self.photos[i].as_raw(),
                mask: Some(self.masks[i].as_raw()),
            })
            .collect()
    }

    /// Points on the surface, as a sparse cloud has them.
    fn points(&self) -> Vec<DVec3> {
        let seen = self.poses.iter().flat_map(|pose| {
            let pixels = (0..12).flat_map(|x| (0..9).map(move |y| (x, y)));
            pixels.filter_map(|(x, y)| {
                let size = DVec2::new(f64::from(self.camera.width), f64::from(self.camera.height));
                let pixel = DVec2::new((f64::from(x) + 0.5) / 12.0, (f64::from(y) + 0.5) / 9.0) * size;
                let z = self.scene.depth(&self.camera, pose, pixel)?;
                let ray = (pixel - self.camera.principal_point()) / self.camera.focal();
                Some(pose.inverse().transform(ray.extend(1.0) * z))
            })
        });
        seen.collect()
    }

    /// Relative errors of the depths that were found, and how many pixels the mask has.
    fn errors(&self, fields: &[PlaneField]) -> (Vec<f64>, usize) {
        let mut errors = Vec::new();
        for (field, pose) in fields.iter().zip(&self.poses) {
            for i in (0..field.depth.len()).filter(|&i| field.depth[i] > 0.0) {
                let (x, y) = field.place(i);
                let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let Some(truth) = self.scene.depth(&self.camera, pose, pixel) else { continue };
                errors.push((f64::from(field.depth[i]) / truth - 1.0).abs());
            }
        }
        errors.sort_by(f64::total_cmp);
        (errors, self.masks.iter().flat_map(|m| m.as_raw()).filter(|v| **v >= 128).count())
    }
}

fn settings() -> StereoSettings {
    StereoSettings::default()
}

fn found(shot: &Shot) -> Vec<PlaneField> {
    dense_depths(&shot.views(), &shot.points(), &settings(), &Progress::silent()).unwrap().fields
}

#[test]
fn depths_of_a_textured_block_are_those_of_its_surface_at_any_size() {
    for unit in [1.0, 1e-6, 1e6] {
        let shot = Shot::new(unit, 8, 160);
        let (errors, pixels) = shot.errors(&found(&shot));
        let share = errors.len() as f64 / pixels as f64;
        let (median, tail) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
        assert!(share > 0.8, "unit {unit}: {share} of the pixels");
        // Between views 16° apart 0.004 of the depth are a fifth of a pixel.
        assert!(median < 0.004 && tail < 0.03, "unit {unit}: {median} {tail}");
    }
}

#[test]
fn normals_face_the_camera_and_are_those_of_the_surface() {
    let shot = Shot::new(1.0, 8, 160);
    let fields = found(&shot);
    let mut angles = Vec::new();
    for (field, pose) in fields.iter().zip(&shot.poses) {
        for i in (0..field.depth.len()).filter(|&i| field.depth[i] > 0.0) {
            let (x, y) = field.place(i);
            let at = |dx: f64, dy: f64| {
                let pixel = DVec2::new(x as f64 + dx, y as f64 + dy);
                let z = shot.scene.depth(&shot.camera, pose, pixel)?;
                Some(((pixel - shot.camera.principal_point()) / shot.camera.focal()).extend(1.0) * z)
            };
            let (Some(a), Some(b), Some(c)) = (at(0.4, 0.4), at(0.6, 0.4), at(0.4, 0.6)) else { continue };
            let truth = (c - a).cross(b - a).normalize();
            let normal = field.normal[i].as_dvec3();
            assert!(normal.dot(a) < 0.0 && (normal.length() - 1.0).abs() < 1e-4, "{normal}");
            angles.push(normal.angle_between(truth).to_degrees());
        }
    }
    angles.sort_by(f64::total_cmp);
    assert!(angles[angles.len() / 2] < 10.0, "{}", angles[angles.len() / 2]);
}

#[test]
fn one_thread_and_two_give_the_same() {
    let shot = Shot::new(1.0, 5, 96);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| found(&shot))
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn a_sheet_that_other_views_look_through_goes_and_the_surface_stays() {
    let shot = Shot::new(1.0, 8, 160);
    let (views, settings) = (shot.views(), settings());
    let mut fields = found(&shot);
    // One view claims something halfway to the surface in the upper rows.
    let sheet = fields[3].depth.len() / 3;
    let before = fields[3].depth.clone();
    fields[3].depth[..sheet].iter_mut().for_each(|z| *z *= 0.8);
    let claimed = fields[3].depth[..sheet].iter().filter(|z| **z > 0.0).count();
    seen_through::drop_seen_through(&mut fields, &views, &settings);
    let left = fields[3].depth[..sheet].iter().filter(|z| **z > 0.0).count();
    assert!(claimed > 100 && left * 20 < claimed, "{left} of {claimed}");
    let known = |depth: &[f32]| depth[sheet..].iter().filter(|z| **z > 0.0).count();
    assert!(known(&fields[3].depth) * 50 > known(&before) * 49);
}

#[test]
fn depths_that_were_kept_are_those_that_were_found() {
    let shot = Shot::new(1.0, 5, 96);
    let (views, points, settings) = (shot.views(), shot.points(), settings());
    let found = dense_depths(&views, &points, &settings, &Progress::silent()).unwrap();
    let mut bytes = Vec::new();
    found.write_to(&mut bytes).unwrap();
    let read_from = |mut bytes: &[u8]| DenseDepths::read_from(&mut bytes, &views, &points, &settings);
    let read = read_from(&bytes).unwrap();
    assert!(found.cloud(&views).len() > 100);
    assert_eq!(found.cloud(&views), read.cloud(&views));
    for (a, b) in found.fields.iter().zip(&read.fields) {
        assert_eq!(a.depth, b.depth);
    }
    // Of fewer or more views they are not.
    for wrong in [&bytes[..bytes.len() - 1], &bytes[1..], &[&bytes[..], &[0]].concat(), &[]] {
        assert!(read_from(wrong).is_none());
    }
    assert!(DenseDepths::read_from(&mut &bytes[..], &views[1..], &points, &settings).is_none());
}

#[test]
fn what_is_seen_much_aslant_has_the_other_depth() {
    let shot = Shot::new(1.0, 5, 96);
    let (views, points) = (shot.views(), shot.points());
    let found = dense_depths(&views, &points, &settings(), &Progress::silent()).unwrap();
    let join = DepthJoin::new(&found, &views);
    let field = &found.fields[2];
    let (focal, middle) = (field.camera.focal().x as f32, field.camera.principal_point().x as f32);
    // Planes behind the surface through the middle column, whose normals lean to the side.
    let plane = |tangent: f32| {
        let inverse = (0..field.depth.len()).map(|i| {
            let beside = field.place(i).0 as f32 + 0.5 - middle;
            50.0 / (1.0 + tangent / focal * beside)
        });
        inverse.collect::<Vec<f32>>()
    };
    let near_middle = |i: &usize| (field.place(*i).0 as f32 - middle).abs() < 4.0 && field.depth[*i] > 0.0;
    let middles: Vec<usize> = (0..field.depth.len()).filter(near_middle).collect();
    assert!(middles.len() > 50);
    for (tangent, is_other) in [(1.0, false), (-1.0, false), (5.0, true), (-5.0, true)] {
        let other = plane(tangent);
        let joined = join.joined(2, &other);
        let same = middles.iter().filter(|&&i| joined[i] == if is_other { other[i] } else { field.depth[i] });
        assert!(same.count() * 10 > middles.len() * 9, "{tangent}");
    }
}

#[test]
fn a_depth_before_that_by_stereo_counts_where_the_photos_do_not_contradict() {
    let shot = Shot::new(1.0, 5, 96);
    let (views, points) = (shot.views(), shot.points());
    let found = dense_depths(&views, &points, &settings(), &Progress::silent()).unwrap();
    let own = &found.fields[2].depth;
    let known = own.iter().filter(|z| **z > 0.0).count();
    let share = |joined: &[f32], factor: f32| {
        let same = joined.iter().zip(own).filter(|(a, b)| **b > 0.0 && **a == factor * **b);
        same.count() as f32 / known as f32
    };
    let nearer = |factor: f32| own.iter().map(|z| factor * z).collect::<Vec<f32>>();
    // The texture is seen: a surface 10 % nearer is refuted, one behind counts only much aslant.
    let join = DepthJoin::new(&found, &views);
    assert!(known > 500 && share(&join.joined(2, &nearer(0.9)), 1.0) > 0.95);
    assert!(share(&join.joined(2, &nearer(1.1)), 1.0) > 0.95);
    // Nothing is known there by one of the two, or by both.
    assert_eq!(join.joined(2, &vec![0.0; own.len()]), *own);
    let unknown = join.joined(2, &vec![7.0; own.len()]);
    assert!(unknown.iter().zip(own).all(|(a, b)| if *b > 0.0 { a == b } else { *a == 7.0 }));
    // Of a blank face the photos say nothing.
    let grey = vec![130; shot.photos[0].as_raw().len()];
    let plain: Vec<PosedPhoto> = views.iter().map(|v| PosedPhoto { rgb: &grey, mask: None, ..*v }).collect();
    let join = DepthJoin::new(&found, &plain);
    assert!(share(&join.joined(2, &nearer(0.9)), 0.9) > 0.95);
    assert!(share(&join.joined(2, &nearer(0.99)), 1.0) > 0.95, "less than the errors of both");
}

#[test]
fn what_cannot_be_matched_has_no_depth_and_nothing_panics() {
    let shot = Shot::new(1.0, 5, 96);
    let (views, points) = (shot.views(), shot.points());
    let dense = |views: &[PosedPhoto], points: &[DVec3]| {
        dense_depths(views, points, &settings(), &Progress::silent()).unwrap().fields
    };
    let empty = |fields: &[PlaneField]| fields.iter().all(|f| f.depth.iter().all(|z| *z == 0.0));
    assert!(dense(&[], &points).is_empty());
    assert!(empty(&dense(&views[..1], &points)), "one view");
    assert!(empty(&dense(&views, &[])), "no points");
    assert!(empty(&dense(&views, &[DVec3::NAN])), "points that are no numbers");
    let black = vec![0; shot.masks[0].as_raw().len()];
    let nothing: Vec<PosedPhoto> = views.iter().map(|v| PosedPhoto { mask: Some(&black), ..*v }).collect();
    assert!(empty(&dense(&nothing, &points)), "black masks");
    let same: Vec<PosedPhoto> = views.iter().map(|v| PosedPhoto { pose: views[0].pose, ..*v }).collect();
    assert!(empty(&dense(&same, &points)), "one place");
    // A surface without texture: whatever is found is finite.
    let grey = vec![130; shot.photos[0].as_raw().len()];
    let plain: Vec<PosedPhoto> = views.iter().map(|v| PosedPhoto { rgb: &grey, ..*v }).collect();
    for field in dense(&plain, &points) {
        assert!(field.depth.iter().all(|z| z.is_finite()) && field.normal.iter().all(|n| n.is_finite()));
    }
}

#[test]
fn views_that_are_not_what_they_should_be_are_refused() {
    let shot = Shot::new(1.0, 3, 96);
    let mut views = shot.views();
    views[2].pose.translation.x = f64::NAN;
    let short = &shot.photos[0].as_raw()[1..];
    let mut distorted = default_camera(CameraModel::SimpleRadial, 96, 72);
    distorted.params[3] = 0.1;
    for (view, why) in [
        (views[2], "finite"),
        (PosedPhoto { rgb: short, ..views[0] }, "size"),
        (PosedPhoto { mask: Some(short), ..views[0] }, "mask"),
        (PosedPhoto { camera: &distorted, ..views[0] }, "distortion"),
    ] {
        let error = dense_depths(&[views[0], view], &shot.points(), &settings(), &Progress::silent());
        let error = error.unwrap_err().to_string();
        assert!(error.contains("view 1") && error.contains(why), "{error}");
    }
}
