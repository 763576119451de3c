//! Progress on a terminal (a bar a stage) or in a log (plain lines), and Ctrl-C.

use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressStyle};
use scene::progress::ProgressSink;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Errors only.
    Quiet,
    /// Stages and results.
    Normal,
    /// What was found out on the way, too.
    Verbose,
}

/// Prints a line (or several) on standard output. A reader that has gone away has read enough; a
/// full disk is an error.
pub fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(e).context("cannot write to standard output")
        }
        _ => Ok(()),
    }
}

/// Prints a line on standard error; where nobody can read it, nothing is lost.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Turned true by the first Ctrl-C.
pub static CANCELLED: AtomicBool = AtomicBool::new(false);

/// The first Ctrl-C asks the stages to stop, the second ends the process at once.
pub fn install_ctrl_c() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        if CANCELLED.swap(true, Ordering::SeqCst) {
            std::process::exit(1);
        }
        say("\nstopping after the present step; once more to stop at once");
    })?;
    Ok(())
}

struct ProgressState {
    what: String,
    total: u64,
    bar: Option<ProgressBar>,
    begun: Instant,
    last_line: Instant,
}

/// Shows progress on standard error and keeps the notes in the stage's log.
pub struct TerminalSink {
    verbosity: Verbosity,
    state: Mutex<ProgressState>,
    log: Option<Mutex<std::fs::File>>,
}

/// Seconds between two plain lines. Source: chosen by hand, never measured.
const LINE_EVERY: Duration = Duration::from_secs(5);

impl TerminalSink {
    /// A sink whose notes go to `log` too.
    pub fn new(verbosity: Verbosity, log: Option<std::fs::File>) -> Self {
        let now = Instant::now();
        let state = ProgressState { what: String::new(), total: 0, bar: None, begun: now, last_line: now };
        Self { verbosity, state: Mutex::new(state), log: log.map(Mutex::new) }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, ProgressState> {
        self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl ProgressSink for TerminalSink {
    fn begin(&self, what: &str, total: u64) {
        let mut state = self.lock();
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        state.what = what.to_owned();
        state.total = total;
        state.begun = Instant::now();
        state.last_line = state.begun;
        if self.verbosity == Verbosity::Quiet {
            return;
        }
        if std::io::stderr().is_terminal() {
            let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
            let template = if total > 0 {
                "{msg:24!} {bar:30} {pos}/{len} {per_sec} eta {eta} {prefix}"
            } else {
                "{msg:24!} {spinner} {pos} {per_sec} {prefix}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(what.to_owned());
            state.bar = Some(bar);
        }
    }

    fn update(&self, done: u64, detail: &str) {
        let mut state = self.lock();
        if let Some(bar) = &state.bar {
            bar.set_position(done);
            if !detail.is_empty() {
                bar.set_prefix(detail.to_owned());
            }
            if state.total > 0 && done >= state.total {
                bar.finish_and_clear();
                state.bar = None;
            }
        } else if self.verbosity > Verbosity::Quiet
            && !std::io::stderr().is_terminal()
            && state.last_line.elapsed() > LINE_EVERY
        {
            state.last_line = Instant::now();
            let rate = done as f64 / state.begun.elapsed().as_secs_f64().max(1e-9);
            let of = if state.total > 0 { format!("/{}", state.total) } else { String::new() };
            let eta = if state.total > done {
                format!(", {:.0} s left", (state.total - done) as f64 / rate)
            } else {
                String::new()
            };
            say(&format!("{}: {done}{of}, {rate:.1}/s{eta} {detail}", state.what));
        }
    }

    fn note(&self, message: &str) {
        if let Some(log) = &self.log {
            let mut file = log.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let _ = writeln!(file, "{message}"); // a log that cannot be written must not end the run
        }
        if self.verbosity == Verbosity::Verbose {
            let state = self.lock();
            match &state.bar {
                Some(bar) => bar.println(message),
                None => say(message),
            }
        }
    }
}

impl Drop for TerminalSink {
    fn drop(&mut self) {
        if let Some(bar) = self.lock().bar.take() {
            bar.finish_and_clear();
        }
    }
}
