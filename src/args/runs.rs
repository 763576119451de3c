//! What commands take that look at former runs, or make many.

use clap::Args;
use std::path::PathBuf;

/// What `parts` takes.
#[derive(Args, Clone, Debug)]
pub struct PartsArgs {
    /// A former output folder of a video
    pub run: PathBuf,
    /// Folder for the record, the corrected model and the splat (default: parts in the former
    /// output folder)
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Find the parts and train no splat of them
    #[arg(long)]
    pub no_splat: bool,
    /// How often the held-out views are rendered to measure frames per second
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub fps_loops: u32,
    /// How points are followed.
    #[command(flatten)]
    pub klt: sfm::KltConfig,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// What `compare` takes.
#[derive(Args, Clone, Debug)]
pub struct CompareArgs {
    /// Former output folders, or COLMAP models; METHOD:CASE=FOLDER names a run in the tables, or a
    /// folder of another tool's renders (pictures named like the held-out views of a run of the
    /// same case)
    #[arg(required = true)]
    pub runs: Vec<String>,
    /// Also write the tables of quality, training and rendering cost into this folder: Markdown,
    /// CSV, LaTeX, JSON
    #[arg(long, value_name = "FOLDER")]
    pub tables: Option<PathBuf>,
    /// Also write a page that shows the runs beside each other
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Tables that --tables wrote earlier (tables.json), or published figures in that form, to
    /// stand in the tables too
    #[arg(long, value_name = "FILE.json")]
    pub beside: Vec<PathBuf>,
    /// Weights for LPIPS of other tools' renders, as for `eval`
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Vec<PathBuf>,
    /// Ground truth: Middlebury *_par.txt, a folder of *.camera, a COLMAP model, or a
    /// transforms.json
    #[arg(long)]
    pub truth: Option<PathBuf>,
    /// Run Debian's COLMAP on the same frames and show it beside
    #[arg(long)]
    pub colmap: bool,
}

/// What `bench` takes.
#[derive(Args, Clone, Debug)]
pub struct BenchArgs {
    /// What `run` takes: a video, a folder of photos, a posed data set
    pub input: PathBuf,
    /// Output folder (default: the input's name with `_bench`, in the current folder)
    #[arg(short, long, value_name = "OUT")]
    pub output: Option<PathBuf>,
    /// Presets to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["draft", "fast", "balanced", "best"], value_name = "LIST")]
    pub qualities: Vec<splat::Quality>,
    /// Time limits to measure, such as 30s,60s,5m
    #[arg(long, value_delimiter = ',', value_parser = splat::config::parse_duration, value_name = "LIST")]
    pub times: Vec<f64>,
    /// Only the time limits, no presets
    #[arg(long)]
    pub only_times: bool,
    /// Figures of other tools to draw beside, instead of those that come with the program (same
    /// format as data/bench/peers.json)
    #[arg(long, value_name = "FILE")]
    pub peers: Option<PathBuf>,
    /// Flags of `run`, after `--`
    #[arg(last = true, value_name = "FLAGS")]
    pub flags: Vec<String>,
}

/// What `batch` takes.
#[derive(Args, Clone, Debug)]
pub struct BatchArgs {
    /// A list (a video, a folder of photos or a data set a line), or a folder that holds them
    pub source: PathBuf,
    /// Folder for all outputs: a folder a capture, its log beside it, and the summary
    #[arg(short, long, value_name = "OUT", default_value = "batch")]
    pub output: PathBuf,
    /// Captures at a time (default: one for every two cores, fewer where memory is short)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub jobs: Option<u32>,
    /// Only print the captures and their names as JSON
    #[arg(long)]
    pub list: bool,
    /// Flags of `run`, after `--`
    #[arg(last = true, value_name = "FLAGS")]
    pub flags: Vec<String>,
}

/// What `collect` takes.
#[derive(Args, Clone, Debug)]
pub struct CollectArgs {
    /// The output folder of a batch, or any folder that holds output folders
    pub output: PathBuf,
}
