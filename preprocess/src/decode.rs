//! Frames of a video in order, each with its index and time: OpenCV first, an `ffmpeg` pipe where
//! OpenCV cannot do it (HDR, a stream that is not the first, damage that OpenCV stops at).

use crate::PreprocessError;
use crate::hdr::ToneMap;
use crate::probe::{Transfer, VideoInfo, file_url};
use crate::tool::Running;
use opencv::core::{CV_8UC3, Mat};
use opencv::prelude::*;
use opencv::videoio::{self, VideoCapture};
use scene::Progress;
use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::ChildStdout;
use std::time::Duration;

/// A decoded frame as coded: not turned, pixels not yet square.
pub(crate) struct Decoded {
    /// Index in presentation order.
    pub index: usize,
    /// Presentation time, seconds from the start of the container.
    pub time_s: f64,
    /// 8-bit, blue first.
    pub bgr: Mat,
}

/// A video being decoded from its first frame on.
pub(crate) enum FrameSource {
    /// OpenCV's reader over FFmpeg.
    OpenCv(OpenCvSource),
    /// Raw frames from an `ffmpeg` process.
    Pipe(PipeSource),
}

impl FrameSource {
    /// The next frame; `None` at the end, be it by damage.
    pub(crate) fn next(&mut self) -> Result<Option<Decoded>, PreprocessError> {
        match self {
            Self::OpenCv(source) => source.next(),
            Self::Pipe(source) => source.next(),
        }
    }
}

/// OpenCV's reader. It says the time of a frame, which tells lost frames from shown ones, but not
/// for those drained at the end of the file (0 there): these follow one another.
pub(crate) struct OpenCvSource {
    capture: VideoCapture,
    times_s: Vec<f64>,
    stream_start_s: f64,
    next_index: usize,
}

impl OpenCvSource {
    /// `None` where OpenCV does not open the file.
    pub(crate) fn open(path: &Path, info: &VideoInfo) -> Result<Option<Self>, PreprocessError> {
        let url = file_url(path);
        let Some(name) = url.to_str() else { return Ok(None) };
        crate::quiet::silence();
        let mut capture = VideoCapture::from_file(name, videoio::CAP_FFMPEG)?;
        if !capture.is_opened()? {
            return Ok(None);
        }
        // OpenCV 4.6 turns 90° and 270° the wrong way round: frames are turned by us.
        capture.set(videoio::CAP_PROP_ORIENTATION_AUTO, 0.0)?;
        Ok(Some(Self {
            capture,
            times_s: info.times_s.clone(),
            stream_start_s: info.stream_start_s,
            next_index: 0,
        }))
    }

    fn next(&mut self) -> Result<Option<Decoded>, PreprocessError> {
        let mut bgr = Mat::default();
        if !self.capture.read(&mut bgr)? || bgr.empty() {
            return Ok(None);
        }
        let position_s = self.capture.get(videoio::CAP_PROP_POS_MSEC)? / 1000.0;
        let index =
            if position_s > 0.0 { self.index_at(position_s + self.stream_start_s) } else { self.next_index };
        self.next_index = index + 1;
        let time_s =
            self.times_s.get(index).copied().unwrap_or_else(|| self.times_s.last().copied().unwrap_or(0.0));
        Ok(Some(Decoded { index, time_s, bgr }))
    }

