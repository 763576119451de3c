//! `measure`: dimensions, planes, discs and cylinders of a surface, as a table, `measure.json` and
//! a drawing.

mod drawing;
pub(crate) mod record;
pub(crate) mod table;

use crate::args::{MeasureArgs, MeshDepths};
use crate::outcome::Outcome;
use crate::record::PoseSummary;
use crate::stage::{write_json, write_whole};
use crate::terminal::{CANCELLED, TerminalSink, Verbosity, print, say};
use anyhow::{Context, Result, bail};
use record::{DRAWING, FILE, MeasureRecord, splat_hash};
use scene::Progress;
use scene::geometry::Mesh;
use scene::world::WorldUnit;
use shape::measure::{MeasureOptions, Measures, measure};
use std::path::{Path, PathBuf};

/// Most shapes that are looked for. Source: chosen by hand: twice what fills a page.
const MOST_SHAPES: usize = 40;

/// Measures a run or a mesh.
pub(crate) fn run(args: &MeasureArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let (mesh, record_of) = surface(args, &progress)?;
    let options = MeasureOptions {
        tolerance: args.tolerance / 100.0,
        least_share: args.least_share / 100.0,
        most_shapes: MOST_SHAPES,
        seed: args.seed,
    };
    let found = measure(&mesh, &options, &progress)?;
    let Some((measures, labels)) = found else {
        bail!("{} has no surface: its triangles have no area", args.input.display());
    };
    let record = MeasureRecord { tolerance: options.tolerance, measures, ..record_of };
    let folder = folder(args);
    write_json(&folder.join(FILE), &record)?;
    let drawing = drawing::svg(&mesh, &labels, &record)?;
    write_whole(&folder.join(DRAWING), drawing.as_bytes())?;
    if args.input.is_dir() {
        crate::report::put_measures(&args.input)?;
    }
    if json {
        print(&serde_json::to_string_pretty(&record)?)?;
    } else {
        print(&table::text(&record))?;
    }
    if verbosity > Verbosity::Quiet {
        say(&format!("wrote {} and {DRAWING}", folder.join(FILE).display()));
    }
    Ok(Outcome::Done)
}

/// Where the results go: the run's folder, or that of the mesh.
fn folder(args: &MeasureArgs) -> PathBuf {
    let beside = args.input.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    args.output.clone().unwrap_or(if args.input.is_dir() { args.input.clone() } else { beside })
}

/// The surface, and what is known of it.
fn surface(args: &MeasureArgs, progress: &Progress) -> Result<(Mesh, MeasureRecord)> {
    let mut record = MeasureRecord {
        unit: WorldUnit::Unchanged,
        surface: String::new(),
        splat: None,
        tolerance: 0.0,
        measures: Measures::default(),
    };
    if !args.input.is_dir() {
        let mesh = scene::io::read_mesh(&args.input)
            .with_context(|| "measure takes the output folder of a run, or a mesh")?;
        record.surface = format!("{} triangles of the mesh given", mesh.triangles.len());
        return Ok((mesh, record));
    }
    crate::stage::settle(&args.input)?;
    let (mesh, dataset) =
        crate::export::fused(&args.input, args.mesh_depths, args.mesh_resolution, progress)?;
    let poses = crate::stage::last::<PoseSummary>(&args.input, "sfm")?;
    record.unit = poses.and_then(|p| p.value.world).map_or(WorldUnit::Unchanged, |w| w.unit);
    record.splat = splat_hash(&args.input);
    record.surface = format!(
        "{} triangles: the surface as {} views see it, fused from {}",
        mesh.triangles.len(),
        dataset.views.len(),
        match args.mesh_depths {
            MeshDepths::Stereo => "depths by stereo",
            MeshDepths::Splat => "the splat's depths",
            MeshDepths::Both => "depths by stereo and the splat's",
        }
    );
    Ok((mesh, record))
}
