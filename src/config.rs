//! Where flags come from: preset, then former run, then configuration file, then what was typed;
//! later ones win.

use crate::args::{Cli, Command, PipelineArgs};
use anyhow::{Context, Result, bail};
use clap::{CommandFactory, FromArgMatches};
use serde::{Deserialize, Serialize};
use splat::Quality;
use std::path::{Path, PathBuf};

/// What a run folder remembers of how it was made (`.stages/args.json`).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Recorded {
    /// The input, absolute.
    pub input: PathBuf,
    /// Configuration-file and typed flags, without input and output.
    pub flags: Vec<String>,
}

/// Flags without a value that may stand before the command.
const BARE_GLOBALS: [&str; 6] = ["-v", "--verbose", "-q", "--quiet", "--json", "--view"];
/// Flags with a value that may stand before the command, and are no part of how a run was made.
const VALUED_GLOBALS: [&str; 4] = ["--config", "--threads", "--memory-limit", "--progress"];

/// Whether an argument is one of the flags with its value behind an equals sign.
fn is_joined(argument: &str, flags: &[&str]) -> bool {
    argument.split_once('=').is_some_and(|(name, _)| flags.contains(&name))
}

/// The preset's flags (`balanced` is the flags' defaults): those of the poses, then those of the
/// splat.
fn preset(quality: Quality) -> Vec<String> {
    let poses: &[(&str, &str)] = match quality {
        Quality::Draft => &[
            // Small images without their finest structure do not tell that photos were turned.
            ("doubling-limit-mp", "0.5"),
            ("keypoints", "detected"),
            ("max-features", "1024"),
            ("track-points", "600"),
            ("track-distance-px", "5"),
        ],
        Quality::Fast | Quality::Balanced => &[],
        Quality::Best => &[("max-features", "8192")],
    };
    poses.iter().chain(quality.flags()).map(|(flag, value)| format!("--{flag}={value}")).collect()
}

/// `sat-recon INPUT` is `sat-recon run INPUT`: puts the command in where none stands.
pub fn with_command(mut argv: Vec<String>) -> Vec<String> {
    let command = Cli::command();
    let mut i = 1;
    while let Some(arg) = argv.get(i) {
        match arg.as_str() {
            a if VALUED_GLOBALS.contains(&a) => i += 2,
            a if BARE_GLOBALS.contains(&a) || is_joined(a, &VALUED_GLOBALS) => i += 1,
            "help" | "-h" | "--help" | "-V" | "--version" => return argv,
            a if command.find_subcommand(a).is_some() => return argv,
            // Left as it is, the parser says what it may have been.
            a if crate::help::mistyped(a).is_some() => return argv,
            _ => break,
        }
    }
    if argv.len() > 1 {
        argv.insert(i.min(argv.len()), "run".into());
    }
    argv
}

/// The command line with everything that goes before the typed flags.
pub struct Parsed {
    /// What is to be done.
    pub cli: Cli,
    /// What to remember in the run folder.
    pub recorded: Option<Recorded>,
    /// What the preset placed, for the user.
    pub preset: Vec<String>,
}

/// Parses; usage errors are clap's, everything else names the file.
pub fn parse(argv: Vec<String>) -> Result<std::result::Result<Parsed, clap::Error>> {
    if let Some(help) = crate::help::help_all(&argv) {
        return Ok(Err(clap::Error::raw(clap::error::ErrorKind::DisplayHelp, help)));
    }
    let argv = with_command(argv);
    let first = match parse_argv(&argv) {
        Ok(cli) => cli,
        Err(error) => return Ok(Err(error)),
    };
    let file_flags = match &first.global.config {
        Some(path) => flags_of_file(path)?,
        None => Vec::new(),
    };
    let Some(args) = pipeline_args(&first.command) else {
        return Ok(insert_and_parse(&argv, &file_flags).map(|cli| Parsed {
            cli,
            recorded: None,
            preset: vec![],
        }));
    };
    let former = former_run(&args.input)?;
    let typed = typed_flags(&argv, &args.input);
    let mut before: Vec<String> = former.as_ref().map(|f| f.flags.clone()).unwrap_or_default();
    before.extend(file_flags.iter().cloned());

    let quality = match insert_and_parse(&argv, &before) {
        Ok(cli) => pipeline_args(&cli.command).map_or(Quality::Balanced, |a| a.quality),
        Err(error) => return Ok(Err(error)),
    };
    let preset = preset(quality);
    let mut all = preset.clone();
    all.extend(before.iter().cloned());
    let mut cli = match insert_and_parse(&argv, &all) {
        Ok(cli) => cli,
        Err(error) => return Ok(Err(error)),
    };
    let mut recorded = None;
    if let Some(resolved) = pipeline_args_mut(&mut cli.command) {
        resolved.output = args.output.clone();
        if let Some(former) = &former {
            resolved.output.get_or_insert_with(|| args.input.clone());
            resolved.input = former.input.clone();
        }
        before.extend(typed);
        let input = std::path::absolute(&resolved.input).unwrap_or_else(|_| resolved.input.clone());
        recorded = Some(Recorded { input, flags: with_absolute_paths(before) });
    }
    Ok(Ok(Parsed { cli, recorded, preset }))
}

