//! What README.md and docs/ show: commands that the program takes, links that lead somewhere,
//! examples that run.

use super::support::{folder, sat_recon_in};
use clap::CommandFactory;
use std::path::{Path, PathBuf};

/// README.md and the pages below docs/, with their text.
fn pages() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(|name| root.join(name))
        .into();
    paths.extend(files(&root.join("docs"), &["md"]));
    paths.into_iter().map(|path| (path.clone(), read(&path))).collect()
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// All files below a folder with one of these endings, in order.
fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        let path = entry.path();
        let name = entry.file_name();
        if path.is_dir() && name != "node_modules" && name != "target" {
            found.extend(files(&path, endings));
        } else if path.extension().is_some_and(|e| endings.contains(&e.to_string_lossy().as_ref())) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The commands of the blocks marked `console` (and, if `only_run`, `run`): the words after each
/// `$`.
fn commands(text: &str, only_run: bool) -> Vec<Vec<String>> {
    let mut inside = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if let Some(mark) = line.strip_prefix("```") {
            let mut marks = mark.split(',');
            inside = !inside && marks.next() == Some("console") && (!only_run || marks.any(|m| m == "run"));
        } else if let Some(command) = line.strip_prefix("$ ").filter(|_| inside) {
            found.push(words(command));
        }
    }
    found
}

/// A command's words: double quotes hold one together, a comment ends it.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quoted = false;
    for letter in command.chars() {
        let at_start = words.last().is_none_or(String::is_empty);
        match letter {
            '"' => quoted = !quoted,
            '#' if at_start && !quoted => break,
            ' ' if !quoted && !at_start => words.push(String::new()),
            ' ' if !quoted => {}
            _ => words.last_mut().expect("a word").push(letter),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[test]
fn every_command_that_is_shown_is_accepted() {
    let mut seen = 0;
    for (page, text) in pages() {
        for command in commands(&text, false) {
            let shown = format!("{}: {}", page.display(), command.join(" "));
            assert_eq!(command[0], "sat-recon", "{shown}");
            let argv = sat_recon::config::with_command(command);
            if let Err(error) = sat_recon::cli::Cli::command().try_get_matches_from(argv) {
                panic!("{shown}: {error}");
            }
            seen += 1;
        }
    }
    assert!(seen > 30, "only {seen} commands were found");
}

#[test]
fn examples_that_are_marked_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (page, text) in pages() {
        let commands = commands(&text, true);
        if commands.is_empty() {
            continue;
        }
        let place = folder(&format!("documentation-{}", page.file_stem().expect("a name").to_string_lossy()));
        std::os::unix::fs::symlink(root.join("data"), place.join("data")).expect("a link to the data");
        for command in commands {
            let output = sat_recon_in(&place, &command[1..]);
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{}: {}: {said}", page.display(), command.join(" "));
        }
        std::fs::remove_dir_all(place).expect("the folder goes");
    }
}

#[test]
fn links_between_pages_lead_to_files() {
    for (page, text) in pages() {
        for link in text.split("](").skip(1).filter_map(|rest| rest.split([')', ' ']).next()) {
            let target = link.split('#').next().unwrap_or_default();
            if target.is_empty() || link.contains("://") {
                continue;
            }
            let path = page.parent().expect("a folder").join(target);
            assert!(path.exists(), "{}: {link} leads nowhere", page.display());
        }
    }
}

/// A citation is the number of a record (two digits) or the name of a file.
#[test]
fn citations_in_the_code_name_decision_records_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let records: Vec<String> = files(&root.join("docs/decisions"), &["md"])
        .iter()
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .collect();
    for part in ["src", "scene", "preprocess", "sfm", "splat", "tests", "tools"] {
        for file in files(&root.join(part), &["rs", "cc", "h", "wgsl", "py", "sh"]) {
            for rest in read(&file).split("docs/decisions/").skip(1) {
                let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '.'));
                let name = rest[..end.unwrap_or(rest.len())].trim_end_matches('.');
                let cited = |record: &String| record == name || record.starts_with(&format!("{name}-"));
                let is_there = name.is_empty() || records.iter().any(cited);
                assert!(is_there, "{}: docs/decisions/{name} does not exist", file.display());
            }
        }
    }
}
