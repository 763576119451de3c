//! The pipeline: frames, poses, undistortion, splat, evaluation, report, each resumable.

mod all_frames;
mod folder;

use crate::args::PipelineArgs;
use crate::config::Recorded;
use crate::database;
use crate::evaluate;
use crate::input::{self, Input};
use crate::outcome::Outcome;
use crate::record::{Deviations, Evaluation, PoseSummary, RunRecord, SplatSummary};
use crate::report;
use crate::stage::{Cost, Stages, describe_input, fingerprint, write_json};
use crate::terminal::{CANCELLED, TerminalSink, Verbosity};
use anyhow::{Context, Result, bail};
use folder::{absolute_in, default_output, relative_to};
use scene::io::TransformsOptions;
use scene::io::ply::CloudPoint;
use scene::{Decision, FrameSet, Progress, Reconstruction};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Until {
    /// After the frames.
    Frames,
    /// After the poses.
    Sfm,
    /// After the training.
    Train,
    /// After the metrics.
    Eval,
    /// After the report.
    Report,
}

/// One run into one output folder.
pub struct Pipeline {
    args: PipelineArgs,
    input: Input,
    out: PathBuf,
    stages: Stages,
    verbosity: Verbosity,
    json: bool,
    record: RunRecord,
}

impl Pipeline {
    /// Looks at the input and opens the output folder.
    pub fn new(
        mut args: PipelineArgs,
        recorded: Option<Recorded>,
        verbosity: Verbosity,
        json: bool,
    ) -> Result<Self> {
        let input = Input::detect(&args.input, args.ignore_poses)?;
        let out = args.output.clone().unwrap_or_else(|| default_output(&args.input));
        if out.is_file() {
            bail!("{} is a file; name a folder with -o", out.display());
        }
        if let Some(folder) = &args.camera_from {
            args.sfm.calibration = Some(crate::calibration::read(folder)?);
        }
        let stages = Stages::open(&out)?;
        if let Some(recorded) = recorded {
            write_json(&stages.path("args.json"), &recorded)?;
        }
        let record = RunRecord {
            version: env!("CARGO_PKG_VERSION"),
            libraries: crate::doctor::library_versions(),
            config: args.clone(),
            costs: Vec::new(),
            frames: None,
            poses: None,
            splat: None,
            evaluation: None,
            decisions: Vec::new(),
            verdict: Vec::new(),
        };
        Ok(Self { args, input, out, stages, verbosity, json, record })
    }

    /// Runs the stages that are not current, as far as `until`.
    pub fn run(self, until: Until) -> Result<Outcome> {
        Ok(self.run_recorded(until)?.0)
    }

    /// The same, and all that the run knows.
    pub fn run_recorded(mut self, until: Until) -> Result<(Outcome, RunRecord)> {
        if until >= Until::Eval {
            evaluate::load_networks(&self.args.eval.lpips_weights)?; // before hours of work, not after
        }
        let (frames, frames_print) = self.frames()?;
        self.record.frames = Some(frames.clone());
        let mut outcome = Outcome::Done;
        if until >= Until::Sfm {
            let (poses, poses_print) = self.poses(&frames, &frames_print)?;
            self.record.poses = Some(poses.clone());
            outcome = poses.outcome();
            if outcome != Outcome::NoModel && until >= Until::Train {
                self.splat(&frames, &poses_print, until)?;
            }
        }
        report::judge(&self.out, &mut self.record)?;
        if until >= Until::Report || (until >= Until::Sfm && outcome == Outcome::NoModel) {
            report::write(&self.out, &self.record).context("cannot write the report")?;
        }
        write_json(&self.out.join("run.json"), &self.record)?;
        self.say_result(until)?;
        Ok((outcome, self.record))
    }

    fn progress(&self, stage: &str) -> Progress {
        Progress::new(Box::new(TerminalSink::new(self.verbosity, self.stages.log(stage))), &CANCELLED)
    }

    fn say(&self, line: &str) {
        if self.verbosity > Verbosity::Quiet {
            eprintln!("{line}");
        }
    }

