//! Time spent, in seconds.
//!
//! ```
//! let begun = splat::clock::cpu_seconds();
//! assert!(splat::clock::cpu_seconds() >= begun);
//! ```

use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::Instant;

/// Wall time since the first call.
pub fn wall_seconds() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// User and system time of all threads of this process as the scheduler counts it, in ns (Linux;
/// wall time elsewhere).
pub fn cpu_seconds() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return wall_seconds() };
    let of = |path: PathBuf| -> f64 {
        let text = std::fs::read_to_string(path.join("schedstat")).unwrap_or_default();
        text.split_whitespace().next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0)
    };
    tasks.filter_map(Result::ok).map(|t| of(t.path())).sum::<f64>() / 1e9
}
