//! Tracks through the frames of a video: corners followed from frame to frame, kept where following
//! back returns to the start (forward-backward check: Kalal, Mikolajczyk & Matas, ICPR 2010).

mod corners;
pub(crate) mod pyramid;
pub(crate) mod reference;
mod register;
#[cfg(test)]
mod tests;
pub(crate) mod window;

use crate::error::SfmError;
use crate::sift::{load_luma, read_mask};
use corners::{corners, is_unmasked};
use glam::{DMat2, DVec2};
use image::GrayImage;
use pyramid::Pyramid;
use rayon::prelude::*;
use reference::{Reference, Warp};
use register::follow;
use scene::flag::between;
use scene::{Frame, FrameSet, Progress};
use serde::{Deserialize, Serialize};

/// Settings of the tracker.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct KltConfig {
    /// Points that are followed at once
    #[arg(long, value_parser = between::<usize>(1, 1_000_000), default_value_t = Self::default().track_points, help_heading = "Motion")]
    pub track_points: usize,
    /// Least distance of a new point from the others, pixels
    #[arg(long, value_parser = between::<f64>(0.5, 1e4), default_value_t = Self::default().track_distance_px, help_heading = "Motion")]
    pub track_distance_px: f64,
    /// Farthest from its start that a point followed forth and back may end, pixels
    #[arg(long, value_parser = between::<f64>(0.0, 1e4), default_value_t = Self::default().track_return_px, help_heading = "Motion")]
    pub track_return_px: f64,
}

impl Default for KltConfig {
    fn default() -> Self {
        Self { track_points: 1500, track_distance_px: 3.0, track_return_px: 0.4 }
    }
}

/// Levels of the pyramids: windows reach about 7 · 2³ pixels.
/// Source: derived: farther than points move between frames of a video.
const LEVELS: usize = 4;
/// Least correlation of a window with the track's first one.
/// Source: judgement; the forward-backward check decides most.
const CORRELATION: f64 = 0.85;

/// A point followed through consecutive frames.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KltTrack {
    /// The first frame.
    pub first: usize,
    /// Its place there and in the frames after it, pixels.
    pub positions: Vec<DVec2>,
}

struct KltPicture {
    pyramid: Pyramid,
    mask: Option<GrayImage>,
}

fn read(frame: &Frame) -> Result<KltPicture, SfmError> {
    let mask = frame.mask.as_deref().map(|path| read_mask(path, frame)).transpose()?;
    Ok(KltPicture { pyramid: Pyramid::new(&load_luma(frame)?, LEVELS), mask })
}

impl KltPicture {
    /// Where a window lies about `start`; `None` where it differs too much or the mask drops the
    /// place.
    fn find(&self, reference: &Reference, start: Warp) -> Option<Warp> {
        let level = &self.pyramid.levels[0];
        let (warp, correlation) = reference.find(level, start)?;
        let (x, y) = (warp.place.x.floor() as i64, warp.place.y.floor() as i64);
        let kept = is_unmasked(self.mask.as_ref(), x, y, level.width, level.height);
        (correlation >= CORRELATION && kept).then_some(warp)
    }
}

/// Whether no other track is within two pixels of a place, which is taken then: two tracks that run
/// into each other are one point or an occlusion, and the older one goes on.
fn take_if_free(taken: &mut Vec<DVec2>, place: DVec2) -> bool {
    let free = taken.iter().all(|q| q.distance_squared(place) > 4.0);
    taken.extend(free.then_some(place));
    free
}

/// Follows corners through all frames of a video, in their order; tracks of at least three frames.
/// Corners in the black of a mask are neither begun nor followed. Does not depend on the number of
/// threads.
pub(crate) fn track(
    frames: &FrameSet,
    config: &KltConfig,
    progress: &Progress,
) -> Result<Vec<KltTrack>, SfmError> {
    progress.begin("tracks", frames.len());
    let mut tracker = Tracker::new(config);
    let mut frame = 0;
    // As many frames are read at once as there are threads.
    for some in frames.frames.chunks(rayon::current_num_threads()) {
        let pictures: Result<Vec<KltPicture>, SfmError> = some.par_iter().map(read).collect();
        for picture in pictures? {
            tracker.advance(frame, picture);
            frame += 1;
            progress.tick()?;
        }
    }
    Ok(tracker.finish())
}

