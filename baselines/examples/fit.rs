//! Fits a field to a data set with a transforms.json within a time limit and renders its held-out
//! views: `fit DATASET METHOD LIMIT OUT`, where LIMIT is a time (90s, 7m: processor time by core)
//! or a number of steps (500x).

use baselines::{FieldConfig, Method, train};
use clap::ValueEnum as _;
use scene::Progress;
use scene::clock::LimitClock;
use splat::simd::{Isa, Simd};
use splat::simd_kernel;
use splat::{Dataset, DatasetConfig};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// Products and sums that wait for nothing, a second of one core.
fn fastest_products() -> f64 {
    /// Rounds of a measurement, and measurements, of which the fastest counts.
    const ROUNDS: [usize; 2] = [2_000_000, 5];
    let mut best = f64::INFINITY;
    for _ in 0..ROUNDS[1] {
        let (begun, mut sums) = (Instant::now(), [0.5; SUMS * 16]);
        products(Isa::best(), &mut Products { sums: &mut sums, rounds: ROUNDS[0] });
        best = best.min(begun.elapsed().as_secs_f64());
        std::hint::black_box(sums);
    }
    (2 * SUMS * 16 * ROUNDS[0]) as f64 / best
}

/// Sums at a time, in registers of 16: enough to hide how long each takes.
const SUMS: usize = 6;

/// Sums, and how often each is multiplied and added to.
struct Products<'a> {
    sums: &'a mut [f32; SUMS * 16],
    rounds: usize,
}

#[inline(always)]
fn products_generic<S: Simd>(a: &mut Products) {
    let factor = S::splat(0.999);
    match S::LANES {
        4 => rounds_of::<S, 24>(a.sums, factor, a.rounds),
        8 => rounds_of::<S, 12>(a.sums, factor, a.rounds),
        _ => rounds_of::<S, 6>(a.sums, factor, a.rounds),
    }
}
simd_kernel!(fn products(a: &mut Products) = products_generic);

#[inline(always)]
fn rounds_of<S: Simd, const N: usize>(sums: &mut [f32; SUMS * 16], factor: S, rounds: usize) {
    let mut own = [factor; N];
    for _ in 0..rounds {
        for sum in &mut own {
            *sum = sum.fma(factor, factor);
        }
    }
    own.iter().zip(sums.chunks_mut(S::LANES)).for_each(|(sum, out)| sum.write(out));
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, method, limit, out] = &arguments[..] else {
        return Err("give a data set, a method, a limit and a folder".into());
    };
    let (folder, out) = (Path::new(folder), Path::new(out));
    let progress = Progress::silent();
    let file = scene::io::read_transforms(&folder.join("transforms.json"))?;
    let dataset = Dataset::load(folder, None, &file.reconstruction, &DatasetConfig::default(), &progress)?;
    let of_frame = |name: &str| file.frames.iter().find(|f| f.file_path == name).and_then(|f| f.time);
    let times: Vec<f32> = dataset.views.iter().map(|v| of_frame(&v.name).unwrap_or(0.0) as f32).collect();
    println!("a core's products and sums, best case: {:.0} GFLOP/s", fastest_products() / 1e9);
    let method = Method::from_str(method, true)?;
    let config = match limit.strip_suffix('x') {
        Some(steps) => FieldConfig::new(method, steps.parse()?),
        None => FieldConfig {
            time_limit: Some(splat::config::parse_duration(limit)?),
            limit_clock: LimitClock::Processor,
            ..FieldConfig::new(method, 1)
        },
    };
    let cpu = scene::clock::cpu_seconds();
    let result = train(&dataset, &times, &config, None, &progress)?;
    let cpu = scene::clock::cpu_seconds() - cpu;
    for p in &result.curve {
        println!("{} steps, {:.0} s: {:.2} dB of training rays", p.iteration, p.seconds, p.psnr);
    }
    std::fs::create_dir_all(out)?;
    println!("{:.1} GFLOP/s of CPU time in the networks' layers", result.operations / cpu / 1e9);
    let (mut psnr, mut views, begun) = (0.0, 0.0, Instant::now());
    for (view, &time) in dataset.views.iter().zip(&times).filter(|(v, _)| v.held_out) {
        let render = result.field.render(&view.camera, &view.pose, time, [0.0; 3])?.rgb.to_rgb8();
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
