use super::*;
use std::fs;

/// A fresh output folder, removed at the end.
struct Out(PathBuf);

impl Out {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sat-recon-stage-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }

    fn read(&self, name: &str) -> Option<String> {
        fs::read_to_string(self.0.join(name)).ok()
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(&self.0)
            .unwrap()
            .chain(fs::read_dir(self.0.join(".stages")).unwrap())
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

impl Drop for Out {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const OWNS: [&str; 3] = ["images", "deep/0", "extra"];

fn stage<'a>(fingerprint: &'a str) -> StageSpec<'a> {
    StageSpec { name: "frames", fingerprint, owns: &OWNS }
}

/// Writes the text into two of the outputs and into the third only where it is `extra`.
fn write(folder: &Path, text: &str) -> Result<String> {
    for name in ["images/a", "deep/0/b"] {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap())?;
        fs::write(path, text)?;
    }
    if text == "extra" {
        fs::write(folder.join("extra"), text)?;
    }
    Ok(text.to_owned())
}

#[test]
fn a_stage_runs_once_for_one_fingerprint_and_again_for_another() {
    let out = Out::new("once");
    let stages = Stages::open(&out.0).unwrap();
    for (print, text, ran) in [("a", "extra", true), ("a", "unused", false), ("b", "two", true)] {
        let done = stages.run(&stage(print), |folder| write(folder, text)).unwrap();
        assert_eq!((done.ran, &done.changed), (ran, &None), "{text}");
        assert_eq!(out.read("images/a"), Some(done.finished.value));
    }
    assert_eq!(out.read("deep/0/b").as_deref(), Some("two"));
    assert_eq!(out.read("extra"), None, "what a stage does not write again is no longer there");
}

#[test]
fn outputs_that_were_deleted_emptied_or_changed_are_made_again_and_copies_are_known() {
    let out = Out::new("changed");
    let stages = Stages::open(&out.0).unwrap();
    let run = || stages.run(&stage("a"), |folder| write(folder, "text")).unwrap();
    run();
    let path = out.0.join("images/a");
    let damages: [(&str, &dyn Fn()); 4] = [
        ("is missing", &|| fs::remove_file(&path).unwrap()),
        ("is missing", &|| fs::remove_dir_all(out.0.join("images")).unwrap()),
        ("has changed", &|| fs::write(&path, "").unwrap()),
        ("has changed", &|| fs::write(&path, "else").unwrap()),
    ];
    for (words, damage) in damages {
        damage();
        let done = run();
        assert!(done.ran && done.changed.is_some_and(|c| c.contains(words)), "{words}");
        assert_eq!(out.read("images/a").as_deref(), Some("text"));
    }
    fs::write(&path, "text").unwrap(); // as `cp` leaves it: another time
    assert!(!run().ran);
}

#[test]
fn a_failed_stage_leaves_the_earlier_result_and_its_record() {
    let out = Out::new("failed");
    let stages = Stages::open(&out.0).unwrap();
    stages.run(&stage("a"), |folder| write(folder, "one")).unwrap();
    let failed = stages.run(&stage("b"), |folder| {
        write(folder, "two")?;
        bail!("no")
    });
    assert!(failed.map(|_: Done<String>| ()).is_err());
    assert_eq!(out.read("images/a").as_deref(), Some("one"));
    assert!(!stages.run(&stage("a"), |folder| write(folder, "three")).unwrap().ran);
}

#[test]
fn interrupted_between_any_two_steps_a_commit_is_finished_by_the_next_start() {
    // The states of the folder between the steps of a commit, made by hand.
    let whole = Out::new("steps-whole");
    let stages = Stages::open(&whole.0).unwrap();
    stages.run(&stage("a"), |folder| write(folder, "extra")).unwrap();
    let record = stages.run(&stage("b"), |folder| write(folder, "two")).unwrap().finished;
    for step in 0..6 {
        let out = Out::new(&format!("step{step}"));
        let stages = Stages::open(&out.0).unwrap();
        stages.run(&stage("a"), |folder| write(folder, "extra")).unwrap();
        let (committed, old) = (stages.path("frames.commit"), stages.path("frames.old"));
        write(&committed, "two").unwrap();
        write_json(&committed.join("record.json"), &record).unwrap();
        fs::create_dir_all(old.join("deep")).unwrap();
        let moves = [
            (out.0.join("images"), old.join("images")),
            (committed.join("images"), out.0.join("images")),
            (out.0.join("deep/0"), old.join("deep/0")),
            (committed.join("deep/0"), out.0.join("deep/0")),
            (out.0.join("extra"), old.join("extra")),
        ];
        moves[..step].iter().for_each(|(from, to)| fs::rename(from, to).unwrap());
        drop(stages);
        let stages = Stages::open(&out.0).unwrap();
        assert_eq!(out.read("images/a").as_deref(), Some("two"), "step {step}");
        assert_eq!(out.read("deep/0/b").as_deref(), Some("two"), "step {step}");
        assert_eq!(out.names(), whole.names(), "step {step}");
        assert!(!stages.run(&stage("b"), |folder| write(folder, "x")).unwrap().ran, "step {step}");
    }
}

#[test]
fn what_a_killed_run_left_is_swept_and_the_files_of_others_stay() {
    let out = Out::new("swept");
    drop(Stages::open(&out.0).unwrap());
    for name in [".stages/sfm.new/sparse/0", ".stages/sfm.old/x", ".stages/sfm.commit/x", ".frames.tmp/y"] {
        fs::create_dir_all(out.0.join(name)).unwrap();
    }
    fs::write(out.0.join(".sat-recon-Ab3.tmp"), "half").unwrap();
    fs::write(out.0.join(".other.tmp"), "theirs").unwrap();
    drop(Stages::open(&out.0).unwrap());
    assert_eq!(out.names(), [".other.tmp", ".stages", "lock"]);
}

