//! One target, many files.

use crate::meter::measured;
use crate::mutate::mutate;
use crate::targets::Target;
use rand::Rng;
use rand::seq::IndexedRandom;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What an execution may take for each kilobyte of its files, and at least. Source: issue
/// requirement; a reader does a few operations a byte.
const TIME_A_KB: Duration = Duration::from_secs(1);
/// Bytes that an execution may have in use for each byte of its files. Source: as above.
const MEMORY_RATIO: usize = 64;
/// Bytes that it may have in use whatever its files are. Source: what readers unpack of small files
/// (`scene/src/io/limits.rs`), twice, and room for SQLite's own.
const MEMORY_FLOOR: usize = 32 << 20;

/// How long a target is run.
#[derive(Clone, Copy)]
pub enum Until {
    /// For this time.
    Time(Duration),
    /// So many executions.
    #[cfg_attr(not(test), expect(dead_code, reason = "for the smoke test"))]
    Count(u64),
}

/// What came of it.
#[derive(Default)]
pub struct Told {
    /// Files read.
    pub executions: u64,
    /// Those that the reader took.
    pub accepted: u64,
    /// Seconds that it took.
    pub seconds: f64,
    /// What went wrong.
    pub failures: Vec<String>,
}

/// Runs the target on its seeds, its regressions and mutations of them.
pub fn run(target: &Target, until: Until, seed: u64) -> Told {
    let work = work_folder(target.name);
    let mut corpus = vec![seed_files(target, &work)];
    corpus.extend(regressions(target));
    let mut told = Told::default();
    for files in &corpus {
        execute(target, &work, files, &mut told);
    }
    let mut rng = scene::rng::rng(seed, target.name, 0);
    let begun = Instant::now();
    let goes_on = |told: &Told| match until {
        Until::Time(limit) => begun.elapsed() < limit,
        Until::Count(count) => told.executions < count,
    };
    while goes_on(&told) && told.failures.len() < 10 {
        let mut files = corpus.choose(&mut rng).cloned().unwrap_or_default();
        let others = corpus.choose(&mut rng).cloned().unwrap_or_default();
        let (at, from) = (rng.random_range(0..files.len()), rng.random_range(0..others.len()));
        mutate(&mut files[at].1, &others[from].1, &mut rng);
        execute(target, &work, &files, &mut told);
    }
    told.seconds = begun.elapsed().as_secs_f64();
    let _ = fs::remove_dir_all(&work); // it lies among the temporary files
    told
}

type Files = Vec<(PathBuf, Vec<u8>)>;

fn work_folder(name: &str) -> PathBuf {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
    base.join(format!("sat-recon-fuzz-{name}-{}", std::process::id()))
}

/// Writes the seed and reads its files.
fn seed_files(target: &Target, work: &Path) -> Files {
    let _ = fs::remove_dir_all(work);
    fs::create_dir_all(work).expect("a folder for the files");
    (target.seed)(work);
    read_files(work)
}

/// All files below a folder, by their paths in it.
fn read_files(folder: &Path) -> Files {
    let mut files = Files::new();
    for entry in fs::read_dir(folder).expect("a folder of files").flatten() {
        let name = PathBuf::from(entry.file_name());
        if entry.path().is_dir() {
            files.extend(read_files(&entry.path()).into_iter().map(|(path, bytes)| (name.join(path), bytes)));
        } else {
            files.push((name, fs::read(entry.path()).expect("a file")));
        }
    }
    files.sort();
    files
}

/// Folders of files that failed before.
fn regressions(target: &Target) -> Vec<Files> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("regressions").join(target.name);
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    entries.flatten().map(|entry| read_files(&entry.path())).collect()
}

fn execute(target: &Target, work: &Path, files: &Files, told: &mut Told) {
    for (name, bytes) in files {
        fs::write(work.join(name), bytes).expect("a file in the work folder");
    }
    let size: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
    let begun = Instant::now();
    let (outcome, memory) = measured(|| catch_unwind(AssertUnwindSafe(|| (target.read)(work))));
    let took = begun.elapsed();
    told.executions += 1;
    told.accepted += u64::from(matches!(outcome, Ok(true)));
    let failure = if outcome.is_err() {
        "panics".to_owned()
    } else if took > TIME_A_KB * (1 + size as u32 / 1024) {
        format!("takes {took:?} for {size} bytes")
    } else if memory > MEMORY_FLOOR + MEMORY_RATIO * size {
        format!("uses {memory} bytes of memory for {size} bytes")
    } else {
        return;
    };
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("failures").join(target.name);
    let kept = kept
        .join(format!("{:016x}", scene::rng::rng(size as u64, target.name, told.executions).random::<u64>()));
    fs::create_dir_all(&kept).expect("a folder for the failure");
    for (name, bytes) in files {
        let path = kept.join(name);
        fs::create_dir_all(path.parent().unwrap_or(&kept)).expect("a folder for the failure");
        fs::write(path, bytes).expect("a file of the failure");
    }
    told.failures.push(format!("{failure}: {}", kept.display()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::TARGETS;

    #[test]
    fn no_reader_fails_on_a_few_thousand_mutated_files() {
        let mut failures = Vec::new();
        for target in TARGETS.iter() {
            let told = run(target, Until::Count(target.smoke), 1);
            assert!(told.accepted > 0, "{}: not even the seed is read", target.name);
            assert!(told.accepted < told.executions, "{}: everything is accepted", target.name);
            failures.extend(told.failures.iter().map(|f| format!("{}: {f}", target.name)));
        }
        assert!(failures.is_empty(), "{failures:#?}");
    }
}
