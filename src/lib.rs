//! sat-recon, wired together: the stages of `preprocess`, `sfm` and `splat` as one resumable
//! pipeline.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

pub mod args;
mod batch;
mod bench;
mod calibration;
mod closing;
pub mod compare;
pub mod config;
mod cut;
mod database;
mod dense;
pub mod doctor;
pub mod evaluate;
pub mod export;
mod handover;
mod help;
mod input;
mod measure;
pub mod memory;
pub mod outcome;
mod parts;
pub mod pictures;
pub mod pipeline;
pub mod record;
mod relit;
pub mod render;
pub mod report;
pub mod stage;
pub mod terminal;
pub mod times;
mod transforms;
pub mod view;

pub use outcome::Outcome;

use anyhow::Result;
use args::Command;
use pipeline::Until;
use terminal::Verbosity;

/// Runs the command.
pub fn run(parsed: config::Parsed) -> Result<Outcome> {
    let global = parsed.cli.global.clone();
    let verbosity = match (global.quiet, global.verbose) {
        (true, _) => Verbosity::Quiet,
        (_, true) => Verbosity::Verbose,
        _ => Verbosity::Normal,
    };
    if let Some(mib) = global.memory_limit {
        memory::limit(mib)?;
    }
    if let Some(threads) = global.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    terminal::tell_as_json(global.progress == args::Telling::Json);
    terminal::install_ctrl_c()?;
    let until = match &parsed.cli.command {
        Command::Frames(_) => Until::Frames,
        Command::Sfm(_) => Until::Sfm,
        Command::Train(_) => Until::Train,
        Command::Eval(_) => Until::Eval,
        _ => Until::Report,
    };
    match parsed.cli.command {
        Command::Run(args)
        | Command::Frames(args)
        | Command::Sfm(args)
        | Command::Train(args)
        | Command::Eval(args)
        | Command::Report(args) => {
            if verbosity > Verbosity::Quiet && !parsed.preset.is_empty() {
                let name = format!("{:?}", args.quality).to_lowercase();
                terminal::say(&format!("--quality {name} sets {}", parsed.preset.join(" ")));
            }
            let pipeline = pipeline::Pipeline::new(*args, parsed.recorded, verbosity, global.json)?;
            pipeline.limited(global.memory_limit).run(until)
        }
        Command::Render(args) => {
            stage::settle(&args.run)?;
            render::run(&args, verbosity)
        }
        Command::Export(args) => {
            stage::settle(&args.input)?;
            export::run(&args, verbosity)
        }
        Command::Measure(args) => measure::run(&args, verbosity, global.json),
        Command::Parts(args) => parts::run(&args, verbosity, global.json),
        Command::Compare(args) => compare::run(&args, verbosity, global.json),
        Command::Bench(args) => bench::run(&args, &global, verbosity),
        Command::Batch(args) => batch::run(&args, verbosity, global.json),
        Command::Collect(args) => batch::collect(&args, verbosity, global.json),
        Command::Clean { run } => stage::clean(&run).map(|()| Outcome::Done),
        Command::View(args) => {
            stage::settle(&args.run)?;
            view::server::run(&args, verbosity == Verbosity::Quiet)
        }
        Command::Doctor => doctor::run(global.json),
        Command::Completions { shell } => Ok(help::print_completions(shell)),
        Command::Man(args) => help::write_man(&args),
    }
}
