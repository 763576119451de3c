//! One target, many files.

use crate::meter::measured;
use crate::mutate::mutate;
use crate::targets::{Reader, Target};
use nix::time::{ClockId, clock_gettime};
use rand::Rng;
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

/// Files that were taken and are mutated further, at most. Source: chosen by hand; a few changes of
/// every part of the small seeds.
const POOL: usize = 64;

/// Runs the target on its seeds, its regressions, mutations of them, and mutations of what it took.
pub fn run(target: &Target, until: Until, seed: u64) -> Told {
    let work = work_folder(target.name);
    let mut corpus = vec![seed_files(target, &work)];
    let longest = 4 * size_of(&corpus[0]);
    corpus.extend(regressions(target));
    let mut told = Told::default();
    let kept = corpus.len();
    for files in &corpus {
        execute(target, &work, files, &mut told);
    }
    let mut rng = scene::rng::rng(seed, target.name, 0);
    let begun = Instant::now();
    let mut files = Files::new();
    while told.failures.len() < 10 {
        let goes_on = match until {
            // The clock is not asked at each of millions of executions a second.
            Until::Time(limit) => !told.executions.is_multiple_of(64) || begun.elapsed() < limit,
            Until::Count(count) => told.executions < count,
        };
        if !goes_on {
            break;
        }
        copy(&corpus[rng.random_range(0..corpus.len())], &mut files);
        let others = &corpus[rng.random_range(0..corpus.len())];
        let (at, from) = (rng.random_range(0..files.len()), rng.random_range(0..others.len()));
        mutate(&mut files[at].1, &others[from].1, &mut rng);
        let is_taken = execute(target, &work, &files, &mut told);
        if is_taken && rng.random_range(0..POOL) == 0 && size_of(&files) <= longest {
            if corpus.len() < kept + POOL {
                corpus.push(files.clone());
            } else {
                copy(&files, &mut corpus[kept + rng.random_range(0..POOL)]);
            }
        }
    }
    told.seconds = begun.elapsed().as_secs_f64();
    let _ = fs::remove_dir_all(&work); // it lies among the temporary files
    told
}

/// The files of a data set: names and contents.
pub type Files = Vec<(PathBuf, Vec<u8>)>;

fn size_of(files: &Files) -> usize {
    files.iter().map(|(_, bytes)| bytes.len()).sum()
}

/// Copies contents; the memory that the copy has is used again.
fn copy(from: &Files, to: &mut Files) {
    if to.len() != from.len() {
        to.clone_from(from);
        return;
    }
    for ((name, bytes), (new_name, new_bytes)) in to.iter_mut().zip(from) {
        if name != new_name {
            name.clone_from(new_name);
        }
        bytes.clone_from(new_bytes);
    }
}

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

/// Reads the files once; whether they were taken.
fn execute(target: &Target, work: &Path, files: &Files, told: &mut Told) -> bool {
    if let Reader::Folder(_) = target.read {
        for (name, bytes) in files {
            fs::write(work.join(name), bytes).expect("a file in the work folder");
        }
    }
    let size = size_of(files);
    let limit = TIME_A_KB * (1 + size as u32 / 1024);
    let read = || {
        catch_unwind(AssertUnwindSafe(|| match target.read {
            Reader::Memory(read) => read(files),
            Reader::Folder(read) => read(work),
        }))
    };
    let begun = Instant::now();
    let (outcome, memory) = measured(read);
    let took = begun.elapsed();
    told.executions += 1;
    let is_taken = matches!(outcome, Ok(true));
    told.accepted += u64::from(is_taken);
    let failure = if outcome.is_err() {
        "panics".to_owned()
    } else if took > limit && processor_time(read) > limit {
        format!("takes {took:?} for {size} bytes")
    } else if memory > MEMORY_FLOOR + MEMORY_RATIO * size {
        format!("uses {memory} bytes of memory for {size} bytes")
    } else {
        return is_taken;
    };
    told.failures.push(format!("{failure}: {}", keep(target, files, told.executions).display()));
    false
}

/// What `work` takes of this thread's time alone: others may have the processor, too.
fn processor_time<T>(work: impl FnOnce() -> T) -> Duration {
    let now = || clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map(Duration::from).unwrap_or_default();
    let before = now();
    work();
    now().saturating_sub(before)
}

/// Writes what failed into a folder of its own.
fn keep(target: &Target, files: &Files, execution: u64) -> PathBuf {
    let name = scene::rng::rng(size_of(files) as u64, target.name, execution).random::<u64>();
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("failures").join(target.name);
    let kept = kept.join(format!("{name:016x}"));
    fs::create_dir_all(&kept).expect("a folder for the failure");
    for (name, bytes) in files {
        let path = kept.join(name);
        fs::create_dir_all(path.parent().unwrap_or(&kept)).expect("a folder for the failure");
        fs::write(path, bytes).expect("a file of the failure");
    }
    kept
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
