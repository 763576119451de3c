//! The command line itself.

use super::support::{expect_code, folder, sat_recon, text};

#[test]
fn help_names_every_command_and_ends_well() {
    let said = expect_code(&["--help"], 0);
    for command in
        ["run", "frames", "sfm", "train", "render", "eval", "report", "export", "compare", "bench", "doctor"]
    {
        assert!(said.contains(command), "{command} is not in the help");
    }
    assert!(expect_code(&["--version"], 0).contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn help_is_plain_text() {
    for command in ["run", "render", "export", "compare", "bench", "view", "doctor"] {
        let said = expect_code(&[command, "--help"], 0);
        assert!(!said.contains("[`") && !said.contains("crate::"), "{command}: a link of rustdoc: {said}");
        assert!(!said.contains("ighting") && !said.contains("likeness"), "{command}: {said}");
    }
}

#[test]
fn no_arguments_and_unknown_flags_are_usage_errors_with_exit_code_1() {
    let said = expect_code(&[], 1);
    assert!(said.contains("sat-recon [OPTIONS] <INPUT>"), "{said}");
    assert!(said.contains("  sat-recon video.mp4 "), "what to type first: {said}");
    expect_code(&["video.mp4", "--no-such-flag"], 1);
    expect_code(&["train", "video.mp4", "--sh-degree", "4"], 1);
    expect_code(&["train", "video.mp4", "--backend", "abacus"], 1);
}

#[test]
fn doctor_prints_versions_and_valid_json() {
    let said = expect_code(&["doctor"], 0);
    assert!(said.contains("ffmpeg") && said.contains("graphics adapters"), "{said}");
    let output = sat_recon(&["doctor", "--json"]);
    let rows: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert!(rows.as_array().is_some_and(|rows| rows.len() > 3));
}

#[test]
fn a_configuration_file_is_flags_and_its_mistakes_are_named() {
    let dir = folder("config");
    let file = dir.join("flags.toml");
    std::fs::write(&file, "no_such_flag = 3\n").unwrap();
    assert!(expect_code(&["missing.mp4", "--config", text(&file)], 1).contains("--no-such-flag"));
    std::fs::write(&file, "seed = [1]\n").unwrap();
    assert!(expect_code(&["missing.mp4", "--config", text(&file)], 1).contains("seed"));
    assert!(expect_code(&["missing.mp4", "--config", text(&dir.join("none.toml"))], 1).contains("none.toml"));
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_preset_says_what_it_changes() {
    let said = expect_code(&["missing.mp4", "--quality", "draft"], 1);
    assert!(said.contains("--iterations"), "{said}");
}

#[test]
fn a_mistyped_command_is_not_taken_for_a_file() {
    let said = expect_code(&["trian", "video.mp4"], 1);
    assert!(said.contains("'train'"), "{said}");
    let said = expect_code(&["photos"], 1);
    assert!(said.contains("cannot read photos"), "{said}");
}

#[test]
fn the_help_of_a_command_holds_what_applies_to_it_and_help_all_the_rest() {
    let lines = |arguments: &[&str]| expect_code(arguments, 0).lines().count();
    assert!(lines(&["frames", "--help"]) * 3 < lines(&["run", "--help"]) * 2);
    assert!(lines(&["run", "--help"]) < lines(&["run", "--help-all"]));
    assert!(!expect_code(&["frames", "--help"], 0).contains("--iterations <"));
    assert!(expect_code(&["frames", "--help-all"], 0).contains("--iterations <"));
    expect_code(&["frames", "missing.mp4", "--iterations", "5"], 1);
}

#[test]
fn completions_and_manual_pages_name_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        assert!(expect_code(&["completions", shell], 0).contains("export"), "{shell}");
    }
    let dir = folder("man");
    expect_code(&["man", "-o", text(&dir)], 0);
    assert!(std::fs::read_to_string(dir.join("sat-recon-export.1")).unwrap().contains("Metashape"));
    std::fs::remove_dir_all(dir).unwrap();
}
