//! The command line: what can be said to sat-recon.

mod runs;

use clap::{Args, Parser, Subcommand, ValueEnum};
use scene::flag::between;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

pub use runs::{BatchArgs, BenchArgs, CollectArgs, CompareArgs, PartsArgs};

/// What to type first, below the list of commands.
const FIRST_STEPS: &str = "First steps:
  sat-recon video.mp4           everything, into the folder video_recon; short for `run`
  sat-recon photos/ --view      the same from photos, watched in a browser
  sat-recon view video_recon    the splat in a browser";

/// Camera poses, a sparse cloud and a 3D Gaussian splat from a video or photos of an object.
#[derive(Parser, Debug)]
#[command(version, propagate_version = true, args_override_self = true, infer_subcommands = false)]
#[command(override_usage = "sat-recon [OPTIONS] <INPUT>\n       sat-recon [OPTIONS] <COMMAND>")]
#[command(after_help = FIRST_STEPS)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Flags of every command.
    #[command(flatten)]
    pub global: Global,
}

/// Flags that every command understands.
#[derive(Args, Clone, Debug)]
pub struct Global {
    /// A TOML file of flags, placed before the typed ones (`iterations = 2000` is `--iterations
    /// 2000`)
    #[arg(long, global = true, value_name = "FILE", help_heading = "General")]
    pub config: Option<PathBuf>,
    /// Worker threads (default: one a core); results do not depend on it
    #[arg(long, global = true, value_parser = between::<usize>(1, 1024), value_name = "N", help_heading = "General")]
    pub threads: Option<usize>,
    /// Most memory of the program and of each that it starts, MiB; a training that will need more
    /// is refused before the poses are sought
    #[arg(long, global = true, value_parser = between::<u64>(64, 1 << 30), value_name = "MIB", help_heading = "General")]
    pub memory_limit: Option<u64>,
    /// Print the result as JSON on standard output
    #[arg(long, global = true, help_heading = "General")]
    pub json: bool,
    /// How standard error tells what goes on: for people, or an object of JSON a line for programs
    #[arg(long, global = true, value_enum, default_value_t = Telling::Text, value_name = "FORM", help_heading = "General")]
    pub progress: Telling,
    /// Print errors only
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = "General")]
    pub quiet: bool,
    /// Print the evidence behind each decision, too
    #[arg(short, long, global = true, help_heading = "General")]
    pub verbose: bool,
    /// Print the help of a command with all its flags
    #[arg(long, global = true, help_heading = "General")]
    pub help_all: bool,
}

/// How progress, messages and errors are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Telling {
    /// Bars on a terminal, lines elsewhere
    Text,
    /// Lines such as {"event": "progress", "stage": 2, "stages": 6, "what": "features", "done": 3,
    /// "total": 100, "detail": ""} and {"event": "message", "text": "…"}
    Json,
}

/// The commands. Those from `frames` to `report` are one pipeline stopped early.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// From a video, a folder of photos or a posed data set to a splat and a report
    Run(Box<PipelineArgs>),
    /// Only select and write the frames (and masks)
    Frames(Box<PipelineArgs>),
    /// Up to camera poses and the sparse cloud
    Sfm(Box<PipelineArgs>),
    /// Up to the trained splat
    Train(Box<PipelineArgs>),
    /// Up to the metrics of the held-out views
    Eval(Box<PipelineArgs>),
    /// All stages, then write report.html again
    Report(Box<PipelineArgs>),
    /// Render a trained splat along the input cameras, an orbit or a spiral
    Render(RenderArgs),
    /// Write a result in another format
    Export(ExportArgs),
    /// Measure the surface: dimensions, planes, discs, cylinders, angles
    Measure(MeasureArgs),
    /// Look for parts that turn on joints while the object is filmed: axes, angles by frame
    Parts(PartsArgs),
    /// Compare poses with those of COLMAP or a ground truth
    Compare(CompareArgs),
    /// Quality against time: trains at several presets and time limits, draws the curve
    Bench(BenchArgs),
    /// Run many captures, as many at a time as cores and memory allow
    Batch(BatchArgs),
    /// Write the summary of a folder of runs
    Collect(CollectArgs),
    /// Finish or remove what an interrupted run has left in its folder; results stay
    Clean {
        /// An output folder
        run: PathBuf,
    },
    /// View a trained splat in a browser, served to this machine only
    View(ViewArgs),
    /// Show installed libraries, graphics adapters, and what will be slow
    Doctor,
    /// Print the completions of a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Write the manual pages
    Man(ManArgs),
}

