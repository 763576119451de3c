//! `batch`: many captures on one machine, as many at a time as cores and memory allow; `collect`:
//! one table and one page of all of them.
//!
//! A capture is a process of its own: one that fails, or is killed, takes no other with it. Its log
//! lies beside its folder. Called again, a batch goes on where it stopped, as each run does.

mod collect;
mod list;

pub(crate) use collect::run as collect;

use crate::args::BatchArgs;
use crate::outcome::Outcome;
use crate::record::KnownRun;
use crate::stage::write_json;
use crate::terminal::{CANCELLED, Verbosity, print, say};
use anyhow::{Context, Result, bail};
use list::{Capture, LIST};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Memory that a capture is thought to need until one has ended, MiB. Source: docs/benchmarks.md,
/// twice the largest peak.
const FIRST_GUESS_MIB: f64 = 1400.0;
/// Memory is left to others: so much of what is free may be used. Source: chosen by hand, never
/// measured.
const USABLE: f64 = 0.8;
/// Cores of a capture: more hardly shorten a short one. Source: chosen by hand, never measured.
const CORES: usize = 2;

/// Runs all captures, then collects.
pub(crate) fn run(args: &BatchArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let captures = list::captures(&args.source)?;
    if args.list {
        print(&serde_json::to_string_pretty(&captures)?)?;
        return Ok(Outcome::Done);
    }
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("cannot make {}", args.output.display()))?;
    write_json(&args.output.join(LIST), &captures)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = args.jobs.map_or((cores / CORES).max(1), |jobs| jobs as usize).min(captures.len());
    let mut batch = Batch {
        output: args.output.clone(),
        flags: args.flags.clone(),
        threads: (cores / most).max(1),
        most,
        verbosity,
        running: Vec::new(),
        peak_mib: 0.0,
        done: 0,
        all: captures.len(),
    };
    let ended = batch.run(&captures);
    batch.stop();
    ended?;
    collect::write(&args.output, verbosity, json)
}

/// A capture that is being reconstructed.
struct RunningCapture {
    capture: Capture,
    child: Child,
}

struct Batch {
    output: PathBuf,
    flags: Vec<String>,
    /// Worker threads of each capture.
    threads: usize,
    /// Most captures at a time.
    most: usize,
    verbosity: Verbosity,
    running: Vec<RunningCapture>,
    /// Largest memory that a capture has needed, MiB; 0 before one has ended.
    peak_mib: f64,
    done: usize,
    all: usize,
}

impl Batch {
    fn run(&mut self, captures: &[Capture]) -> Result<()> {
        let mut waiting = captures.iter();
        let mut next = waiting.next();
        while next.is_some() || !self.running.is_empty() {
            if CANCELLED.load(Ordering::Relaxed) {
                bail!("stopped; the same command goes on");
            }
            while let Some(capture) = next.filter(|_| self.has_room()) {
                self.start(capture)?;
                next = waiting.next();
            }
            self.reap()?;
            std::thread::sleep(Duration::from_millis(100));
        }
        Ok(())
    }

    /// Whether another capture has a core, and memory beside those that run.
    fn has_room(&self) -> bool {
        let need = if self.peak_mib > 0.0 { self.peak_mib } else { FIRST_GUESS_MIB };
        let is_free = free_mib().is_none_or(|free| USABLE * free > need);
        self.running.is_empty() || self.running.len() < self.most && is_free
    }

    fn start(&mut self, capture: &Capture) -> Result<()> {
        let log = self.output.join(format!("{}.log", capture.name));
        let file = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        let program = std::env::current_exe().context("cannot find this program")?;
        let child = Command::new(program)
            .arg("run")
            .arg(&capture.input)
            .arg("-o")
            .arg(self.output.join(&capture.name))
            .args(["--threads", &self.threads.to_string()])
            .args(&self.flags)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(file)
            .spawn()
            .context("cannot start a capture")?;
        self.running.push(RunningCapture { capture: capture.clone(), child });
        Ok(())
    }

    /// Takes away what has ended.
    fn reap(&mut self) -> Result<()> {
        let mut still = Vec::new();
        for mut running in std::mem::take(&mut self.running) {
            let Some(status) = running.child.try_wait()? else {
                still.push(running);
                continue;
            };
            self.done += 1;
            let folder = self.output.join(&running.capture.name);
            if let Ok(known) = KnownRun::read(&folder) {
                let peaks = known.costs.iter().map(|(_, cost)| cost.peak_mib);
                self.peak_mib = peaks.fold(self.peak_mib, f64::max);
            }
            if self.verbosity > Verbosity::Quiet {
                let row = collect::CaptureRow::of(&self.output, &running.capture, status.code());
                say(&format!("{}/{} {}", self.done, self.all, row.sentence()));
            }
        }
        self.running = still;
        Ok(())
    }

    /// Ends what still runs.
    fn stop(&mut self) {
        for running in &mut self.running {
            let _ = running.child.kill(); // it may have ended by itself
            let _ = running.child.wait();
        }
    }
}

/// Memory that programs may still take, MiB; nothing where the system does not tell.
fn free_mib() -> Option<f64> {
    let text = std::fs::read_to_string(Path::new("/proc/meminfo")).ok()?;
    let line = text.lines().find(|l| l.starts_with("MemAvailable:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}