#[test]
fn two_runs_in_one_folder_are_refused_until_the_first_has_ended() {
    let out = Out::new("two");
    let first = Stages::open(&out.0).unwrap();
    let error = Stages::open(&out.0).unwrap_err().to_string();
    assert!(error.contains("another sat-recon"), "{error}");
    settle(&out.0).unwrap();
    drop(first);
    Stages::open(&out.0).unwrap();
}

#[test]
fn a_folder_with_the_files_of_others_is_refused_and_stays_as_it_was() {
    for name in ["images/mine.jpg", "sparse/0/cameras.bin", "transforms.json", "eval/notes.txt"] {
        let out = Out::new("foreign");
        fs::create_dir_all(out.0.join(name).parent().unwrap()).unwrap();
        fs::write(out.0.join(name), "mine").unwrap();
        for _ in 0..2 {
            let error = Stages::open(&out.0).unwrap_err().to_string();
            assert!(error.contains("not written by sat-recon"), "{error}");
        }
        assert!(!out.0.join(".stages").exists());
    }
    let out = Out::new("empty");
    fs::create_dir_all(out.0.join("images")).unwrap();
    Stages::open(&out.0).unwrap();
}

#[test]
fn cleaning_keeps_results_and_refuses_other_folders_and_runs_at_work() {
    let out = Out::new("clean");
    fs::create_dir_all(&out.0).unwrap();
    assert!(clean(&out.0).unwrap_err().to_string().contains("no output folder"));
    let stages = Stages::open(&out.0).unwrap();
    stages.run(&stage("a"), |folder| write(folder, "one")).unwrap();
    for name in [".stages/sfm.new/sparse", ".stages/train", ".frames.tmp"] {
        fs::create_dir_all(out.0.join(name)).unwrap();
    }
    assert!(clean(&out.0).unwrap_err().to_string().contains("another sat-recon"));
    drop(stages);
    clean(&out.0).unwrap();
    assert_eq!(out.names(), [".stages", "deep", "frames.json", "images", "lock"]);
}

/// What reads it fails, in another way than where nothing is there.
fn make_unreadable(path: &Path) {
    fs::rename(path, path.with_extension("aside")).unwrap();
    fs::create_dir(path).unwrap();
}

fn make_readable(path: &Path) {
    fs::remove_dir(path).unwrap();
    fs::rename(path.with_extension("aside"), path).unwrap();
}

/// The error of a run that must not do its work.
fn refused(stages: &Stages) -> String {
    let run = stages.run(&stage("a"), |_| -> Result<String> { panic!("the work is done again") });
    format!("{:#}", run.unwrap_err())
}

#[test]
fn a_record_that_cannot_be_read_is_told_and_its_work_is_not_done_again() {
    let out = Out::new("unreadable-record");
    let stages = Stages::open(&out.0).unwrap();
    stages.run(&stage("a"), |folder| write(folder, "one")).unwrap();
    let record = stages.path("frames.json");
    make_unreadable(&record);
    assert!(refused(&stages).contains("frames.json"));
    assert!(last::<String>(&out.0, "frames").is_err());
    make_readable(&record);
    assert!(!stages.run(&stage("a"), |folder| write(folder, "two")).unwrap().ran);
    fs::write(&record, "{").unwrap();
    assert!(last::<String>(&out.0, "frames").unwrap().is_none(), "a damaged record is no result");
}

#[test]
fn a_committed_result_whose_record_cannot_be_read_is_kept() {
    let out = Out::new("unreadable-commit");
    let stages = Stages::open(&out.0).unwrap();
    let record = stages.run(&stage("a"), |folder| write(folder, "two")).unwrap().finished;
    stages.retire("frames", &OWNS).unwrap();
    let committed = stages.path("frames.commit");
    write(&committed, "two").unwrap();
    write_json(&committed.join("record.json"), &record).unwrap();
    drop(stages);
    make_unreadable(&committed.join("record.json"));
    assert!(format!("{:#}", Stages::open(&out.0).unwrap_err()).contains("record.json"));
    make_readable(&committed.join("record.json"));
    let stages = Stages::open(&out.0).unwrap();
    assert_eq!(out.read("images/a").as_deref(), Some("two"));
    assert!(!stages.run(&stage("a"), |folder| write(folder, "x")).unwrap().ran);
}

#[cfg(target_os = "linux")]
#[test]
fn an_output_that_cannot_be_read_is_told_and_not_made_again() {
    let out = Out::new("unreadable-output");
    let stages = Stages::open(&out.0).unwrap();
    stages.run(&stage("a"), |folder| write(folder, "")).unwrap();
    let path = out.0.join("images/a");
    fs::remove_file(&path).unwrap();
    // An empty file of another time, of which no byte can be read.
    std::os::unix::fs::symlink("/proc/self/mem", &path).unwrap();
    assert!(refused(&stages).contains("images/a"));
}

#[test]
fn what_a_stage_keeps_stays_where_its_owner_cannot_be_read() {
    let out = Out::new("unreadable-owner");
    let stages = Stages::open(&out.0).unwrap();
    let kept = stages.keep("train", "a").unwrap();
    fs::write(kept.join("checkpoint"), "hours").unwrap();
    make_unreadable(&kept.join("fingerprint"));
    assert!(format!("{:#}", stages.keep("train", "a").unwrap_err()).contains("fingerprint"));
    make_readable(&kept.join("fingerprint"));
    assert_eq!(fs::read_to_string(stages.keep("train", "a").unwrap().join("checkpoint")).unwrap(), "hours");
    assert!(!stages.keep("train", "b").unwrap().join("checkpoint").exists(), "another training's");
}