/// What the pipeline's commands take.
#[derive(Args, Clone, Debug, Serialize)]
pub struct PipelineArgs {
    /// A video, a folder of photos, a COLMAP data set, poses of another program beside their images
    /// (transforms.json, Metashape's .xml, RealityScan's .csv, bundle.out, OpenSfM's
    /// reconstruction.json), or a former output folder (its input and flags are used again)
    pub input: PathBuf,
    /// Output folder (default: the input's name with `_recon`, in the current folder)
    #[arg(short, long, value_name = "OUT", help_heading = "General")]
    pub output: Option<PathBuf>,
    /// Preset: places flags before the configuration file's and the typed ones
    #[arg(long, value_enum, default_value_t = splat::Quality::Balanced, help_heading = "General")]
    pub quality: splat::Quality,
    /// Look while it works: opens a page in the browser, served to this machine only, that shows
    /// the frames, the poses as they are found and the splat while it is trained
    #[arg(long, help_heading = "General")]
    #[serde(skip)]
    pub view: bool,
    /// How the scene is represented and learnt: a splat, or a field to compare it with
    #[arg(long, value_enum, default_value_t = baselines::Method::Gaussians, help_heading = "Splat")]
    pub method: baselines::Method,
    /// Never more Gaussians than take so many megabytes as .sog
    #[arg(long, value_name = "MB", value_parser = between::<f32>(0.01, 1e6), help_heading = "Splat")]
    pub max_size_mb: Option<f32>,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0, help_heading = "General")]
    pub seed: u64,
    /// Estimate the poses even if the input provides them
    #[arg(long, help_heading = "General")]
    pub ignore_poses: bool,
    /// Also write the models as text
    #[arg(long, help_heading = "General")]
    pub text: bool,
    /// Leave the model in the solver's arbitrary frame instead of turning it upright (y down), with
    /// the object in the origin and its radius as unit
    #[arg(long, conflicts_with_all = ["known_length", "tag_size"], help_heading = "General")]
    pub keep_frame: bool,
    /// Take features, matches and camera groups from this database.db of COLMAP's (images are known
    /// by their names); given several times, the matches of all are taken together
    #[arg(long, value_name = "FILE", help_heading = "Structure from motion")]
    pub database: Vec<PathBuf>,
    /// Only match the I-th of N parts of the pairs and write OUT/database.db: many jobs share a
    /// large set of photos, and a last run takes all their files with --database
    #[arg(long, value_name = "I/N", conflicts_with = "database", help_heading = "Structure from motion")]
    pub pairs: Option<sfm::PairBlock>,
    /// Take only the features from --database and match them again
    #[arg(long, requires = "database", help_heading = "Structure from motion")]
    pub rematch: bool,
    /// Write OUT/database.db too: features, matches and verified pairs, on which COLMAP's mappers
    /// run
    #[arg(long, help_heading = "Structure from motion")]
    pub colmap_database: bool,
    /// Take the camera of an earlier run (its folder: within its standard deviations) or of a
    /// COLMAP model (as it is)
    #[arg(
        long,
        value_name = "FOLDER",
        conflicts_with = "intrinsics",
        help_heading = "Structure from motion"
    )]
    pub camera_from: Option<PathBuf>,
    /// Choice of frames.
    #[command(flatten)]
    pub frames: preprocess::FrameConfig,
    /// Cutting the object out of a screen.
    #[command(flatten)]
    pub key: preprocess::KeyConfig,
    /// Structure from motion.
    #[command(flatten)]
    pub sfm: sfm::SfmConfig,
    /// What the splat is trained on.
    #[command(flatten)]
    pub dataset: splat::DatasetConfig,
    /// Training.
    #[command(flatten)]
    pub train: splat::TrainConfig,
    /// Evaluation.
    #[command(flatten)]
    pub eval: EvalConfig,
}

