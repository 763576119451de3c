//! Killed, or out of disk space, or unable to read, at chosen calls to the file system: a second
//! run ends with the same bytes. `make crash-test` takes every call.

use super::support::{folder, sample, text};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// As little work as still has all stages; one thread, so that calls come in one order.
const TINY: &str = "--threads 1 --frames 10 --max-size 140 --iterations 20 --max-gaussians 1500 \
    --checkpoint-every 8 --max-features 500";

/// Calls that are tried of one kind.
const FEW: usize = 6;

struct Harness {
    dir: PathBuf,
    fault: PathBuf,
    input: PathBuf,
}

impl Harness {
    /// Builds the tracer; `None` (said loudly) where it cannot work.
    fn new(name: &str) -> Option<Self> {
        let dir = folder(name);
        let fault = dir.join("fault");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/fault.c");
        let built = Command::new("cc").args(["-O1", "-o", text(&fault), text(&source)]).output();
        let harness = Self { dir, fault, input: sample("sample/orbit.mp4") };
        let works = built.is_ok_and(|b| b.status.success())
            && harness.traced(&harness.dir, &["count"], &["--version".to_owned()]).status.code() == Some(0);
        if !works {
            assert!(std::env::var_os("CI").is_none(), "CI must have a C compiler and allow tracing");
            eprintln!("SKIPPED: needs a C compiler, Linux on x86-64 and permission to trace");
        }
        works.then_some(harness)
    }

    fn traced(&self, out: &Path, mode: &[&str], arguments: &[String]) -> Output {
        std::fs::create_dir_all(out).unwrap();
        self.traced_at(out, mode, arguments)
    }

    /// Runs the program; calls that touch the folder `watched` are counted.
    fn traced_at(&self, watched: &Path, mode: &[&str], arguments: &[String]) -> Output {
        Command::new(&self.fault)
            .args([text(watched), text(&self.dir.join("log"))])
            .args(mode)
            .arg(env!("CARGO_BIN_EXE_sat-recon"))
            .args(arguments)
            .output()
            .unwrap()
    }

    fn arguments(&self, out: &Path, more: &str) -> Vec<String> {
        let flags = TINY.split_whitespace().chain(more.split_whitespace()).map(str::to_owned);
        [text(&self.input), "-o", text(out)].map(str::to_owned).into_iter().chain(flags).collect()
    }

    /// Runs to the end; what the folder holds then.
    fn whole(&self, out: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let run =
            Command::new(env!("CARGO_BIN_EXE_sat-recon")).args(self.arguments(out, "")).output().unwrap();
        assert!(has_ended(&run), "{}", String::from_utf8_lossy(&run.stderr));
        let mut files = BTreeMap::new();
        collect(out, Path::new(""), &mut files);
        files
    }

    /// The calls that a run makes, as the log lists them; those that are tried.
    fn chosen(&self, out: &Path, mode: &str, more: &str) -> Vec<usize> {
        let counted = self.traced(out, &[mode], &self.arguments(out, more));
        assert!(has_ended(&counted), "{}", String::from_utf8_lossy(&counted.stderr));
        let calls = std::fs::read_to_string(self.dir.join("log")).unwrap().lines().count();
        assert!(calls > 50, "{calls} calls");
        (1..=FEW).map(|i| 1 + i * (calls - 1) / FEW - calls / (3 * FEW)).collect()
    }

    fn last_call(&self) -> String {
        let log = std::fs::read_to_string(self.dir.join("log")).unwrap_or_default();
        log.lines().last().unwrap_or("none").to_owned()
    }
}

impl Drop for Harness {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// Whether a run came to its end. What ten small frames and so short a training make is doubtful.
fn has_ended(run: &Output) -> bool {
    matches!(run.status.code(), Some(0 | 3))
}

/// Every file below a folder; of those that hold times or logs only that they are there.
fn collect(out: &Path, name: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in std::fs::read_dir(out.join(name)).unwrap() {
        let path = name.join(entry.unwrap().file_name());
        if out.join(&path).is_dir() {
            collect(out, &path, files);
            continue;
        }
        let varies = path.starts_with(".stages")
            || ["run.json", "report.html", "view.html", "eval/metrics.json"]
                .iter()
                .any(|v| path.ends_with(v));
        let bytes = if varies { Vec::new() } else { std::fs::read(out.join(&path)).unwrap() };
        files.insert(path, bytes);
    }
}

fn expect_same(found: &BTreeMap<PathBuf, Vec<u8>>, wanted: &BTreeMap<PathBuf, Vec<u8>>, what: &str) {
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(found), names(wanted), "{what}");
    let differ: Vec<_> = found.iter().filter(|(name, bytes)| wanted[*name] != **bytes).map(|f| f.0).collect();
    assert!(differ.is_empty(), "{what}: {differ:?}");
}

#[test]
fn killed_at_any_call_a_run_ends_with_the_same_bytes() {
    let Some(harness) = Harness::new("killed_at") else { return };
    let out = harness.dir.join("out");
    let wanted = harness.whole(&harness.dir.join("whole"));
    let calls = harness.chosen(&out, "count", "");
    for call in calls {
        std::fs::remove_dir_all(&out).unwrap();
        harness.traced(&out, &["kill", &call.to_string()], &harness.arguments(&out, ""));
        let what = format!("killed before {}", harness.last_call());
        expect_same(&harness.whole(&out), &wanted, &what);
    }
}

