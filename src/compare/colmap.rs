//! The installed COLMAP on the frames of a run, and what it cost.

use crate::terminal::{CANCELLED, Verbosity};
use anyhow::{Context, Result, bail, ensure};
use nix::libc;
use scene::FrameSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;

/// CPU seconds (user and system) and peak memory of processes that ran one after another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Spent {
    /// Sum, seconds.
    pub cpu_s: f64,
    /// Largest resident size, MiB.
    pub peak_mib: f64,
}

/// What COLMAP made of the frames.
pub(crate) struct Models {
    /// "COLMAP 3.8", and whether it was given masks.
    pub name: String,
    /// Folders of its models, the largest first as it numbers them.
    pub folders: Vec<PathBuf>,
    /// Of extraction, matching and mapping together.
    pub spent: Spent,
}

/// First line of `colmap help` up to the version; an error that says what to install where there is
/// none.
pub(crate) fn installed() -> Result<String> {
    let output = Command::new("colmap").arg("help").env("QT_QPA_PLATFORM", "offscreen").output();
    let output = output.context("colmap is not installed or not in PATH (Debian: apt-get install colmap)")?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = said.lines().find(|l| l.starts_with("COLMAP")).unwrap_or("COLMAP");
    Ok(line.split(" -- ").next().unwrap_or(line).trim().to_owned())
}

/// Extracts, matches every pair and maps with COLMAP's defaults (one camera, no GPU), inside the
/// masks of the run where it has any.
pub(crate) fn run(name: &str, run: &Path, frames: Option<&FrameSet>, verbosity: Verbosity) -> Result<Models> {
    let images = run.join("images");
    if !images.is_dir() {
        bail!("{} has no images/ for COLMAP to run on; name an output folder of sat-recon", run.display());
    }
    let folder = run.join(".stages/colmap");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot clear {}", folder.display()))?;
    }
    let sparse = folder.join("sparse");
    std::fs::create_dir_all(&sparse).with_context(|| format!("cannot make {}", sparse.display()))?;
    let masks = frames.map_or(Ok(None), |frames| link_masks(frames, run, &folder.join("masks")))?;
    let mut job = ColmapJob {
        database: folder.join("database.db"),
        log: folder.join("log"),
        spent: Spent::default(),
        verbosity,
    };
    // Newer versions have other names for two options.
    let (extraction, matching) = if help_of("feature_extractor").contains("--SiftExtraction.use_gpu") {
        ("--SiftExtraction.use_gpu", "--SiftMatching.use_gpu")
    } else {
        ("--FeatureExtraction.use_gpu", "--FeatureMatching.use_gpu")
    };
    let mut extract = job.step("feature_extractor");
    extract.arg("--image_path").arg(&images).args(["--ImageReader.single_camera", "1", extraction, "0"]);
    if let Some(masks) = &masks {
        extract.arg("--ImageReader.mask_path").arg(masks);
    }
    job.run("feature_extractor", extract)?;
    let mut matcher = job.step("exhaustive_matcher");
    matcher.args([matching, "0"]);
    job.run("exhaustive_matcher", matcher)?;
    let mut mapper = job.step("mapper");
    mapper.arg("--image_path").arg(&images).arg("--output_path").arg(&sparse);
    // Where nothing can be mapped, some versions say so with an exit code.
    let mapped = job.run("mapper", mapper);
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(&sparse)?.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_dir()).collect();
    folders.sort();
    if folders.is_empty() && CANCELLED.load(Ordering::Relaxed) {
        mapped?;
    }
    let name = if masks.is_some() { format!("{name}, inside the masks") } else { name.to_owned() };
    Ok(Models { name, folders, spent: job.spent })
}