/// Bytes of a `.sog` beside its Gaussians and of each, harmonics of degree 3. Source: measured; 23
/// to 28.5 a Gaussian with all of four splats of 14,000 to 26,000, 11 without harmonics.
const PACKED_BYTES: [f32; 2] = [10_000.0, 30.0];

impl PipelineArgs {
    /// Makes of the size of the splat's file a number of Gaussians.
    pub(crate) fn keep_to_size(&mut self) {
        let by_size = self
            .max_size_mb
            .map_or(usize::MAX, |mb| ((mb * 1e6 - PACKED_BYTES[0]) / PACKED_BYTES[1]) as usize);
        self.train.max_gaussians = self.train.max_gaussians.min(by_size.max(1));
    }
}

/// How the held-out views are judged.
#[derive(Args, Clone, Debug, Serialize, Deserialize)]
pub struct EvalConfig {
    /// Weights for LPIPS, a .safetensors file of AlexNet's or VGG-16's made by
    /// tools/lpips_weights.py; may be given for each
    #[arg(long, value_name = "FILE", help_heading = "Evaluation")]
    pub lpips_weights: Vec<PathBuf>,
    /// How often the held-out views are rendered to measure frames per second
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Evaluation")]
    pub fps_loops: u32,
    /// The true shape.
    #[command(flatten)]
    #[serde(default)]
    pub mesh: MeshConfig,
}

/// The true shape.
#[derive(Args, Clone, Debug, Default, Serialize, Deserialize)]
pub struct MeshConfig {
    /// True shape of the object (.ply, .obj, .glb): accuracy, completeness, F-score and Chamfer
    /// distance of the cloud and the splat
    #[arg(long, value_name = "FILE", help_heading = "Evaluation")]
    pub mesh: Option<PathBuf>,
    /// True cameras in the frame of --mesh (as for compare --truth); the model is moved onto their
    /// centres (default: it is in that frame)
    #[arg(long, value_name = "TRUTH", requires = "mesh", help_heading = "Evaluation")]
    pub mesh_truth: Option<PathBuf>,
    /// Depths from which the fused mesh is made
    #[arg(long, value_enum, default_value_t, requires = "mesh", help_heading = "Evaluation")]
    #[serde(default)]
    pub mesh_depths: MeshDepths,
}

/// The depths from which a mesh is fused.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeshDepths {
    /// By multi-view stereo between the photos
    Stereo,
    /// Those at which the splat is half opaque
    Splat,
    /// By stereo; the splat's where the photos do not agree, or stereo looks through it
    #[default]
    Both,
}

/// The path of a rendered camera.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum RenderPath {
    /// The input cameras
    Input,
    /// The held-out input cameras
    Test,
    /// A circle at the mean height and distance of the input cameras
    Orbit,
    /// A circle that rises and falls
    Spiral,
}

/// What a rendered picture shows.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Colour
    Color,
    /// Expected depth, near bright
    Depth,
    /// Coverage
    Alpha,
    /// Surface direction from depth, as colour
    Normals,
}

