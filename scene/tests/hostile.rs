//! Every reader against cut-off and bit-flipped files: an error or a valid value, no panic, no huge
//! allocation.

mod common;

use common::folder;
use rand::Rng;
use scene::io::{self, IoError};
use scene::rng::rng;
use scene::synthetic::{SyntheticOptions, synthetic_scene};
use scene::{Gaussians, Reconstruction};
use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The largest block that was asked for.
static LARGEST: AtomicUsize = AtomicUsize::new(0);

struct Watching;

// SAFETY: passes everything on to the system's allocator.
unsafe impl GlobalAlloc for Watching {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's contract is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is the same.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watching = Watching;

fn small_model() -> Reconstruction {
    synthetic_scene(&SyntheticOptions { num_points: 20, num_cameras: 4, ..Default::default() }, 1).truth
}

fn gaussians(n: usize, sh_degree: u32) -> Gaussians {
    let mut r = rng(3, "hostile gaussians", 0);
    let mut g = Gaussians { sh_degree, ..Default::default() };
    for _ in 0..n {
        let mut v = || r.random_range(-1.0_f32..1.0);
        g.means.push(glam::Vec3::new(v(), v(), v()));
        g.log_scales.push(glam::Vec3::new(v(), v(), v()) - 3.0);
        g.rotations.push(glam::Quat::from_xyzw(v(), v(), v(), v()).normalize());
        g.opacity_logits.push(v());
        g.sh.extend((0..(sh_degree as usize + 1).pow(2) * 3).map(|_| v() * 0.3));
    }
    g
}

/// Replaces a file by a new one: overwriting in place makes some file systems wait for the disk
/// each time.
fn put(path: &Path, bytes: &[u8]) {
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Feeds `read` the file cut off at many places and with single bits and whole bytes changed.
fn torture(path: &Path, mut read: impl FnMut() -> Result<(), IoError>) {
    let whole = fs::read(path).unwrap();
    read().unwrap();
    let step = (whole.len() / 80).max(1);
    for cut in (0..whole.len()).step_by(step) {
        put(path, &whole[..cut]);
        let _ = read();
    }
    let mut r = rng(1, "bit flips", whole.len() as u64);
    LARGEST.store(0, Ordering::Relaxed);
    for i in 0..300 {
        let mut bad = whole.clone();
        // The beginning, where the counts are, gets its share.
        let near = if i % 2 == 0 { whole.len() } else { whole.len().min(200) };
        for _ in 0..r.random_range(1..4) {
            let at = r.random_range(0..near);
            if i % 3 == 0 { bad[at] = r.random() } else { bad[at] ^= 1 << r.random_range(0..8) }
        }
        put(path, &bad);
        let _ = read();
    }
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest < 64 * whole.len() + (1 << 20), "{}: {largest} bytes at once", path.display());
    put(path, &whole);
}

#[test]
fn damaged_files_of_every_format_end_in_an_error_or_a_valid_value() {
    let dir = folder("hostile");
    let model = small_model();
    for (form, files) in [
        ("bin", ["cameras.bin", "images.bin", "points3D.bin"]),
        ("txt", ["cameras.txt", "images.txt", "points3D.txt"]),
    ] {
        let sub = dir.join(form);
        if form == "bin" {
            io::write_model_bin(&model, &sub).unwrap()
        } else {
            io::write_model_txt(&model, &sub).unwrap()
        }
        for file in files {
            torture(&sub.join(file), || {
                io::read_model(&sub).map(|m| assert_eq!(m.validate(), Ok(()), "what is read is valid"))
            });
        }
    }
    let path = dir.join("transforms.json");
    io::write_transforms(&path, &model, &Default::default()).unwrap();
    torture(&path, || io::read_transforms(&path).map(|t| t.reconstruction.validate().unwrap()));

    let path = dir.join("splat.ply");
    io::write_splat_ply(&path, &gaussians(12, 1)).unwrap();
    torture(&path, || io::read_splat_ply(&path).map(|g| g.validate().unwrap()));

    let path = dir.join("points.ply");
    let points: Vec<_> = (0..9)
        .map(|i| io::CloudPoint { position: glam::DVec3::splat(f64::from(i)), rgb: [i as u8; 3] })
        .collect();
    io::write_points_ply(&path, &points).unwrap();
    torture(&path, || io::read_points_ply(&path).map(|_| ()));
}

#[test]
fn damaged_splats_of_every_format_end_in_an_error_or_a_valid_value() {
    let dir = folder("hostile_splats");
    let names = ["a.ply", "a.compressed.ply", "a.splat", "a.spz", "a.glb"];
    for (name, degree) in names.into_iter().zip([2, 1, 0, 1, 1]) {
        let path = dir.join(name);
        io::write_splat(&path, &gaussians(12, degree)).unwrap();
        torture(&path, || io::read_splat(&path).map(|g| g.validate().unwrap()));
    }
    for name in ["minimal.ksplat", "minimal-raw.spz", "minimal-v4.spz"] {
        let Some(original) = common::shared("splats").map(|d| d.join(name)) else { return };
        let path = dir.join(name);
        fs::write(&path, fs::read(original).unwrap()).unwrap();
        torture(&path, || io::read_splat(&path).map(|g| g.validate().unwrap()));
    }
}

#[test]
fn damaged_images_end_in_an_error_or_a_picture() {
    let dir = folder("hostile_images");
    for name in ["a.png", "a.jpg"] {
        let path = dir.join(name);
        image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * 6) as u8, (y * 8) as u8, (x * y) as u8]))
            .save(&path)
            .unwrap();
        let whole = fs::read(&path).unwrap();
        let mut r = rng(2, "image flips", 0);
        for _ in 0..150 {
            let mut bad = whole.clone();
            for _ in 0..r.random_range(1..4) {
                let at = r.random_range(0..bad.len());
                bad[at] = r.random();
            }
            bad.truncate(r.random_range(1..=bad.len()));
            put(&path, &bad);
            if let Ok(image) = io::load_rgb(&path) {
                assert!(
                    image.width() > 0
                        && image.as_raw().len() == 3 * (image.width() * image.height()) as usize
                );
            }
            let _ = (io::image_info(&path), io::load_mask(&path));
        }
    }
}
