//! `parts`: parts of the object that turn on joints while it is filmed, as a table and
//! `parts.json`, with the model that their motion no longer bends.

mod meshes;
mod posed;
mod record;
mod search;
mod splat;

pub(crate) use posed::MovingSplat;
pub(crate) use record::{labels, read_moving};

use crate::args::PartsArgs;
use crate::outcome::Outcome;
use crate::pipeline::folder::absolute_in;
use crate::record::PoseSummary;
use crate::terminal::{CANCELLED, TerminalSink, Verbosity, print, say};
use anyhow::{Context, Result, bail};
use scene::{FrameSet, Progress};
use sfm::{Articulation, MovingPart, moving_parts};
use std::fmt::Write as _;

/// What is written, in a run's folder.
const FOLDER: &str = "parts";

/// Probability of the poses from which on parts are looked for. Source: more probably right than
/// wrong. Parts that move make poses less probable: 0.5 and 0.9 on two of eight films
/// (docs/decisions/22).
const PROBABLE: f64 = 0.5;

/// Looks for parts in the frames of a run.
pub(crate) fn run(args: &PartsArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let run = &args.run;
    crate::stage::settle(run)?;
    let Some(frames) = crate::stage::last::<FrameSet>(run, "frames")? else {
        bail!("{} is not the output folder of a run", run.display());
    };
    let frames = absolute_in(frames.value, run);
    if !frames.is_video {
        bail!("{} is of photos: parts are looked for in videos", run.display());
    }
    let model = scene::io::read_model(&run.join("sparse/0"))
        .with_context(|| format!("{} has no poses", run.display()))?;
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let poses = crate::stage::last::<PoseSummary>(run, "sfm")?;
    let sure = poses.map_or(1.0, |p| p.value.probability());
    let (mut found, corrected) = if sure < PROBABLE {
        (Articulation::default(), model)
    } else {
        moving_parts(&frames, &model, &args.klt, args.seed, &progress)?
    };
    found.poses_probability = sure;
    let folder = args.output.clone().unwrap_or_else(|| run.join(FOLDER));
    // Whatever wrong poses do looks like a motion to photos.
    if found.parts.is_empty() && sure >= 1.0 {
        found.parts.extend(search::part_from_photos(run, &folder, &frames, &corrected, &progress)?);
    }
    let sparse = folder.join("sparse/0");
    std::fs::create_dir_all(&sparse).with_context(|| format!("cannot make {}", sparse.display()))?;
    scene::io::write_model_bin(&corrected, &sparse)?;
    record::forget_splat(&folder);
    record::write(&folder, &found)?;
    if !json {
        print(&text(&found))?;
    }
    if !found.parts.is_empty() && !args.no_splat {
        let train = splat::PartsTraining {
            frames: &frames,
            model: &corrected,
            parts: &mut found,
            fps_loops: args.fps_loops,
        };
        let judged = train.train(run, &folder, &progress)?;
        if !json {
            print(&format!("splat of the parts: {}", judged.sentence()))?;
            print(&text(&found))?;
        }
    }
    if json {
        print(&serde_json::to_string_pretty(&found)?)?;
    }
    if verbosity > Verbosity::Quiet {
        say(&format!("wrote {}", folder.display()));
    }
    Ok(if found.poses_probability < 1.0 { Outcome::Doubtful } else { Outcome::Done })
}

/// What was found, for people.
fn text(found: &Articulation) -> String {
    if found.poses_probability < PROBABLE {
        return "the run's poses are more probably wrong than right, and what moves against them is their \
                error: no parts were looked for; the run's report says what helps\n"
            .to_owned();
    }
    let mut out = String::new();
    if found.poses_probability < 1.0 {
        out += "the run's poses are doubtful: what moves here may be their error\n";
    }
    if found.parts.is_empty() {
        let _ = writeln!(out, "no part moves against the body: {} tracks follow it", found.tracks);
    }
    for (k, part) in found.parts.iter().enumerate() {
        let _ = writeln!(out, "part {}: {}", k + 1, sentence(part));
    }
    let _ = writeln!(
        out,
        "{} of {} tracks belong neither to the body nor to a part; noise {:.2} px",
        found.unexplained, found.tracks, found.noise_px
    );
    out
}

fn sentence(part: &MovingPart) -> String {
    let [x, y, z] = part.axis;
    let widest = part.angle_sigmas_deg.iter().copied().fold(0.0, f64::max);
    let (least, most) = part
        .angles_deg
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), a| (least.min(*a), most.max(*a)));
    let found = match part.gain_db {
        Some(gain) => format!("found by photos, which it explains {gain:.2} dB better"),
        None => format!(
            "{} tracks, {:.2} px (as the body {:.1} px)",
            part.tracks, part.error_px, part.still_error_px
        ),
    };
    format!(
        "turns by {:.1}° (± {widest:.1}°) about ({x:.3}, {y:.3}, {z:.3}) ± {:.2}° through \
         ({:.4}, {:.4}, {:.4}) ± {:.4}; {found}",
        most - least,
        part.axis_sigma_deg,
        part.place[0],
        part.place[1],
        part.place[2],
        part.place_sigma
    )
}
