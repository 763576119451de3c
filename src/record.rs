//! What a run remembers of its stages: `run.json`, and what later stages and the report read.

mod evaluation;
mod field;
mod known;
mod schema;
mod verdict;

pub use evaluation::{
    Evaluation, Metrics, Percentile, RenderingCost, ShapeEvaluation, TrainingViews, ViewMetrics,
};
pub use field::FieldSummary;
pub(crate) use known::up_of;
pub use known::{KnownConfig, KnownRun};
pub use schema::run_schema;
pub use verdict::{Level, Light};

use crate::args::PipelineArgs;
use crate::outcome::Outcome;
use crate::stage::Cost;
use scene::motion_report::MotionReport;
use scene::{Decision, FrameSet, Reconstruction, WorldFrame};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What is known of the poses, for the following stages and the report.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PoseSummary {
    /// Images with a pose.
    pub registered: usize,
    /// Images given.
    pub total: usize,
    /// Triangulated points.
    pub points: usize,
    /// Mean reprojection error over observations, pixels.
    pub mean_error_px: f64,
    /// Whether the poses came with the input.
    pub imported: bool,
    /// Where the world lies in which poses, points and splat are written, and what says so.
    pub world: Option<WorldFrame>,
    /// Why there is no model.
    pub no_model: Option<String>,
    /// What was repaired in poses that came with the input.
    pub notes: Vec<String>,
    /// Images without a pose, and why.
    pub missing: Vec<(String, String)>,
    /// Images whose pose is weakly constrained, and why.
    pub weak: Vec<(String, String)>,
    /// Standard deviations from the final adjustment.
    pub deviations: Option<Deviations>,
    /// How the object moves, where it turns or tumbles in a video.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionReport>,
    /// What was decided.
    pub decisions: Vec<Decision>,
    /// Figures by step.
    pub figures: Vec<(String, f64)>,
}

impl PoseSummary {
    /// Why the model is to be doubted, where it is.
    pub(crate) fn doubt(&self) -> Option<&Decision> {
        self.decisions.iter().find(|d| d.is_doubt())
    }

    /// How probably the model is right where it is to be doubted, else 1.
    pub(crate) fn probability(&self) -> f64 {
        match self.doubt().map(|d| &d.choice) {
            // What could not be told is as doubtful as can be.
            Some(scene::decision::Choice::Value(found)) => found.value.max(0.0),
            _ => 1.0,
        }
    }

    /// How the search for poses ended.
    pub(crate) fn outcome(&self) -> Outcome {
        match (&self.no_model, self.doubt()) {
            (Some(_), _) => Outcome::NoModel,
            (None, Some(_)) => Outcome::Doubtful,
            (None, None) if self.missing.is_empty() => Outcome::Done,
            (None, None) => Outcome::Partial,
        }
    }
}

/// Standard deviations of poses and intrinsics (gauge: first camera and the scale fixed).
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct Deviations {
    /// Robust standard deviation of one residual coordinate, pixels.
    pub sigma_px: f64,
    /// By camera number: one a parameter, 0 for those held.
    pub cameras: BTreeMap<u32, Vec<f64>>,
    /// By image.
    pub images: Vec<ImageDeviation>,
}

/// Standard deviations of one image's pose.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct ImageDeviation {
    /// File name.
    pub name: String,
    /// Of the rotation about the camera's x, y and z axes, degrees.
    pub rotation_deg: [f64; 3],
    /// Of the camera centre along the world's axes, scene units.
    pub centre: [f64; 3],
}

impl Deviations {
    pub(crate) fn of(uncertainty: &sfm::Uncertainty, model: &Reconstruction) -> Self {
        let images = uncertainty.images.iter().filter_map(|(id, d)| {
            let name = model.images.get(id)?.name.clone();
            let centre = centre_deviation(d);
            Some(ImageDeviation { name, rotation_deg: d.rotation.map(f64::to_degrees), centre })
        });
        Self {
            sigma_px: uncertainty.sigma_px,
            cameras: uncertainty.cameras.clone(),
            images: images.collect(),
        }
    }
}

/// Standard deviations of a camera centre along the world's axes, scene units.
pub(crate) fn centre_deviation(deviation: &sfm::PoseDeviation) -> [f64; 3] {
    let [x, y, z] = [0, 1, 2].map(|i| deviation.centre.col(i)[i]);
    [x, y, z].map(|variance| variance.max(0.0).sqrt())
}

/// What is known of the splat.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct SplatSummary {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Spherical-harmonic degree.
    pub sh_degree: u32,
    /// Whether it was trained (and is to be rendered) with --antialias.
    pub antialias: bool,
    /// Loss and PSNR against time.
    #[schemars(with = "Vec<CurveSchema>")]
    pub curve: Vec<splat::train::CurvePoint>,
    /// What was decided.
    pub decisions: Vec<Decision>,
}

/// The fields of [`splat::CurvePoint`], for the schema.
#[derive(JsonSchema)]
#[schemars(rename = "CurvePoint")]
#[expect(dead_code, reason = "only its schema is used")]
struct CurveSchema {
    /// Steps done.
    iteration: u32,
    /// Seconds spent.
    seconds: f64,
    /// Loss of the training views.
    loss: f32,
    /// PSNR of the training views at the resolution in use, dB.
    psnr: f32,
    /// Gaussians.
    gaussians: usize,
}

/// All that a run knows, for `run.json` and the report.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunRecord {
    /// Program version.
    pub version: &'static str,
    /// Versions of what it is built on.
    pub libraries: Vec<(String, String)>,
    /// The resolved configuration: options by their names, `-` as `_`, in groups.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub config: PipelineArgs,
    /// Cost of each stage, in order.
    pub costs: Vec<(String, Cost)>,
    /// The frames.
    pub frames: Option<FrameSet>,
    /// The poses.
    pub poses: Option<PoseSummary>,
    /// The splat.
    pub splat: Option<SplatSummary>,
    /// The field, where --method makes one instead of a splat.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<FieldSummary>,
    /// The metrics.
    pub evaluation: Option<Evaluation>,
    /// All decisions of the run in the order of their subjects, defaults that no stage examined
    /// among them.
    pub decisions: Vec<Decision>,
    /// The report's traffic light.
    pub verdict: Vec<Light>,
}

impl RunRecord {
    /// Of a run that has done nothing yet.
    pub(crate) fn begun(config: PipelineArgs, verdict: Vec<Light>) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            libraries: crate::doctor::library_versions(),
            config,
            costs: Vec::new(),
            frames: None,
            poses: None,
            splat: None,
            field: None,
            evaluation: None,
            decisions: Vec::new(),
            verdict,
        }
    }
}
