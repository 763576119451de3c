//! Fits a field to a data set with a transforms.json within a time limit and renders its held-out
//! views: `fit DATASET METHOD SECONDS OUT`.

use baselines::{FieldConfig, Method, train};
use clap::ValueEnum as _;
use scene::Progress;
use splat::{Dataset, DatasetConfig};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, method, seconds, out] = &arguments[..] else {
        return Err("give a data set, a method, seconds and a folder".into());
    };
    let (folder, out) = (Path::new(folder), Path::new(out));
    let progress = Progress::silent();
    let model = scene::io::read_transforms(&folder.join("transforms.json"))?.reconstruction;
    let dataset = Dataset::load(folder, None, &model, &DatasetConfig::default(), &progress)?;
    let config = FieldConfig {
        time_limit: Some(splat::config::parse_duration(seconds)?),
        ..FieldConfig::new(Method::from_str(method, true)?, 1)
    };
    let cpu = splat::clock::cpu_seconds();
    let result = train(&dataset, &[], &config, None, &progress)?;
    let cpu = splat::clock::cpu_seconds() - cpu;
    for p in &result.curve {
        println!("{} steps, {:.0} s: {:.2} dB of training rays", p.iteration, p.seconds, p.psnr);
    }
    std::fs::create_dir_all(out)?;
    let (mut psnr, mut views, begun) = (0.0, 0.0, Instant::now());
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let render = result.field.render(&view.camera, &view.pose, 0.0, [0.0; 3])?.rgb.to_rgb8();
        let mut photo = scene::io::load_image(&folder.join(&view.name))?;
        for (p, a) in photo.rgb.pixels_mut().zip(photo.alpha.iter().flat_map(|a| a.pixels())) {
            p.0 = p.0.map(|v| ((u32::from(v) * u32::from(a.0[0]) + 127) / 255) as u8);
        }
        psnr += scene::metrics::psnr(&render, &photo.rgb, None)?;
        views += 1.0;
        render.save(out.join(Path::new(&view.name).file_name().unwrap_or_default()).with_extension("png"))?;
    }
    let frame = begun.elapsed().as_secs_f64() / views;
    println!(
        "{cpu:.0} CPU s; {:.2} dB on {views} held-out views over black; {frame:.2} s a frame",
        psnr / views
    );
    Ok(())
}
