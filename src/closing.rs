//! What the terminal says when a run ends: the verdict, what to do about it, what to open.

use crate::record::{Level, Light, RunRecord};
use crate::report::{advice, overall, overall_in_words};
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::Path;

/// Files of a run that are worth opening, in this order.
const WORTH_OPENING: [(&str, &str); 9] = [
    ("report.html", "pictures, evidence, poses in 3D"),
    ("view.html", "the splat in a browser"),
    ("splat.ply", "the splat, for any 3DGS viewer"),
    ("field.bin", "the radiance field; render and eval read it"),
    ("sparse/0", "poses and points, a COLMAP model"),
    ("transforms.json", "the same for nerfstudio"),
    ("mattes.png", "the object as it was cut out"),
    ("eval", "held-out photos beside their renders"),
    ("images", "the frames"),
];
/// No more of them are named. Source: chosen by hand: a screen without scrolling.
const MOST_NAMED: usize = 4;

/// The last lines of a run. `colour`: for a terminal.
fn lines(out: &Path, record: &RunRecord, colour: bool) -> String {
    let mut text = String::new();
    if !record.verdict.is_empty() {
        let overall = overall(&record.verdict);
        text += &format!("{} {}\n", lamp(overall, colour), overall_in_words(overall));
        for light in record.verdict.iter().filter(|l| matches!(l.level, Level::Fair | Level::Bad)) {
            text += &doubt(light, colour);
        }
    }
    let there = WORTH_OPENING.iter().filter(|(name, _)| out.join(name).exists()).take(MOST_NAMED);
    let there: Vec<(String, &str)> =
        there.map(|(name, what)| (out.join(name).display().to_string(), *what)).collect();
    let width = there.iter().map(|(path, _)| path.chars().count()).max().unwrap_or(0);
    for (i, (path, what)) in there.iter().enumerate() {
        let open = if i == 0 { "open" } else { "    " };
        let _ = writeln!(text, "{open} {path:width$}  {what}"); // a String takes all
    }
    if out.join("splat.ply").is_file() {
        let _ = writeln!(text, "     or look at the splat: sat-recon view {}", out.display());
    }
    text
}

/// A light that is not green, and what helps.
fn doubt(light: &Light, colour: bool) -> String {
    let mut text = format!("  {} {}: {}\n", lamp(light.level, colour), light.what, light.reason);
    if let Some(advice) = advice(light) {
        text += &format!("      {advice}\n");
    }
    text
}

/// A coloured dot; without colours a word.
fn lamp(level: Level, colour: bool) -> String {
    let (code, word) = match level {
        Level::Good => (32, "green:"),
        Level::Fair => (33, "yellow:"),
        Level::Bad => (31, "red:"),
        Level::Unknown => (90, "grey:"),
    };
    if colour { format!("\x1b[{code}m●\x1b[0m") } else { word.to_owned() }
}

/// Says the last lines of a run on standard error.
pub(crate) fn say(out: &Path, record: &RunRecord) {
    let colour = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    crate::terminal::say(lines(out, record, colour).trim_end());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(verdict: Vec<Light>) -> RunRecord {
        let parsed = crate::config::parse(["sat-recon", "video.mp4"].map(str::to_owned).to_vec());
        let crate::args::Command::Run(config) = parsed.unwrap().unwrap().cli.command else {
            panic!("an input alone means run")
        };
        RunRecord::begun(*config, verdict)
    }

    #[test]
    fn the_end_names_the_light_its_reason_what_helps_and_only_what_is_there() {
        let out = std::env::temp_dir().join(format!("sat-recon-closing-{}", std::process::id()));
        std::fs::create_dir_all(&out).unwrap();
        std::fs::write(out.join("report.html"), "").unwrap();
        let light =
            |what: &str, level, reason: &str| Light { what: what.into(), level, reason: reason.into() };
        let bad = record(vec![
            light("frames with a pose", Level::Bad, "no model: too dark"),
            light("loop", Level::Good, "closed"),
        ]);
        let said = lines(&out, &bad, false);
        assert!(said.starts_with("red: Not reliable\n  red: frames with a pose: no model: too dark\n      "));
        assert!(said.contains("report.html") && !said.contains("splat.ply") && !said.contains("closed"));
        std::fs::write(out.join("splat.ply"), "").unwrap();
        let said = lines(&out, &record(vec![light("loop", Level::Good, "closed")]), true);
        assert!(said.contains("\x1b[32m●\x1b[0m All well"), "{said}");
        assert!(said.contains("sat-recon view"), "{said}");
        std::fs::remove_dir_all(out).unwrap();
    }
}
