//! The texture of a coloured box, photographed by cameras that are known.

use super::*;
use crate::testing::box_mesh;
use scene::{Camera, CameraModel, Pose, PosedPhoto};

const SIZE: DVec3 = DVec3::new(1.0, 0.7, 0.4);

/// Colour of the box at a place on it: each face has its own, with a smooth pattern.
fn paint(p: DVec3) -> [u8; 3] {
    let q = p / (SIZE / 2.0);
    let face = (0..3).max_by(|&a, &b| q[a].abs().total_cmp(&q[b].abs())).unwrap();
    let base = [[200.0, 60.0, 60.0], [60.0, 180.0, 60.0], [60.0, 60.0, 200.0]][face];
    let sign = if q[face] > 0.0 { 1.0 } else { 0.6 };
    let wave = 30.0 * (6.0 * p.x).sin() * (5.0 * p.y + 4.0 * p.z).cos();
    [0, 1, 2].map(|k| (base[k] * sign + wave).clamp(0.0, 255.0) as u8)
}

/// Where a ray meets the box from outside.
fn hit(eye: DVec3, ray: DVec3) -> Option<DVec3> {
    let near = (-SIZE / 2.0 - eye) / ray;
    let far = (SIZE / 2.0 - eye) / ray;
    let (enter, leave) = (near.min(far).max_element(), near.max(far).min_element());
    (enter > 0.0 && enter < leave).then(|| eye + ray * enter)
}

struct Taken {
    camera: Camera,
    pose: Pose,
    rgb: Vec<u8>,
    mask: Vec<u8>,
}

/// Photos from all round; `glint`: every fifth is white.
fn photos(scale: f64, glint: bool) -> Vec<Taken> {
    let camera = Camera::centred(1, CameraModel::Pinhole, 320, 240, 300.0);
    (0..40)
        .map(|i| {
            let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
            let eye = DVec3::new(cos, sin, 0.9 * (f64::from(i) * 0.45).sin()) * 2.2;
            let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
            let back = pose.inverse();
            let (mut rgb, mut mask) = (vec![], vec![]);
            for k in 0..320 * 240_u32 {
                let pixel = DVec2::new(f64::from(k % 320) + 0.5, f64::from(k / 320) + 0.5);
                let ray = back.rotation * camera.ray(pixel);
                let seen = hit(eye, ray);
                let color = seen.map_or([0, 255, 0], paint);
                rgb.extend(if glint && i % 5 == 0 { [255; 3] } else { color });
                mask.push(if seen.is_some() { 255 } else { 0 });
            }
            let pose = Pose::look_at(eye * scale, DVec3::ZERO, DVec3::Z);
            Taken { camera: camera.clone(), pose, rgb, mask }
        })
        .collect()
}

fn views(photos: &[Taken]) -> Vec<PosedPhoto<'_>> {
    photos
        .iter()
        .map(|t| PosedPhoto { camera: &t.camera, pose: t.pose, rgb: &t.rgb, mask: Some(&t.mask) })
        .collect()
}

/// Mean difference between the texture and the true colours, away from the box's edges, and the
/// share of places where it is more than 16.
fn errors(found: &TexturedMesh, scale: f64) -> (f64, f64) {
    let (mut sum, mut n, mut far) = (0.0, 0.0, 0.0);
    let size = DVec2::new(f64::from(found.texture.width()), f64::from(found.texture.height()));
    for (i, t) in found.mesh.triangles.iter().enumerate() {
        let corners = found.mesh.corners(i);
        for w in [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6], [1.0 / 3.0; 3]] {
            let p = (corners[0] * w[0] + corners[1] * w[1] + corners[2] * w[2]) / scale;
            let q = (p.abs() / (SIZE / 2.0)).to_array();
            if q.iter().filter(|v| **v > 0.93).count() > 1 {
                continue;
            }
            let uv: DVec2 = t.iter().zip(w).map(|(v, w)| found.uvs[*v as usize] * w).sum();
            let at = (uv * size).floor();
            let color = found.texture.get_pixel(at.x as u32, at.y as u32).0;
            let off = color.iter().zip(paint(p)).map(|(a, b)| f64::from(a.abs_diff(b))).fold(0.0, f64::max);
            sum += off;
            n += 1.0;
            far += f64::from(u8::from(off > 16.0));
        }
    }
    assert!(n > 1000.0, "{n} places looked at");
    (sum / n, far / n)
}

