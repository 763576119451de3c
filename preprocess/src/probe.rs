//! What a video container says about itself, from `ffprobe`.

use crate::PreprocessError;
use crate::tool::{self, ONE_FILE, Output};
use scene::Progress;
use serde_json::Value;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::time::Duration;

/// Time `ffprobe` may take. Source: chosen by hand, never measured.
const PROBE_LIMIT: Duration = Duration::from_secs(120);

/// How a stream's light values are to be understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transfer {
    /// Gamma-coded for an ordinary screen.
    Sdr,
    /// Hybrid log-gamma (ARIB STD-B67).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084).
    Pq,
}

/// The eight ways in which an upright image can lie in memory: `(flip x before, quarter turns
/// clockwise)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Turn {
    /// Mirror left and right first.
    pub mirror: bool,
    /// Then turn clockwise by this many quarter turns, 0 to 3.
    pub quarters: u8,
}

/// What is needed to decode a stream rightly.
#[derive(Clone, Debug)]
pub(crate) struct VideoInfo {
    /// Number of the stream in the container.
    pub stream: usize,
    /// Coded width and height, pixels.
    pub size: (u32, u32),
    /// Width of a pixel over its height.
    pub pixel_aspect: f64,
    /// What makes the coded picture upright.
    pub turn: Turn,
    /// A display rotation that is no multiple of 90°, degrees.
    pub odd_rotation: Option<f64>,
    /// Whether it says that each frame is an equirectangular panorama.
    pub is_panorama: bool,
    /// Light values.
    pub transfer: Transfer,
    /// Whether luma and chroma are coded by the Rec. 709 matrix.
    pub is_bt709: bool,
    /// Whether chroma is coded by the Rec. 2020 matrix.
    pub is_bt2020: bool,
    /// Whether any stream of the container is encrypted.
    pub encrypted: bool,
    /// Frames that the header announces and the container does not hold.
    pub missing: usize,
    /// Presentation times of all frames in order, seconds from the start of the container.
    pub times_s: Vec<f64>,
}

/// `file:` and the absolute path: no name can be taken for an option, a protocol or a pattern.
pub(crate) fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(std::path::absolute(path).unwrap_or_else(|_| path.to_owned()));
    url
}

/// Reads header and packet times (nothing is decoded).
pub(crate) fn probe(path: &Path, progress: &Progress) -> Result<VideoInfo, PreprocessError> {
    check_file(path)?;
    let url = file_url(path);
    let args = ["-v", "error", "-print_format", "json", "-show_streams", "-show_format"].map(OsStr::new);
    let args = [&args[..], &ONE_FILE.map(OsStr::new), &[OsStr::new("-i"), url.as_os_str()]].concat();
    let output = tool::run("ffprobe", &args, path, PROBE_LIMIT, progress)?;
    output.need_whole_input(path)?;
    let json: Value = serde_json::from_str(&output.stdout).unwrap_or(Value::Null);
    let streams = json["streams"].as_array().filter(|s| !s.is_empty());
    let Some(streams) = streams.filter(|_| output.success) else {
        return Err(PreprocessError::NotAVideo { path: path.to_owned(), reason: output.reason() });
    };
    let mut info = choose_stream(path, streams)?;
    let origin = number(&json["format"]["start_time"]).unwrap_or(0.0);
    let (times, hidden) = packet_times(path, &info, origin, progress)?;
    info.missing = info.missing.saturating_sub(times.len() + hidden);
    info.times_s = times;
    Ok(info)
}

/// An error where a second look finds more packets: `ffprobe` passes over a read that fails among
/// the packets in silence.
pub(crate) fn need_same(info: &VideoInfo, path: &Path, progress: &Progress) -> Result<(), PreprocessError> {
    let (before, after) = (info.times_s.len(), probe(path, progress)?.times_s.len());
    if after <= before {
        return Ok(());
    }
    let reason = format!("{before} of its {after} frames were found at first");
    Err(PreprocessError::Unreadable { path: path.to_owned(), reason })
}

fn check_file(path: &Path) -> Result<(), PreprocessError> {
    let meta = match std::fs::metadata(path) {
        Ok(meta) => meta,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(PreprocessError::NotFound { path: path.to_owned() });
        }
        Err(e) => return Err(PreprocessError::io(path)(e)),
    };
    if meta.is_dir() {
        return Err(PreprocessError::WrongKind {
            path: path.to_owned(),
            found: "a folder",
            expected: "a video file",
        });
    }
    if !meta.is_file() {
        return Err(PreprocessError::WrongKind {
            path: path.to_owned(),
            found: "a device or pipe",
            expected: "a video file",
        });
    }
    if meta.len() == 0 {
        return Err(PreprocessError::EmptyFile { path: path.to_owned() });
    }
    std::fs::File::open(path).map(drop).map_err(PreprocessError::io(path))
}

