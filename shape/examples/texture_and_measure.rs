//! Decimates a mesh, paints it with photos and measures it:
//! `texture_and_measure MESH MODEL IMAGES MASKS OUT.glb ERROR`, the error of the decimation in % of
//! the longest side, with a COLMAP model of pinhole cameras in
//! the frame of the mesh.

use scene::{PosedPhoto, Progress};
use shape::measure::{MeasureOptions, measure};
use shape::{Decimation, TextureOptions, decimated, textured};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, model, images, masks, out, error] = &arguments[..] else {
        return Err("texture_and_measure MESH MODEL IMAGES MASKS OUT.glb ERROR".into());
    };
    let mesh = scene::io::read_mesh(Path::new(mesh))?;
    let options = MeasureOptions { tolerance: 0.005, least_share: 0.01, most_shapes: 40, seed: 0 };
    if let Some((measures, _)) = measure(&mesh, &options, &Progress::silent())? {
        println!("{:?}", measures.overall.sides);
        for f in &measures.features {
            println!("{:?} {:?} rms {:.5}", f.kind, f.sizes, f.rms);
        }
    }
    let coarse = decimated(&mesh, &Decimation { error: error.parse::<f64>()? / 100.0, color_error: None });
    println!("{} of {} triangles", coarse.triangles.len(), mesh.triangles.len());
    let model = scene::io::read_model(Path::new(model))?;
    let mut photos = Vec::new();
    for image in model.images.values() {
        let rgb = scene::io::load_rgb(&Path::new(images).join(&image.name))?.into_raw();
        let mask = Path::new(masks).join(format!("{}.png", image.name));
        let mask = if mask.is_file() { Some(scene::io::load_mask(&mask)?.into_raw()) } else { None };
        photos.push((&model.cameras[&image.camera], image.pose, rgb, mask));
    }
    let views: Vec<PosedPhoto<'_>> = photos
        .iter()
        .map(|(camera, pose, rgb, mask)| PosedPhoto { camera, pose: *pose, rgb, mask: mask.as_deref() })
        .collect();
    let painted = textured(&coarse, &views, &TextureOptions::default(), &Progress::silent())?;
    let painted = painted.ok_or("the mesh has no triangles")?;
    println!("texture {}×{}", painted.texture.width(), painted.texture.height());
    scene::io::write_textured_mesh(Path::new(out), &painted)?;
    Ok(())
}