#[test]
fn a_box_gets_the_colours_its_photos_show_at_any_scale() {
    for scale in [1e-6, 1.0, 1e6] {
        let photos = photos(scale, false);
        let mut mesh = box_mesh(SIZE, 12);
        mesh.vertices.iter_mut().for_each(|v| *v *= scale);
        let options = TextureOptions::default();
        let found = textured(&mesh, &views(&photos), &options, &Progress::silent()).unwrap().unwrap();
        assert_eq!(found.mesh.triangles.len(), mesh.triangles.len());
        let (mean, far) = errors(&found, scale);
        assert!(mean < 2.0 && far == 0.0, "{scale}: {mean} {far}");
        assert!(found.uvs.iter().all(|uv| uv.min_element() > 0.0 && uv.max_element() < 1.0));
    }
}

#[test]
fn glints_in_every_fifth_photo_do_not_show() {
    let photos = photos(1.0, true);
    let found =
        textured(&box_mesh(SIZE, 12), &views(&photos), &TextureOptions::default(), &Progress::silent());
    let (mean, far) = errors(&found.unwrap().unwrap(), 1.0);
    assert!(mean < 1.0 && far < 0.005, "{mean} {far}");
}

#[test]
fn what_is_hidden_has_its_own_colour_and_what_is_nothing_has_no_texture() {
    let mut mesh = box_mesh(SIZE, 4);
    mesh.colors = vec![[9, 8, 7]; mesh.vertices.len()];
    let textured_by = |mesh: &Mesh, views: &[PosedPhoto<'_>]| {
        textured(
            mesh,
            views,
            &TextureOptions { most_texels: 128, ..TextureOptions::default() },
            &Progress::silent(),
        )
        .unwrap()
    };
    let found = textured_by(&mesh, &[]).unwrap();
    assert!(found.texture.pixels().all(|p| p.0 == [9, 8, 7]));
    assert!(found.texture.width().max(found.texture.height()) <= 128);
    mesh.colors.clear();
    assert!(textured_by(&mesh, &[]).unwrap().texture.pixels().all(|p| p.0 == [0; 3]));
    assert!(textured_by(&Mesh::default(), &[]).is_none());
    // A wall before the box hides it from the one camera there is.
    let taken = &photos(1.0, false)[0];
    let view = PosedPhoto { camera: &taken.camera, pose: taken.pose, rgb: &taken.rgb, mask: None };
    let mut walled = box_mesh(SIZE, 4);
    walled.colors = vec![[1, 2, 3]; walled.vertices.len()];
    let n = walled.vertices.len() as u32;
    let eye = taken.pose.centre();
    let (u, v) = eye.normalize().any_orthonormal_pair();
    walled.vertices.extend([-u - v, u - v, u + v, -u + v].map(|x| eye * 0.6 + x * 3.0));
    walled.colors.extend([[200; 3]; 4]);
    walled.triangles.extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
    let found = textured(&walled, &[view], &TextureOptions::default(), &Progress::silent()).unwrap().unwrap();
    for (triangle, i) in found.mesh.triangles.iter().zip(0..) {
        let corners = found.mesh.corners(i);
        if corners.iter().all(|c| c.abs().max_element() < 0.6) {
            let uv = triangle.iter().map(|v| found.uvs[*v as usize]).sum::<DVec2>() / 3.0;
            let (w, h) = (f64::from(found.texture.width()), f64::from(found.texture.height()));
            let color = found.texture.get_pixel((uv.x * w) as u32, (uv.y * h) as u32).0;
            assert_eq!(color, [1, 2, 3], "{corners:?}");
        }
    }
}