    fn say_decisions(&self, decisions: &[Decision]) {
        for words in decisions.iter().map(Decision::sentences) {
            let is_verbose = self.verbosity == Verbosity::Verbose && !words.evidence.is_empty();
            let evidence =
                if is_verbose { format!(" ({})", words.evidence.join("; ")) } else { String::new() };
            self.say(&format!("          {words}{evidence}"));
        }
    }

    fn finish(&mut self, stage: &str, cost: Cost, ran: bool, line: &str) {
        let spent = if ran {
            format!("{:.1} s, {:.1} CPU s, {:.0} MiB", cost.wall_s, cost.cpu_s, cost.peak_mib)
        } else {
            "as before".into()
        };
        self.say(&format!("{stage:<9} {line} ({spent})"));
        self.record.costs.push((stage.to_owned(), cost));
    }

    fn frames(&mut self) -> Result<(FrameSet, String)> {
        let source = self.input.source();
        let print = fingerprint(&(
            "frames",
            env!("FRAMES_SOURCES"),
            &self.args.frames,
            &self.args.key,
            describe_input(source)?,
        ))?;
        if self.stages.current::<FrameSet>("frames", &print).is_none() {
            self.refuse_foreign_folder()?;
        }
        let (finished, ran) = self.stages.run("frames", &print, &[self.out.join("images")], || {
            let progress = self.progress("frames");
            let frames = match &self.input {
                Input::Video(path) => {
                    preprocess::video_frames(path, &self.out, &self.args.frames, &progress)?
                }
                Input::Photos(path) | Input::Posed { images: path, .. } => {
                    preprocess::photo_frames(path, &self.out, &self.args.frames, &progress)?
                }
            };
            // Who brings masks has cut the object out already.
            let cut = self.args.key.key == "auto" && frames.frames.iter().any(|f| f.mask.is_some());
            let frames = if cut || self.args.key.key == "off" {
                frames
            } else {
                preprocess::matte_frames(&frames, &self.out, &self.args.key, &progress)?
            };
            if frames.frames.iter().any(|f| f.mask.is_some()) {
                preprocess::contact_sheet(&frames, &self.out.join("mattes.png"))?;
            }
            Ok(relative_to(frames, &self.out))
        })?;
        let frames = absolute_in(finished.value, &self.out);
        let sizes = frames.frames.first().map_or(String::new(), |f| format!(", {}×{}", f.width, f.height));
        self.finish("frames", finished.cost, ran, &format!("{}{sizes}", frames.len()));
        for note in &frames.notes {
            self.say(&format!("          {note}"));
        }
        self.say_decisions(&frames.decisions);
        Ok((frames, print))
    }

    /// A folder that holds something that no run of ours made is not written over.
    fn refuse_foreign_folder(&self) -> Result<()> {
        for name in ["images", "sparse", "masks"] {
            let path = self.out.join(name);
            if path.exists()
                && self.stages.last::<FrameSet>("frames").is_none()
                && std::fs::read_dir(&path)?.next().is_some()
            {
                bail!(
                    "{} holds files that sat-recon did not write; choose another folder with -o",
                    path.display()
                );
            }
        }
        Ok(())
    }

