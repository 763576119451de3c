//! Round trips, and files that lie.

use super::*;
use crate::io::test_folder;
use crate::{CameraModel, Keypoint, Pose, TwoViewKind};
use glam::{DMat3, DQuat, DVec3};
use rusqlite::Connection;

fn sample() -> Database {
    let mut database = Database::default();
    let mut camera = Camera::centred(3, CameraModel::SimpleRadial, 640, 480, 700.0 / 3.0);
    camera.has_prior_focal = true;
    database.cameras.insert(3, camera);
    for id in [1_u32, 2, 7] {
        let keypoint =
            |i: u32| Keypoint { x: i as f32 + 0.25, y: 480.0 / (1.0 + i as f32), scale: 1.5, angle: -0.4 };
        let features = Features {
            keypoints: (0..5 + id).map(keypoint).collect(),
            descriptors: (0..(5 + id) * 128).map(|v| (v * id % 251) as u8).collect(),
        };
        database.images.insert(id, DatabaseImage { name: format!("sub/view {id}.png"), camera: 3, features });
    }
    database.matches.insert((1, 2), vec![[0, 1], [5, 6]]);
    database.matches.insert((2, 7), Vec::new());
    let geometry = TwoViewGeometry {
        a: 0,
        b: 6,
        kind: TwoViewKind::Calibrated,
        inliers: vec![[1, 11], [2, 0]],
        f: Some(DMat3::from_cols_array(&[0.1, 2.0, -3.0, 4.0, 5e-9, 6.0, 7.0, 8.0, 9.0])),
        e: None,
        h: Some(DMat3::IDENTITY),
        b_from_a: Some(Pose::new(DQuat::from_rotation_y(0.3), DVec3::new(1.0, 0.0, -1e-3))),
        median_angle: 0.0,
    };
    database.geometries.insert((1, 7), geometry);
    database
}

#[test]
fn what_is_written_is_read_again() {
    let path = test_folder("db_round_trip").join("a % b?.db");
    let written = sample();
    write_database(&path, &written).unwrap();
    let read = read_database(&path).unwrap();
    assert_eq!(read.cameras, written.cameras);
    assert_eq!(read.matches, written.matches);
    for (id, image) in &written.images {
        let other = &read.images[id];
        assert_eq!((&other.name, other.camera), (&image.name, image.camera));
        assert_eq!(other.features.descriptors, image.features.descriptors);
        for (a, b) in other.features.keypoints.iter().zip(&image.features.keypoints) {
            assert_eq!((a.x, a.y), (b.x, b.y));
            assert!((a.scale - b.scale).abs() < 1e-6 && (a.angle - b.angle).abs() < 1e-6, "{a:?} {b:?}");
        }
    }
    let (a, b) = (&read.geometries[&(1, 7)], &written.geometries[&(1, 7)]);
    assert_eq!((a.a, a.b, a.kind, &a.inliers, a.f, a.e, a.h), (b.a, b.b, b.kind, &b.inliers, b.f, b.e, b.h));
    let (p, q) = (a.b_from_a.unwrap(), b.b_from_a.unwrap());
    assert!(p.rotation.angle_between(q.rotation) < 1e-9 && p.translation == q.translation);
    let others: Vec<_> = std::fs::read_dir(path.parent().unwrap()).unwrap().collect();
    assert_eq!(others.len(), 1, "reading and writing leave nothing beside: {others:?}");
}

