//! The pipeline: frames, poses, undistortion, splat, evaluation, report, each resumable.

mod all_frames;
mod field;
pub(crate) mod folder;
mod look;
mod model;
mod pairs;
mod split;
mod until;
mod world;

pub use until::Until;

use crate::args::PipelineArgs;
use crate::config::Recorded;
use crate::database;
use crate::evaluate;
use crate::input::{self, Imported, Input};
use crate::memory;
use crate::outcome::Outcome;
use crate::record::{Deviations, Evaluation, Level, PoseSummary, RunRecord, SplatSummary};
use crate::report;
use crate::stage::{Done, Finished, StageSpec, Stages, describe_input, fingerprint, write_json};
use crate::terminal::{Verbosity, print, say};
use crate::times::Times;
use crate::transforms;
use crate::view::{Serving, Watch};
use anyhow::{Context, Result};
use baselines::Method;
use folder::{absolute_in, output_folder, relative_to};
use scene::decision::Rule;
use scene::{FrameSet, Progress, Reconstruction};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What each stage writes into the output folder and no other does. The record and the report tell
/// of all stages: whichever runs anew takes them away.
const FRAMES: [&str; 7] =
    ["images", "masks", ".film.png", "mattes.png", "run.json", "report.html", "view.html"];
const SFM: [&str; 8] = [
    "sparse/0",
    "transforms.json",
    "sparse_points.ply",
    "database.db",
    "frames.json",
    "run.json",
    "report.html",
    "view.html",
];
/// Written after the poses, anew where other views are held out.
const TRANSFORMS: [&str; 1] = ["transforms.json"];
const UNDISTORT: [&str; 1] = ["undistorted"];
const TRAIN: [&str; 7] =
    ["splat.ply", "field.bin", "times.json", "refined", "run.json", "report.html", "view.html"];
const EVAL: [&str; 3] = ["eval", "run.json", "report.html"];

/// One run into one output folder.
pub struct Pipeline {
    until: Until,
    args: PipelineArgs,
    input: Input,
    out: PathBuf,
    stages: Stages,
    verbosity: Verbosity,
    json: bool,
    memory_limit: Option<u64>,
    record: RunRecord,
    /// Who looks on.
    page: Option<Serving>,
}

impl Pipeline {
    /// Looks at the input and opens the output folder.
    pub fn new(
        args: PipelineArgs,
        recorded: Option<Recorded>,
        verbosity: Verbosity,
        json: bool,
    ) -> Result<Self> {
        Input::detect(&args.input, args.ignore_poses)?; // before a folder is made for it
        let out = output_folder(args.output.as_deref(), &args.input)?;
        Self::within(Stages::open(&out)?, args, recorded, verbosity, json)
    }

    /// The same in a folder that is open already.
    pub fn within(
        stages: Stages,
        mut args: PipelineArgs,
        recorded: Option<Recorded>,
        verbosity: Verbosity,
        json: bool,
    ) -> Result<Self> {
        args.keep_to_size();
        let input = Input::detect(&args.input, args.ignore_poses)?;
        let out = stages.out().to_path_buf();
        if let Some(folder) = &args.camera_from {
            args.sfm.calibration = Some(crate::calibration::read(folder)?);
        }
        if let Some(recorded) = recorded {
            write_json(&stages.path("args.json"), &recorded)?;
        }
        let record = RunRecord::begun(args.clone(), Vec::new());
        let (until, memory_limit) = (Until::Report, None);
        let page = if args.view { Some(Serving::start(Arc::new(Watch::live(&out)))?) } else { None };
        Ok(Self { until, args, input, out, stages, verbosity, json, memory_limit, record, page })
    }

    /// The same with no more than so much memory, MiB.
    pub(crate) fn limited(self, memory_limit: Option<u64>) -> Self {
        Self { memory_limit, ..self }
    }

    /// Runs the stages that are not current, as far as `until`.
    pub fn run(self, until: Until) -> Result<Outcome> {
        Ok(self.run_recorded(until)?.0)
    }

