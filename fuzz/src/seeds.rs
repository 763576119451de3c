//! Small valid files, most of them made by our own writers.

use glam::{DVec3, Quat, Vec3};
use scene::geometry::Mesh;
use scene::io;
use scene::io::colmap_db::{Database, DatabaseImage};
use scene::synthetic::{SyntheticOptions, SyntheticScene, synthetic_scene};
use scene::{Gaussians, Reconstruction};
use std::fs;
use std::path::Path;

const WRITTEN: &str = "a seed is written";

fn scene() -> SyntheticScene {
    let options = SyntheticOptions { num_points: 12, num_cameras: 4, ..SyntheticOptions::default() };
    synthetic_scene(&options, 1)
}

fn model() -> Reconstruction {
    scene().truth
}

pub fn colmap_bin(folder: &Path) {
    io::write_model_bin(&model(), folder).expect(WRITTEN);
}

pub fn colmap_txt(folder: &Path) {
    io::write_model_txt(&model(), folder).expect(WRITTEN);
}

pub fn database(folder: &Path) {
    let scene = scene();
    let mut database = Database { cameras: scene.truth.cameras.clone(), ..Database::default() };
    for (image, features) in scene.truth.images.values().zip(&scene.features) {
        let (name, camera) = (image.name.clone(), image.camera);
        database.images.insert(image.id, DatabaseImage { name, camera, features: features.clone() });
    }
    let ids: Vec<u32> = scene.truth.images.keys().copied().collect();
    database.matches.insert((ids[0], ids[1]), scene.matches(0, 1));
    io::write_database(&folder.join("database.db"), &database).expect(WRITTEN);
}

pub fn transforms(folder: &Path) {
    let options = io::TransformsOptions::default();
    io::write_transforms(&folder.join("transforms.json"), &model(), &options).expect(WRITTEN);
}

pub fn middlebury(folder: &Path) {
    let line = |i: u32| format!("a{i}.png 600 0 320 0 600 240 0 0 1 1 0 0 0 1 0 0 0 1 {i} 0 4\n");
    fs::write(folder.join("a_par.txt"), format!("2\n{}{}", line(1), line(2))).expect(WRITTEN);
}

pub fn strecha(folder: &Path) {
    let text =
        |i: u32| format!("600 0 320\n0 600 240\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{i} 0 4\n640 480\n");
    for i in 0..2 {
        fs::write(folder.join(format!("{i}.png.camera")), text(i)).expect(WRITTEN);
    }
}

pub fn points_ply(folder: &Path) {
    let points: Vec<io::CloudPoint> =
        model().points.values().map(|p| io::CloudPoint { position: p.position, rgb: p.rgb }).collect();
    io::write_points_ply(&folder.join("a.ply"), &points).expect(WRITTEN);
}

fn gaussians() -> Gaussians {
    let mut g = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for i in 0..9 {
        let v = i as f32;
        g.means.push(Vec3::new(v, -v, 0.5 * v));
        g.log_scales.push(Vec3::splat(-3.0 - 0.1 * v));
        g.rotations.push(Quat::from_rotation_y(0.2 * v));
        g.opacity_logits.push(v - 4.0);
        g.sh.extend((0..12).map(|k| 0.02 * k as f32 * v));
    }
    g
}

pub fn splat(folder: &Path, name: &str) {
    io::write_splat(&folder.join(name), &gaussians()).expect(WRITTEN);
}

/// Version 2, which may stand without gzip around it, so that mutations reach its fields.
pub fn spz_unpacked(folder: &Path) {
    let n = 5_u32;
    let header = [&0x5053_474e_u32.to_le_bytes()[..], &2_u32.to_le_bytes(), &n.to_le_bytes(), &[0, 12, 0, 0]];
    let body: Vec<u8> = (0..n * 19).map(|i| (i * 37) as u8).collect();
    fs::write(folder.join("a.spz"), [header.concat(), body].concat()).expect(WRITTEN);
}

