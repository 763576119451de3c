//! Writes photos of a made-up object and their true cameras: `synthetic_photos FOLDER [PHOTOS]
//! [STEP_DEG] [WIDTH]`.

use scene::CameraModel;
use scene::io::write_model_bin;
use scene::synthetic::{TexturedScene, default_camera, photo_ring};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let folder = PathBuf::from(args.get(1).ok_or("give a folder")?);
    let number = |i: usize, default: f64| args.get(i).map_or(Ok(default), |a| a.parse::<f64>());
    let (n, step, width) = (number(2, 36.0)?, number(3, 10.0)?, number(4, 480.0)?);
    let camera = default_camera(CameraModel::SimplePinhole, width as u32, (width * 0.75) as u32);
    let (photos, truth) = photo_ring(&TexturedScene::default(), &camera, n as usize, step);
    std::fs::create_dir_all(folder.join("images"))?;
    for (photo, image) in photos.iter().zip(truth.images.values()) {
        photo.save(folder.join("images").join(&image.name))?;
    }
    write_model_bin(&truth, &folder.join("truth"))?;
    Ok(())
}