/// What `render` takes.
#[derive(Args, Clone, Debug)]
pub struct RenderArgs {
    /// A former output folder
    pub run: PathBuf,
    /// A folder for PNG files, or a file ending in .mp4
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Where the camera goes
    #[arg(long, value_enum, default_value_t = RenderPath::Orbit)]
    pub path: RenderPath,
    /// What to show
    #[arg(long, value_enum, default_value_t = Channel::Color)]
    pub channel: Channel,
    /// Pictures along an orbit or spiral
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub count: u32,
    /// Frames a second of an mp4
    #[arg(long, default_value_t = 30.0, value_parser = between::<f64>(0.01, 1e4))]
    pub fps: f64,
    /// Background colour, red green blue in [0, 1]
    #[arg(long, num_args = 3, default_values_t = [0.0, 0.0, 0.0], value_parser = between::<f32>(0.0, 1.0))]
    pub background: Vec<f32>,
    /// Show a scene that moves as it was at this time, 0 (the first photo) to 1 (the last), in all
    /// pictures [default: as each photo was; along a path time goes by]
    #[arg(long, value_name = "TIME", value_parser = between::<f32>(0.0, 1.0))]
    pub time: Option<f32>,
    /// Hold a joint of a folder of `parts` at an angle; may be given for each, by its number or as
    /// `part1`
    #[arg(long, value_name = "NAME=DEG", value_parser = parse_joint)]
    pub joint: Vec<(usize, f64)>,
    /// Show a splat as if the lamp stood elsewhere: degrees to the camera's right and upwards; 0,0
    /// is a lamp on the camera. The object must have been filmed on a turntable, or with a lamp
    /// that moves with the camera
    #[arg(long, value_name = "AZ,EL", value_parser = parse_light, allow_hyphen_values = true)]
    pub light: Option<[f64; 2]>,
    /// Where to render.
    #[command(flatten)]
    pub device: splat::DeviceConfig,
}

/// `part1=30` or `1=30`: the number of a part, from 1 on, and an angle in degrees.
fn parse_joint(text: &str) -> Result<(usize, f64), String> {
    let parsed = text.split_once('=').and_then(|(name, angle)| {
        let number: usize = name.trim_start_matches("part").parse().ok()?;
        Some((number, angle.parse::<f64>().ok()?))
    });
    parsed
        .filter(|(number, angle)| *number > 0 && angle.is_finite())
        .ok_or_else(|| "expected the part and an angle in degrees, such as part1=30".to_owned())
}

/// `30,10`: azimuth and elevation, degrees.
fn parse_light(text: &str) -> Result<[f64; 2], String> {
    let angles = text
        .split_once(',')
        .and_then(|(az, el)| Some([az.trim().parse::<f64>().ok()?, el.trim().parse::<f64>().ok()?]));
    angles
        .filter(|[az, el]| az.abs() <= 360.0 && el.abs() <= 90.0)
        .ok_or_else(|| "expected azimuth and elevation in degrees, such as 30,10".to_owned())
}

/// The tools for which there are sets.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tool {
    /// COLMAP: images, masks by its names, sparse/0, database.db of a run with --colmap-database
    Colmap,
    /// The original 3D Gaussian splatting: PINHOLE images, mattes over black, sparse/0 with
    /// test.txt
    #[value(name = "3dgs")]
    Gs3d,
    /// gsplat's simple_trainer: the same without the list of held-out views, which it chooses alike
    Gsplat,
    /// brush: PINHOLE images with mattes as alpha, sparse/0
    Brush,
    /// nerfstudio: PINHOLE images with mattes as alpha, transforms.json with the split and times
    Nerfstudio,
    /// Metashape: images, masks, cameras.xml
    Metashape,
}

