//! Camera poses and a sparse cloud from a folder of photos, written as a COLMAP model:
//! `poses_from_images IMAGES MODEL`.

use scene::{Frame, FrameSet, Progress};
use sfm::{SfmConfig, SfmResult, reconstruct};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [images, model] = &arguments[..] else {
        return Err("give a folder of photos and one for the model".into());
    };
    let result = solve(Path::new(images))?;
    // What the evidence decided, and why.
    for decision in &result.decisions {
        let words = decision.sentences();
        println!("{words} ({})", words.evidence.join("; "));
    }
    for (name, why) in result.missing.iter().chain(&result.weak_images) {
        println!("{name}: {why}");
    }
    // That there is no model is a result, not an error.
    let Some(found) = &result.reconstruction else {
        println!("no model: {}", result.reason);
        return Ok(());
    };
    println!("{} of {} images, {} points", found.images.len(), result.stats.images, found.points.len());
    Ok(scene::io::write_model_bin(found, Path::new(model))?)
}

/// The photos of the folder, sorted by name, as one camera took them; solved with the defaults.
fn solve(images: &Path) -> Result<SfmResult, Box<dyn Error>> {
    let mut paths: Vec<_> = std::fs::read_dir(images)?.filter_map(|e| Some(e.ok()?.path())).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "png" || e == "jpg"));
    paths.sort();
    let mut frames = FrameSet::default();
    for (source_index, path) in paths.into_iter().enumerate() {
        let (width, height) = image::image_dimensions(&path)?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        frames.frames.push(Frame { name, path, width, height, source_index, ..Frame::default() });
    }
    Ok(reconstruct(&frames, &SfmConfig::default(), &Progress::silent())?)
}

#[test]
fn photos_of_a_ring_become_a_model() {
    use scene::CameraModel::SimplePinhole;
    use scene::synthetic::{TexturedScene, default_camera, photo_ring};
    let folder = std::env::temp_dir().join(format!("sat-recon-poses-from-images-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let camera = default_camera(SimplePinhole, 400, 300);
    let (photos, truth) = photo_ring(&TexturedScene::default(), &camera, 8, 8.0);
    for (photo, image) in photos.iter().zip(truth.images.values()) {
        photo.save(folder.join(&image.name)).unwrap();
    }
    let found = solve(&folder).unwrap().reconstruction.expect("a model");
    let errors = scene::sim3::compare_poses(&found, &truth);
    assert_eq!(errors.registered, 8);
    assert!(errors.rotation_deg.unwrap().max < 1.0);
    std::fs::remove_dir_all(folder).unwrap();
}