/// Version 0.1, one section of three Gaussians without compression.
pub fn ksplat(folder: &Path) {
    let mut bytes = vec![0; 4096 + 1024];
    let mut put = |at: usize, value: u32| bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    put(0, 0x0100);
    put(4, 1);
    put(4096, 3);
    put(4096 + 4, 3);
    for _ in 0..3 {
        bytes.extend([0.0_f32, 1.0, 2.0, 0.1, 0.1, 0.1, 1.0, 0.0, 0.0, 0.0].map(f32::to_le_bytes).concat());
        bytes.extend([200, 100, 50, 255]);
    }
    fs::write(folder.join("a.ksplat"), bytes).expect(WRITTEN);
}

pub fn mesh(folder: &Path, name: &str) {
    let mesh = Mesh {
        vertices: [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .map(DVec3::from_array)
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]],
        ..Mesh::default()
    };
    io::write_mesh(&folder.join(name), &mesh).expect(WRITTEN);
}

pub fn mesh_obj(folder: &Path) {
    let text = "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 0\nf 1/1/1 2/1/1 3/1/1\nf 1 2 3 4\nf -1 -2 -3\n";
    fs::write(folder.join("a.obj"), text).expect(WRITTEN);
}

/// A container as it should be, whose tensors are not a network's.
pub fn weights(folder: &Path) {
    let header = r#"{"features.0.weight":{"dtype":"F32","shape":[64,3,3,3],"data_offsets":[0,6912]}}"#;
    let bytes = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 6912]].concat();
    fs::write(folder.join("a.safetensors"), bytes).expect(WRITTEN);
}

/// Six tiles, coded by libheif.
pub fn heif(folder: &Path) {
    let picture = include_bytes!("../../scene/tests/fixtures/heif/grid.heic");
    fs::write(folder.join("a.heic"), picture).expect(WRITTEN);
}

/// A TIFF structure, little endian, with a maker and a link to focal lengths.
pub fn exif(folder: &Path) {
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()].concat()
    };
    bytes.extend(2_u16.to_le_bytes());
    bytes.extend(entry(0x010f, 2, 4, u32::from_le_bytes(*b"Can\0")));
    bytes.extend(entry(0x8769, 4, 1, 38));
    bytes.extend([0; 4]);
    bytes.extend(2_u16.to_le_bytes());
    bytes.extend(entry(0x920a, 5, 1, 68));
    bytes.extend(entry(0xa405, 3, 1, 28));
    bytes.extend([0; 4]);
    bytes.extend([50_u32.to_le_bytes(), 10_u32.to_le_bytes()].concat());
    fs::write(folder.join("exif"), bytes).expect(WRITTEN);
}

pub fn image(folder: &Path) {
    image::RgbaImage::from_pixel(5, 4, image::Rgba([9, 8, 7, 6])).save(folder.join("a.png")).expect(WRITTEN);
}

pub fn jpeg(folder: &Path) {
    image::RgbImage::from_fn(17, 9, |x, y| image::Rgb([(x * 9) as u8, (y * 20) as u8, 7]))
        .save(folder.join("a.jpg"))
        .expect(WRITTEN);
}

pub fn tiff(folder: &Path) {
    image::RgbImage::from_pixel(5, 4, image::Rgb([9, 8, 7])).save(folder.join("a.tif")).expect(WRITTEN);
}

pub fn metashape(folder: &Path) {
    io::write_metashape(&folder.join("cameras.xml"), &model()).expect(WRITTEN);
}

pub fn realityscan(folder: &Path) {
    image(folder);
    let text = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
        a.png,1,2,3,90,90,0,18,3.6,-1.8,0.1,0,0,0,0,0.01\n";
    fs::write(folder.join("cameras.csv"), text).expect(WRITTEN);
}

pub fn bundler(folder: &Path) {
    image(folder);
    let text = "# Bundle file v0.3\n1 0\n5 0.1 -0.2\n0 -1 0\n0 0 1\n-1 0 0\n2 -3 1\n";
    fs::write(folder.join("bundle.out"), text).expect(WRITTEN);
    fs::write(folder.join("list.txt"), "a.png 0 5\n").expect(WRITTEN);
}

pub fn opensfm(folder: &Path) {
    let text = r#"[{"cameras":{"c":{"projection_type":"perspective","width":200,"height":100,
        "focal":0.75,"k1":0.1,"k2":0.0}},"shots":{"a.jpg":{"camera":"c","rotation":[1,-1,1],
        "translation":[2,3,-1]}},"points":{}}]"#;
    fs::write(folder.join("reconstruction.json"), text).expect(WRITTEN);
}
