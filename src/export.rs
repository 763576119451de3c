//! `export`: a result in another format, chosen by the name of the target.

use crate::args::{ExportArgs, MeshDepths, Tool};
use crate::dense;
use crate::outcome::Outcome;
use crate::pictures::need_splat;
use crate::record::KnownRun;
use crate::terminal::{CANCELLED, TerminalSink, Verbosity, say};
use crate::transforms;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use scene::geometry::{Mesh, TexturedMesh};
use scene::io::{SplatFormat, read_splat, write_splat};
use scene::{PosedPhoto, Progress};
use shape::{Decimation, TextureOptions};
use splat::{Dataset, Pixels};
use std::path::Path;

/// Writes a splat or a model.
pub fn run(args: &ExportArgs, verbosity: Verbosity) -> Result<Outcome> {
    if let Some(tool) = args.tool {
        return hand_over(args, tool, verbosity);
    }
    let default = args.input.join(match (args.mesh, args.dense) {
        (true, _) => "mesh.ply",
        (_, true) => "dense.ply",
        _ => crate::view::PAGE,
    });
    let output = args.output.as_deref().unwrap_or(&default);
    if args.cut.is_some() && SplatFormat::of(output).is_none() {
        bail!("--crop and --without-floaters cut splats: name a file such as cut.ply with -o");
    }
    let ending = output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        _ if args.mesh => write_mesh(args, output, verbosity)?,
        _ if args.dense => write_dense(args, output, verbosity)?,
        _ if args.html || ending == "html" => crate::view::write_page(&args.input, output, None)?,
        _ if SplatFormat::of(output).is_some() => {
            let mut splat =
                if args.input.is_dir() { need_splat(&args.input)? } else { read_splat(&args.input)? };
            if args.cut.is_some() {
                let gone = args.cut.apply(&mut splat);
                say(&format!("{gone} Gaussians cut away, {} left", splat.len()));
            }
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

/// Points of a run by stereo between its photos.
fn write_dense(args: &ExportArgs, output: &Path, verbosity: Verbosity) -> Result<()> {
    if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) {
        bail!("{}: a dense cloud is written as .ply", output.display());
    }
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let dataset = training_set(&args.input, &progress)?;
    let cloud = dense::cloud(&dense::depths(&args.input, &dataset, &progress)?, &dataset);
    if cloud.is_empty() {
        bail!("{}: no three photos agree on any point", args.input.display());
    }
    scene::io::ply::write_oriented_ply(output, &cloud)?;
    if verbosity > Verbosity::Quiet {
        say(&format!("{} points", cloud.len()));
    }
    Ok(())
}

/// The photos of a run without distortion; before a black sky with what its splat covers as mattes.
fn training_set(run: &Path, progress: &Progress) -> Result<Dataset> {
    let config = crate::render::dataset_config(run);
    let dataset = crate::evaluate::load_dataset(&run.join("undistorted"), &config, progress)
        .with_context(|| format!("{} is not the output folder of a run with a splat", run.display()))?;
    if !run.join("splat.ply").is_file() {
        return Ok(dataset);
    }
    let antialias = crate::pictures::trained_with_antialias(run)?;
    let matted = dense::with_silhouettes(&dataset, (&need_splat(run)?, antialias))?;
    Ok(matted.unwrap_or(dataset))
}

/// Colours of vertices weigh as much as the error of the surface where they are off by so much,
/// share of the range. Source: chosen by hand, never measured.
const COLOR_ERROR: f64 = 0.05;

/// The surface of a run as its input cameras see it, and those.
pub(crate) fn fused(
    run: &Path,
    from: MeshDepths,
    resolution: u32,
    progress: &Progress,
) -> Result<(Mesh, Dataset)> {
    // A run of another method has no splat.
    let wanted = from == MeshDepths::Splat || from.by_splat() && run.join("splat.ply").exists();
    let gaussians = if wanted { Some(need_splat(run)?) } else { None };
    let dataset = training_set(run, progress)?;
    let depths = if from.by_stereo() { Some(dense::depths(run, &dataset, progress)?) } else { None };
    let antialias = crate::pictures::trained_with_antialias(run)?;
    let splat = gaussians.as_ref().map(|g| (g, antialias));
    let mesh = dense::mesh(depths, splat, &dataset, resolution, progress)?;
    if mesh.triangles.is_empty() {
        bail!(
            "{} has no surface: its views agree on none; --mesh-depths splat asks fewer of them",
            run.display()
        );
    }
    Ok((mesh, dataset))
}

/// The surface, closed where asked, of few triangles, with a texture or colours.
fn write_mesh(args: &ExportArgs, output: &Path, verbosity: Verbosity) -> Result<()> {
    let ending = output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if !matches!(ending.as_str(), "ply" | "glb" | "obj") {
        bail!("{}: a mesh is written as .ply, .glb or .obj", output.display());
    }
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let (mut mesh, dataset) = fused(&args.input, args.mesh_depths, args.mesh_resolution, &progress)?;
    let (config, fine) = (&args.surface, mesh.triangles.len());
    if config.watertight {
        mesh = shape::watertight(&mesh);
    }
    let texture = if ending == "ply" { 0 } else { config.mesh_texture };
    let color_error = (texture == 0).then_some(COLOR_ERROR);
    mesh = shape::decimated(&mesh, &Decimation { error: config.mesh_error / 100.0, color_error });
    if config.watertight {
        // Where parts touch, sides may have come to lie on each other.
        mesh = shape::watertight(&mesh);
    }
    let counts = format!("{} vertices, {} triangles (of {fine})", mesh.vertices.len(), mesh.triangles.len());
    let with_texture = match texture {
        0 => None,
        most_texels => paint(&mesh, &dataset, most_texels, &progress)?,
    };
    match &with_texture {
        Some(textured) => scene::io::write_textured_mesh(output, textured)?,
        None => scene::io::write_mesh(output, &mesh)?,
    }
    if verbosity > Verbosity::Quiet {
        let texture = with_texture.map(|t| format!(", texture {}×{}", t.texture.width(), t.texture.height()));
        say(&(counts + &texture.unwrap_or_default()));
    }
    Ok(())
}

/// The mesh with a texture from the photos.
fn paint(
    mesh: &Mesh,
    dataset: &Dataset,
    most_texels: u32,
    progress: &Progress,
) -> Result<Option<TexturedMesh>> {
    let views: Vec<PosedPhoto<'_>> = dataset
        .views
        .iter()
        .map(|v| {
            let Pixels { rgb, mask, .. } = &v.levels[0];
            PosedPhoto { camera: &v.camera, pose: v.pose, rgb, mask: mask.as_deref() }
        })
        .collect();
    let options = TextureOptions { most_texels, ..TextureOptions::default() };
    Ok(shape::textured(mesh, &views, &options, progress)?)
}

fn read_model(input: &Path) -> Result<scene::Reconstruction> {
    let folder = scene::io::find_model(input).with_context(|| format!("no model in {}", input.display()))?;
    Ok(scene::io::read_model(&folder)?)
}
