//! What stages cost.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
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
