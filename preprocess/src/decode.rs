//! Frames of a video in order, each with its index and time, through a pipe from `ffmpeg`.

use crate::PreprocessError;
use crate::hdr::ToneMap;
use crate::probe::{Transfer, VideoInfo, file_url};
use crate::tool::{ONE_FILE, Running, failed_read, reason};
use image::RgbImage;
use scene::Progress;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{ChildStderr, ChildStdout};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// A frame's time and its packet's differ by less than this, seconds. Source: derived; above the 1
/// ms to which Matroska rounds, and half the distance of frames at 240 a second.
const SAME_TIME_S: f64 = 0.002;

/// Bytes that the pipe holds.
/// Source: pipe(7), the most that Linux lets everybody ask for.
#[cfg(target_os = "linux")]
const PIPE_BYTES: usize = 1 << 20;

/// A decoded frame as coded: not turned, pixels not yet square.
pub(crate) struct Decoded {
    /// Index in presentation order.
    pub index: usize,
    /// Presentation time, seconds from the start of the container.
    pub time_s: f64,
    /// Width and height as coded, pixels: where they change inside a video, `rgb` is scaled to
    /// those of the header.
    pub coded_size: (u32, u32),
    /// Gamma-coded SDR.
    pub rgb: RgbImage,
}

/// A video being decoded from its first frame on by an `ffmpeg` process. Raw frames come through
/// its standard output; standard error tells each frame's time and size (the filter `showinfo`) and
/// damage.
pub(crate) struct Source {
    running: Running,
    stdout: ChildStdout,
    shown: Receiver<Shown>,
    complaints: JoinHandle<Complaints>,
    tone_map: Option<ToneMap>,
    size: (u32, u32),
    bytes: usize,
    times_s: Vec<f64>,
    next_index: usize,
}

/// What `showinfo` says about a frame.
#[derive(Debug, PartialEq)]
struct Shown {
    /// Seconds from the start of the container; `None` where the stream does not say.
    time_s: Option<f64>,
    size: (u32, u32),
}

/// The decoder's complaints: how many, the last, and the system's where it could not read.
#[derive(Default)]
struct Complaints {
    count: usize,
    last: String,
    failed_read: Option<String>,
}

impl Source {
    /// Starts the decoder.
    pub(crate) fn open(path: &Path, info: &VideoInfo) -> Result<Self, PreprocessError> {
        let tone_map = (info.transfer != Transfer::Sdr).then(|| ToneMap::new(info.transfer, info.is_bt2020));
        let (format, bytes) = if tone_map.is_some() { ("rgb48le", 6) } else { ("rgb24", 3) };
        let (url, map, filters) = (file_url(path), format!("0:{}", info.stream), filters(info));
        let before = ["-nostdin", "-hide_banner", "-nostats", "-v", "repeat+level+info", "-noautorotate"];
        let after = ["-map", &map, "-vf", &filters, "-fps_mode", "passthrough"];
        let output = ["-f", "rawvideo", "-pix_fmt", format, "-"];
        let args = [
            &before.map(OsStr::new)[..],
            &ONE_FILE.map(OsStr::new),
            &[OsStr::new("-i"), url.as_os_str()],
            &after.map(OsStr::new),
            &output.map(OsStr::new),
        ];
        let (running, stdout, stderr) = Running::start_piped("ffmpeg", &args.concat())?;
        // Where the system refuses, both sides only wait for each other more often.
        #[cfg(target_os = "linux")]
        let _ = rustix::pipe::fcntl_setpipe_size(&stdout, PIPE_BYTES);
        let (send, shown) = channel();
        Ok(Self {
            running,
            stdout,
            shown,
            complaints: std::thread::spawn(move || listen(stderr, &send)),
            tone_map,
            size: info.size,
            bytes: info.size.0 as usize * info.size.1 as usize * bytes,
            times_s: info.times_s.clone(),
            next_index: 0,
        })
    }

    /// The next frame; `None` at the end, be it by damage.
    pub(crate) fn next(&mut self) -> Result<Option<Decoded>, PreprocessError> {
        let mut buffer = vec![0; self.bytes];
        let (Ok(()), Ok(shown)) = (self.stdout.read_exact(&mut buffer), self.shown.recv()) else {
            return Ok(None);
        };
        let index = shown.time_s.map_or(self.next_index, |time_s| self.index_at(time_s));
        self.next_index = index + 1;
        let known = self.times_s.get(index).copied().or(shown.time_s).or(self.times_s.last().copied());
        let pixels = match &self.tone_map {
            Some(map) => map.apply(&buffer),
            None => buffer,
        };
        let (width, height) = self.size;
        let rgb = RgbImage::from_raw(width, height, pixels).ok_or_else(|| {
            PreprocessError::Config(format!("a frame of {width} x {height} pixels is too large"))
        })?;
        Ok(Some(Decoded { index, time_s: known.unwrap_or(0.0), coded_size: shown.size, rgb }))
    }

