//! From a video to upright, sharp, distinct frames.

use crate::decode::{Decoded, Source};
use crate::film::{FILM, Reel};
use crate::output::{Staging, write_png};
use crate::pixels::{self, Look};
use crate::probe::{self, Transfer, VideoInfo};
use crate::select::{BucketSlot, Plan};
use crate::{FrameConfig, PreprocessError, wide};
use image::ExtendedColorType;
use scene::{Film, Frame, FrameSet, Progress};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Mutex, mpsc};
use std::time::Duration;

/// Time a helper program may take for one whole decoding. Source: chosen by hand, never measured.
const DECODE_LIMIT: Duration = Duration::from_secs(1800);
/// Threads that write frames. Source: chosen by hand, never measured.
const WRITERS: usize = 2;

/// Extracts frames of `input` into `out/images/frame_NNNNNN.png` (the number is the index in the
/// video, in order of presentation). Frames are upright (display matrix), have square pixels and
/// SDR colours; `time_s` is the presentation time from the start of the container. One frame of
/// each bucket of time is taken, the sharpest, unless it shows the same as the one before. Damage
/// that decoders pass over in silence is told in the notes.
pub fn video_frames(
    input: &Path,
    out: &Path,
    config: &FrameConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    config.validate()?;
    let info = probe::probe(input, progress)?;
    let lens = config.lens.wide(|| info.is_panorama);
    let given = config;
    let config = &given.before_cutting(lens);
    let extraction =
        Extraction { input, config, progress, staging: Staging::new(out)?, failed: AtomicBool::new(false) };
    let mut notes = info.notes();
    let expected = info.times_s.len();
    let mut source = Source::open(input, &info)?;
    let taken = extraction.take(&mut source, &info)?;
    let complaints = if taken.stopped_early { None } else { source.finish(input, DECODE_LIMIT, progress)? };
    if taken.decoded > expected || info.missing > 0 {
        probe::need_same(&info, input, progress)?;
    }
    if taken.frames.is_empty() && info.encrypted {
        return Err(PreprocessError::Encrypted { path: input.to_owned() });
    }
    if taken.frames.is_empty() {
        let reason = complaints.map_or_else(|| "the decoder gives no picture".to_owned(), |c| c.1);
        return Err(PreprocessError::NothingDecodes { path: input.to_owned(), expected, reason });
    }
    notes.extend(taken.notes(expected + info.missing, complaints));
    let (frames, film) = extraction.publish(taken)?;
    let frames = FrameSet { frames, is_video: true, notes, film, ..FrameSet::default() };
    match lens {
        Some(lens) => wide::cut(frames, lens, out, given, progress),
        None => Ok(frames),
    }
}

struct Extraction<'a> {
    input: &'a Path,
    config: &'a FrameConfig,
    progress: &'a Progress,
    staging: Staging,
    /// A frame could not be written.
    failed: AtomicBool,
}

/// What one decoding yielded.
struct Taken {
    frames: Vec<Frame>,
    reel: Reel,
    decoded: usize,
    candidates: usize,
    duplicates: usize,
    resized: usize,
    last_time_s: f64,
    stopped_early: bool,
}

struct Best {
    score: f64,
    slot: BucketSlot,
    frame: Decoded,
    look: Look,
}