    /// The frame not yet shown whose time is nearest; the next one where none is near.
    fn index_at(&self, time_s: f64) -> usize {
        let after = self.times_s.partition_point(|t| *t < time_s);
        let near = [after.saturating_sub(1), after].into_iter().filter(|i| *i < self.times_s.len());
        let nearest = near
            .map(|i| (i, (self.times_s[i] - time_s).abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|(i, distance_s)| *distance_s < 0.002 && *i >= self.next_index);
        nearest.map_or(self.next_index, |(i, _)| i)
    }
}

/// Frames through a pipe.
pub(crate) struct PipeSource {
    running: Option<Running>,
    stdout: ChildStdout,
    tone_map: Option<ToneMap>,
    size: (u32, u32),
    times_s: Vec<f64>,
    next_index: usize,
    buffer: Vec<u8>,
}

impl PipeSource {
    /// `times_s`: presentation times of the frames as `ffmpeg` puts them out.
    pub(crate) fn open(path: &Path, info: &VideoInfo, times_s: Vec<f64>) -> Result<Self, PreprocessError> {
        let tone_map = (info.transfer != Transfer::Sdr).then(|| ToneMap::new(info.transfer, info.is_bt2020));
        let (format, bytes) = if tone_map.is_some() { ("bgr48le", 6) } else { ("bgr24", 3) };
        let (url, map) = (file_url(path), format!("0:{}", info.stream));
        let size = format!("{}x{}", info.size.0, info.size.1);
        let before = ["-nostdin", "-v", "quiet", "-noautorotate", "-i"].map(OsStr::new);
        let after = [
            "-map",
            &map,
            "-fps_mode",
            "passthrough",
            "-s",
            &size,
            "-f",
            "rawvideo",
            "-pix_fmt",
            format,
            "-",
        ];
        let args = [&before[..], &[url.as_os_str()], &after.map(OsStr::new)[..]].concat();
        let mut running = Running::start("ffmpeg", &args, false)?;
        let reason = "its output cannot be read".to_owned();
        let stdout = running.take_stdout().ok_or(PreprocessError::MissingTool { tool: "ffmpeg", reason })?;
        let buffer = vec![0; info.size.0 as usize * info.size.1 as usize * bytes];
        Ok(Self { running: Some(running), stdout, tone_map, size: info.size, times_s, next_index: 0, buffer })
    }

    fn next(&mut self) -> Result<Option<Decoded>, PreprocessError> {
        if self.stdout.read_exact(&mut self.buffer).is_err() {
            drop(self.running.take());
            return Ok(None);
        }
        let (width, height) = (self.size.0 as i32, self.size.1 as i32);
        let mut bgr = Mat::new_rows_cols_with_default(height, width, CV_8UC3, 0.0.into())?;
        match &self.tone_map {
            Some(map) => map.apply(&self.buffer, bgr.data_bytes_mut()?),
            None => bgr.data_bytes_mut()?.copy_from_slice(&self.buffer),
        }
        let index = self.next_index;
        self.next_index += 1;
        let time_s = self.times_s.get(index).or(self.times_s.last()).copied().unwrap_or(0.0);
        Ok(Some(Decoded { index, time_s, bgr }))
    }
}

/// Listens to a decoder that reports damage, beside the real decoding.
pub(crate) struct DamageCheck {
    running: Running,
}

impl DamageCheck {
    /// Starts `ffmpeg` on the stream; deblocking is left out, as damage shows before it.
    pub(crate) fn start(path: &Path, stream: usize) -> Result<Self, PreprocessError> {
        let (url, map) = (file_url(path), format!("0:{stream}"));
        let before =
            ["-nostdin", "-v", "error", "-threads", "1", "-skip_loop_filter", "all", "-i"].map(OsStr::new);
        let after = ["-map", &map, "-f", "null", "-"].map(OsStr::new);
        let args = [&before[..], &[url.as_os_str()], &after[..]].concat();
        Ok(Self { running: Running::start("ffmpeg", &args, true)? })
    }

    /// The decoder's complaints: how many, and the last.
    pub(crate) fn finish(
        self,
        path: &Path,
        limit: Duration,
        progress: &Progress,
    ) -> Result<Option<(usize, String)>, PreprocessError> {
        let output = self.running.finish(path, limit, progress)?;
        let count = output.stderr.lines().filter(|l| !l.trim().is_empty()).count();
        Ok((count > 0).then(|| (count, output.reason())))
    }
}