#[test]
fn a_run_with_other_flags_killed_at_any_call_leaves_nothing_in_the_result_of_the_first() {
    let Some(harness) = Harness::new("other_flags") else { return };
    let out = harness.dir.join("out");
    let other = "--max-size 120 --iterations 10";
    let calls = harness.chosen(&out, "count", other);
    let wanted = harness.whole(&out);
    for call in calls {
        harness.traced(&out, &["kill", &call.to_string()], &harness.arguments(&out, other));
        let what = format!("killed before {}", harness.last_call());
        expect_same(&harness.whole(&out), &wanted, &what);
    }
}

#[test]
fn a_full_disk_at_any_call_is_told_and_with_room_again_the_run_ends_with_the_same_bytes() {
    let Some(harness) = Harness::new("full_disk") else { return };
    let out = harness.dir.join("out");
    let wanted = harness.whole(&harness.dir.join("whole"));
    for call in harness.chosen(&out, "count", "") {
        std::fs::remove_dir_all(&out).unwrap();
        let run = harness.traced(&out, &["full", &call.to_string()], &harness.arguments(&out, ""));
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        let code = run.status.code();
        let is_told = code == Some(1) && said.contains("No space left") && said.contains("error: ");
        assert!(is_told || has_ended(&run), "call {call}: {code:?} {said}");
        expect_same(&harness.whole(&out), &wanted, &format!("call {call}"));
    }
}

#[test]
fn a_file_that_cannot_be_read_is_told_and_when_it_can_the_run_ends_with_the_same_bytes() {
    let Some(harness) = Harness::new("unreadable") else { return };
    let out = harness.dir.join("out");
    let wanted = harness.whole(&harness.dir.join("whole"));
    for call in harness.chosen(&out, "count-reads", "") {
        std::fs::remove_dir_all(&out).unwrap();
        let run = harness.traced(&out, &["read", &call.to_string()], &harness.arguments(&out, ""));
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        let code = run.status.code();
        let is_told = code == Some(1) && said.contains("error: ");
        assert!(is_told || has_ended(&run), "call {call}: {code:?} {said}");
        expect_same(&harness.whole(&out), &wanted, &format!("call {call}: {}", harness.last_call()));
    }
}

#[test]
fn a_read_that_fails_once_does_not_make_a_finished_run_do_its_work_again() {
    let Some(harness) = Harness::new("finished") else { return };
    let out = harness.dir.join("out");
    let wanted = harness.whole(&out);
    let records = || {
        let entries = std::fs::read_dir(out.join(".stages")).unwrap().map(|e| e.unwrap());
        // Every run writes its arguments.
        let is_record = |name: &str| name.ends_with(".json") && name != "args.json";
        let ours = entries.filter(|e| is_record(&e.file_name().to_string_lossy()));
        ours.map(|e| (e.file_name(), e.metadata().unwrap().modified().unwrap())).collect::<BTreeMap<_, _>>()
    };
    let before = records();
    for call in harness.chosen(&out, "count-reads", "") {
        let run = harness.traced(&out, &["read", &call.to_string()], &harness.arguments(&out, ""));
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        let is_told = run.status.code() == Some(1) && said.contains("error: ");
        let what = format!("call {call}: {} {said}", harness.last_call());
        assert!(is_told || has_ended(&run), "{what}");
        assert_eq!(records(), before, "{what}");
    }
    expect_same(&harness.whole(&out), &wanted, "after all");
}

#[test]
fn a_video_that_cannot_be_read_whole_is_told_and_never_used_in_part() {
    let Some(harness) = Harness::new("video_reads") else { return };
    let input = harness.input.parent().unwrap();
    let frames_with = |name: &str, mode: &[&str]| {
        let out = harness.dir.join(name);
        let arguments =
            ["frames", text(&harness.input), "-o", text(&out), "--frames", "10", "--max-size", "140"];
        let run = harness.traced_at(input, mode, &arguments.map(str::to_owned));
        let mut files = BTreeMap::new();
        if run.status.success() {
            collect(&out, Path::new(""), &mut files);
        }
        (run, files)
    };
    let (counted, wanted) = frames_with("whole", &["count-reads"]);
    assert!(counted.status.success(), "{}", String::from_utf8_lossy(&counted.stderr));
    let calls = std::fs::read_to_string(harness.dir.join("log")).unwrap().lines().count();
    let mut told = 0;
    for call in (1..=calls).step_by(calls / (4 * FEW) + 1) {
        let (run, found) = frames_with(&format!("out{call}"), &["read", &call.to_string()]);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        if run.status.code() == Some(1) && said.contains("error: ") {
            told += 1;
            continue;
        }
        assert!(run.status.success(), "call {call} of {calls}: {said}");
        expect_same(&found, &wanted, &format!("call {call} of {calls}: {said}"));
    }
    assert!(told > FEW, "{told} of the reads of {calls} failed");
}