fn parse_argv(argv: &[String]) -> std::result::Result<Cli, clap::Error> {
    Cli::from_arg_matches(&crate::help::command(false).try_get_matches_from(argv)?)
}

fn insert_and_parse(argv: &[String], flags: &[String]) -> std::result::Result<Cli, clap::Error> {
    let command = Cli::command();
    let at = argv.iter().skip(1).position(|a| command.find_subcommand(a).is_some()).map_or(1, |i| i + 2);
    let mut all = argv[..at.min(argv.len())].to_vec();
    all.extend(flags.iter().cloned());
    all.extend(argv[at.min(argv.len())..].iter().cloned());
    parse_argv(&all)
}

fn pipeline_args(command: &Command) -> Option<&PipelineArgs> {
    match command {
        Command::Run(a)
        | Command::Frames(a)
        | Command::Sfm(a)
        | Command::Train(a)
        | Command::Eval(a)
        | Command::Report(a) => Some(a),
        _ => None,
    }
}

fn pipeline_args_mut(command: &mut Command) -> Option<&mut PipelineArgs> {
    match command {
        Command::Run(a)
        | Command::Frames(a)
        | Command::Sfm(a)
        | Command::Train(a)
        | Command::Eval(a)
        | Command::Report(a) => Some(a),
        _ => None,
    }
}

/// What stands after the command, without the input and the flags that belong to one call.
fn typed_flags(argv: &[String], input: &Path) -> Vec<String> {
    let command = Cli::command();
    let after = argv.iter().skip(1).position(|a| command.find_subcommand(a).is_some()).map_or(1, |i| i + 2);
    let mut flags: Vec<String> = argv[after.min(argv.len())..].to_vec();
    if let Some(i) = flags.iter().rposition(|a| Path::new(a) == input) {
        flags.remove(i);
    }
    let mut kept = Vec::new();
    let mut skip = false;
    for flag in flags {
        if std::mem::take(&mut skip) {
            continue;
        }
        match flag.as_str() {
            "-o" | "--output" => skip = true,
            f if VALUED_GLOBALS.contains(&f) => skip = true,
            f if BARE_GLOBALS.contains(&f) || is_joined(f, &VALUED_GLOBALS) => {}
            f if f.starts_with("-o") || f.starts_with("--output=") => {}
            _ => kept.push(flag),
        }
    }
    kept
}

/// Files and folders that flags name, from the current folder: a run is gone on with from any.
fn with_absolute_paths(mut flags: Vec<String>) -> Vec<String> {
    let command = Cli::command();
    let Some(run) = command.find_subcommand("run") else { return flags };
    let paths = run.get_arguments().filter(|a| a.get_value_hint() == clap::ValueHint::AnyPath);
    let names: Vec<String> = paths.filter_map(|a| Some(format!("--{}", a.get_long()?))).collect();
    for i in 0..flags.len() {
        let (name, value) = flags[i].split_once('=').unwrap_or((&flags[i], ""));
        let (is_path, name, value) = (names.iter().any(|n| n == name), name.to_owned(), value.to_owned());
        if is_path && flags[i].contains('=') {
            flags[i] = format!("{name}={}", absolute(&value));
        } else if is_path && i + 1 < flags.len() {
            flags[i + 1] = absolute(&flags[i + 1]);
        }
    }
    flags
}

fn absolute(path: &str) -> String {
    std::path::absolute(path).map_or_else(|_| path.to_owned(), |path| path.display().to_string())
}

/// What the run in this folder was told, if there was one.
pub(crate) fn former_run(input: &Path) -> Result<Option<Recorded>> {
    let path = input.join(".stages").join("args.json");
    if !path.is_file() {
        return Ok(None);
    }
    let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let recorded = serde_json::from_slice(&text).with_context(|| {
        format!("{} is damaged; delete it and name the video or photos again", path.display())
    })?;
    Ok(Some(recorded))
}

