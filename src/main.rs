//! The program: parses, runs one command, turns its outcome into an exit code.
//!
//! Exit codes: 0 all well, 2 no model, 3 a partial or doubtful model, 1 anything else.

use sat_recon::{Outcome, config, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    quiet_drivers();
    match config::parse(std::env::args().collect()) {
        Ok(Ok(parsed)) => match run(parsed) {
            Ok(Outcome::Done) => ExitCode::SUCCESS,
            Ok(Outcome::NoModel) => ExitCode::from(2),
            Ok(Outcome::Partial | Outcome::Doubtful) => ExitCode::from(3),
            Err(error) => fail(&error),
        },
        Ok(Err(usage)) => {
            let _ = usage.print(); // to a closed pipe there is nothing to say
            if usage.use_stderr() { ExitCode::from(1) } else { ExitCode::SUCCESS }
        }
        Err(error) => fail(&error),
    }
}

/// Keeps Mesa's device-select layer, which asks the desktop for its favourite adapter, from
/// complaining on standard error where there is no desktop.
fn quiet_drivers() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: no other thread runs yet that could read the environment.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}

fn fail(error: &anyhow::Error) -> ExitCode {
    eprintln!("error: {error:#}");
    ExitCode::from(1)
}