/// A track that goes on, with its first window and how that lies in the last frame.
struct LiveTrack {
    track: KltTrack,
    reference: Reference,
    shape: DMat2,
}

/// What became of a point in the next frame.
enum TrackStep {
    /// Its first window was found again.
    On(Warp),
    /// Its first window shows too little of it by now: another track begins with that of the last
    /// frame.
    Anew(Box<Reference>, Warp),
    /// It is gone.
    Lost,
}

struct Tracker<'a> {
    config: &'a KltConfig,
    last: Option<KltPicture>,
    live: Vec<LiveTrack>,
    done: Vec<KltTrack>,
}

impl<'a> Tracker<'a> {
    fn new(config: &'a KltConfig) -> Self {
        Self { config, last: None, live: Vec::new(), done: Vec::new() }
    }

    fn advance(&mut self, frame: usize, next: KltPicture) {
        if let Some(last) = self.last.take() {
            let found: Vec<TrackStep> =
                self.live.par_iter().map(|t| self.follow_one(&last, &next, t)).collect();
            let mut taken: Vec<DVec2> = Vec::new();
            for (mut live, step) in std::mem::take(&mut self.live).into_iter().zip(found) {
                match step {
                    TrackStep::On(warp) if take_if_free(&mut taken, warp.place) => {
                        live.track.positions.push(warp.place);
                        live.shape = warp.shape;
                        self.live.push(live);
                    }
                    TrackStep::Anew(reference, warp) if take_if_free(&mut taken, warp.place) => {
                        let start = live.track.positions.last().copied().unwrap_or(warp.place);
                        self.done.push(live.track);
                        let track = KltTrack { first: frame - 1, positions: vec![start, warp.place] };
                        self.live.push(LiveTrack { track, reference: *reference, shape: warp.shape });
                    }
                    _ => self.done.push(live.track),
                }
            }
        }
        let wanted = self.config.track_points.saturating_sub(self.live.len());
        if wanted > 0 {
            let taken: Vec<DVec2> =
                self.live.iter().filter_map(|t| t.track.positions.last().copied()).collect();
            let level = &next.pyramid.levels[0];
            let new = corners(level, next.mask.as_ref(), &taken, self.config.track_distance_px, wanted);
            self.live.extend(new.into_iter().filter_map(|p| {
                let reference = Reference::new(level, p)?;
                let track = KltTrack { first: frame, positions: vec![p] };
                Some(LiveTrack { track, reference, shape: DMat2::IDENTITY })
            }));
        }
        self.last = Some(next);
    }

    fn follow_one(&self, last: &KltPicture, next: &KltPicture, live: &LiveTrack) -> TrackStep {
        let positions = &live.track.positions;
        let Some(&p) = positions.last() else { return TrackStep::Lost };
        let before = positions.len().checked_sub(2).map(|i| positions[i]);
        let guess = before.map_or(p, |b| p + (p - b));
        let found = follow(&last.pyramid, &next.pyramid, p, guess)
            .or_else(|| (guess != p).then(|| follow(&last.pyramid, &next.pyramid, p, p)).flatten());
        let Some(found) = found else { return TrackStep::Lost };
        let back = follow(&next.pyramid, &last.pyramid, found, p);
        if back.is_none_or(|b| !(b.distance(p) <= self.config.track_return_px)) {
            return TrackStep::Lost;
        }
        if let Some(warp) = next.find(&live.reference, Warp { shape: live.shape, place: found }) {
            return TrackStep::On(warp);
        }
        let Some(anew) = Reference::new(&last.pyramid.levels[0], p) else { return TrackStep::Lost };
        let warp = next.find(&anew, Warp { shape: DMat2::IDENTITY, place: found });
        warp.map_or(TrackStep::Lost, |warp| TrackStep::Anew(Box::new(anew), warp))
    }

    fn finish(mut self) -> Vec<KltTrack> {
        self.done.extend(self.live.into_iter().map(|l| l.track));
        self.done.retain(|t| t.positions.len() >= 3);
        self.done.sort_by(|a, b| {
            let (p, q) = (a.positions[0], b.positions[0]);
            a.first.cmp(&b.first).then(p.y.total_cmp(&q.y)).then(p.x.total_cmp(&q.x))
        });
        self.done
    }
}