#[test]
fn a_file_that_cannot_be_written_leaves_the_old_one() {
    let folder = test_folder("db_refused");
    let path = folder.join("database.db");
    write_database(&path, &sample()).unwrap();
    let before = std::fs::read(&path).unwrap();
    let mut bad = sample();
    bad.matches.insert((1, 2), vec![[0, 99]]);
    assert!(write_database(&path, &bad).unwrap_err().to_string().contains("not there"));
    bad = sample();
    bad.images.get_mut(&7).unwrap().name = "sub/view 1.png".into(); // SQLite itself refuses the second of a name
    assert!(write_database(&path, &bad).unwrap_err().to_string().contains("SQLite"));
    assert_eq!(std::fs::read(&path).unwrap(), before);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

/// A database in which one statement has changed something.
fn damaged(name: &str, sql: &str) -> String {
    let path = test_folder(&format!("db_{name}")).join("database.db");
    write_database(&path, &sample()).unwrap();
    let sql = format!("PRAGMA foreign_keys = OFF; {sql}");
    Connection::open(&path).unwrap().execute_batch(&sql).unwrap();
    read_database(&path).unwrap_err().to_string()
}

#[test]
fn what_contradicts_itself_is_refused_with_file_and_table() {
    for (name, sql, expected) in [
        ("rows", "UPDATE keypoints SET rows = 1000000000000 WHERE image_id = 2", "table keypoints: image 2"),
        ("negative", "UPDATE keypoints SET rows = -1, cols = -42 WHERE image_id = 2", "table keypoints"),
        ("cols", "UPDATE keypoints SET cols = 3, rows = rows * 2", "3 numbers a keypoint"),
        ("text", "UPDATE keypoints SET data = 'x' WHERE image_id = 1", "does not hold bytes"),
        ("nan", "UPDATE keypoints SET data = x'0000c07f0000c07f', rows = 1, cols = 2", "not finite"),
        ("short", "UPDATE descriptors SET data = zeroblob(128), rows = 1", "1 descriptors for"),
        ("wide", "UPDATE descriptors SET cols = 64, rows = rows * 2", "only SIFT's 128"),
        ("index", "UPDATE matches SET data = x'0000000063000000', rows = 1", "features 0 and 99"),
        ("pair", "UPDATE matches SET pair_id = 5 WHERE rows = 2", "pair 5 names no two images"),
        ("self", "UPDATE matches SET pair_id = 2147483647 + 1 WHERE rows = 2", "no two images"),
        ("f", "UPDATE two_view_geometries SET F = zeroblob(71)", "F has 71 bytes"),
        (
            "inf",
            "UPDATE two_view_geometries SET tvec = x'000000000000f07f00000000000000000000000000000000'",
            "not finite",
        ),
        ("camera", "UPDATE images SET camera_id = 9 WHERE image_id = 1", "camera 9, which is missing"),
        ("model", "UPDATE cameras SET model = 5", "not supported"),
        ("params", "UPDATE cameras SET params = zeroblob(31)", "params"),
        ("zero", "UPDATE images SET image_id = 0 WHERE image_id = 1", "number 0"),
        ("name", "UPDATE images SET name = '../../etc/passwd' WHERE image_id = 1", "contains '..'"),
        ("table", "DROP TABLE matches", "table matches: is missing"),
        (
            "view",
            "DROP TABLE matches; CREATE VIEW matches AS SELECT * FROM images",
            "table matches: is missing",
        ),
    ] {
        let message = damaged(name, sql);
        assert!(message.contains(expected) && message.contains("database.db"), "{name}: {message}");
    }
}

#[test]
fn files_that_are_cut_or_overwritten_give_an_error_and_never_a_panic() {
    let folder = test_folder("db_cut");
    let path = folder.join("database.db");
    write_database(&path, &sample()).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for length in [0, 10, 100, 4096, whole.len() / 2, whole.len() - 4096] {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(read_database(&path).is_err(), "cut to {length} bytes");
    }
    for seed in 0..200_u64 {
        let mut bytes = whole.clone();
        for k in 0..20 {
            let at = (seed * 7919 + k * 104_729 + k * k * 31) as usize % bytes.len();
            bytes[at] = bytes[at].wrapping_add((seed + k) as u8 | 1);
        }
        std::fs::write(&path, bytes).unwrap();
        let _ = read_database(&path); // what counts is that it ends
    }
    assert!(read_database(&folder.join("none.db")).unwrap_err().to_string().contains("none.db"));
}
