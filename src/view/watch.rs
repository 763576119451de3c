//! What the page is told of a run: how far it is, its frames, its poses, its splat. A finished run
//! is one that has come to its end.

use super::work::{Work, Works};
use super::{Run, Splat, ViewScene, picture};
use crate::record::Level;
use anyhow::{Context, Result};
use glam::DVec3;
use scene::up::{UP, level_up};
use scene::{FrameSet, Gaussians, Preview, Reconstruction};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A page that has not asked for so long is closed: browsers let the timers of pages in the
/// background run once a minute. Source: developer.chrome.com, "Heavy throttling of chained JS
/// timers", Chrome 88.
const CLOSED_AFTER: Duration = Duration::from_secs(75);
/// Between two interim results. Source: chosen by hand, so that they cost a run little.
const PREVIEW_EVERY: Duration = Duration::from_secs(2);

/// How often a picture that is not there is looked for again. Source: chosen by hand: a mask is
/// written in less than one wait, on a busy machine, too.
const TRIES: u32 = 3;
/// Before each time.
const BETWEEN_TRIES: Duration = Duration::from_millis(100);

/// Which of how many stages.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct StagePlace {
    /// From 1 on; 0 before the first.
    pub number: usize,
    /// How many there are.
    pub of: usize,
}

/// How a run ended.
#[derive(Clone, Debug, Serialize)]
struct End {
    level: &'static str,
    words: &'static str,
    reasons: Vec<String>,
}

/// How far a run is. Versions are 0 where nothing is there, and grow with every change.
#[derive(Clone, Debug, Default, Serialize)]
struct WatchStatus {
    place: StagePlace,
    what: String,
    done: u64,
    total: u64,
    detail: String,
    frames: usize,
    frames_version: u32,
    mattes: usize,
    poses: u32,
    splat: u32,
    report: bool,
    end: Option<End>,
}

/// The newest splat: as it came, until somebody asks for it.
enum Newest {
    Nothing,
    Raw(Gaussians),
    Encoded(Arc<Vec<u8>>),
}

struct Watched {
    status: WatchStatus,
    frames: Works,
    run: Arc<Run>,
    splat: Newest,
    asked: Option<Instant>,
    shown: Option<Instant>,
}

/// A run that is looked at.
pub(crate) struct Watch {
    folder: PathBuf,
    is_live: bool,
    state: Mutex<Watched>,
}

impl Watch {
    /// A run that is about to work in this folder.
    pub(crate) fn live(folder: &Path) -> Self {
        let run = Run::of_model(folder, &Reconstruction::default(), UP);
        Self::new(run, WatchStatus::default(), Newest::Nothing, true)
    }

    /// A finished run.
    pub(crate) fn finished(mut run: Run) -> Self {
        let splat = run.splat.take().map_or(Newest::Nothing, |splat| Newest::Encoded(Arc::new(splat)));
        let status = WatchStatus { poses: 1, splat: 1, ..WatchStatus::default() };
        Self::new(run, status, splat, false)
    }

    fn new(run: Run, status: WatchStatus, splat: Newest, is_live: bool) -> Self {
        let folder = run.folder.clone();
        let (frames, asked, shown) = (Works::default(), None, None);
        let state = Watched { status, frames, run: Arc::new(run), splat, asked, shown };
        Self { folder, is_live, state: Mutex::new(state) }
    }

    fn lock(&self) -> MutexGuard<'_, Watched> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The folder of the run.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// What the page shows, with its version, and whether it should ask for news.
    pub(super) fn scene(&self) -> (ViewScene, u32, bool) {
        let (run, status) = {
            let state = self.lock();
            (Arc::clone(&state.run), state.status.clone())
        };
        let splat = (status.splat > 0).then_some(Splat { url: Some("splat.spz") });
        let mut scene = run.scene(splat, |i| run.photo(i).map(|_| format!("photo/{i}")));
        let state = self.lock();
        for camera in &mut scene.cameras {
            camera.frame = state.frames.number_of(&camera.name);
        }
        (scene, status.poses, self.is_live)
    }

    /// How far the run is, as JSON.
    pub(super) fn status(&self) -> Result<String> {
        let mut state = self.lock();
        state.asked = Some(Instant::now());
        let Watched { status, frames, .. } = &mut *state;
        if frames.look(&self.folder) {
            status.frames_version += 1;
        }
        (status.frames, status.mattes) = (frames.len(), frames.mattes(&self.folder));
        status.report = self.folder.join("report.html").is_file();
        Ok(serde_json::to_string(&state.status)?)
    }

    /// The newest splat as `.spz`.
    pub(super) fn splat(&self) -> Option<Arc<Vec<u8>>> {
        let mut state = self.lock();
        let raw = match std::mem::replace(&mut state.splat, Newest::Nothing) {
            Newest::Nothing => return None,
            Newest::Encoded(splat) => {
                state.splat = Newest::Encoded(Arc::clone(&splat));
                return Some(splat);
            }
            Newest::Raw(raw) => raw,
        };
        let encoded = Arc::new(state.run.encode(raw).ok()?.0);
        state.splat = Newest::Encoded(Arc::clone(&encoded));
        Some(encoded)
    }

    /// The splat of a finished run, or the newest, with a cut, as `.spz` in the page's frame.
    pub(super) fn encode(&self, gaussians: Gaussians) -> Result<Vec<u8>> {
        let run = Arc::clone(&self.lock().run);
        Ok(run.encode(gaussians)?.0)
    }

