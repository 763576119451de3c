//! Fits a field to a data set with a transforms.json and renders its held-out views:
//! `fit DATASET STEPS OUT`.

use baselines::{Photos, StepPlace};
use scene::Progress;
use splat::{Dataset, DatasetConfig};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, steps, out] = &arguments[..] else { return Err("give a data set, steps and a folder".into()) };
    let (folder, out, steps) = (Path::new(folder), Path::new(out), steps.parse::<u32>()?);
    let model = scene::io::read_transforms(&folder.join("transforms.json"))?.reconstruction;
    let dataset = Dataset::load(folder, None, &model, &DatasetConfig::default(), &Progress::silent())?;
    let photos = Photos::new(&dataset, &[]);
    let mut field = baselines::instant_ngp(&dataset, 0);
    let (begun, cpu) = (Instant::now(), splat::clock::cpu_seconds());
    let (mut sum, mut count) = (0.0, 0.0);
    for step in 0..steps {
        let place = StepPlace { step, position: f64::from(step) / f64::from(steps), seed: 0 };
        let report = field.train_step(&photos, place)?;
        (sum, count) = (sum + report.square_error, count + 1.0);
        if (step + 1) % 50 == 0 || step + 1 == steps {
            let half = (splat::clock::cpu_seconds() - cpu) / 2.0;
            println!(
                "{} {:.1} s wall, {half:.1} s of two cores: {:.2} dB, {} rays {} samples",
                step + 1,
                begun.elapsed().as_secs_f64(),
                -10.0 * f64::log10(sum / count),
                report.rays,
                report.samples
            );
            (sum, count) = (0.0, 0.0);
        }
    }
    std::fs::create_dir_all(out)?;
    let (mut psnr, mut views, begun) = (0.0, 0.0, Instant::now());
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let render = field.render(&view.view, 0.0, [0.0; 3]).rgb.to_rgb8();
        let mut photo = render.clone();
        let pixels = &view.levels[0];
        for (i, p) in photo.pixels_mut().enumerate() {
            let cover = pixels.mask.as_ref().map_or(255, |m| u32::from(m[i]));
            p.0 = [0, 1, 2].map(|c| ((u32::from(pixels.rgb[i * 3 + c]) * cover + 127) / 255) as u8);
        }
        psnr += scene::metrics::psnr(&render, &photo, None)?;
        views += 1.0;
        render.save(out.join(Path::new(&view.name).file_name().unwrap_or_default()).with_extension("png"))?;
    }
    println!("{:.2} dB on {views} views, {:.2} s a frame", psnr / views, begun.elapsed().as_secs_f64() / views);
    Ok(())
}