    /// The same, and all that the run knows.
    pub fn run_recorded(mut self, until: Until) -> Result<(Outcome, RunRecord)> {
        self.until = until;
        if until >= Until::Eval {
            evaluate::load_networks(&self.args.eval.lpips_weights)?; // before hours of work, not after
        }
        let (frames, frames_print) = self.frames()?;
        memory::check(self.memory_limit, &frames, &self.args, until)?;
        self.record.frames = Some(frames.clone());
        self.hold_out(self.input.held_out(&frames)?);
        if let Some(block) = self.args.pairs {
            self.match_part(block, &frames, &frames_print)?;
            return Ok((Outcome::Done, self.record));
        }
        let mut outcome = Outcome::Done;
        if until >= Until::Sfm {
            let (poses, poses_print) = self.poses(&frames, &frames_print)?;
            self.record.poses = Some(poses.clone());
            outcome = poses.outcome();
            if outcome == Outcome::NoModel {
                // What an earlier run made of other poses is no result of this one.
                self.stages.retire("transforms", &TRANSFORMS)?;
                self.stages.retire("undistort", &UNDISTORT)?;
                self.stages.retire("train", &TRAIN)?;
                self.stages.retire("eval", &EVAL)?;
            } else {
                self.show_poses("sparse/0", &poses);
                self.hold_out_sector()?;
                self.write_transforms(&frames, &poses_print)?;
                if until >= Until::Train {
                    self.splat(&frames, &poses_print, until)?;
                }
            }
        }
        report::judge(&self.out, &mut self.record)?;
        if until >= Until::Report || (until >= Until::Sfm && outcome == Outcome::NoModel) {
            self.write_page()?;
            report::write(&self.out, &self.record).context("cannot write the report")?;
        }
        write_json(&self.out.join("run.json"), &self.record)?;
        self.say_result(until)?;
        if outcome == Outcome::Done && report::overall(&self.record.verdict) == Level::Bad {
            outcome = Outcome::Doubtful;
        }
        self.show_end();
        Ok((outcome, self.record))
    }

    fn say(&self, line: &str) {
        if self.verbosity > Verbosity::Quiet {
            say(line);
        }
    }

    /// Says what a stage came to and what it cost.
    fn finish<T>(&mut self, stage: &str, done: Done<T>, line: &str) -> Finished<T> {
        let cost = done.finished.cost.clone();
        let spent = if done.ran {
            format!("{:.1} s, {:.1} CPU s, {:.0} MiB", cost.wall_s, cost.cpu_s, cost.peak_mib)
        } else {
            "as before".into()
        };
        let (number, of) = self.until.place(stage);
        self.say(&format!("{number}/{of} {stage:<9} {line} ({spent})"));
        if let Some(changed) = &done.changed {
            self.say(&format!("          made again: {changed}"));
        }
        self.record.costs.push((stage.to_owned(), cost));
        done.finished
    }

    fn frames(&mut self) -> Result<(FrameSet, String)> {
        let source = self.input.source();
        let print = fingerprint(&(
            "frames",
            env!("FRAMES_SOURCES"),
            &self.args.frames,
            &self.args.key,
            describe_input(source)?,
            self.masks_beside(source).as_deref().map(describe_input).transpose()?,
        ))?;
        let stage = StageSpec { name: "frames", fingerprint: &print, owns: &FRAMES };
        let done = self.stages.run(&stage, |new| {
            let progress = self.progress("frames");
            let frames = match &self.input {
                Input::Video(path) => preprocess::video_frames(path, new, &self.args.frames, &progress)?,
                Input::Posed { images, listed, .. } if !listed.is_empty() => {
                    preprocess::listed_photo_frames(images, listed, new, &self.args.frames, &progress)?
                }
                Input::Photos(path) | Input::Posed { images: path, .. } => {
                    preprocess::photo_frames(path, new, &self.args.frames, &progress)?
                }
            };
            // Who brings masks has cut the object out already.
            let cut = self.args.key.key == "auto" && frames.frames.iter().any(|f| f.mask.is_some());
            let frames = if cut || self.args.key.key == "off" {
                frames
            } else {
                preprocess::matte_frames(&frames, new, &self.args.key, &progress)?
            };
            if frames.frames.iter().any(|f| f.mask.is_some()) {
                preprocess::contact_sheet(&frames, &new.join("mattes.png"))?;
            }
            Ok(relative_to(frames, new))
        })?;
        let frames: &FrameSet = &done.finished.value;
        let sizes = frames.frames.first().map_or(String::new(), |f| format!(", {}×{}", f.width, f.height));
        let line = format!("{}{sizes}", frames.len());
        let finished = self.finish("frames", done, &line);
        let identity = finished.identity()?;
        let frames = absolute_in(finished.value, &self.out);
        for note in &frames.notes {
            self.say(&format!("          {note}"));
        }
        self.say_decisions(&frames.decisions);
        self.show_frames(&frames);
        Ok((frames, identity))
    }