fn choose_stream(path: &Path, streams: &[Value]) -> Result<VideoInfo, PreprocessError> {
    let mut videos = streams.iter().filter(|s| s["codec_type"] == "video");
    let Some(stream) = videos.find(|s| s["disposition"]["attached_pic"] != 1) else {
        let mut kinds: Vec<_> = streams.iter().filter_map(|s| s["codec_type"].as_str()).collect();
        kinds.dedup();
        let found =
            if kinds.is_empty() { "no stream".to_owned() } else { format!("only {}", kinds.join(", ")) };
        return Err(PreprocessError::NoVideoStream { path: path.to_owned(), found });
    };
    let side_data = stream["side_data_list"].as_array().map(Vec::as_slice).unwrap_or_default();
    if is_encrypted(stream) || stream["codec_tag_string"] == "encv" {
        return Err(PreprocessError::Encrypted { path: path.to_owned() });
    }
    let dimension = |key: &str| stream[key].as_u64().and_then(|v| u32::try_from(v).ok()).unwrap_or(0);
    let size = (dimension("width"), dimension("height"));
    if size.0 == 0 || size.1 == 0 {
        let reason = "the picture size is unknown".to_owned();
        return Err(PreprocessError::NothingDecodes { path: path.to_owned(), expected: 0, reason });
    }
    let (turn, odd_rotation) = display_turn(side_data);
    let matrix = stream["color_space"].as_str().unwrap_or_default();
    let transfer = match stream["color_transfer"].as_str() {
        Some("arib-std-b67") => Transfer::Hlg,
        Some("smpte2084") => Transfer::Pq,
        _ => Transfer::Sdr,
    };
    Ok(VideoInfo {
        stream: stream["index"].as_u64().unwrap_or(0) as usize,
        size,
        pixel_aspect: pixel_aspect(stream),
        turn,
        odd_rotation,
        is_panorama: is_panorama(side_data),
        transfer,
        is_bt709: matrix == "bt709" || (size.1.min(size.0) >= 720 && matches!(matrix, "" | "unknown")),
        is_bt2020: matrix.starts_with("bt2020"),
        encrypted: streams.iter().any(is_encrypted),
        missing: number(&stream["nb_frames"]).map_or(0, |n| n as usize),
        times_s: Vec::new(),
    })
}

fn is_encrypted(stream: &Value) -> bool {
    let side_data = stream["side_data_list"].as_array().map(Vec::as_slice).unwrap_or_default();
    side_data.iter().any(|d| d["side_data_type"].as_str().is_some_and(|t| t.starts_with("Encryption")))
}

/// Google's spherical video, version 1 or 2, as `ffprobe` tells it.
fn is_panorama(side_data: &[Value]) -> bool {
    let spherical = side_data.iter().find(|d| d["side_data_type"] == "Spherical Mapping");
    spherical.is_some_and(|d| d["projection"] == "equirectangular")
}

fn number(value: &Value) -> Option<f64> {
    value.as_str()?.parse().ok().filter(|v: &f64| v.is_finite())
}

fn pixel_aspect(stream: &Value) -> f64 {
    let ratio = stream["sample_aspect_ratio"].as_str().and_then(|s| {
        let (w, h) = s.split_once(':')?;
        Some(w.parse::<f64>().ok()? / h.parse::<f64>().ok()?)
    });
    // Beyond 8 : 1 it is a wrong header, not a lens.
    ratio.filter(|r| r.is_finite() && *r > 0.125 && *r < 8.0).unwrap_or(1.0)
}

