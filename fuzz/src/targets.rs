//! The readers, each with a seed.

use crate::seeds;
use scene::io;
use std::path::Path;

/// A reader of one or more files in a folder.
pub struct Target {
    /// Name.
    pub name: &'static str,
    /// Writes valid files into an empty folder.
    pub seed: fn(&Path),
    /// Reads them; whether they were taken.
    pub read: fn(&Path) -> bool,
    /// Executions of the smoke test.
    #[cfg_attr(not(test), expect(dead_code, reason = "for the smoke test"))]
    pub smoke: u64,
}

/// The names of all targets.
pub fn names() -> Vec<&'static str> {
    TARGETS.iter().map(|target| target.name).collect()
}

fn target(name: &'static str, smoke: u64, seed: fn(&Path), read: fn(&Path) -> bool) -> Target {
    Target { name, seed, read, smoke }
}

/// Everything that reads files from outside.
pub static TARGETS: std::sync::LazyLock<Vec<Target>> = std::sync::LazyLock::new(|| {
    vec![
        target("colmap-bin", 2000, seeds::colmap_bin, |f| admitted(io::read_model(f))),
        target("colmap-txt", 2000, seeds::colmap_txt, |f| admitted(io::read_model(f))),
        target("database", 300, seeds::database, |f| io::read_database(&f.join("database.db")).is_ok()),
        target("transforms", 2000, seeds::transforms, |f| {
            let read = io::read_transforms(&f.join("transforms.json"));
            admitted(read.map(|file| file.reconstruction))
        }),
        target("middlebury", 2000, seeds::middlebury, |f| io::read_truth(&f.join("a_par.txt")).is_ok()),
        target("strecha", 2000, seeds::strecha, |f| io::read_truth(f).is_ok()),
        target("metashape", 2000, seeds::metashape, |f| poses(f, "cameras.xml")),
        target("realityscan", 2000, seeds::realityscan, |f| poses(f, "cameras.csv")),
        target("bundler", 2000, seeds::bundler, |f| poses(f, "bundle.out")),
        target("opensfm", 2000, seeds::opensfm, |f| poses(f, "reconstruction.json")),
        target("points-ply", 2000, seeds::points_ply, |f| io::read_points_ply(&f.join("a.ply")).is_ok()),
        target("splat-ply", 2000, |f| seeds::splat(f, "a.ply"), |f| read_splat(f, "a.ply")),
        target(
            "compressed-ply",
            2000,
            |f| seeds::splat(f, "a.compressed.ply"),
            |f| read_splat(f, "a.compressed.ply"),
        ),
        target("dot-splat", 2000, |f| seeds::splat(f, "a.splat"), |f| read_splat(f, "a.splat")),
        target("spz", 2000, |f| seeds::splat(f, "a.spz"), |f| read_splat(f, "a.spz")),
        target("spz-unpacked", 2000, seeds::spz_unpacked, |f| read_splat(f, "a.spz")),
        target("ksplat", 2000, seeds::ksplat, |f| read_splat(f, "a.ksplat")),
        target("splat-glb", 2000, |f| seeds::splat(f, "a.glb"), |f| read_splat(f, "a.glb")),
        target("sog", 500, |f| seeds::splat(f, "a.sog"), |f| read_splat(f, "a.sog")),
        target("mesh-ply", 2000, |f| seeds::mesh(f, "a.ply"), |f| read_mesh(f, "a.ply")),
        target("mesh-glb", 2000, |f| seeds::mesh(f, "a.glb"), |f| read_mesh(f, "a.glb")),
        target("mesh-obj", 2000, seeds::mesh_obj, |f| read_mesh(f, "a.obj")),
        target("weights", 1000, seeds::weights, |f| {
            // The seed's container is whole, its tensors are not all there.
            let read = scene::lpips::Lpips::load(&f.join("a.safetensors"));
            read.err().is_some_and(|e| e.to_string().contains("is missing"))
        }),
        target("exif", 2000, seeds::exif, |f| {
            scene::io::exif::ExifCamera::parse(&std::fs::read(f.join("exif")).unwrap_or_default())
                .make
                .is_some()
        }),
        target("heif", 2000, seeds::heif, |f| io::heif::HeifPicture::read(&f.join("a.heic")).is_ok()),
        target("image-header", 1000, seeds::image, |f| io::image_info(&f.join("a.png")).is_ok()),
        target("png", 1000, seeds::image, |f| io::load_image(&f.join("a.png")).is_ok()),
        target("jpeg", 1000, seeds::jpeg, |f| io::load_image(&f.join("a.jpg")).is_ok()),
        target("tiff", 1000, seeds::tiff, |f| io::load_image(&f.join("a.tif")).is_ok()),
        target("flags-toml", 50, seeds::flags, |f| {
            let file = f.join("flags.toml").to_string_lossy().into_owned();
            let words = ["sat-recon", "sfm", "no-such-input", "--config", &file].map(str::to_owned);
            sat_recon::config::parse(words.to_vec()).is_ok_and(|usage| usage.is_ok())
        }),
        target("former-run", 50, seeds::former_run, |f| {
            let words = ["sat-recon", "sfm", &f.to_string_lossy()].map(str::to_owned);
            let parsed = sat_recon::config::parse(words.to_vec());
            // Without the record the folder is taken for one of photos.
            parsed.is_ok_and(|usage| usage.is_ok_and(|p| p.recorded.is_some_and(|r| !r.flags.is_empty())))
        }),
        target("times", 1000, seeds::times, |f| sat_recon::times::Times::read(f).is_ok()),
        target("tables", 1000, seeds::tables, |f| {
            sat_recon::compare::runs::read_tables(&f.join("a.json")).is_ok()
        }),
    ]
});

fn admitted(model: Result<scene::Reconstruction, io::IoError>) -> bool {
    model.is_ok_and(|mut model| model.admit().is_ok())
}

fn poses(folder: &Path, name: &str) -> bool {
    admitted(io::read_poses(&folder.join(name), folder).map(|imported| imported.model))
}

fn read_splat(folder: &Path, name: &str) -> bool {
    io::read_splat(&folder.join(name)).is_ok()
}

fn read_mesh(folder: &Path, name: &str) -> bool {
    io::read_mesh(&folder.join(name)).is_ok()
}