    /// The folder of masks, where it lies outside the folder of the photos.
    fn masks_beside(&self, photos: &Path) -> Option<PathBuf> {
        let masks = match self.args.frames.masks.as_str() {
            _ if matches!(self.input, Input::Video(_)) => return None,
            "off" => return None,
            "auto" => photos.parent()?.join("masks"),
            given => PathBuf::from(given),
        };
        masks.is_dir().then_some(masks)
    }

    fn poses(&mut self, frames: &FrameSet, frames_print: &str) -> Result<(PoseSummary, String)> {
        let print = match &self.input {
            Input::Posed { model, .. } => {
                database::refuse(&self.args)?;
                world::refuse_scale(&self.args)?;
                input::refuse_wide(frames)?;
                let points = (env!("SFM_SOURCES"), &self.args.sfm);
                fingerprint(&("import", 4, frames_print, describe_input(model)?, self.args.text, points))?
            }
            _ => {
                let database = database::print(&self.args)?;
                fingerprint(&(
                    "sfm",
                    env!("SFM_SOURCES"),
                    frames_print,
                    &self.args.sfm,
                    self.args.seed,
                    self.args.text,
                    self.args.keep_frame,
                    database,
                ))?
            }
        };
        let stage = StageSpec { name: "sfm", fingerprint: &print, owns: &SFM };
        let done = self.stages.run(&stage, |new| {
            let progress = self.progress("sfm");
            let (reconstruction, mut summary) = match &self.input {
                Input::Posed { model, .. } => {
                    let imported = input::import_poses(model, self.input.source(), frames)?;
                    let (imported, weak, doubt) =
                        input::against_photos(imported, frames, &self.args.sfm, &progress)?;
                    let Imported { model, world_from_file, missing, notes } = imported;
                    let (model, mut decisions) =
                        input::with_points(model, frames, &self.args.sfm, &progress)?;
                    decisions.extend(doubt);
                    let world = world::given(&model, frames, world_from_file);
                    let summary = PoseSummary {
                        imported: true,
                        world,
                        missing,
                        weak,
                        notes,
                        decisions,
                        ..Default::default()
                    };
                    (Some(model), summary)
                }
                _ => self.solve_poses(frames, new, &progress)?,
            };
            summary.total = frames.len();
            if let Some(reconstruction) = &reconstruction {
                summary.registered = reconstruction.images.len();
                summary.points = reconstruction.points.len();
                summary.mean_error_px = reconstruction.mean_reprojection_error();
                model::write(reconstruction, new, self.args.text)?;
            }
            Ok(summary)
        })?;
        let poses: &PoseSummary = &done.finished.value;
        let line = match &poses.no_model {
            Some(reason) => format!("no model: {reason}"),
            None => format!(
                "{} of {} images{}, {}",
                poses.registered,
                poses.total,
                if poses.imported { " (poses of the input)" } else { "" },
                if poses.points == 0 {
                    "no points".to_owned()
                } else {
                    format!("{} points, {:.2} px", poses.points, poses.mean_error_px)
                }
            ),
        };
        let finished = self.finish("poses", done, &line);
        let identity = finished.identity()?;
        let poses = finished.value;
        self.say_decisions(&poses.decisions);
        for note in &poses.notes {
            self.say(&format!("          {note}"));
        }
        for (name, why) in &poses.missing {
            self.say(&format!("          missing {name}: {why}"));
        }
        for (name, why) in &poses.weak {
            self.say(&format!("          weak    {name}: {why}"));
        }
        for reason in poses.doubt().iter().flat_map(|d| d.remarks_in_words()) {
            self.say(&format!("          {reason}"));
        }
        Ok((poses, identity))
    }