/// What `export` takes.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// A former output folder, or a splat file
    pub input: PathBuf,
    /// The file or folder to write; its ending says the format: .html (a page to open in a
    /// browser), .ply (3DGS order), .compressed.ply, .splat, .spz, .sog, .glb (these also read, and
    /// .ksplat), .json (transforms), .db (COLMAP's database, of a run with --colmap-database), or a
    /// folder (COLMAP model, --text for text)
    #[arg(short, long, value_name = "OUT", required_unless_present_any = ["html", "mesh", "dense", "tool"])]
    pub output: Option<PathBuf>,
    /// A folder that another program loads as it is, with mattes, held-out views and times as it
    /// wants them (default output: RUN_TOOL)
    #[arg(long = "for", value_enum, value_name = "TOOL", conflicts_with_all = ["html", "mesh", "dense", "text"])]
    pub tool: Option<Tool>,
    /// One self-contained page that opens from disk (default output: RUN/view.html)
    #[arg(long)]
    pub html: bool,
    /// A dense cloud by multi-view stereo between the photos, with normals and colours; .ply
    /// (default output: RUN/dense.ply)
    #[arg(long, conflicts_with_all = ["html", "mesh"])]
    pub dense: bool,
    /// A triangle mesh: the surface as the input cameras see it, fused; .glb or .obj with a texture
    /// from the photos, or .ply with colours at its vertices (default output: RUN/mesh.ply)
    #[arg(long, conflicts_with = "html")]
    pub mesh: bool,
    /// Depths from which --mesh is made
    #[arg(long, value_enum, default_value_t, requires = "mesh")]
    pub mesh_depths: MeshDepths,
    /// Most voxels along the longest side of the object from which --mesh is made (fewer where they
    /// would be smaller than 1.5 pixels)
    #[arg(long, default_value_t = splat::fusion::DEFAULT_RESOLUTION, requires = "mesh", value_name = "N",
          value_parser = clap::value_parser!(u32).range(16..=2048))]
    pub mesh_resolution: u32,
    /// How --mesh is made.
    #[command(flatten)]
    pub surface: SurfaceConfig,
    /// What of a splat is kept.
    #[command(flatten)]
    pub cut: crate::cut::CutConfig,
    /// Write a COLMAP model as text
    #[arg(long)]
    pub text: bool,
}

/// What is done to a mesh before it is written.
#[derive(Args, Clone, Debug)]
pub struct SurfaceConfig {
    /// Error up to which triangles of --mesh are joined, % of its longest side (0: none are)
    #[arg(long, default_value_t = 0.1, requires = "mesh", value_name = "PERCENT", value_parser = between::<f64>(0.0, 10.0))]
    pub mesh_error: f64,
    /// Most pixels along a side of the texture of a .glb or .obj (0: colours at the vertices)
    #[arg(long, default_value_t = 4096, requires = "mesh", value_name = "N", value_parser = clap::value_parser!(u32).range(0..=16_384))]
    pub mesh_texture: u32,
    /// Close all holes of --mesh, also those where no camera looked, as for printing
    #[arg(long, requires = "mesh")]
    pub watertight: bool,
}

/// What `measure` takes.
#[derive(Args, Clone, Debug)]
pub struct MeasureArgs {
    /// A former output folder (its report gets the measures), or a mesh (.ply, .obj, .glb)
    pub input: PathBuf,
    /// Folder for measure.json and measure.svg (default: the former output folder, or that of the
    /// mesh)
    #[arg(short, long, value_name = "FOLDER")]
    pub output: Option<PathBuf>,
    /// How near a surface is to a shape that it belongs to, % of its longest side
    #[arg(long, default_value_t = 0.5, value_name = "PERCENT", value_parser = between::<f64>(1e-3, 10.0))]
    pub tolerance: f64,
    /// Least share of the surface that makes a shape, %
    #[arg(long, default_value_t = 1.0, value_name = "PERCENT", value_parser = between::<f64>(0.01, 100.0))]
    pub least_share: f64,
    /// Depths from which the surface of a run is made, as for export --mesh
    #[arg(long, value_enum, default_value_t)]
    pub mesh_depths: MeshDepths,
    /// Most voxels along the longest side of a run's object, as for export --mesh
    #[arg(long, default_value_t = splat::fusion::DEFAULT_RESOLUTION, value_name = "N",
          value_parser = clap::value_parser!(u32).range(16..=2048))]
    pub mesh_resolution: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// What `man` takes.
#[derive(Args, Clone, Debug)]
pub struct ManArgs {
    /// Folder for the pages
    #[arg(short, long, value_name = "FOLDER", default_value = "man")]
    pub output: PathBuf,
}

/// What `view` takes.
#[derive(Args, Clone, Debug)]
pub struct ViewArgs {
    /// A former output folder
    pub run: PathBuf,
    /// Port on 127.0.0.1 (0: any that is free)
    #[arg(long, default_value_t = 0)]
    pub port: u16,
}
