//! Solves a folder of photos and writes a COLMAP model: `map_folder IMAGES OUT [--camera-model
//! SIMPLE_RADIAL …]`.

use clap::Parser;
use scene::{Frame, FrameSet, Progress};
use std::path::PathBuf;

#[derive(Parser)]
struct Cli {
    /// Folder of PNG or JPEG files.
    images: PathBuf,
    /// Folder for the COLMAP model.
    out: PathBuf,
    /// Seed of all randomness.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The images are the frames of a video in the order of their names, taken at the times that
    /// the names' numbers are.
    #[arg(long)]
    video: bool,
    /// Folder of masks, white = keep, in the order of the images.
    #[arg(long)]
    mask_folder: Option<PathBuf>,
    /// Worker threads.
    #[arg(long)]
    threads: Option<usize>,
    /// Prints the verified pairs.
    #[arg(long)]
    pairs: bool,
    #[command(flatten)]
    sfm: sfm::SfmConfig,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut cli = Cli::parse();
    cli.sfm.seed = cli.seed;
    if let Some(n) = cli.threads {
        rayon::ThreadPoolBuilder::new().num_threads(n).build_global()?;
    }
    let masks = cli.mask_folder.as_deref().map(pictures).transpose()?.unwrap_or_default();
    let mut frames = FrameSet { is_video: cli.video, ..FrameSet::default() };
    for (i, path) in pictures(&cli.images)?.into_iter().enumerate() {
        let (width, height) = image::image_dimensions(&path)?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let mask = masks.get(i).cloned();
        let digits: String = name.chars().filter(char::is_ascii_digit).collect();
        let time_s = digits.parse().ok().filter(|_| cli.video);
        frames.frames.push(Frame {
            name,
            path,
            mask,
            width,
            height,
            time_s,
            source_index: i,
            ..Frame::default()
        });
    }
    let result = sfm::reconstruct(&frames, &cli.sfm, &Progress::silent())?;
    for s in &result.stats.steps {
        println!("{:<14} wall {:7.2} s  cpu {:7.2} s", s.step, s.wall_s, s.cpu_s);
    }
    println!("total cpu {:.2} s", result.stats.steps.iter().map(|s| s.cpu_s).sum::<f64>());
    for d in &result.decisions {
        let words = d.sentences();
        println!("{words} ({})", words.evidence.join("; "));
    }
    for (name, why) in result.missing.iter().chain(&result.weak_images) {
        println!("{name}: {why}");
    }
    if cli.pairs {
        let name = |i: usize| frames.frames[i].name.as_str();
        for g in &result.geometries {
            let angle = g.median_angle.to_degrees();
            println!("{} {} {:?} {} matches, {angle:.1} deg", name(g.a), name(g.b), g.kind, g.inliers.len());
        }
    }
    let Some(model) = &result.reconstruction else {
        println!("no model: {}", result.reason);
        return Ok(());
    };
    let s = &result.stats;
    println!(
        "{} of {} images, {} features, {} pairs, {} points, {} observations, track {:.2}, error median {:.3} rms {:.3} px",
        s.registered,
        s.images,
        s.features,
        s.pairs_verified,
        s.points,
        s.observations,
        s.mean_track_length,
        s.reprojection_median_px,
        s.reprojection_rms_px
    );
    for (id, camera) in &model.cameras {
        let sd = result.uncertainty.as_ref().and_then(|u| u.cameras.get(id));
        println!("camera {id} {} {:?} ± {:?}", camera.model.name(), camera.params, sd);
    }
    model.validate()?;
    std::fs::create_dir_all(&cli.out)?;
    scene::io::write_model_bin(model, &cli.out)?;
    Ok(())
}

/// PNG and JPEG files of a folder, sorted.
fn pictures(folder: &std::path::Path) -> std::io::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)?.filter_map(|e| Some(e.ok()?.path())).collect();
    let kinds = ["png", "jpg", "jpeg"];
    paths.retain(|p| {
        p.extension().is_some_and(|e| kinds.contains(&e.to_string_lossy().to_lowercase().as_str()))
    });
    paths.sort();
    Ok(paths)
}
