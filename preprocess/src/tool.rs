//! Helper programs (`ffprobe`, `ffmpeg`): run to the end, never longer than allowed, stopped on
//! cancel.

use crate::PreprocessError;
use scene::Progress;
use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The most text kept from each stream of a helper program, bytes. Source: chosen by hand: the
/// packets of a video of days.
const OUTPUT_LIMIT: u64 = 256 << 20;

/// Before every input: it is one file and holds the pictures itself. A playlist, whatever it is
/// called, would have other files and addresses opened.
pub(crate) const ONE_FILE: [&str; 4] = [
    "-protocol_whitelist",
    "file",
    "-format_whitelist",
    "mov,matroska,avi,mpegts,mpegtsraw,mpeg,mpegvideo,vob,asf,flv,ogg,mxf,nut,gxf,dv,wtv,rm,swf,nsv,ivf,obu,av1,\
     h261,h263,h264,hevc,vc1,m4v,mjpeg,dirac,y4m,yuv4mpegpipe,gif,apng",
];

/// What a finished program said.
pub(crate) struct Output {
    /// Exit status 0.
    pub success: bool,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Output {
    /// An error where the system could not read the input.
    pub(crate) fn need_whole_input(&self, path: &Path) -> Result<(), PreprocessError> {
        match self.stderr.lines().find_map(failed_read) {
            Some(reason) => Err(PreprocessError::Unreadable { path: path.to_owned(), reason }),
            None => Ok(()),
        }
    }

    /// Last line of standard error without the demuxer's address prefix.
    pub(crate) fn reason(&self) -> String {
        reason(self.stderr.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("no message"))
    }
}

/// A line of `ffmpeg`'s or `ffprobe`'s without the address prefix, level and context.
pub(crate) fn reason(line: &str) -> String {
    let line = line.rsplit_once("] ").map_or(line, |(_, rest)| rest);
    line.rsplit_once(": ").map_or(line, |(_, rest)| rest).trim().to_owned()
}

/// The system's words in a line of `ffmpeg`'s or `ffprobe`'s about a file that is there and could
/// not be read. The demuxers have other words for files that are damaged or cut off, and both
/// programs go on with what they have and end with exit status 0.
pub(crate) fn failed_read(line: &str) -> Option<String> {
    let words = ["Input/output error", "I/O error", "Stale file handle", "timed out"];
    words.iter().any(|w| line.trim_end().ends_with(w)).then(|| reason(line))
}

/// A running helper program whose output is being collected; killed when dropped.
pub(crate) struct Running {
    tool: &'static str,
    child: Child,
    stdout: Option<JoinHandle<String>>,
    stderr: Option<JoinHandle<String>>,
    started: Instant,
}

impl Running {
    /// Starts `tool`.
    pub(crate) fn start(tool: &'static str, args: &[&OsStr]) -> Result<Self, PreprocessError> {
        let (mut running, stdout, stderr) = Self::start_piped(tool, args)?;
        running.stdout = Some(collect(stdout));
        running.stderr = Some(collect(stderr));
        Ok(running)
    }

    /// Starts `tool`, whose standard output and standard error the caller reads.
    pub(crate) fn start_piped(
        tool: &'static str,
        args: &[&OsStr],
    ) -> Result<(Self, ChildStdout, ChildStderr), PreprocessError> {
        let missing = |reason: String| PreprocessError::MissingTool { tool, reason };
        let mut command = Command::new(tool);
        command.args(args).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|e| missing(e.to_string()))?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let running = Self { tool, child, stdout: None, stderr: None, started: Instant::now() };
        match (stdout, stderr) {
            (Some(stdout), Some(stderr)) => Ok((running, stdout, stderr)),
            _ => Err(missing("its output cannot be read".to_owned())),
        }
    }

    /// Waits for the end, at most `limit` from the start.
    pub(crate) fn finish(
        mut self,
        input: &Path,
        limit: Duration,
        progress: &Progress,
    ) -> Result<Output, PreprocessError> {
        let mut pause = Duration::from_millis(1);
        let status = loop {
            progress.check()?;
            if let Some(status) = self.child.try_wait().map_err(PreprocessError::io(input))? {
                break status;
            }
            if self.started.elapsed() > limit {
                let seconds = limit.as_secs();
                return Err(PreprocessError::Timeout { tool: self.tool, path: input.to_owned(), seconds });
            }
            std::thread::sleep(pause);
            pause = (pause * 2).min(Duration::from_millis(20));
        };
        let text =
            |handle: Option<JoinHandle<String>>| handle.and_then(|h| h.join().ok()).unwrap_or_default();
        let (stdout, stderr) = (text(self.stdout.take()), text(self.stderr.take()));
        Ok(Output { success: status.success(), stdout, stderr })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Errors mean that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads a pipe to its end on a thread of its own, so that the program never blocks on a full pipe.
fn collect(mut pipe: impl Read + Send + 'static) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        let read = (&mut pipe).take(OUTPUT_LIMIT).read_to_end(&mut bytes);
        if read.is_ok() {
            // Beyond the limit: drain, or the program would wait for ever.
            let _ = std::io::copy(&mut pipe, &mut std::io::sink());
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Runs a program to its end.
pub(crate) fn run(
    tool: &'static str,
    args: &[&OsStr],
    input: &Path,
    limit: Duration,
    progress: &Progress,
) -> Result<Output, PreprocessError> {
    Running::start(tool, args)?.finish(input, limit, progress)
}

/// First line of `tool -version`, shortened to the version.
fn version_of(tool: &'static str) -> Result<String, String> {
    let args = [OsStr::new("-version")];
    let output = run(tool, &args, Path::new(tool), Duration::from_secs(10), &Progress::silent());
    let output = output.map_err(|e| e.to_string())?;
    let line = output.stdout.lines().next().unwrap_or_default();
    line.split_whitespace().nth(2).map(str::to_owned).ok_or_else(|| format!("unexpected answer: {line}"))
}

/// Versions of what this stage calls: ffprobe, ffmpeg; an error says what is missing.
pub fn versions() -> Vec<(String, Result<String, String>)> {
    ["ffprobe", "ffmpeg"].map(|tool| (tool.to_owned(), version_of(tool))).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_that_failed_is_told_from_a_damaged_file() {
        for line in [
            "[error] file:/a/video.mp4: Input/output error\n",
            "[in#0/mov,mp4 @ 0x5] [error] Error during demuxing: Input/output error",
            "file:/net/video.mp4: Stale file handle",
        ] {
            assert!(failed_read(line).is_some_and(|reason| !reason.contains(':')), "{line}");
        }
        for line in [
            "[mov,mp4 @ 0x5] [error] stream 0, offset 0x88379: partial file",
            "[h264 @ 0x5] [error] Invalid NAL unit size (17513 > 16624).",
            "[error] Error while decoding stream #0:0: Invalid data found when processing input",
        ] {
            assert_eq!(failed_read(line), None, "{line}");
        }
    }
}
