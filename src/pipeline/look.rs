//! What those who look on are shown: on the terminal, and on the page of `--view`.

use super::Pipeline;
use crate::record::{Level, PoseSummary, SplatSummary};
use crate::report::{overall, overall_in_words};
use crate::terminal::{CANCELLED, TerminalSink, Verbosity};
use crate::view::{BUNDLE, PAGE, StagePlace, Watch};
use anyhow::{Context, Result};
use glam::DVec3;
use scene::progress::ProgressSink;
use scene::{Decision, FrameSet, Preview, Progress};
use std::sync::{Arc, Mutex, PoisonError};

impl Pipeline {
    pub(super) fn progress(&self, stage: &str) -> Progress {
        let (number, of) = self.until.place(stage);
        let terminal = TerminalSink::new(self.verbosity, self.stages.log(stage)).of_stage(number, of);
        let Some(page) = &self.page else { return Progress::new(Box::new(terminal), &CANCELLED) };
        let (watch, place, work) = (Arc::clone(page.watch()), StagePlace { number, of }, Mutex::default());
        Progress::new(Box::new(WatchedSink { terminal, watch, place, work }), &CANCELLED)
    }

    pub(super) fn say_decisions(&self, decisions: &[Decision]) {
        for words in decisions.iter().map(Decision::sentences) {
            let is_verbose = self.verbosity == Verbosity::Verbose && !words.evidence.is_empty();
            let evidence =
                if is_verbose { format!(" ({})", words.evidence.join("; ")) } else { String::new() };
            self.say(&format!("          {words}{evidence}"));
        }
    }

    pub(super) fn show_frames(&self, frames: &FrameSet) {
        if let Some(page) = &self.page {
            page.watch().show_frames(frames);
        }
    }

    /// Shows the poses of a model in the run's folder.
    pub(super) fn show_poses(&self, model: &str, poses: &PoseSummary) {
        let up = poses.world.as_ref().map(|w| DVec3::from_array(w.up));
        if let Some(Err(error)) = self.page.as_ref().map(|p| p.watch().show_poses(model, up)) {
            self.say(&format!("          the page cannot show the poses: {error:#}"));
        }
    }

    pub(super) fn show_splat(&self, splat: &SplatSummary) {
        if let Some(Err(error)) = self.page.as_ref().map(|p| p.watch().show_splat(splat.antialias)) {
            self.say(&format!("          the page cannot show the splat: {error:#}"));
        }
    }

    /// Writes the page of the splat unless it is there; the report links to it.
    pub(super) fn write_page(&self) -> Result<()> {
        let page = self.out.join(PAGE);
        if self.record.splat.is_none() || BUNDLE.is_none() || page.is_file() {
            return Ok(());
        }
        let world = self.record.poses.as_ref().and_then(|p| p.world.as_ref());
        let up = world.map(|w| DVec3::from_array(w.up));
        crate::view::write_page(&self.out, &page, up).context("cannot write the page of the splat")
    }

    /// Shows the verdict, and stays until the page is closed.
    pub(super) fn show_end(&self) {
        let Some(page) = &self.page else { return };
        let verdict = &self.record.verdict;
        let doubts = verdict.iter().filter(|l| matches!(l.level, Level::Fair | Level::Bad));
        let reasons = doubts.map(|l| format!("{}: {}", l.what, l.reason)).collect();
        page.watch().end(overall(verdict), overall_in_words(overall(verdict)), reasons);
        page.linger();
    }
}

/// The terminal, with the page beside it.
struct WatchedSink {
    terminal: TerminalSink,
    watch: Arc<Watch>,
    place: StagePlace,
    /// What is done now, and of how many steps.
    work: Mutex<(String, u64)>,
}

impl ProgressSink for WatchedSink {
    fn begin(&self, what: &str, total: u64) {
        self.terminal.begin(what, total);
        self.watch.tell(self.place, what, (0, total), "");
        *self.work.lock().unwrap_or_else(PoisonError::into_inner) = (what.to_owned(), total);
    }

    fn update(&self, done: u64, detail: &str) {
        self.terminal.update(done, detail);
        let work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        // More than was announced: nobody knows of how many.
        let total = if done > work.1 { 0 } else { work.1 };
        self.watch.tell(self.place, &work.0, (done, total), detail);
    }

    fn note(&self, message: &str) {
        self.terminal.note(message);
    }

    fn wants_preview(&self) -> bool {
        self.watch.wants_preview()
    }

    fn preview(&self, preview: Preview) {
        self.watch.preview(preview);
    }
}