/// `key = value` is `--key value`, `key = true` is `--key`; tables only group.
fn flags_of_file(path: &Path) -> Result<Vec<String>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let table: toml::Table = text.parse().with_context(|| format!("{} is not valid TOML", path.display()))?;
    let mut flags = Vec::new();
    collect(&table, path, &mut flags)?;
    Ok(flags)
}

fn collect(table: &toml::Table, path: &Path, flags: &mut Vec<String>) -> Result<()> {
    for (key, value) in table {
        let name = key.replace('_', "-");
        match value {
            toml::Value::Table(inner) => collect(inner, path, flags)?,
            toml::Value::Boolean(true) => flags.push(format!("--{name}")),
            toml::Value::Boolean(false) => {}
            toml::Value::String(s) => flags.push(format!("--{name}={s}")),
            toml::Value::Integer(_) | toml::Value::Float(_) => flags.push(format!("--{name}={value}")),
            _ => bail!("{}: {key} must be a string, a number, true or false", path.display()),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use clap::error::ErrorKind;

    fn argv(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn an_input_alone_means_run() {
        assert_eq!(with_command(argv("sat-recon video.mp4"))[1], "run");
        assert_eq!(with_command(argv("sat-recon -v --threads 2 video.mp4"))[4], "run");
        assert_eq!(with_command(argv("sat-recon frames video.mp4"))[1], "frames");
        assert_eq!(with_command(argv("sat-recon --help")), argv("sat-recon --help"));
    }

    #[test]
    fn typed_flags_win_over_the_file_and_the_file_over_the_preset() {
        let file = std::env::temp_dir().join(format!("sat-recon-config-{}.toml", std::process::id()));
        std::fs::write(&file, "seed = 7\nquality = \"fast\"\n").unwrap();
        let line = format!("sat-recon video.mp4 --config {}", file.display());
        let seed = |line: &str| match parse(argv(line)).unwrap().unwrap().cli.command {
            Command::Run(args) => (args.seed, args.quality),
            other => panic!("{other:?}"),
        };
        assert_eq!(seed(&line), (7, Quality::Fast));
        assert_eq!(seed(&format!("{line} --seed 3 --quality best")), (3, Quality::Best));
        std::fs::remove_file(file).unwrap();
    }

    #[test]
    fn files_that_flags_name_are_found_from_any_folder() {
        let here = std::env::current_dir().unwrap();
        let line = "sat-recon video.mp4 --camera-from cam --seed 3 --database=a=b.db --mesh /m.ply";
        let flags = parse(argv(line)).unwrap().unwrap().recorded.unwrap().flags;
        let absolute = |name: &str| here.join(name).display().to_string();
        let database = format!("--database={}", absolute("a=b.db"));
        let wanted = ["--camera-from", &absolute("cam"), "--seed", "3", &database, "--mesh", "/m.ply"];
        assert_eq!(flags, wanted);
        assert_eq!(with_absolute_paths(flags.clone()), flags);
    }

    #[test]
    fn no_flag_takes_nan_or_infinity() {
        let command = Cli::command();
        let mut numbers = 0;
        for sub in command.get_subcommands() {
            for argument in sub.get_arguments().filter(|a| a.get_long().is_some()) {
                let flag = format!("--{}", argument.get_long().unwrap());
                let line = |value: &str| {
                    let mut argv = vec!["sat-recon".to_owned(), sub.get_name().to_owned(), "x".to_owned()];
                    argv.extend(["-o".to_owned(), "y".to_owned()].into_iter().filter(|_| flag != "--output"));
                    argv.push(format!("{flag}={value}"));
                    Cli::try_parse_from(argv)
                };
                let refused =
                    |value: &str| line(value).is_err_and(|e| e.kind() == ErrorKind::ValueValidation);
                // Takes numbers, and no text.
                if !refused("text") || refused("1") && refused("50") {
                    continue;
                }
                numbers += 1;
                for value in ["nan", "inf", "-inf", "1e999"] {
                    assert!(refused(value), "{} {flag} takes {value}", sub.get_name());
                }
            }
        }
        assert!(numbers > 100, "{numbers} numbers");
    }

    #[test]
    fn an_unknown_key_in_the_file_is_a_usage_error() {
        let file = std::env::temp_dir().join(format!("sat-recon-bad-{}.toml", std::process::id()));
        std::fs::write(&file, "sed = 7\n").unwrap();
        assert!(parse(argv(&format!("sat-recon video.mp4 --config {}", file.display()))).unwrap().is_err());
        std::fs::remove_file(file).unwrap();
    }
}