    /// The training image of a camera of the page.
    pub(super) fn photo(&self, index: usize) -> Option<PathBuf> {
        let run = Arc::clone(&self.lock().run);
        run.photo(index)
    }

    /// A frame, small, or what was cut out of it. While the stage works files are half written, or
    /// move on between looking for and opening them: then they are looked for again.
    pub(super) fn thumbnail(&self, index: usize, is_matte: bool) -> Option<Vec<u8>> {
        let made = || {
            let Work { image, mask } = self.lock().frames.at(&self.folder, index)?;
            let mask = if is_matte { Some(mask?) } else { None };
            picture::thumbnail(&image, mask.as_deref()).ok()
        };
        made().or_else(|| {
            (0..TRIES).find_map(|_| {
                std::thread::sleep(BETWEEN_TRIES);
                made()
            })
        })
    }

    /// A stage's work is so far.
    pub(crate) fn tell(&self, place: StagePlace, what: &str, (done, total): (u64, u64), detail: &str) {
        let mut state = self.lock();
        let status = &mut state.status;
        (status.place, status.done, status.total) = (place, done, total);
        (status.what, status.detail) = (what.to_owned(), detail.to_owned());
    }

    /// The frames that were chosen.
    pub(crate) fn show_frames(&self, frames: &FrameSet) {
        let mut state = self.lock();
        state.frames.choose(frames);
        state.status.frames_version += 1;
    }

    /// Poses that stand: those of a folder inside the run's, and what is up in them.
    pub(crate) fn show_poses(&self, model: &str, up: Option<DVec3>) -> Result<()> {
        let model = scene::io::read_model(&self.folder.join(model))?;
        self.place(&model, up.unwrap_or_else(|| up_in(&model)));
        Ok(())
    }

    /// The splat of the run, once it is there.
    pub(crate) fn show_splat(&self, antialias: bool) -> Result<()> {
        let gaussians = crate::pictures::need_splat(&self.folder)?;
        Arc::make_mut(&mut self.lock().run).antialias = antialias;
        self.put(gaussians);
        Ok(())
    }

    fn place(&self, model: &Reconstruction, up: DVec3) {
        let run = Run::of_model(&self.folder, model, up.normalize_or(UP));
        let mut state = self.lock();
        state.run = Arc::new(run);
        state.status.poses += 1;
    }

    fn put(&self, gaussians: Gaussians) {
        let mut state = self.lock();
        state.splat = Newest::Raw(gaussians);
        state.status.splat += 1;
    }

    /// Whether somebody looks on, and the last interim result has been shown for a while.
    pub(crate) fn wants_preview(&self) -> bool {
        let state = self.lock();
        let is_due = state.shown.is_none_or(|at| at.elapsed() > PREVIEW_EVERY);
        // A splat that nobody has fetched is new enough.
        let is_waiting = matches!(state.splat, Newest::Raw(_));
        is_due && !is_waiting && state.asked.is_some_and(|at| at.elapsed() < CLOSED_AFTER)
    }

    /// Shows an interim result.
    pub(crate) fn preview(&self, preview: Preview) {
        match preview {
            Preview::Model(mut model) => {
                self.lock().frames.name(&mut model);
                self.place(&model, up_in(&model));
            }
            Preview::Splat(gaussians) => self.put(gaussians),
        }
        self.lock().shown = Some(Instant::now());
    }

    /// The run has come to its end.
    pub(crate) fn end(&self, level: Level, words: &'static str, reasons: Vec<String>) {
        self.lock().status.end = Some(End { level: level.class(), words, reasons });
    }

    /// Whether a page is open.
    pub(crate) fn is_looked_at(&self) -> bool {
        self.lock().asked.is_some_and(|at| at.elapsed() < CLOSED_AFTER)
    }

    /// The splat of the run's folder, as it was trained.
    pub(super) fn trained(&self) -> Result<Gaussians> {
        crate::pictures::need_splat(&self.folder).context("there is no finished splat yet")
    }
}

/// What is up for level cameras.
fn up_in(model: &Reconstruction) -> DVec3 {
    level_up(model.images.values().map(|i| &i.pose)).unwrap_or(UP)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::synthetic::{SyntheticOptions, synthetic_scene};

    #[test]
    fn interim_results_are_made_for_those_who_look_on_and_no_faster_than_they_look() {
        let watch = Watch::live(Path::new("nowhere"));
        assert!(!watch.wants_preview(), "nobody has asked");
        watch.status().unwrap();
        assert!(watch.wants_preview() && watch.is_looked_at());
        let options = SyntheticOptions { num_points: 20, num_cameras: 3, ..Default::default() };
        watch.preview(Preview::Model(synthetic_scene(&options, 1).truth));
        assert!(!watch.wants_preview(), "too soon");
        assert_eq!((watch.scene().0.cameras.len(), watch.scene().1), (3, 1));
        assert!(watch.splat().is_none() && watch.scene().0.splat.is_none());
        watch.lock().shown = None;
        watch.preview(Preview::Splat(Gaussians::default()));
        watch.lock().shown = None;
        assert!(!watch.wants_preview(), "the last one was not fetched");
        assert!(watch.splat().is_some() && watch.splat().is_some(), "it stays there");
        assert!(watch.wants_preview());
        let status: serde_json::Value = serde_json::from_str(&watch.status().unwrap()).unwrap();
        assert_eq!((&status["poses"], &status["splat"]), (&1.into(), &1.into()));
    }
}
