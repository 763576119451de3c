//! Stages of the output folder: fingerprints, skipping what is current, costs.

use anyhow::{Context, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a stage cost.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct Cost {
    /// Wall-clock seconds.
    pub wall_s: f64,
    /// CPU seconds, user and system, subprocesses included.
    pub cpu_s: f64,
    /// Peak resident memory while it ran, MiB (0 where the system does not tell).
    pub peak_mib: f64,
}

/// What is kept of a finished stage, in `.stages/NAME.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finished<T> {
    /// Stage version, configuration and inputs, hashed.
    pub fingerprint: String,
    /// What it cost when it ran.
    pub cost: Cost,
    /// What the following stages need of it.
    pub value: T,
}

/// The `.stages` folder of an output folder.
#[derive(Clone, Debug)]
pub struct Stages {
    folder: PathBuf,
}

impl Stages {
    /// Opens (makes) `OUT/.stages`.
    pub fn open(out: &Path) -> Result<Self> {
        let folder = out.join(".stages");
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Self { folder })
    }

    /// A path inside the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The log of a stage, begun anew.
    pub fn log(&self, name: &str) -> Option<std::fs::File> {
        std::fs::File::create(self.path(&format!("{name}.log"))).ok()
    }

    /// What an earlier run left of the stage, if its fingerprint is current.
    pub fn current<T: DeserializeOwned>(&self, name: &str, fingerprint: &str) -> Option<Finished<T>> {
        let text = std::fs::read(self.path(&format!("{name}.json"))).ok()?;
        let finished: Finished<T> = serde_json::from_slice(&text).ok()?;
        (finished.fingerprint == fingerprint).then_some(finished)
    }

    /// What an earlier run left of the stage, current or not.
    pub fn last<T: DeserializeOwned>(&self, name: &str) -> Option<Finished<T>> {
        serde_json::from_slice(&std::fs::read(self.path(&format!("{name}.json"))).ok()?).ok()
    }

    /// Has the stage run anew the next time.
    pub fn forget(&self, name: &str) {
        let _ = std::fs::remove_file(self.path(&format!("{name}.json"))); // what is not there is forgotten
    }

    /// Runs `work` unless its result is current and its `outputs` are there; remembers the result
    /// when it is complete. The second value says whether it ran.
    pub fn run<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        fingerprint: &str,
        outputs: &[PathBuf],
        work: impl FnOnce() -> Result<T>,
    ) -> Result<(Finished<T>, bool)> {
        if let Some(finished) = self.current(name, fingerprint)
            && outputs.iter().all(|path| path.exists())
        {
            return Ok((finished, false));
        }
        let meter = Meter::start();
        let value = work()?;
        let finished = Finished { fingerprint: fingerprint.to_owned(), cost: meter.stop(), value };
        write_json(&self.path(&format!("{name}.json")), &finished)?;
        Ok((finished, true))
    }
}

/// Hash of anything that serialises: stage name and version (or what tells its sources from those
/// of another build), configuration, fingerprints of what it reads.
pub fn fingerprint(parts: &impl Serialize) -> Result<String> {
    Ok(blake3::hash(&serde_json::to_vec(parts)?).to_hex()[..32].to_owned())
}

/// What identifies an input without reading all of it: names, sizes and times of change.
pub fn describe_input(path: &Path) -> Result<Vec<(String, u64, u128)>> {
    let mut found = Vec::new();
    let mut folders = vec![path.to_path_buf()];
    while let Some(current) = folders.pop() {
        let meta =
            std::fs::metadata(&current).with_context(|| format!("cannot read {}", current.display()))?;
        if meta.is_dir() {
            for entry in
                std::fs::read_dir(&current).with_context(|| format!("cannot list {}", current.display()))?
            {
                let entry = entry?;
                if !entry.file_type()?.is_symlink() && !entry.file_name().to_string_lossy().starts_with('.') {
                    folders.push(entry.path());
                }
            }
        } else {
            let changed = meta.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
            found.push((
                current.to_string_lossy().into_owned(),
                meta.len(),
                changed.map_or(0, |d| d.as_nanos()),
            ));
        }
    }
    found.sort();
    Ok(found)
}

/// Writes JSON beside its target and renames when complete.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_whole(path, &serde_json::to_vec_pretty(value)?)
}

/// Writes a file beside its target and renames when complete.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    Ok(scene::io::write_atomic(path, |w| std::io::Write::write_all(w, bytes))?)
}

/// Measures one stage.
pub struct Meter {
    begun: Instant,
    cpu_s: f64,
}

impl Meter {
    /// Begins; the kernel's peak of resident memory is set back where it can be.
    pub fn start() -> Self {
        give_back_memory();
        let _ = std::fs::write("/proc/self/clear_refs", "5"); // not on every kernel: then the peak is the process's
        Self { begun: Instant::now(), cpu_s: cpu_seconds() }
    }

    /// What was spent since.
    pub fn stop(self) -> Cost {
        Cost {
            wall_s: self.begun.elapsed().as_secs_f64(),
            cpu_s: cpu_seconds() - self.cpu_s,
            peak_mib: peak_mib().unwrap_or(0.0),
        }
    }
}

/// Returns memory that earlier stages have freed to the system, which glibc keeps otherwise.
fn give_back_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: takes the allocator's own locks; any thread may call it at any time.
    unsafe {
        nix::libc::malloc_trim(0);
    }
}

/// From here on, large blocks that are freed go back to the system at once. glibc keeps what is
/// smaller than the largest block it ever freed, and growing Gaussians free many.
pub fn free_large_blocks_at_once() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: sets a number under the allocator's own lock.
    unsafe {
        nix::libc::mallopt(nix::libc::M_MMAP_THRESHOLD, 1 << 18);
    }
}

fn cpu_seconds() -> f64 {
    use nix::sys::resource::{UsageWho, getrusage};
    let used = [UsageWho::RUSAGE_SELF, UsageWho::RUSAGE_CHILDREN].into_iter().flat_map(getrusage);
    let times = used.flat_map(|u| [u.user_time(), u.system_time()]);
    times.map(|t| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6).sum()
}

fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_runs_once_for_one_fingerprint_and_again_for_another() {
        let folder = std::env::temp_dir().join(format!("sat-recon-stage-{}", std::process::id()));
        let stages = Stages::open(&folder).unwrap();
        let mut runs = 0;
        for (print, expected) in [("a", 1), ("a", 1), ("b", 2)] {
            let (finished, _) = stages
                .run("frames", print, &[], || {
                    runs += 1;
                    Ok(runs)
                })
                .unwrap();
            assert_eq!(finished.value, expected);
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_stage_whose_output_was_deleted_runs_again() {
        let folder = std::env::temp_dir().join(format!("sat-recon-deleted-{}", std::process::id()));
        let stages = Stages::open(&folder).unwrap();
        let output = folder.join("splat.ply");
        for expected in [true, false, true] {
            let made = output.clone();
            let (_, ran) = stages
                .run("train", "a", std::slice::from_ref(&output), || Ok(std::fs::write(made, "x")?))
                .unwrap();
            assert_eq!(ran, expected);
            if !ran {
                std::fs::remove_file(&output).unwrap();
            }
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_failed_stage_leaves_nothing_to_skip_to() {
        let folder = std::env::temp_dir().join(format!("sat-recon-failed-{}", std::process::id()));
        let stages = Stages::open(&folder).unwrap();
        assert!(stages.run::<u32>("sfm", "a", &[], || anyhow::bail!("no")).is_err());
        assert!(stages.current::<u32>("sfm", "a").is_none());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
