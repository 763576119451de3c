//! Progress on a terminal (a bar a stage) or in a log (plain lines), and Ctrl-C.

use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressStyle};
use scene::progress::ProgressSink;
use serde_json::json;
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

/// Whether standard error is for programs.
static AS_JSON: AtomicBool = AtomicBool::new(false);

/// From now on all that is said on standard error is an object of JSON a line, or not.
pub fn tell_as_json(json: bool) {
    AS_JSON.store(json, Ordering::SeqCst);
}

/// Prints a line on standard error; where nobody can read it, nothing is lost.
pub fn say(line: &str) {
    say_event(&json!({"event": "message", "text": line}), line);
}

/// Says why the program ends without a result.
pub fn say_error(text: &str) {
    say_event(&json!({"event": "error", "text": text}), &format!("error: {text}"));
}

fn say_event(event: &serde_json::Value, line: &str) {
    let _ = if AS_JSON.load(Ordering::SeqCst) {
        writeln!(std::io::stderr(), "{event}")
    } else {
        writeln!(std::io::stderr(), "{line}")
    };
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
    /// Which of how many stages.
    stage: Option<[usize; 2]>,
}

/// Seconds between two plain lines. Source: chosen by hand, never measured.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Seconds between two events. Source: what an eye still takes for motion without a break.
const EVENT_EVERY: Duration = Duration::from_millis(100);

impl TerminalSink {
    /// A sink whose notes go to `log` too.
    pub fn new(verbosity: Verbosity, log: Option<std::fs::File>) -> Self {
        let now = Instant::now();
        let state = ProgressState { what: String::new(), total: 0, bar: None, begun: now, last_line: now };
        Self { verbosity, state: Mutex::new(state), log: log.map(Mutex::new), stage: None }
    }

    /// The same of one of several stages.
    pub fn of_stage(mut self, number: usize, of: usize) -> Self {
        self.stage = Some([number, of]);
        self
    }

    /// What is done, behind the number of its stage.
    fn named(&self, what: &str) -> String {
        self.stage.map_or_else(|| what.to_owned(), |[number, of]| format!("{number}/{of} {what}"))
    }

    /// Tells a program how far the stage is.
    fn tell(&self, what: &str, done: u64, total: u64, detail: &str) {
        let [stage, stages] = self.stage.unwrap_or([1, 1]);
        let total = (total > 0).then_some(total);
        let event = json!({"event": "progress", "stage": stage, "stages": stages, "what": what,
            "done": done, "total": total, "detail": detail});
        say_event(&event, "");
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
        if AS_JSON.load(Ordering::SeqCst) {
            self.tell(what, 0, total, "");
        } else if std::io::stderr().is_terminal() {
            let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
            let template = if total > 0 {
                "{msg:32!} {bar:30} {pos}/{len} {rate} {eta} left {prefix}"
            } else {
                "{msg:32!} {spinner} {pos} {rate} {prefix}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                let rate = |state: &indicatif::ProgressState, w: &mut dyn std::fmt::Write| {
                    let _ = w.write_str(&rate_in_words(state.per_sec())); // a String takes all
                };
                bar.set_style(style.with_key("rate", rate));
            }
            bar.set_message(self.named(what));
            state.bar = Some(bar);
        }
    }

    fn update(&self, done: u64, detail: &str) {
        let mut state = self.lock();
        if done > state.total {
            state.total = 0; // more than was announced: nobody knows of how many
        }
        if let Some(bar) = &state.bar {
            if state.total == 0 {
                bar.unset_length();
            }
            bar.set_position(done);
            if !detail.is_empty() {
                bar.set_prefix(detail.to_owned());
            }
            if state.total > 0 && done >= state.total {
                bar.finish_and_clear();
                state.bar = None;
            }
            return;
        }
        let as_json = AS_JSON.load(Ordering::SeqCst);
        let pause = if as_json { EVENT_EVERY } else { LINE_EVERY };
        let is_due = state.last_line.elapsed() > pause || (as_json && done == state.total);
        if self.verbosity == Verbosity::Quiet || !is_due {
            return;
        }
        state.last_line = Instant::now();
        if as_json {
            self.tell(&state.what, done, state.total, detail);
        } else if !std::io::stderr().is_terminal() {
            let seconds = state.begun.elapsed().as_secs_f64();
            say(&plain_line(&self.named(&state.what), &state, done, seconds, detail));
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

/// How fast things are done, in digits that say something: several a second, or seconds for each.
fn rate_in_words(per_second: f64) -> String {
    match per_second {
        r if !(r.is_finite() && r > 0.0) => String::new(),
        r if r >= 10.0 => format!("{r:.0}/s"),
        r if r >= 1.0 => format!("{r:.1}/s"),
        r if r >= 0.1 => format!("{:.1} s each", 1.0 / r),
        r => format!("{:.0} s each", 1.0 / r),
    }
}

/// A line of a log: what is done, how much of it, how fast, and the time that is left.
fn plain_line(what: &str, state: &ProgressState, done: u64, seconds: f64, detail: &str) -> String {
    let rate = done as f64 / seconds.max(1e-9);
    let of = if state.total > 0 { format!("/{}", state.total) } else { String::new() };
    let left =
        (state.total > done && done > 0).then(|| format!("{:.0} s left", (state.total - done) as f64 / rate));
    let parts = [Some(format!("{what}: {done}{of}")), Some(rate_in_words(rate)), left];
    let parts: Vec<String> = parts.into_iter().flatten().filter(|p| !p.is_empty()).collect();
    let detail = if detail.is_empty() { String::new() } else { format!(" ({detail})") };
    format!("{}{detail}", parts.join(", "))
}

impl Drop for TerminalSink {
    fn drop(&mut self) {
        if let Some(bar) = self.lock().bar.take() {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_in_sane_digits_and_more_than_all_is_never_said() {
        let words = [1234.5, 42.3, 3.123, 0.4, 0.0123, 0.0, f64::NAN].map(rate_in_words);
        assert_eq!(words, ["1234/s", "42/s", "3.1/s", "2.5 s each", "81 s each", "", ""]);
        let sink = TerminalSink::new(Verbosity::Normal, None).of_stage(2, 6);
        sink.begin("mapping", 100);
        assert_eq!(
            plain_line(&sink.named("mapping"), &sink.lock(), 50, 100.0, "50 images"),
            "2/6 mapping: 50/100, 2.0 s each, 100 s left (50 images)"
        );
        sink.update(184, "");
        assert_eq!(plain_line("mapping", &sink.lock(), 184, 100.0, ""), "mapping: 184, 1.8/s");
    }
}