    fn solve_poses(
        &self,
        frames: &FrameSet,
        new: &Path,
        progress: &Progress,
    ) -> Result<(Option<Reconstruction>, PoseSummary)> {
        self.input.refuse_too_few(frames.len())?;
        let mut result = database::solve(&self.args, frames, progress)?;
        let model = result.reconstruction.as_ref();
        let scale = model.map(|m| sfm::metric_scale(m, frames, &self.args.sfm.scale, progress));
        let world = world::find(&result, frames, &self.args, scale.transpose()?.flatten(), progress)?;
        if let Some(world) = world.as_ref().filter(|_| !self.args.keep_frame) {
            world::place(&mut result, &world.sim3());
        }
        let rule = if self.args.keep_frame { Rule::Requested } else { Rule::Evidence };
        result.decisions.extend(world.as_ref().map(|w| w.decision(rule)));
        result.decisions.extend(world.as_ref().and_then(|w| w.scale).map(|s| s.decision()));
        let summary = PoseSummary {
            no_model: result.reconstruction.is_none().then(|| result.reason.clone()),
            missing: result.missing.clone(),
            weak: result.weak_images.clone(),
            deviations: result
                .uncertainty
                .as_ref()
                .zip(result.reconstruction.as_ref())
                .map(|(u, model)| Deviations::of(u, model)),
            motion: result.motion.clone(),
            world,
            decisions: result.decisions.clone(),
            figures: figures(&result.stats),
            ..PoseSummary::default()
        };
        all_frames::write(&new.join("frames.json"), &result.frames, frames)?;
        let reconstruction = database::write(&self.args, new, result, frames)?;
        Ok((reconstruction, summary))
    }

    /// Which views are held out is no matter of the poses.
    fn write_transforms(&self, frames: &FrameSet, poses_print: &str) -> Result<()> {
        let print = fingerprint(&("transforms", 1, poses_print, &self.args.dataset))?;
        let stage = StageSpec { name: "transforms", fingerprint: &print, owns: &TRANSFORMS };
        self.stages.run(&stage, |new| {
            let model = scene::io::read_model(&self.out.join("sparse/0"))?;
            let target = new.join("transforms.json");
            transforms::write(&target, &model, Some(frames), &self.args.dataset)
        })?;
        Ok(())
    }

    fn splat(&mut self, frames: &FrameSet, poses_print: &str, until: Until) -> Result<()> {
        let training_set = self.out.join("undistorted");
        let print = fingerprint(&("undistort", 2, poses_print))?;
        let stage = StageSpec { name: "undistort", fingerprint: &print, owns: &UNDISTORT };
        let done = self.stages.run(&stage, |new| {
            let progress = self.progress("undistort");
            let reconstruction = scene::io::read_model(&self.out.join("sparse/0"))?;
            let written = sfm::undistort(frames, &reconstruction, &new.join("undistorted"), &progress)?;
            Ok(written.decisions)
        })?;
        let finished = self.finish("undistort", done, "images for training");
        let print = finished.identity()?;
        self.say_decisions(&finished.value);
        self.record.frames.iter_mut().for_each(|frames| frames.decisions.extend_from_slice(&finished.value));
        if let Some(poses) = &self.record.poses {
            self.show_poses("undistorted/sparse/0", poses);
        }
        if self.args.method != Method::Gaussians {
            let times = Times::of(frames, &self.input)?;
            return self.field((&training_set, &times), &print, until);
        }
        let print = fingerprint(&(
            "train",
            env!("SPLAT_SOURCES"),
            &print,
            &self.args.dataset,
            &self.args.train,
            self.args.seed,
        ))?;
        let stage = StageSpec { name: "train", fingerprint: &print, owns: &TRAIN };
        let done = self.stages.run(&stage, |new| self.train(&training_set, new, &print))?;
        // The splat is in its place: the checkpoint has done its work.
        self.stages.discard("train")?;
        let splat: &SplatSummary = &done.finished.value;
        let line = format!("{} Gaussians, SH degree {}", splat.gaussians, splat.sh_degree);
        let finished = self.finish("train", done, &line);
        let print = finished.identity()?;
        self.show_splat(&finished.value);
        self.record.splat = Some(finished.value);
        self.judge(&print, until)
    }