    /// The frame not yet shown whose time is nearest, which tells lost frames from shown ones; the
    /// next one where none is near.
    fn index_at(&self, time_s: f64) -> usize {
        let after = self.times_s.partition_point(|t| *t < time_s);
        let near = [after.saturating_sub(1), after].into_iter().filter(|i| *i < self.times_s.len());
        let distance = |i: usize| (self.times_s[i] - time_s).abs();
        let nearest = near.min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        nearest.filter(|i| distance(*i) < SAME_TIME_S && *i >= self.next_index).unwrap_or(self.next_index)
    }

    /// Waits for the decoder's end. Its complaints about damage: how many, and the last; an error
    /// where the file is there and could not be read.
    pub(crate) fn finish(
        self,
        path: &Path,
        limit: Duration,
        progress: &Progress,
    ) -> Result<Option<(usize, String)>, PreprocessError> {
        drop(self.stdout);
        self.running.finish(path, limit, progress)?;
        let complaints = self.complaints.join().unwrap_or_default();
        if let Some(reason) = complaints.failed_read {
            return Err(PreprocessError::Unreadable { path: path.to_owned(), reason });
        }
        Ok((complaints.count > 0).then_some((complaints.count, complaints.last)))
    }
}

/// Times in microseconds, told with the coded size; then RGB by the stream's matrix (Rec. 601 where
/// it names none), as large as the header says.
fn filters(info: &VideoInfo) -> String {
    let (width, height) = info.size;
    let matrix = if info.is_bt709 { "bt601" } else { "auto" };
    format!(
        "settb=1/1000000,showinfo=checksum=0,scale={width}:{height}:flags=bicubic:in_color_matrix={matrix}"
    )
}

/// Reads what `ffmpeg` says to its end, so that it never blocks on a full pipe.
fn listen(stderr: ChildStderr, shown: &Sender<Shown>) -> Complaints {
    let mut complaints = Complaints::default();
    let (mut lines, mut bytes) = (BufReader::new(stderr), Vec::new());
    while lines.read_until(b'\n', &mut bytes).is_ok_and(|n| n > 0) {
        let line = String::from_utf8_lossy(&bytes);
        if line.contains("[error] ") || line.contains("[fatal] ") {
            complaints.count += 1;
            complaints.last = reason(&line);
            complaints.failed_read = complaints.failed_read.or_else(|| failed_read(&line));
        } else if let Some(frame) = shown_frame(&line) {
            // Nobody receives after the last frame of interest.
            let _ = shown.send(frame);
        }
        bytes.clear();
    }
    complaints
}

/// A line like `[Parsed_showinfo_1 @ 0x5] [info] n: 1 pts: 33333 pts_time:0.03 fmt:yuv420p
/// s:720x1280 i:P`.
fn shown_frame(line: &str) -> Option<Shown> {
    let (_, fields) = line.strip_prefix("[Parsed_showinfo")?.split_once("] n:")?;
    let value = |key: &str| fields.split_once(key)?.1.split_whitespace().next();
    let (width, height) = value(" s:")?.split_once('x')?;
    let time_s = value(" pts:")?.parse::<f64>().ok().map(|microseconds| microseconds / 1e6);
    Some(Shown { time_s, size: (width.parse().ok()?, height.parse().ok()?) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_about_frames_are_told_from_others() {
        let line = "[Parsed_showinfo_1 @ 0x5] [info] n:  12 pts: 400000 pts_time:0.4     pos:    29345 \
            fmt:yuv420p sar:0/1 s:720x1280 i:P iskey:1 type:I \n";
        assert_eq!(shown_frame(line), Some(Shown { time_s: Some(0.4), size: (720, 1280) }));
        let unknown = line.replace(" 400000", "NOPTS");
        assert_eq!(shown_frame(&unknown), Some(Shown { time_s: None, size: (720, 1280) }));
        assert_eq!(shown_frame("[Parsed_showinfo_1 @ 0x5] [info] config in time_base: 1/1000000\n"), None);
        assert_eq!(shown_frame("[info]     title           : n: 1 pts: 0 s:1x1\n"), None);
    }
}
