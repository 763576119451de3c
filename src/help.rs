//! Help that says what applies, suggestions for what was mistyped, completions and manual pages.

use crate::args::{Cli, ManArgs};
use crate::outcome::Outcome;
use anyhow::{Context, Result};
use clap::{Arg, Command, CommandFactory};
use std::path::Path;

/// The flag that shows all flags.
pub(crate) const HELP_ALL: &str = "--help-all";
/// Groups of flags by the first command of the pipeline to which they apply.
const GROUPS: [(&str, &[&str]); 4] = [
    ("frames", &["General", "Frames", "Matte"]),
    ("sfm", &["Structure from motion", "Motion"]),
    ("train", &["Splat"]),
    ("eval", &["Evaluation"]),
];
/// The commands of the pipeline, each with all that the ones before it do.
const PIPELINE: [&str; 6] = ["frames", "sfm", "train", "eval", "report", "run"];
/// Flags of those groups that few will ever need: with the groups that are not named above, they
/// are shown by `--help-all`.
const RARE: [&str; 29] = [
    "fisheye-field",
    "rematch",
    "text",
    "known-rate",
    "known-elevation",
    "intrinsics-sigma",
    "skip",
    "doubling-limit-mp",
    "keypoints",
    "track-points",
    "track-distance-px",
    "coarse-levels",
    "learning-rate",
    "sh-degree",
    "smoothing",
    "fps-loops",
    "mesh-truth",
    "mesh-depths",
    "lambda-dssim",
    "checkpoint-every",
    "test-sector",
    "pairs",
    "length-ends",
    "track-return-px",
    "verify-confidence",
    "max-log10-false-alarms",
    "duplicate-levels",
    "vram-limit",
    "limit-clock",
];

/// The command line. `all`: its help hides nothing.
pub(crate) fn command(all: bool) -> Command {
    let mut command = Cli::command();
    if all {
        return command;
    }
    for (i, name) in PIPELINE.iter().enumerate() {
        let applies = |arg: &Arg| {
            let heading = arg.get_help_heading().unwrap_or("General");
            let known = GROUPS.iter().find(|(_, groups)| groups.contains(&heading));
            let first = known.and_then(|(first, _)| PIPELINE.iter().position(|p| p == first));
            first.is_some_and(|first| first <= i) && !RARE.contains(&arg.get_long().unwrap_or_default())
        };
        command = command.mut_subcommand(*name, |c| {
            let c = c.mut_args(|a| if applies(&a) || a.is_positional() { a } else { a.hide(true) });
            c.after_help("More flags: sat-recon --help-all, or --help-all behind the command.")
        });
    }
    command
}

/// The command that a word, which stands where one is expected, was meant to be.
pub(crate) fn mistyped(word: &str) -> Option<String> {
    let is_name = word.chars().all(|c| c.is_ascii_lowercase() || c == '-');
    if !is_name || Path::new(word).exists() {
        return None;
    }
    let names: Vec<String> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
    let near = names.into_iter().map(|n| (strsim::damerau_levenshtein(word, &n), n));
    // One slip in three letters.
    near.filter(|(slips, n)| 3 * slips <= n.len()).min().map(|(_, n)| n)
}

/// Where the typed words ask for all flags: the help of the command that is among them.
pub(crate) fn help_all(argv: &[String]) -> Option<String> {
    if !argv.iter().skip(1).any(|a| a == HELP_ALL) {
        return None;
    }
    let mut command = command(true);
    command.build();
    let named = argv
        .iter()
        .skip(1)
        .find_map(|a| command.find_subcommand(a))
        .or_else(|| command.find_subcommand("run"));
    let mut named = named?.clone();
    Some(named.render_long_help().to_string())
}

/// Writes the manual pages into a folder: one for the program, one a command.
pub(crate) fn write_man(args: &ManArgs) -> Result<Outcome> {
    let folder = &args.output;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    clap_mangen::generate_to(command(true), folder)
        .with_context(|| format!("cannot write into {}", folder.display()))?;
    let page = folder.join("sat-recon.1");
    crate::terminal::say(&format!("wrote {}; read them with: man -l {}", folder.display(), page.display()));
    Ok(Outcome::Done)
}

/// Prints the completions of a shell.
pub(crate) fn print_completions(shell: clap_complete::Shell) -> Outcome {
    clap_complete::generate(shell, &mut Cli::command(), "sat-recon", &mut std::io::stdout());
    Outcome::Done
}

#[cfg(test)]
mod tests {
    use super::*;

    fn help(name: &str) -> String {
        let mut command = command(false);
        command.build();
        command.find_subcommand(name).unwrap().clone().render_long_help().to_string()
    }

    #[test]
    fn each_command_shows_the_flags_that_apply_to_it() {
        let shows = |name: &str, flag: &str| help(name).contains(&format!("{flag} <"));
        assert!(shows("frames", "--key") && !shows("frames", "--iterations"));
        assert!(!shows("frames", "--motion") && shows("sfm", "--motion"));
        assert!(!shows("sfm", "--iterations") && shows("train", "--iterations"));
        assert!(!shows("train", "--lpips-weights") && shows("run", "--lpips-weights"));
        assert!(help("run").lines().count() < 260, "{} lines", help("run").lines().count());
        for rare in RARE {
            assert!(!help("run").contains(&format!("--{rare} <")), "{rare}");
        }
    }

    #[test]
    fn help_all_shows_every_flag_and_names_of_rare_flags_exist() {
        let argv = ["sat-recon", "train", "--help-all"].map(str::to_owned);
        let all = help_all(&argv).unwrap();
        let flags = Cli::command().find_subcommand("run").unwrap().clone();
        for flag in flags.get_arguments().filter_map(|a| a.get_long()).filter(|f| *f != "help") {
            assert!(all.contains(&format!("--{flag}")), "{flag}");
        }
        for rare in RARE {
            assert!(flags.get_arguments().any(|a| a.get_long() == Some(rare)), "{rare} is no flag");
        }
        assert_eq!(help_all(&argv[..2]), None);
    }

    #[test]
    fn slips_of_the_keyboard_are_recognised_and_names_of_files_are_not() {
        assert_eq!(mistyped("trian").as_deref(), Some("train"));
        assert_eq!(mistyped("exprot").as_deref(), Some("export"));
        assert_eq!(mistyped("video.mp4"), None);
        assert_eq!(mistyped("photos"), None);
    }
}
