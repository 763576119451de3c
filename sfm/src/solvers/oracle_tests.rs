//! Agreement with OpenCV on the problems of `tests/fixtures/solvers/opencv.json` (`make oracle`
//! makes it anew).

use super::decompose::poses_from_essential;
use super::fundamental_8pt::Normaliser;
use super::testing::{angle, array};
use super::*;
use glam::{DMat3, DVec2, DVec3};
use scene::pose::rotation_angle;
use serde_json::Value;

fn cases(kind: &str) -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/solvers/opencv.json");
    let text = std::fs::read_to_string(path).unwrap();
    let all: Value = serde_json::from_str(&text).unwrap();
    let cases = all[kind].as_array().unwrap().clone();
    assert!(cases.len() >= 10);
    cases
}

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn points(v: &Value) -> Vec<DVec2> {
    v.as_array().unwrap().iter().map(|p| DVec2::from_slice(&numbers(p))).collect()
}

fn vectors(v: &Value) -> Vec<DVec3> {
    v.as_array().unwrap().iter().map(|p| DVec3::from_slice(&numbers(p))).collect()
}

fn matrix(v: &Value) -> DMat3 {
    linalg::mat3_from_rows(&array(&numbers(v)))
}

/// Distance of two matrices up to scale and sign.
fn distance(p: &DMat3, q: &DMat3) -> f64 {
    let norm = |m: &DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    let (p, q) = (*p * (1.0 / norm(p)), *q * (1.0 / norm(q)));
    norm(&(p - q)).min(norm(&(p + q)))
}

fn assert_all_found(kind: &str, case: usize, expected: &Value, found: &[DMat3]) {
    for (k, solution) in expected.as_array().unwrap().iter().enumerate() {
        let truth = matrix(solution);
        let nearest = found.iter().map(|m| distance(m, &truth)).fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-5, "{kind} case {case}, solution {k}: nearest of ours is {nearest} away");
    }
}

#[test]
fn every_p3p_pose_of_opencv_is_among_ours() {
    for (i, case) in cases("p3p").iter().enumerate() {
        let rays: Vec<DVec3> = points(&case["pixels"]).iter().map(|p| p.extend(1.0).normalize()).collect();
        let found = p3p(&array(&rays), &array(&vectors(&case["points"])));
        for pose in case["poses"].as_array().unwrap() {
            let truth = scene::Pose::from_matrix(
                matrix(&pose["rotation"]),
                DVec3::from_slice(&numbers(&pose["translation"])),
            );
            let error = |p: &scene::Pose| {
                rotation_angle(p.rotation, truth.rotation) + p.translation.distance(truth.translation)
            };
            let nearest = found.iter().map(error).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-4, "case {i}: {nearest}");
        }
    }
}

#[test]
fn every_minimal_epipolar_matrix_of_opencv_is_among_ours() {
    for (i, case) in cases("essential").iter().enumerate() {
        let rays = |v: &Value| points(v).iter().map(|p| p.extend(1.0)).collect::<Vec<DVec3>>();
        let found = essential_5pt(&array(&rays(&case["a"])), &array(&rays(&case["b"])));
        assert_all_found("essential", i, &case["solutions"], &found);
    }
    for (i, case) in cases("fundamental7").iter().enumerate() {
        let (a, b) = (points(&case["a"]), points(&case["b"]));
        let (na, nb) =
            (Normaliser::of(a.iter().copied()).unwrap(), Normaliser::of(b.iter().copied()).unwrap());
        let (p, q): (Vec<DVec2>, Vec<DVec2>) =
            a.iter().zip(&b).map(|(a, b)| (na.apply(*a), nb.apply(*b))).unzip();
        let found: Vec<DMat3> = fundamental_7pt(&array(&p), &array(&q))
            .into_iter()
            .map(|f| nb.matrix().transpose() * f * na.matrix())
            .collect();
        assert_all_found("fundamental", i, &case["solutions"], &found);
    }
}

#[test]
fn linear_fits_and_sampson_distances_are_those_of_opencv() {
    for (i, case) in cases("fundamental8").iter().enumerate() {
        let (a, b) = (points(&case["a"]), points(&case["b"]));
        let truth = matrix(&case["solution"]);
        let found = fundamental_8pt(&a, &b).unwrap();
        assert!(distance(&found, &truth) < 1e-6, "case {i}: {}", distance(&found, &truth));
        for ((a, b), expected) in a.iter().zip(&b).zip(numbers(&case["sampson"])) {
            let error = sampson_sq(&truth, *a, *b);
            assert!((error - expected).abs() < 1e-9 * (1.0 + expected), "case {i}: {error} {expected}");
        }
    }
    for (i, case) in cases("homography").iter().enumerate() {
        let (a, b) = (points(&case["a"]), points(&case["b"]));
        let truth = matrix(&case["solution"]);
        let found = homography_4pt(&array(&a), &array(&b)).unwrap();
        assert!(distance(&found, &truth) < 1e-6, "case {i}: {}", distance(&found, &truth));
        let fitted = homography_dlt(&a, &b).unwrap();
        assert!(distance(&fitted, &truth) < 1e-6, "case {i}: {}", distance(&fitted, &truth));
    }
}

#[test]
fn decompositions_hold_the_motions_of_opencv() {
    for (i, case) in cases("decomposition").iter().enumerate() {
        let poses = poses_from_essential(&matrix(&case["essential"])).unwrap();
        let translation = DVec3::from_slice(&numbers(&case["translation"]));
        for rotation in case["rotations"].as_array().unwrap() {
            let truth = scene::Pose::from_matrix(matrix(rotation), translation);
            for sign in [1.0, -1.0] {
                let hit = poses.iter().any(|p| {
                    rotation_angle(p.rotation, truth.rotation) < 1e-7
                        && angle(p.translation, truth.translation * sign) < 1e-7
                });
                assert!(hit, "case {i}");
            }
        }
        // Ours are those of OpenCV's four whose plane lies in front of the camera.
        let motions = motions_from_homography(&matrix(&case["homography"]), &[DVec3::Z]);
        let expected: Vec<&Value> =
            case["motions"].as_array().unwrap().iter().filter(|m| numbers(&m["normal"])[2] > 0.0).collect();
        assert_eq!(motions.len(), expected.len(), "case {i}");
        for motion in expected {
            let rotation = scene::Pose::from_matrix(matrix(&motion["rotation"]), DVec3::ZERO).rotation;
            let t = DVec3::from_slice(&numbers(&motion["translation"]));
            let hit = motions
                .iter()
                .any(|m| rotation_angle(m.rotation, rotation) < 1e-6 && m.translation.distance(t) < 1e-6);
            assert!(hit, "case {i}");
        }
    }
}
