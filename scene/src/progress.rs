//! How a stage says how far it is, and how it is told to stop.

use crate::{Gaussians, Reconstruction};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The user asked to stop (Ctrl-C); what was finished is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// An interim result, for those who look on while a stage works.
#[derive(Clone, Debug)]
pub enum Preview {
    /// Cameras, poses and points, in the frame that the solver has now; without observations, and
    /// names may be missing (image number = index of the frame + 1).
    Model(Reconstruction),
    /// Gaussians, world frame.
    Splat(Gaussians),
}

/// What shows progress to a person: a bar, plain lines, or nothing.
pub trait ProgressSink: Send + Sync {
    /// A new piece of work of `total` steps (0 where unknown) begins.
    fn begin(&self, what: &str, total: u64);
    /// `done` steps of the present work are done; `detail` is a short figure to show beside (may be
    /// empty).
    fn update(&self, done: u64, detail: &str);
    /// A sentence for the user (shown with `-v`).
    fn note(&self, message: &str);
    /// Whether somebody looks on and is ready for another interim result.
    fn wants_preview(&self) -> bool {
        false
    }
    /// Shows an interim result.
    fn preview(&self, _: Preview) {}
}

struct Silent;

impl ProgressSink for Silent {
    fn begin(&self, _: &str, _: u64) {}
    fn update(&self, _: u64, _: &str) {}
    fn note(&self, _: &str) {}
}

/// The last argument of every stage. Shared between threads.
pub struct Progress {
    sink: Box<dyn ProgressSink>,
    cancel: &'static AtomicBool,
    done: AtomicU64,
}

impl Progress {
    /// Shows through `sink`; stops when `cancel` turns true.
    pub fn new(sink: Box<dyn ProgressSink>, cancel: &'static AtomicBool) -> Self {
        Self { sink, cancel, done: AtomicU64::new(0) }
    }

    /// Shows nothing and never stops.
    pub fn silent() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self::new(Box::new(Silent), &NEVER)
    }

    /// A new piece of work of `total` steps (0 where unknown) begins.
    pub fn begin(&self, what: &str, total: usize) {
        self.done.store(0, Ordering::Relaxed);
        self.sink.begin(what, total as u64);
    }

    /// One step more is done; an error if the user asked to stop.
    pub fn tick(&self) -> Result<(), Cancelled> {
        self.tick_with("")
    }

    /// One step more is done, with a figure to show beside; an error if the user asked to stop.
    pub fn tick_with(&self, detail: &str) -> Result<(), Cancelled> {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        self.sink.update(done, detail);
        self.check()
    }

    /// An error if the user asked to stop.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
    }

    /// Whether an interim result would be looked at now: only then is one worth making.
    pub fn wants_preview(&self) -> bool {
        self.sink.wants_preview()
    }

    /// Shows an interim result; no result depends on it.
    pub fn preview(&self, preview: Preview) {
        self.sink.preview(preview);
    }

    /// A sentence for the user (shown with `-v`).
    pub fn note(&self, message: &str) {
        self.sink.note(message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};
    use std::thread::{scope, yield_now};

    const THREADS: u64 = 4;
    // Miri, which looks at every access, takes seconds for what takes others microseconds.
    const STEPS: u64 = if cfg!(miri) { 20 } else { 5000 };
    const ROUNDS: usize = if cfg!(miri) { 4 } else { 200 };

    /// Keeps what it is told.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u64>>>);

    impl ProgressSink for Kept {
        fn begin(&self, _: &str, _: u64) {}
        fn update(&self, done: u64, _: &str) {
            self.0.lock().unwrap().push(done);
        }
        fn note(&self, _: &str) {}
    }

    #[test]
    fn steps_of_many_threads_are_counted_once_each() {
        static NEVER: AtomicBool = AtomicBool::new(false);
        let kept = Kept::default();
        let progress = Progress::new(Box::new(kept.clone()), &NEVER);
        progress.begin("steps", 0);
        scope(|s| {
            (0..THREADS).for_each(|_| {
                s.spawn(|| (0..STEPS).for_each(|_| progress.tick().unwrap()));
            });
        });
        let mut told = kept.0.lock().unwrap().clone();
        told.sort_unstable();
        assert!(told.into_iter().eq(1..=THREADS * STEPS));
    }

    #[test]
    fn whenever_it_is_cancelled_each_thread_ends_with_the_step_it_is_in() {
        for round in 0..ROUNDS {
            let cancel: &'static AtomicBool = Box::leak(Box::default());
            let kept = Kept::default();
            let progress = Progress::new(Box::new(kept.clone()), cancel);
            let mut before = 0;
            scope(|s| {
                (0..THREADS).for_each(|_| {
                    s.spawn(|| while progress.tick().is_ok() {});
                });
                while kept.0.lock().unwrap().len() < round {
                    yield_now();
                }
                let told = kept.0.lock().unwrap();
                cancel.store(true, Ordering::Relaxed);
                before = told.len();
            });
            // A thread that takes the lock after it was held above sees that it is cancelled.
            let after = kept.0.lock().unwrap().len();
            assert!(after <= before + THREADS as usize, "{before} steps, then {after}");
            assert_eq!(progress.check(), Err(Cancelled));
        }
    }
}
