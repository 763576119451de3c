//! `--memory-limit`: held by the system, and compared with what a run will need before it begins.

use crate::args::PipelineArgs;
use crate::pipeline::Until;
use anyhow::{Context, Result, bail};
use baselines::Method;
use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit, setrlimit};
use scene::FrameSet;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// Bytes that a Gaussian needs in training, spherical harmonics of degree 3.
/// Source: docs/benchmarks.md, "How does a training step grow?": 450 more for each of a million
/// beyond 10,000, 580 of three million.
const GAUSSIAN_BYTES: f64 = 480.0;
/// Bytes of a decoded pixel with its mask at full resolution and all coarser ones.
/// Source: derived; four bytes, and a third more for all halved copies.
const PIXEL_BYTES: f64 = 4.0 * 4.0 / 3.0;
/// What the program needs beside, MiB. Source: measured; the sample's peak in its smallest stage.
const PROGRAM_MIB: f64 = 30.0;

/// Read by OpenBLAS, which Ceres and ffmpeg load, when a program starts.
const BLAS_THREADS: &str = "OPENBLAS_NUM_THREADS";

/// Lets the system refuse more memory than `mib` to this process and to those that it starts.
pub(crate) fn limit(mib: u64) -> Result<()> {
    let (_, most) = getrlimit(Resource::RLIMIT_DATA).context("cannot read the limit of memory")?;
    let bytes = (mib << 20).min(most);
    setrlimit(Resource::RLIMIT_DATA, bytes, most).context("cannot set --memory-limit")?;
    restart_without_blas_threads()
}

/// Under a limit of memory, starts this program anew without OpenBLAS's threads. Each asks for up
/// to 128 MiB when the program is loaded (on a processor with AVX-512), asks again for ever where
/// the limit refuses, and the program cannot end until it is given them.
pub fn restart_without_blas_threads() -> Result<()> {
    let (limit, _) = getrlimit(Resource::RLIMIT_DATA).context("cannot read the limit of memory")?;
    if limit == RLIM_INFINITY || std::env::var_os(BLAS_THREADS).is_some() {
        return Ok(());
    }
    let program = std::env::current_exe().context("cannot find this program to start it anew")?;
    let arguments = std::env::args_os().skip(1);
    let failed = Command::new(&program).args(arguments).env(BLAS_THREADS, "1").exec();
    Err(failed).with_context(|| format!("cannot start {} anew under a limit of memory", program.display()))
}

/// Refuses a run that will need more memory than the limit, before it has worked for hours.
pub(crate) fn check(limit: Option<u64>, frames: &FrameSet, args: &PipelineArgs, until: Until) -> Result<()> {
    let Some(limit) = limit.filter(|_| until >= Until::Train && args.method == Method::Gaussians) else {
        return Ok(());
    };
    let needed = training_mib(frames, args.train.max_gaussians);
    if needed > limit as f64 {
        bail!(
            "training will need about {needed:.0} MiB for {} pictures and {} Gaussians, more than --memory-limit {limit}; \
             lower --max-gaussians, --frames or --max-size",
            frames.len(),
            args.train.max_gaussians
        );
    }
    Ok(())
}

/// What the training of a splat will need at its peak, MiB.
fn training_mib(frames: &FrameSet, gaussians: usize) -> f64 {
    let pixels: f64 = frames.frames.iter().map(|f| f64::from(f.width) * f64::from(f.height)).sum();
    let bytes = pixels * PIXEL_BYTES + gaussians as f64 * GAUSSIAN_BYTES;
    PROGRAM_MIB + bytes / f64::from(1 << 20)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::Frame;

    #[test]
    fn photos_and_gaussians_are_counted() {
        let frame = Frame { width: 1024, height: 1024, ..Frame::default() };
        let frames = FrameSet { frames: vec![frame; 30], ..FrameSet::default() };
        assert!((training_mib(&frames, 0) - (30.0 + 160.0)).abs() < 1e-9);
        let more = training_mib(&frames, 1 << 20) - training_mib(&frames, 0);
        assert!((more - GAUSSIAN_BYTES).abs() < 1e-9);
    }
}
