//! The readers, each with a seed.

use crate::run::Files;
use crate::seeds;
use Reader::{Folder, Memory};
use scene::io;
use std::path::Path;

/// How a target reads.
#[derive(Clone, Copy)]
pub enum Reader {
    /// Contents of files; whether they were taken.
    Memory(fn(&Files) -> bool),
    /// A folder on disk that holds the files; whether they were taken.
    Folder(fn(&Path) -> bool),
}

/// A reader of one or more files.
#[derive(Clone)]
pub struct Target {
    /// Name.
    pub name: &'static str,
    /// Writes valid files into an empty folder.
    pub seed: fn(&Path),
    /// Reads them.
    pub read: Reader,
    /// Executions of the smoke test.
    #[cfg_attr(not(test), expect(dead_code, reason = "for the smoke test"))]
    pub smoke: u64,
}

/// The names of all targets.
pub fn names() -> Vec<&'static str> {
    TARGETS.iter().map(|target| target.name).collect()
}

/// A target.
pub fn target(name: &'static str, smoke: u64, seed: fn(&Path), read: Reader) -> Target {
    Target { name, seed, read, smoke }
}

/// Everything that reads files from outside.
pub static TARGETS: std::sync::LazyLock<Vec<Target>> =
    std::sync::LazyLock::new(|| [splats(), meshes(), models(), pictures(), program()].concat());

#[cfg(feature = "program")]
fn program() -> Vec<Target> {
    crate::program::targets()
}

#[cfg(not(feature = "program"))]
fn program() -> Vec<Target> {
    Vec::new()
}

fn splats() -> Vec<Target> {
    let named = |name, smoke, seed, read| target(name, smoke, seed, Memory(read));
    vec![
        named("points-ply", 2000, seeds::points_ply, |f| io::parse_points_ply(&f[0].0, &f[0].1).is_ok()),
        named("splat-ply", 2000, |f| seeds::splat(f, "a.ply"), splat),
        named("compressed-ply", 2000, |f| seeds::splat(f, "a.compressed.ply"), splat),
        named("dot-splat", 2000, |f| seeds::splat(f, "a.splat"), splat),
        named("spz", 2000, |f| seeds::splat(f, "a.spz"), splat),
        named("spz-unpacked", 2000, seeds::spz_unpacked, splat),
        named("ksplat", 2000, seeds::ksplat, splat),
        named("splat-glb", 2000, |f| seeds::splat(f, "a.glb"), splat),
        named("sog", 500, |f| seeds::splat(f, "a.sog"), splat),
    ]
}

fn meshes() -> Vec<Target> {
    vec![
        target("mesh-ply", 2000, |f| seeds::mesh(f, "a.ply"), Memory(mesh)),
        target("mesh-glb", 2000, |f| seeds::mesh(f, "a.glb"), Memory(mesh)),
        target("mesh-obj", 2000, seeds::mesh_obj, Memory(mesh)),
    ]
}

fn models() -> Vec<Target> {
    vec![
        target("colmap-bin", 2000, seeds::colmap_bin, Memory(colmap_bin)),
        target("colmap-txt", 2000, seeds::colmap_txt, Memory(colmap_txt)),
        target("colmap-folder", 500, seeds::colmap_bin, Folder(|f| admitted(io::read_model(f)))),
        target(
            "database",
            300,
            seeds::database,
            Folder(|f| io::read_database(&f.join("database.db")).is_ok()),
        ),
        target(
            "transforms",
            2000,
            seeds::transforms,
            Folder(|f| {
                let read = io::read_transforms(&f.join("transforms.json"));
                admitted(read.map(|file| file.reconstruction))
            }),
        ),
        target(
            "middlebury",
            2000,
            seeds::middlebury,
            Memory(|f| text(f, 0).is_some_and(|text| io::parse_middlebury(&f[0].0, text).is_ok())),
        ),
        target("strecha", 2000, seeds::strecha, Folder(|f| io::read_truth(f).is_ok())),
        target(
            "metashape",
            2000,
            seeds::metashape,
            Memory(|f| {
                let read = text(f, 0).map(|text| io::poses::parse_metashape(&f[0].0, text));
                read.is_some_and(|read| admitted(read.map(|imported| imported.model)))
            }),
        ),
        target(
            "opensfm",
            2000,
            seeds::opensfm,
            Memory(|f| {
                let read = text(f, 0).map(|text| io::poses::parse_opensfm(&f[0].0, text));
                read.is_some_and(|read| admitted(read.map(|imported| imported.model)))
            }),
        ),
        target("realityscan", 2000, seeds::realityscan, Folder(|f| poses(f, "cameras.csv"))),
        target("bundler", 2000, seeds::bundler, Folder(|f| poses(f, "bundle.out"))),
    ]
}

fn pictures() -> Vec<Target> {
    vec![
        target("exif", 2000, seeds::exif, Memory(|f| io::exif::ExifCamera::parse(&f[0].1).make.is_some())),
        target("heif", 2000, seeds::heif, Memory(|f| io::heif::HeifPicture::parse(&f[0].1).is_ok())),
        target("image-header", 1000, seeds::image, Folder(|f| io::image_info(&f.join("a.png")).is_ok())),
        target("png", 1000, seeds::image, Folder(|f| io::load_image(&f.join("a.png")).is_ok())),
        target("jpeg", 1000, seeds::jpeg, Folder(|f| io::load_image(&f.join("a.jpg")).is_ok())),
        target("tiff", 1000, seeds::tiff, Folder(|f| io::load_image(&f.join("a.tif")).is_ok())),
        target(
            "weights",
            1000,
            seeds::weights,
            Memory(|f| {
                // The seed's container is whole, its tensors are not all there.
                let read = scene::lpips::Lpips::parse(&f[0].0, &f[0].1);
                read.err().is_some_and(|e| e.to_string().contains("is missing"))
            }),
        ),
    ]
}

fn admitted(model: Result<scene::Reconstruction, io::IoError>) -> bool {
    model.is_ok_and(|mut model| model.admit().is_ok())
}

fn poses(folder: &Path, name: &str) -> bool {
    admitted(io::read_poses(&folder.join(name), folder).map(|imported| imported.model))
}

fn splat(files: &Files) -> bool {
    io::parse_splat(&files[0].0, &files[0].1).is_ok()
}

fn mesh(files: &Files) -> bool {
    io::parse_mesh(&files[0].0, &files[0].1).is_ok()
}

fn text(files: &Files, index: usize) -> Option<&str> {
    std::str::from_utf8(&files[index].1).ok()
}

/// By name in order: cameras, images, points.
fn colmap_bin(files: &Files) -> bool {
    let [cameras, images, points] = [0, 1, 2].map(|i| files[i].1.as_slice());
    admitted(io::parse_model_bin(Path::new(""), [cameras, images], Some(points)))
}

fn colmap_txt(files: &Files) -> bool {
    let [Some(cameras), Some(images), Some(points)] = [0, 1, 2].map(|i| text(files, i)) else { return false };
    admitted(io::parse_model_txt(Path::new(""), [cameras, images], Some(points)))
}