impl Extraction<'_> {
    fn take(&self, source: &mut Source, info: &VideoInfo) -> Result<Taken, PreprocessError> {
        let plan = Plan::new(&info.times_s, self.config);
        if plan.len == 0 && !info.times_s.is_empty() {
            return Err(PreprocessError::EmptyRange {
                path: self.input.to_owned(),
                start: self.config.start.unwrap_or(0.0),
                end: self.config.end.unwrap_or(f64::INFINITY),
                first: info.times_s.first().copied().unwrap_or(0.0),
                last: info.times_s.last().copied().unwrap_or(0.0),
            });
        }
        self.progress.begin("frames", plan.end);
        let correct_matrix = info.is_bt709;
        let (send, receive) = mpsc::sync_channel::<Decoded>(2 * WRITERS);
        let (receive, written) = (Mutex::new(receive), Mutex::new(Vec::new()));
        let mut taken = std::thread::scope(|scope| {
            let writers: Vec<_> = (0..WRITERS)
                .map(|_| scope.spawn(|| self.write(&receive, &written, info, correct_matrix)))
                .collect();
            let taken = self.select(source, &plan, &send);
            drop(send);
            for writer in writers {
                writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
            }
            taken
        })?;
        taken.frames = written.into_inner().unwrap_or_else(|e| e.into_inner());
        taken.frames.sort_by_key(|f| f.source_index);
        Ok(taken)
    }

    /// Decodes to the end and hands the chosen frames to the writers.
    fn select(
        &self,
        source: &mut Source,
        plan: &Plan,
        send: &SyncSender<Decoded>,
    ) -> Result<Taken, PreprocessError> {
        let mut taken = Taken::new(plan.candidates);
        let (mut best, mut last): (Option<Best>, Option<Look>) = (None, None);
        let mut size = None;
        let mut flush = |best: Option<Best>, taken: &mut Taken| {
            let Some(best) = best else { return true };
            if last.as_ref().is_some_and(|l| l.difference(&best.look) < self.config.duplicate_levels) {
                taken.duplicates += 1;
                return true;
            }
            last = Some(best.look);
            send.send(best.frame).is_ok()
        };
        while let Some(frame) = source.next()? {
            self.progress.tick()?;
            if self.failed.load(Ordering::Relaxed) {
                break; // the writer's error is reported when it is joined
            }
            taken.decoded += 1;
            taken.last_time_s = frame.time_s;
            if frame.index >= plan.end {
                taken.stopped_early = self.config.end.is_some();
                if taken.stopped_early {
                    break;
                }
            }
            let Some(slot) = plan.slot(frame.index) else { continue };
            if *size.get_or_insert(frame.coded_size) != frame.coded_size {
                taken.resized += 1;
                continue;
            }
            let look = Look::of(&frame.rgb);
            taken.reel.push(&look, frame.time_s);
            let score = look.sharpness * slot.weight;
            if best.as_ref().is_some_and(|b| b.slot.bucket != slot.bucket) && !flush(best.take(), &mut taken)
            {
                break;
            }
            if best.as_ref().is_none_or(|b| score > b.score) {
                best = Some(Best { score, slot, frame, look });
            }
        }
        flush(best, &mut taken);
        Ok(taken)
    }

    /// Writes frames until there are no more; after an error it only drains the queue, so that
    /// nobody waits.
    fn write(
        &self,
        receive: &Mutex<Receiver<Decoded>>,
        written: &Mutex<Vec<Frame>>,
        info: &VideoInfo,
        correct_matrix: bool,
    ) -> Result<(), PreprocessError> {
        let mut result = Ok(());
        loop {
            let frame = receive.lock().unwrap_or_else(|e| e.into_inner()).recv();
            let Ok(frame) = frame else { return result };
            if self.failed.load(Ordering::Relaxed) {
                continue;
            }
            match self.write_one(&frame, info, correct_matrix) {
                Ok(frame) => written.lock().unwrap_or_else(|e| e.into_inner()).push(frame),
                Err(e) => {
                    self.failed.store(true, Ordering::Relaxed);
                    result = Err(e);
                }
            }
        }
    }

    fn write_one(
        &self,
        frame: &Decoded,
        info: &VideoInfo,
        correct_matrix: bool,
    ) -> Result<Frame, PreprocessError> {
        let image = pixels::finished(&frame.rgb, info, self.config.max_size, correct_matrix);
        let name = format!("frame_{:06}.png", frame.index);
        let (width, height) = image.dimensions();
        write_png(
            &self.staging.path("images", &name),
            image.as_raw(),
            width,
            height,
            ExtendedColorType::Rgb8,
        )?;
        let path = self.staging.final_path("images", &name);
        Ok(Frame {
            name,
            path,
            width,
            height,
            time_s: Some(frame.time_s),
            source_index: frame.index,
            ..Frame::default()
        })
    }

    fn publish(self, taken: Taken) -> Result<(Vec<Frame>, Option<Film>), PreprocessError> {
        self.progress.check()?;
        let film = taken.reel.write(&self.staging)?;
        match &film {
            Some(_) => self.staging.publish(&["images", FILM], &["masks"])?,
            None => self.staging.publish(&["images"], &["masks", FILM])?,
        }
        Ok((taken.frames, film))
    }
}

impl Taken {
    fn new(candidates: usize) -> Self {
        Self {
            frames: Vec::new(),
            reel: Reel::new(),
            decoded: 0,
            candidates,
            duplicates: 0,
            resized: 0,
            last_time_s: 0.0,
            stopped_early: false,
        }
    }

    fn notes(&self, expected: usize, complaints: Option<(usize, String)>) -> Vec<String> {
        let mut notes = vec![format!(
            "{} frames taken of {}, the sharpest of each stretch of time",
            self.frames.len(),
            self.candidates
        )];
        if self.duplicates > 0 {
            notes.push(format!(
                "{} frames left out because they show the same as the one before",
                self.duplicates
            ));
        }
        if self.resized > 0 {
            notes.push(format!(
                "{} frames left out because the picture size changes inside the video",
                self.resized
            ));
        }
        if !self.stopped_early && self.decoded < expected {
            notes.push(format!(
                "the video is damaged: {} of {expected} frames could be decoded, up to {:.2} s; copy it again from the camera if the end is missing",
                self.decoded, self.last_time_s
            ));
        }
        if let Some((count, last)) = complaints {
            notes.push(format!("the decoder complains {count} times about damage (last: {last}): some pictures may be smeared"));
        }
        notes
    }
}

impl VideoInfo {
    /// What a person should know about how this stream was read.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.turn != probe::Turn::default() {
            let mirror = if self.turn.mirror { "mirrored and " } else { "" };
            notes.push(format!(
                "{mirror}turned by {}° clockwise, as the video's display matrix asks",
                90 * u32::from(self.turn.quarters)
            ));
        }
        if let Some(degrees) = self.odd_rotation {
            notes.push(format!(
                "the display matrix asks for a rotation by {degrees:.1}°, which is no quarter turn: ignored"
            ));
        }
        if (self.pixel_aspect - 1.0).abs() >= 0.005 {
            notes.push(format!(
                "pixels are {:.3} times as wide as high: the frames were stretched to square pixels",
                self.pixel_aspect
            ));
        }
        match self.transfer {
            Transfer::Sdr => {}
            Transfer::Hlg => notes.push("HDR video (HLG): tone-mapped to SDR".to_owned()),
            Transfer::Pq => notes.push("HDR video (PQ): tone-mapped to SDR".to_owned()),
        }
        let mut gaps: Vec<f64> = self.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        if let (Some(&longest), Some(&usual)) = (gaps.last(), gaps.get(gaps.len() / 2))
            && longest > 1.5 * usual
        {
            notes.push(format!(
                "uneven time stamps: frames follow every {:.1} ms, the longest gap is {:.1} ms",
                usual * 1e3,
                longest * 1e3
            ));
        }
        notes
    }
}
