//! A fused surface put back on what its views measured.
//!
//! Where a sheet is thinner than the error of the depths, the views of one side say that the
//! other's surface lies before their own, and nothing is left inside. Depth maps are therefore
//! fused as if all surfaces lay a little nearer to the cameras. Afterwards each vertex goes along
//! its normal by the mean distance that the views of its own side see.

use super::Mesh;
use super::depth_map::DepthMap;
use super::facing::LEAST_COSINE;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Moves the vertices, which lie about `nearer` before what was measured (scene units, as is
/// `voxel`); what no view sees there, give or take it and half a voxel, goes with its neighbours,
/// or stays.
pub(super) fn settle(mesh: &mut Mesh, maps: &[DepthMap<'_>], nearer: f64, voxel: f64) {
    let normals = mesh.normals();
    let centres: Vec<DVec3> = maps.iter().map(|map| map.pose.inverse().translation).collect();
    // Weighted sums of distances along the normal, and their weights.
    let seen = |(vertex, normal): (&DVec3, &DVec3)| {
        let mut sums = DVec2::ZERO;
        for (map, centre) in maps.iter().zip(&centres) {
            let cosine = (*centre - *vertex).normalize_or_zero().dot(*normal);
            let seen = (cosine > LEAST_COSINE).then(|| before(map, *vertex)).flatten();
            let across = seen.map(|along| cosine * along);
            if let Some(across) = across.filter(|across| (across - nearer).abs() < nearer + voxel / 2.0) {
                sums += cosine * DVec2::new(across, 1.0);
            }
        }
        sums
    };
    let own: Vec<DVec2> = mesh.vertices.par_iter().zip(&normals).map(seen).collect();
    // Depths have errors of their own at each pixel: neighbours share what they see.
    let mut shared = own.clone();
    for triangle in &mesh.triangles {
        let all: DVec2 = triangle.iter().map(|&i| own[i as usize]).sum();
        triangle.iter().for_each(|&i| shared[i as usize] += all);
    }
    for ((vertex, normal), sums) in mesh.vertices.iter_mut().zip(&normals).zip(&shared) {
        if sums.y > 0.0 {
            *vertex -= *normal * (sums.x / sums.y);
        }
    }
}

/// How far a point lies before the surface that the map measured at its pixel, along the ray.
fn before(map: &DepthMap<'_>, point: DVec3) -> Option<f64> {
    let p = map.pose.transform(point);
    let pixel = map.camera.focal() * p.truncate() / p.z + map.camera.principal_point();
    let size = DVec2::new(f64::from(map.camera.width), f64::from(map.camera.height));
    if !(p.z > 0.0 && pixel.min_element() >= 0.0 && pixel.cmplt(size).all()) {
        return None;
    }
    let depth = depth_at(map, pixel);
    (depth > 0.0 && depth.is_finite()).then(|| (depth - p.z) / p.z * p.length())
}

/// The depth at a place of the picture, between the four pixels around it where all are known,
/// else that of its pixel.
fn depth_at(map: &DepthMap<'_>, place: DVec2) -> f64 {
    let (width, height) = (map.camera.width as usize, map.camera.height as usize);
    let of = |x: usize, y: usize| f64::from(map.depth[y * width + x]);
    let corner = (place - 0.5).max(DVec2::ZERO);
    let [x, y] = [(corner.x as usize).min(width - 1), (corner.y as usize).min(height - 1)];
    let [right, below] = [(x + 1).min(width - 1), (y + 1).min(height - 1)];
    let around = [of(x, y), of(right, y), of(x, below), of(right, below)];
    if around.iter().any(|d| !(*d > 0.0 && d.is_finite())) {
        return of(place.x as usize, place.y as usize);
    }
    let [u, v] = [corner.x - x as f64, corner.y - y as f64];
    let row = |a: f64, b: f64| a + (b - a) * u;
    row(around[0], around[1]) * (1.0 - v) + row(around[2], around[3]) * v
}
