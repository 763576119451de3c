//! Feeds every reader of files from outside with mutated files: no panic, no hang, no more memory
//! than the file deserves.
//!
//!     fuzz SECONDS [--results FILE] [TARGET...]
//!
//! `--results` adds what came of it to the sums by target in a JSON file, and to its list of runs.
//!
//! Seeds are files that our own writers made, and the files in `fuzz/regressions/TARGET/`. What
//! fails is written to `fuzz/failures/TARGET/`: move it to the regressions when it is mended.

mod meter;
mod mutate;
#[cfg(feature = "program")]
mod program;
mod results;
mod run;
mod seeds;
mod targets;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

#[global_allocator]
static METER: meter::Meter = meter::Meter;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().and_then(|text| text.parse::<f64>().ok());
    let Some(seconds) = seconds.filter(|s| s.is_finite() && *s > 0.0) else {
        eprintln!("usage: fuzz SECONDS [TARGET...]; targets: {}", targets::names().join(" "));
        return ExitCode::from(1);
    };
    let mut wanted: Vec<String> = arguments.collect();
    let results = match wanted.iter().position(|word| word == "--results") {
        Some(at) if at + 1 < wanted.len() => wanted.drain(at..at + 2).nth(1).map(PathBuf::from),
        _ => None,
    };
    let chosen: Vec<_> =
        targets::TARGETS.iter().filter(|t| wanted.is_empty() || wanted.iter().any(|w| w == t.name)).collect();
    let mut all = Vec::new();
    println!("| target | executions | accepted | failures |\n|---|---|---|---|");
    for target in &chosen {
        let limit = Duration::from_secs_f64(seconds / chosen.len() as f64);
        let told = run::run(target, run::Until::Time(limit), rand::random());
        println!("| {} | {} | {} | {} |", target.name, told.executions, told.accepted, told.failures.len());
        told.failures.iter().for_each(|failure| eprintln!("{}: {failure}", target.name));
        all.push((target.name, told));
    }
    if let Some(path) = &results {
        results::add(path, &all);
    }
    ExitCode::from(u8::from(all.iter().any(|(_, told)| !told.failures.is_empty())))
}
