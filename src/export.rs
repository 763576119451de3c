//! `export`: a result in another format, chosen by the name of the target.

use crate::args::{ExportArgs, Tool};
use crate::outcome::Outcome;
use crate::pictures::need_splat;
use crate::record::KnownRun;
use crate::terminal::{CANCELLED, TerminalSink, Verbosity, say};
use crate::transforms;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use scene::Progress;
use scene::io::{SplatFormat, read_splat, write_splat};
use std::path::Path;

/// Writes a splat or a model.
pub fn run(args: &ExportArgs, verbosity: Verbosity) -> Result<Outcome> {
    if let Some(tool) = args.tool {
        return hand_over(args, tool, verbosity);
    }
    let default = args.input.join(if args.mesh { "mesh.ply" } else { "view.html" });
    let output = args.output.as_deref().unwrap_or(&default);
    let ending = output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        _ if args.mesh => write_mesh(args, output, verbosity)?,
        _ if args.html || ending == "html" => crate::view::write_page(&args.input, output)?,
        _ if SplatFormat::of(output).is_some() => {
            let splat = if args.input.is_dir() { need_splat(&args.input)? } else { read_splat(&args.input)? };
            write_splat(output, &splat)?;
        }
        "json" => write_transforms(&args.input, output)?,
        "db" => {
            let database = args.input.join("database.db");
            if !database.is_file() {
                bail!(
                    "{0} has no database.db; 'sat-recon sfm {0} --colmap-database' writes it",
                    args.input.display()
                );
            }
            scene::io::write_database(output, &scene::io::read_database(&database)?)?;
        }
        "" => {
            let model = read_model(&args.input)?;
            scene::io::replace_folder(output, |folder| {
                if args.text {
                    scene::io::write_model_txt(&model, folder)
                } else {
                    scene::io::write_model_bin(&model, folder)
                }
            })?;
        }
        other => bail!("no format is known by the ending .{other}; see 'sat-recon export --help'"),
    }
    say(&format!("wrote {}", output.display()));
    Ok(Outcome::Done)
}

/// The set of a run for another program.
fn hand_over(args: &ExportArgs, tool: Tool, verbosity: Verbosity) -> Result<Outcome> {
    let name = tool.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
    let run = std::path::absolute(&args.input)?;
    let stem = run.file_name().map_or_else(|| "run".into(), |n| n.to_string_lossy().into_owned());
    let default = run.with_file_name(format!("{stem}_{name}"));
    let output = args.output.as_deref().unwrap_or(&default);
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let advice = crate::handover::write(&args.input, tool, output, &progress)?;
    say(&format!("wrote {}\nto load it: {advice}", output.display()));
    Ok(Outcome::Done)
}

/// Of a run with its masks, times and held-out views; of another model its poses, with the points
/// beside the file.
fn write_transforms(input: &Path, output: &Path) -> Result<()> {
    let model = read_model(input)?;
    let Ok(known) = KnownRun::read(input) else {
        if !model.points.is_empty() {
            transforms::write_cloud(&output.with_file_name(transforms::CLOUD), &model)?;
        }
        return transforms::write(output, &model, None, &splat::DatasetConfig::default());
    };
    transforms::write(output, &model, known.frames.as_ref(), &known.config.dataset)?;
    let folder = std::path::absolute(output)?;
    if folder.parent() != Some(&*std::path::absolute(input)?) {
        say(&format!(
            "the paths in {} begin in {}: put it there, or export --for nerfstudio a folder of its own",
            output.display(),
            input.display()
        ));
    }
    Ok(())
}

/// The surface of a run's splat as its input cameras see it.
fn write_mesh(args: &ExportArgs, output: &Path, verbosity: Verbosity) -> Result<()> {
    let ending = output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if !matches!(ending.as_deref(), Some("ply" | "glb")) {
        bail!("{}: a mesh is written as .ply or .glb", output.display());
    }
    let gaussians = need_splat(&args.input)?;
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let config = crate::render::dataset_config(&args.input);
    let dataset = crate::evaluate::load_dataset(&args.input.join("undistorted"), &config, &progress)?;
    let antialias = crate::pictures::trained_with_antialias(&args.input);
    let mesh = splat::fusion::fused_mesh(&gaussians, &dataset, antialias, args.mesh_resolution, &progress)?;
    if mesh.triangles.is_empty() {
        bail!("{} has no surface: nowhere do its cameras see it half opaque", args.input.display());
    }
    scene::io::write_mesh(output, &mesh)?;
    if verbosity > Verbosity::Quiet {
        say(&format!("{} vertices, {} triangles", mesh.vertices.len(), mesh.triangles.len()));
    }
    Ok(())
}

fn read_model(input: &Path) -> Result<scene::Reconstruction> {
    let folder = scene::io::find_model(input).with_context(|| format!("no model in {}", input.display()))?;
    Ok(scene::io::read_model(&folder)?)
}