    /// Judges what was trained, whose identity is `print`, if that is wanted.
    fn judge(&mut self, print: &str, until: Until) -> Result<()> {
        if until < Until::Eval {
            return Ok(());
        }
        let mesh = self.args.eval.mesh.mesh.as_deref().map(describe_input).transpose()?;
        let print = fingerprint(&("eval", 4, print, &self.args.eval, mesh))?;
        let stage = StageSpec { name: "eval", fingerprint: &print, owns: &EVAL };
        let done: Done<Evaluation> = self.stages.run(&stage, |new| {
            let progress = self.progress("eval");
            let args = &self.args;
            evaluate::evaluate(&self.out, new, &args.dataset, &args.eval, &args.train.device, &progress)
        })?;
        let line = done.finished.value.sentence();
        self.record.evaluation = Some(self.finish("eval", done, &line).value);
        Ok(())
    }

    /// Trains, with checkpoints in `.stages/train`, and writes the splat into the folder `new`.
    fn train(&self, training_set: &Path, new: &Path, print: &str) -> Result<SplatSummary> {
        crate::stage::free_large_blocks_at_once();
        let progress = self.progress("train");
        let checkpoints = self.stages.keep("train", print)?;
        let begun = self.args.train.limit_clock.seconds();
        let dataset = evaluate::load_to_train_splat(training_set, &self.args.dataset, &progress)?;
        let mut config = self.args.train.clone();
        config.seed = self.args.seed;
        config.seconds_gone = config.limit_clock.seconds() - begun;
        let result = splat::train::train(&dataset, &config, Some(&checkpoints), &progress)?;
        scene::io::ply::write_splat_ply(&new.join("splat.ply"), &result.gaussians)?;
        model::write_refined(&self.out, new, &result.poses)?;
        let summary = SplatSummary {
            gaussians: result.gaussians.len(),
            sh_degree: result.gaussians.sh_degree,
            antialias: config.antialias,
            curve: result.curve,
            decisions: result.decisions,
        };
        Ok(summary)
    }

    fn say_result(&self, until: Until) -> Result<()> {
        if self.json {
            print(&serde_json::to_string_pretty(&self.record)?)?;
        } else if let (Until::Eval, Some(evaluation)) = (until, &self.record.evaluation)
            && self.verbosity > Verbosity::Quiet
        {
            print(&evaluation.markdown())?;
        }
        if self.verbosity > Verbosity::Quiet {
            crate::closing::say(&self.out, &self.record);
        }
        Ok(())
    }
}

fn figures(stats: &sfm::SfmStats) -> Vec<(String, f64)> {
    let mut figures = vec![
        ("features".to_owned(), stats.features as f64),
        ("pairs matched".to_owned(), stats.pairs_matched as f64),
        ("pairs verified".to_owned(), stats.pairs_verified as f64),
        ("observations".to_owned(), stats.observations as f64),
        ("mean track length".to_owned(), stats.mean_track_length),
        ("reprojection rms, px".to_owned(), stats.reprojection_rms_px),
        ("reprojection median, px".to_owned(), stats.reprojection_median_px),
    ];
    figures.extend(stats.steps.iter().map(|s| (format!("{}, CPU s", s.step), s.cpu_s)));
    figures
}
