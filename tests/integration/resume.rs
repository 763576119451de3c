//! Ctrl-C and kill -9 at any time: a second run continues and ends with the same bytes.

use super::support::{expect_code, folder, sample, text};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const TINY: [&str; 10] = [
    "--frames",
    "20",
    "--max-size",
    "240",
    "--iterations",
    "400",
    "--max-gaussians",
    "10000",
    "--checkpoint-every",
    "50",
];

fn start(input: &Path, out: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_sat-recon"))
        .args([text(input), "-o", text(out)])
        .args(TINY)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Waits until `done` holds or the program has ended by itself.
fn wait_until(child: &mut Child, done: impl Fn() -> bool) {
    let begun = Instant::now();
    while !done() && child.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(300), "the program hangs");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn has_checkpoint(out: &Path) -> bool {
    let files = std::fs::read_dir(out.join(".stages/train"));
    files.is_ok_and(|f| f.filter_map(Result::ok).any(|e| e.file_name() != "fingerprint"))
}

#[test]
fn killed_in_every_stage_a_run_ends_with_the_same_splat() {
    let input = sample("sample/orbit.mp4");
    let dir = folder("killed");
    let whole = dir.join("whole");
    expect_code(&[&[text(&input), "-o", text(&whole)][..], &TINY].concat(), 0);

    let out = dir.join("out");
    let in_frames = || out.join(".stages/frames.log").exists();
    let in_sfm = || out.join(".stages/sfm.log").exists();
    let in_train = || has_checkpoint(&out);
    let moments: [&dyn Fn() -> bool; 3] = [&in_frames, &in_sfm, &in_train];
    for moment in moments {
        let mut child = start(&input, &out);
        wait_until(&mut child, moment);
        child.kill().unwrap(); // SIGKILL
        child.wait().unwrap();
    }
    expect_code(&["run", text(&out)], 0);
    for file in ["splat.ply", "sparse/0/images.bin", "sparse/0/points3D.bin"] {
        assert_eq!(
            std::fs::read(out.join(file)).unwrap(),
            std::fs::read(whole.join(file)).unwrap(),
            "{file}"
        );
    }
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn ctrl_c_in_training_keeps_a_checkpoint_and_the_next_run_goes_on() {
    let input = sample("sample/orbit.mp4");
    let dir = folder("ctrl_c");
    let out = dir.join("out");
    let mut child = start(&input, &out);
    wait_until(&mut child, || out.join(".stages/train.log").exists());
    std::thread::sleep(Duration::from_millis(300));
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let status = child.wait().unwrap();
    if !out.join("splat.ply").exists() {
        assert_eq!(status.code(), Some(1));
        assert!(has_checkpoint(&out), "a cancelled training leaves a checkpoint");
    }
    let said = expect_code(&["run", text(&out)], 0);
    assert!(said.contains("as before"), "{said}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_full_disk_is_reported_and_leaves_no_half_written_file() {
    let dir = folder("full");
    let mounted =
        Command::new("mount").args(["-t", "tmpfs", "-o", "size=300k", "tmpfs", text(&dir)]).output();
    if !mounted.is_ok_and(|m| m.status.success()) {
        return eprintln!("SKIPPED: mounting a small file system needs privileges");
    }
    let out = dir.join("out");
    let said = expect_code(&["frames", text(&sample("sample/orbit.mp4")), "-o", text(&out)], 1);
    Command::new("umount").arg(&dir).status().unwrap();
    assert!(said.contains("space") || said.contains("write"), "{said}");
}
