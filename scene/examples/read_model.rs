//! Reads a COLMAP model (text or binary) and says what is in it: `read_model FOLDER`.

use scene::io::{IoError, find_model, read_model};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder =
        std::env::args().nth(1).ok_or("give the folder of a model, or of a data set with sparse/0")?;
    print!("{}", describe(Path::new(&folder))?);
    Ok(())
}

/// Cameras, each image's place and reprojection error, number of points.
fn describe(folder: &Path) -> Result<String, IoError> {
    let model = read_model(&find_model(folder).unwrap_or_else(|| folder.to_owned()))?;
    let mut text = String::new();
    for (id, camera) in &model.cameras {
        let (name, focal) = (camera.model.name(), camera.focal());
        text += &format!("camera {id}: {name} {} × {}, focal {focal:.1} px\n", camera.width, camera.height);
    }
    let errors = model.reprojection_errors_by_image();
    for (id, image) in &model.images {
        // A pose is `cam_from_world`; its centre is where the camera stands in the world.
        let centre = image.pose.centre();
        text += &format!("{} at {centre:.3}", image.name);
        if let Some(errors) = errors.get(id) {
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            text += &format!(", sees {} points, off by {mean:.2} px", errors.len());
        }
        text.push('\n');
    }
    text += &format!("{} points\n", model.points.len());
    Ok(text)
}

#[test]
fn a_model_is_described() {
    use scene::synthetic::{SyntheticOptions, synthetic_scene};
    let folder = std::env::temp_dir().join(format!("sat-recon-read-model-{}", std::process::id()));
    let options = SyntheticOptions { num_points: 40, num_cameras: 5, ..Default::default() };
    let truth = synthetic_scene(&options, 1).truth;
    scene::io::write_model_bin(&truth, &folder.join("sparse/0")).unwrap();
    let text = describe(&folder).unwrap();
    assert_eq!(text.lines().count(), truth.cameras.len() + 5 + 1, "{text}");
    assert!(
        text.contains(truth.images[&1].name.as_str())
            && text.ends_with(&format!("\n{} points\n", truth.points.len())),
        "{text}"
    );
    std::fs::remove_dir_all(folder).unwrap();
}