/// COLMAP looks for the mask of `a.jpg` under the name `a.jpg.png`.
fn link_masks(frames: &FrameSet, run: &Path, folder: &Path) -> Result<Option<PathBuf>> {
    for frame in &frames.frames {
        let Some(mask) = &frame.mask else { continue };
        let link = folder.join(format!("{}.png", frame.name));
        if let Some(parent) = link.parent() {
            std::fs::create_dir_all(parent)?;
        }
        let mask = std::path::absolute(run.join(mask))?;
        std::os::unix::fs::symlink(&mask, &link)
            .with_context(|| format!("cannot link {} for COLMAP", mask.display()))?;
    }
    Ok(folder.is_dir().then(|| folder.to_path_buf()))
}

fn help_of(step: &str) -> String {
    let output = Command::new("colmap").args([step, "-h"]).env("QT_QPA_PLATFORM", "offscreen").output();
    output.map_or(String::new(), |o| {
        format!("{}{}", String::from_utf8_lossy(&o.stdout), String::from_utf8_lossy(&o.stderr))
    })
}

struct ColmapJob {
    database: PathBuf,
    log: PathBuf,
    spent: Spent,
    verbosity: Verbosity,
}

impl ColmapJob {
    fn step(&self, step: &str) -> Command {
        let mut command = Command::new("colmap");
        command.arg(step).arg("--database_path").arg(&self.database).env("QT_QPA_PLATFORM", "offscreen");
        command
    }

    fn run(&mut self, step: &str, mut command: Command) -> Result<()> {
        if self.verbosity > Verbosity::Quiet {
            crate::terminal::say(&format!("colmap {step}"));
        }
        let log = File::options().create(true).append(true).open(&self.log)?;
        let child = command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log).spawn();
        let (code, spent) = wait(child.context("colmap cannot be started")?)?;
        self.spent.cpu_s += spent.cpu_s;
        self.spent.peak_mib = self.spent.peak_mib.max(spent.peak_mib);
        ensure!(!CANCELLED.load(Ordering::Relaxed), "interrupted");
        ensure!(code == 0, "colmap {step} failed; {} says why", self.log.display());
        Ok(())
    }
}

/// Waits for a child; its exit code (−1: a signal) and what it alone used.
fn wait(child: Child) -> Result<(i32, Spent)> {
    // SAFETY: `rusage` consists of integers, for which zero is a value.
    let (mut status, mut usage) = (0, unsafe { std::mem::zeroed::<libc::rusage>() });
    loop {
        // SAFETY: both pointers are to variables that outlive the call.
        let id = unsafe { libc::wait4(child.id() as libc::pid_t, &raw mut status, 0, &raw mut usage) };
        if id >= 0 {
            break;
        }
        let error = std::io::Error::last_os_error();
        ensure!(error.kind() == std::io::ErrorKind::Interrupted, "cannot wait for colmap: {error}");
    }
    let seconds = |t: libc::timeval| t.tv_sec as f64 + t.tv_usec as f64 * 1e-6;
    let spent = Spent {
        cpu_s: seconds(usage.ru_utime) + seconds(usage.ru_stime),
        peak_mib: usage.ru_maxrss as f64 / 1024.0,
    };
    Ok((if libc::WIFEXITED(status) { libc::WEXITSTATUS(status) } else { -1 }, spent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_is_charged_for_what_it_used_and_nothing_else() {
        let idle = wait(Command::new("sh").args(["-c", "exit 3"]).spawn().unwrap()).unwrap();
        assert_eq!(idle.0, 3);
        assert!(idle.1.cpu_s < 0.2 && idle.1.peak_mib > 0.1, "{idle:?}");
        let busy = "i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done";
        let busy = wait(Command::new("sh").args(["-c", busy]).spawn().unwrap()).unwrap();
        assert!(busy.0 == 0 && busy.1.cpu_s > idle.1.cpu_s + 0.02, "{busy:?}");
        let killed = wait(Command::new("sh").args(["-c", "kill -9 $$"]).spawn().unwrap()).unwrap();
        assert_eq!(killed.0, -1);
    }
}