    fn poses(&mut self, frames: &FrameSet, frames_print: &str) -> Result<(PoseSummary, String)> {
        let print = match &self.input {
            Input::Posed { model, .. } => {
                database::refuse(&self.args)?;
                let points = (env!("SFM_SOURCES"), &self.args.sfm);
                fingerprint(&("import", 2, frames_print, describe_input(model)?, self.args.text, points))?
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
                    database,
                ))?
            }
        };
        let known: Option<PoseSummary> = self.stages.current("sfm", &print).map(|f| f.value);
        let has_model = known.is_none_or(|k| k.no_model.is_none());
        let mut model = if has_model {
            vec![self.out.join("sparse/0"), self.out.join("transforms.json")]
        } else {
            vec![]
        };
        model.extend(self.args.colmap_database.then(|| self.out.join("database.db")));
        let (finished, ran) = self.stages.run("sfm", &print, &model, || {
            let progress = self.progress("sfm");
            let (reconstruction, mut summary) = match &self.input {
                Input::Posed { model, .. } => {
                    let given = input::import_poses(model, frames)?;
                    let (model, decisions) = input::with_points(given, frames, &self.args.sfm, &progress)?;
                    (Some(model), PoseSummary { imported: true, decisions, ..PoseSummary::default() })
                }
                _ => self.solve_poses(frames, &progress)?,
            };
            summary.total = frames.len();
            if let Some(reconstruction) = &reconstruction {
                summary.registered = reconstruction.images.len();
                summary.points = reconstruction.points.len();
                summary.mean_error_px = reconstruction.mean_reprojection_error();
                self.write_model(reconstruction, frames)?;
            }
            Ok(summary)
        })?;
        let poses = finished.value;
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
        self.finish("poses", finished.cost, ran, &line);
        self.say_decisions(&poses.decisions);
        for (name, why) in &poses.missing {
            self.say(&format!("          missing {name}: {why}"));
        }
        for (name, why) in &poses.weak {
            self.say(&format!("          weak    {name}: {why}"));
        }
        for reason in poses.doubt().iter().flat_map(|d| d.remarks_in_words()) {
            self.say(&format!("          {reason}"));
        }
        Ok((poses, print))
    }

    fn solve_poses(
        &self,
        frames: &FrameSet,
        progress: &Progress,
    ) -> Result<(Option<Reconstruction>, PoseSummary)> {
        let result = database::solve(&self.args, frames, progress)?;
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
            decisions: result.decisions.clone(),
            figures: figures(&result.stats),
            ..PoseSummary::default()
        };
        all_frames::write(&self.out.join("frames.json"), &result.frames, frames)?;
        let reconstruction = database::write(&self.args, &self.out, result, frames)?;
        Ok((reconstruction, summary))
    }

    fn write_model(&self, reconstruction: &Reconstruction, frames: &FrameSet) -> Result<()> {
        let target = self.out.join("sparse").join("0");
        scene::io::atomic::replace_folder(&target, |folder| {
            scene::io::write_model_bin(reconstruction, folder)?;
            if self.args.text {
                scene::io::write_model_txt(reconstruction, folder)?;
            }
            Ok::<(), scene::io::IoError>(())
        })?;
        let mask_of = |f: &scene::Frame| {
            Some(f.mask.as_ref()?.strip_prefix(&self.out).ok()?.to_string_lossy().into_owned())
        };
        let masks: BTreeMap<String, String> =
            frames.frames.iter().filter_map(|f| Some((f.name.clone(), mask_of(f)?))).collect();
        let points: Vec<CloudPoint> =
            reconstruction.points.values().map(|p| CloudPoint { position: p.position, rgb: p.rgb }).collect();
        let cloud = "sparse_points.ply";
        scene::io::ply::write_points_ply(&self.out.join(cloud), &points)?;
        let options = TransformsOptions {
            image_folder: "images".into(),
            masks: reconstruction
                .images
                .values()
                .filter_map(|i| Some((i.id, masks.get(&i.name)?.clone())))
                .collect(),
            ply_file_path: Some(cloud.into()),
        };
        scene::io::write_transforms(&self.out.join("transforms.json"), reconstruction, &options)?;
        Ok(())
    }

    fn splat(&mut self, frames: &FrameSet, poses_print: &str, until: Until) -> Result<()> {
        let training_set = self.out.join("undistorted");
        let print = fingerprint(&("undistort", 1, poses_print))?;
        let (finished, ran) = self.stages.run(
            "undistort",
            &print,
            &[training_set.join("sparse/0"), training_set.join("images")],
            || {
                let progress = self.progress("undistort");
                let reconstruction = scene::io::read_model(&self.out.join("sparse/0"))?;
                sfm::undistort(frames, &reconstruction, &training_set, &progress)?;
                Ok(0_u32)
            },
        )?;
        self.finish("undistort", finished.cost, ran, "images for training");

        let print = fingerprint(&(
            "train",
            env!("SPLAT_SOURCES"),
            &print,
            &self.args.dataset,
            &self.args.train,
            self.args.seed,
        ))?;
        let (finished, ran) = self
            .stages
            .run("train", &print, &[self.out.join("splat.ply")], || self.train(&training_set, &print))?;
        let splat = finished.value;
        self.finish(
            "train",
            finished.cost,
            ran,
            &format!("{} Gaussians, SH degree {}", splat.gaussians, splat.sh_degree),
        );
        self.record.splat = Some(splat);
        if until < Until::Eval {
            return Ok(());
        }
        let mesh = self.args.eval.mesh.mesh.as_deref().map(describe_input).transpose()?;
        let print = fingerprint(&("eval", 4, &print, &self.args.eval, mesh))?;
        let known = self.stages.current::<Evaluation>("eval", &print);
        if known.is_some_and(|k| !k.value.is_whole(&self.out)) {
            self.stages.forget("eval"); // a picture is missing
        }
        let (finished, ran) =
            self.stages.run("eval", &print, &[self.out.join("eval/metrics.json")], || {
                let progress = self.progress("eval");
                let args = &self.args;
                evaluate::evaluate(&self.out, &args.dataset, &args.eval, &args.train.device, &progress)
            })?;
        let evaluation = finished.value;
        self.finish("eval", finished.cost, ran, &evaluation.sentence());
        self.record.evaluation = Some(evaluation);
        Ok(())
    }

    fn train(&self, training_set: &Path, print: &str) -> Result<SplatSummary> {
        crate::stage::free_large_blocks_at_once();
        let progress = self.progress("train");
        let checkpoints = self.stages.path("train");
        let owner = checkpoints.join("fingerprint");
        if std::fs::read_to_string(&owner).ok().as_deref() != Some(print) {
            match std::fs::remove_dir_all(&checkpoints) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(e).context("cannot clear old checkpoints");
                }
                _ => {}
            }
            std::fs::create_dir_all(&checkpoints)?;
            crate::stage::write_whole(&owner, print.as_bytes())?;
        }
        let begun = std::time::Instant::now();
        let dataset = evaluate::load_dataset(training_set, &self.args.dataset, &progress)?;
        let mut config = self.args.train.clone();
        config.seed = self.args.seed;
        config.seconds_gone = begun.elapsed().as_secs_f64();
        let result = splat::train::train(&dataset, &config, Some(&checkpoints), &progress)?;
        scene::io::ply::write_splat_ply(&self.out.join("splat.ply"), &result.gaussians)?;
        self.write_refined(&result.poses)?;
        let summary = SplatSummary {
            gaussians: result.gaussians.len(),
            sh_degree: result.gaussians.sh_degree,
            antialias: config.antialias,
            curve: result.curve,
            decisions: result.decisions,
        };
        let _ = std::fs::remove_dir_all(&checkpoints); // the splat is written: the checkpoint has done its work
        Ok(summary)
    }

    /// `refined/0`: the model with the poses that training moved; none where it moved none.
    fn write_refined(&self, poses: &[(String, scene::Pose)]) -> Result<()> {
        let folder = self.out.join("refined");
        match std::fs::remove_dir_all(&folder) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(e).with_context(|| format!("cannot clear {}", folder.display()));
            }
            _ if poses.is_empty() => return Ok(()),
            _ => {}
        }
        let mut model = scene::io::read_model(&self.out.join("sparse/0"))?;
        for image in model.images.values_mut() {
            if let Some((_, pose)) = poses.iter().find(|(name, _)| *name == image.name) {
                image.pose = *pose;
            }
        }
        Ok(scene::io::atomic::replace_folder(&folder.join("0"), |new| {
            scene::io::write_model_bin(&model, new)
        })?)
    }

    fn say_result(&self, until: Until) -> Result<()> {
        if self.json {
            println!("{}", serde_json::to_string_pretty(&self.record)?);
        } else if let (Until::Eval, Some(evaluation)) = (until, &self.record.evaluation)
            && self.verbosity > Verbosity::Quiet
        {
            println!("{}", evaluation.markdown());
        }
        let what = match until {
            Until::Frames => "images/",
            Until::Sfm => "sparse/0, transforms.json",
            Until::Train => "splat.ply",
            Until::Eval => "eval/metrics.json, splat.ply",
            Until::Report => "report.html, splat.ply, sparse/0",
        };
        self.say(&format!("in {}: {what}", self.out.display()));
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