/// The quarter turn that the display matrix asks for. The matrix holds rows `[a b u]`, `[c d v]`
/// and takes picture to screen by `(x', y') = (a x + c y, b x + d y)` (ISO/IEC 14496-12, 8.3.2.3).
fn display_turn(side_data: &[Value]) -> (Turn, Option<f64>) {
    let Some(data) = side_data.iter().find(|d| d["side_data_type"] == "Display Matrix") else {
        return (Turn::default(), None);
    };
    let rows: Vec<f64> = data["displaymatrix"]
        .as_str()
        .unwrap_or_default()
        .lines()
        .filter_map(|line| line.split_once(':'))
        .flat_map(|(_, numbers)| {
            numbers.split_whitespace().filter_map(|n| n.parse().ok()).collect::<Vec<f64>>()
        })
        .collect();
    if rows.len() < 5 {
        return (Turn::default(), None);
    }
    let scale = rows[0].hypot(rows[1]);
    if scale <= 0.0 {
        return (Turn::default(), None);
    }
    let [a, b, c, d] = [rows[0], rows[1], rows[3], rows[4]].map(|v| (v / scale).round() as i32);
    let degrees = rows[1].atan2(rows[0]).to_degrees();
    let off_grid = (degrees / 90.0 - (degrees / 90.0).round()).abs() > 0.01;
    let mirror = a * d - b * c < 0;
    // A mirrored picture is flipped in x first: that negates the first row.
    let (a, b) = if mirror { (-a, -b) } else { (a, b) };
    let quarters = match (a, b) {
        _ if off_grid => 0,
        (0, 1) => 1,
        (-1, 0) => 2,
        (0, -1) => 3,
        _ => 0,
    };
    (Turn { mirror: mirror && !off_grid, quarters }, off_grid.then_some(degrees))
}

fn packet_times(
    path: &Path,
    info: &VideoInfo,
    origin: f64,
    progress: &Progress,
) -> Result<(Vec<f64>, usize), PreprocessError> {
    let (url, stream) = (file_url(path), info.stream.to_string());
    let args = [
        "-v",
        "error",
        "-select_streams",
        &stream,
        "-show_entries",
        "packet=pts_time,dts_time,duration_time,flags",
        "-of",
        "compact=p=0",
    ];
    let args = args.map(OsStr::new);
    let args = [&args[..], &ONE_FILE.map(OsStr::new), &[OsStr::new("-i"), url.as_os_str()]].concat();
    let output = tool::run("ffprobe", &args, path, PROBE_LIMIT, progress)?;
    output.need_whole_input(path)?;
    Ok(parse_packets(&output, origin))
}

/// Packets marked `D` lie outside the edit list and are never shown. Where a time stamp is missing,
/// the decoding time serves, else the last time and duration. Returns the times in order and how
/// many are never shown.
fn parse_packets(output: &Output, origin: f64) -> (Vec<f64>, usize) {
    let (mut times, mut hidden, mut next) = (Vec::new(), 0, 0.0);
    for line in output.stdout.lines() {
        let field = |key: &str| line.split('|').find_map(|f| f.strip_prefix(key)?.strip_prefix('='));
        let seconds = |key: &str| field(key).and_then(|v| v.parse::<f64>().ok());
        if field("flags").is_none_or(|f| f.contains('D')) {
            hidden += 1;
            continue;
        }
        let time = seconds("pts_time").or_else(|| seconds("dts_time")).map_or(next, |t| t - origin);
        next = time + seconds("duration_time").filter(|d| *d > 0.0).unwrap_or(1.0 / 30.0);
        times.push(time);
    }
    times.sort_by(f64::total_cmp);
    (times, hidden)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turn_of(matrix: [i32; 4]) -> Turn {
        let text = format!(
            "\n00000000: {} {} 0\n00000001: {} {} 0\n00000002: 0 0 1073741824\n",
            matrix[0], matrix[1], matrix[2], matrix[3]
        );
        display_turn(&[serde_json::json!({"side_data_type": "Display Matrix", "displaymatrix": text})]).0
    }

    #[test]
    fn display_matrices_of_phones_become_quarter_turns() {
        let one = 65536;
        assert_eq!(turn_of([one, 0, 0, one]), Turn { mirror: false, quarters: 0 });
        assert_eq!(turn_of([0, one, -one, 0]), Turn { mirror: false, quarters: 1 });
        assert_eq!(turn_of([-one, 0, 0, -one]), Turn { mirror: false, quarters: 2 });
        assert_eq!(turn_of([0, -one, one, 0]), Turn { mirror: false, quarters: 3 });
        assert_eq!(turn_of([-one, 0, 0, one]), Turn { mirror: true, quarters: 0 });
    }

    #[test]
    fn packets_outside_the_edit_list_are_not_counted() {
        let stdout = "pts_time=0.2|flags=K_\npts_time=0.1|flags=KD\npts_time=0.0|flags=__\npts_time=N/A|dts_time=0.3|flags=__\n";
        let output = Output { success: true, stdout: stdout.to_owned(), stderr: String::new() };
        assert_eq!(parse_packets(&output, 0.0), (vec![0.0, 0.2, 0.3], 1));
    }
}
