//! Stages of the output folder: fingerprints, skipping what is current, costs.

mod commit;
mod cost;
mod listing;
mod lock;
mod there;

pub use cost::{Cost, Meter, free_large_blocks_at_once};
pub use listing::OutputFile;

use anyhow::{Context, Result, bail};
use commit::Workspace;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What is kept of a finished stage, in `.stages/NAME.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Finished<T> {
    /// Stage version, configuration and inputs, hashed.
    pub fingerprint: String,
    /// What it cost when it ran.
    pub cost: Cost,
    /// Paths in the output folder that belong to the stage.
    #[serde(default)]
    pub owns: Vec<String>,
    /// The files that it wrote there.
    #[serde(default)]
    pub outputs: Vec<OutputFile>,
    /// What the following stages need of it.
    pub value: T,
}

impl<T> Finished<T> {
    /// What stages that read the outputs put into their fingerprints.
    pub fn identity(&self) -> Result<String> {
        let contents: Vec<_> = self.outputs.iter().map(|file| (&file.path, &file.hash)).collect();
        fingerprint(&(&self.fingerprint, contents))
    }
}

/// A stage that is to run unless its result is there.
#[derive(Clone, Copy, Debug)]
pub struct StageSpec<'a> {
    /// Its name.
    pub name: &'a str,
    /// Of its version, its configuration and what it reads.
    pub fingerprint: &'a str,
    /// Paths in the output folder that it writes and no other stage does. What it does not write
    /// this time is removed.
    pub owns: &'a [&'a str],
}

/// A stage's result.
#[derive(Debug)]
pub struct Done<T> {
    /// The result.
    pub finished: Finished<T>,
    /// Whether the stage ran.
    pub ran: bool,
    /// Which output was no longer as it was written, so that the stage had to run again.
    pub changed: Option<String>,
}

/// The `.stages` folder of an output folder, locked against other runs.
#[derive(Clone, Debug)]
pub struct Stages {
    out: PathBuf,
    folder: PathBuf,
    _lock: Arc<File>,
}

impl Stages {
    /// Opens (makes) `OUT/.stages` for this process alone and puts right what an interrupted run
    /// has left. Folders with the files of others are refused.
    pub fn open(out: &Path) -> Result<Self> {
        let folder = out.join(".stages");
        lock::refuse_foreign(out, &folder)?;
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let Some(held) = lock::take(&folder)? else {
            bail!(
                "another sat-recon is working in {}; wait until it has ended or choose another folder with -o",
                out.display()
            );
        };
        commit::settle(out, &folder)?;
        Ok(Self { out: out.to_path_buf(), folder, _lock: Arc::new(held) })
    }

    /// The output folder.
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// A path inside the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The log of a stage, begun anew.
    pub fn log(&self, name: &str) -> Option<File> {
        File::create(self.path(&format!("{name}.log"))).ok()
    }

    /// Removes a stage's result: first the record, then what it owns.
    pub fn retire(&self, name: &str, owns: &[&str]) -> Result<()> {
        let outputs = owns.iter().map(|owned| self.out.join(owned));
        std::iter::once(self.path(&format!("{name}.json")))
            .chain(outputs)
            .try_for_each(|path| commit::remove(&path))
    }

    /// Removes what a stage kept in `.stages` for itself.
    pub fn discard(&self, name: &str) -> Result<()> {
        commit::remove(&self.path(name))
    }

    /// The folder in `.stages` for what a stage keeps for itself, emptied where it belongs to
    /// another fingerprint.
    pub fn keep(&self, name: &str, fingerprint: &str) -> Result<PathBuf> {
        let folder = self.path(name);
        let owner = folder.join("fingerprint");
        if there::read(&owner)?.as_deref() != Some(fingerprint.as_bytes()) {
            commit::remove(&folder)?;
            std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
            write_whole(&owner, fingerprint.as_bytes())?;
        }
        Ok(folder)
    }

    /// Runs `work` unless an earlier result is current and whole. `work` writes into the folder it
    /// is given, laid out like the output folder; the result is put in place when it is complete.
    pub fn run<T: Serialize + DeserializeOwned>(
        &self,
        stage: &StageSpec,
        work: impl FnOnce(&Path) -> Result<T>,
    ) -> Result<Done<T>> {
        let known = last::<T>(&self.out, stage.name)?.filter(|k| k.fingerprint == stage.fingerprint);
        let changed = match &known {
            Some(known) => listing::difference(&self.out, &known.outputs)?,
            None => None,
        };
        if let (Some(finished), None) = (known, &changed) {
            return Ok(Done { finished, ran: false, changed });
        }
        let meter = Meter::start();
        let workspace = Workspace::new(&self.folder, stage.name)?;
        let value = work(&workspace.folder())?;
        let finished = Finished {
            fingerprint: stage.fingerprint.to_owned(),
            owns: stage.owns.iter().map(|&owned| owned.to_owned()).collect(),
            outputs: listing::list(&workspace.folder(), stage.owns)?,
            cost: meter.stop(),
            value,
        };
        write_json(&workspace.record(), &finished)?;
        workspace.commit(&self.out)?;
        Ok(Done { finished, ran: true, changed })
    }
}

/// What the last run left of a stage, current or not; `None` where it left nothing, or a record of
/// another version or a damaged one.
pub fn last<T: DeserializeOwned>(out: &Path, name: &str) -> Result<Option<Finished<T>>> {
    let record = there::read(&out.join(".stages").join(format!("{name}.json")))?;
    Ok(record.and_then(|text| serde_json::from_slice(&text).ok()))
}

/// Finishes what an interrupted run has committed, for commands that only read its folder; not
/// where a run is at work there.
pub fn settle(out: &Path) -> Result<()> {
    let folder = out.join(".stages");
    if !folder.is_dir() {
        return Ok(());
    }
    match lock::take(&folder) {
        Ok(Some(_held)) => commit::settle(out, &folder),
        _ => Ok(()),
    }
}

/// Finishes what was committed, and removes everything else that an interrupted run has left:
/// half-made results, temporary files, checkpoints of a training that was not finished.
pub(crate) fn clean(out: &Path) -> Result<()> {
    if !out.join(".stages").is_dir() {
        bail!("{} is no output folder of sat-recon's", out.display());
    }
    Stages::open(out)?.discard("train")
}

/// Hash of anything that serialises: stage name and version (or what tells its sources from those
/// of another build), configuration, fingerprints of what it reads.
pub fn fingerprint(parts: &impl Serialize) -> Result<String> {
    Ok(blake3::hash(&serde_json::to_vec(parts)?).to_hex()[..32].to_owned())
}

/// What identifies an input without reading all of it: names, sizes and times of change.
pub fn describe_input(path: &Path) -> Result<Vec<(String, u64, u128)>> {
    let mut found = Vec::new();
    // The same from any folder.
    let mut folders = vec![std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf())];
    while let Some(current) = folders.pop() {
        let meta =
            std::fs::metadata(&current).with_context(|| format!("cannot read {}", current.display()))?;
        if meta.is_dir() {
            for entry in
                std::fs::read_dir(&current).with_context(|| format!("cannot list {}", current.display()))?
            {
                let entry = entry?;
                if !entry.file_type()?.is_symlink() && !entry.file_name().to_string_lossy().starts_with('.') {
                    folders.push(entry.path());
                }
            }
        } else {
            let changed = meta.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
            found.push((
                current.to_string_lossy().into_owned(),
                meta.len(),
                changed.map_or(0, |d| d.as_nanos()),
            ));
        }
    }
    found.sort();
    Ok(found)
}

/// Writes JSON beside its target and renames when complete.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_whole(path, &serde_json::to_vec_pretty(value)?)
}

/// Writes a file beside its target and renames when complete.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    Ok(scene::io::write_atomic(path, |w| std::io::Write::write_all(w, bytes))?)
}

#[cfg(test)]
mod tests;
