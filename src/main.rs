//! The program: parses, runs one command, turns its outcome into an exit code.
//!
//! Exit codes: 0 all well, 2 no model, 3 a partial or doubtful model, 1 anything else.

mod allocator;

use anyhow::anyhow;
use sat_recon::memory::restart_without_blas_threads;
use sat_recon::terminal::say_error;
use sat_recon::{Outcome, config, run};
use std::ffi::OsString;
use std::io::ErrorKind;
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: allocator::Advising = allocator::Advising;

fn main() -> ExitCode {
    quiet_drivers();
    refuse_large_files_by_error();
    if let Err(error) = restart_without_blas_threads() {
        return fail(&error);
    }
    let arguments: Result<Vec<String>, OsString> = std::env::args_os().map(OsString::into_string).collect();
    let arguments = match arguments {
        Ok(arguments) => arguments,
        Err(odd) => return fail(&anyhow!("{} is not UTF-8; rename the file", odd.display())),
    };
    match config::parse(arguments) {
        Ok(Ok(parsed)) => match run(parsed) {
            Ok(Outcome::Done) => ExitCode::SUCCESS,
            Ok(Outcome::NoModel) => ExitCode::from(2),
            Ok(Outcome::Partial | Outcome::Doubtful) => ExitCode::from(3),
            Err(error) => fail(&error),
        },
        Ok(Err(usage)) => match usage.print() {
            Ok(()) if !usage.use_stderr() => ExitCode::SUCCESS,
            Err(e) if !usage.use_stderr() && e.kind() == ErrorKind::BrokenPipe => ExitCode::SUCCESS,
            _ => ExitCode::from(1),
        },
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

/// A file beyond the limit of the user (`ulimit -f`) is an error like a full disk, not a signal
/// that ends the program.
fn refuse_large_files_by_error() {
    // SAFETY: no handler runs; no other thread runs yet.
    unsafe { nix::libc::signal(nix::libc::SIGXFSZ, nix::libc::SIG_IGN) };
}

fn fail(error: &anyhow::Error) -> ExitCode {
    say_error(&format!("{error:#}"));
    ExitCode::from(1)
}
