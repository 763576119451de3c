//! Training interrupted and resumed: Gaussians, moments, statistics and the place in the schedule.
//!
//! File: magic, length of the header (u64, little endian), header (JSON), arrays of f32 (little
//! endian) in the order of `arrays`, CRC-32 of all that (u32, little endian). Written beside its
//! target and renamed, so that what exists is whole.

use super::rules::Rules;
use super::state::TrainingState;
use crate::error::SplatError;
use crate::model::{GEOMETRY, MAX_SH_DEGREE, Model, padded};
use crate::statistics::Statistics;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Begins the file. Source: this format, in its fifth version.
const MAGIC: &str = "SPLATCK5";

/// Name of the file in the checkpoint folder.
pub(crate) const FILE: &str = "training.checkpoint";

#[derive(Serialize, Deserialize)]
struct CheckpointHeader {
    state: TrainingState,
    rules: Rules,
    len: usize,
    sh_degree: u32,
    #[serde(default)]
    part: Vec<u8>,
}

/// A checkpoint in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Checkpoint {
    /// Place in the schedule, and what was noted on the way.
    pub(super) state: TrainingState,
    /// States of the rules.
    pub(super) rules: Rules,
    /// Gaussians and moments.
    pub(super) model: Model,
    /// Sums since the last densification.
    pub(super) statistics: Statistics,
}

/// All arrays of a checkpoint, in file order.
fn arrays<'a>(model: &'a Model, statistics: &'a Statistics) -> Vec<&'a [f32]> {
    let Model { geometry, geometry_m, geometry_v, sh, sh_v, steps, .. } = model;
    let Statistics { gradient, visible } = statistics;
    let planes = geometry.iter().chain(geometry_m).chain(geometry_v).chain(sh_v);
    planes.chain([sh, steps, gradient, visible]).map(Vec::as_slice).collect()
}

/// The same, to be filled.
fn arrays_mut<'a>(model: &'a mut Model, statistics: &'a mut Statistics) -> Vec<&'a mut Vec<f32>> {
    let Model { geometry, geometry_m, geometry_v, sh, sh_v, steps, .. } = model;
    let mut all: Vec<&mut Vec<f32>> = Vec::new();
    all.extend(geometry.iter_mut().chain(geometry_m).chain(geometry_v).chain(sh_v));
    all.extend([sh, steps]);
    all.extend([&mut statistics.gradient, &mut statistics.visible]);
    all
}

/// Writes a checkpoint into the folder (created if missing), atomically.
pub(super) fn write(
    (state, rules): (&TrainingState, &Rules),
    model: &Model,
    statistics: &Statistics,
    folder: &Path,
) -> Result<(), SplatError> {
    let path = folder.join(FILE);
    write_file(&path, (state, rules), model, statistics)
        .map_err(|source| SplatError::CheckpointWrite { path, source })
}

fn write_file(
    path: &Path,
    (state, rules): (&TrainingState, &Rules),
    model: &Model,
    statistics: &Statistics,
) -> std::io::Result<()> {
    let (state, rules) = (state.clone(), rules.clone());
    let Model { len, sh_degree, .. } = *model;
    let header = CheckpointHeader { state, rules, len, sh_degree, part: model.part.clone() };
    let header = serde_json::to_vec(&header)?;
    std::fs::create_dir_all(path.parent().unwrap_or(path))?;
    let partial = path.with_extension("partial");
    let mut file = std::io::BufWriter::new(std::fs::File::create(&partial)?);
    let mut sum = crc32fast::Hasher::new();
    let mut put = |bytes: &[u8]| {
        sum.update(bytes);
        file.write_all(bytes)
    };
    put(MAGIC.as_bytes())?;
    put(&(header.len() as u64).to_le_bytes())?;
    put(&header)?;
    let mut bytes = Vec::new();
    // A piece at a time: an array is as large as the Gaussians are.
    for some in arrays(model, statistics).into_iter().flat_map(|array| array.chunks(4096)) {
        bytes.clear();
        bytes.extend(some.iter().flat_map(|value| value.to_le_bytes()));
        put(&bytes)?;
    }
    file.write_all(&sum.finalize().to_le_bytes())?;
    file.into_inner().map_err(|e| e.into_error())?.sync_all()?;
    std::fs::rename(&partial, path)
}

impl Checkpoint {
    /// Reads the folder's checkpoint; `None` if there is none or it belongs to another
    /// configuration.
    pub(super) fn read(folder: &Path, fingerprint: &str) -> Result<Option<Self>, SplatError> {
        let path = folder.join(FILE);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(unusable(&path, e)),
        };
        let checkpoint = parse(&bytes).map_err(|reason| unusable(&path, reason))?;
        Ok((checkpoint.state.fingerprint == fingerprint).then_some(checkpoint))
    }
}

fn unusable(path: &Path, reason: impl ToString) -> SplatError {
    SplatError::CheckpointRead { path: PathBuf::from(path), reason: reason.to_string() }
}

const SHORT: &str = "it is cut short";

fn parse(bytes: &[u8]) -> Result<Checkpoint, String> {
    if !bytes.starts_with(MAGIC.as_bytes()) {
        return Err("it is not a checkpoint of this version".to_owned());
    }
    let (bytes, sum) = bytes.split_last_chunk::<4>().ok_or(SHORT)?;
    if crc32fast::hash(bytes) != u32::from_le_bytes(*sum) {
        return Err("it is cut short or damaged".to_owned());
    }
    let rest = bytes.get(MAGIC.len()..).ok_or(SHORT)?;
    let (length, rest) = rest.split_first_chunk::<8>().ok_or(SHORT)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|e| e.to_string())?;
    let (header, mut rest) = rest.split_at_checked(length).ok_or(SHORT)?;
    let header: CheckpointHeader = serde_json::from_slice(header).map_err(|e| e.to_string())?;
    if header.sh_degree > MAX_SH_DEGREE || header.len > rest.len() {
        return Err(SHORT.to_owned());
    }
    let CheckpointHeader { len, sh_degree, part, .. } = header;
    let mut model = Model { len, sh_degree, part, ..Model::default() };
    let mut statistics = Statistics::default();
    let (planes, sh) = (padded(model.len), model.len * model.sh_stride());
    for (index, array) in arrays_mut(&mut model, &mut statistics).into_iter().enumerate() {
        // In the order of `arrays`: what comes before the harmonics are planes, and what follows.
        let length = if index == 3 * GEOMETRY + 3 { sh } else { planes };
        let (own, next) = rest.split_at_checked(length * 4).ok_or(SHORT)?;
        *array = own.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
        rest = next;
    }
    if rest.is_empty() {
        Ok(Checkpoint { state: header.state, rules: header.rules, model, statistics })
    } else {
        Err("it is too long".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::schedule::Place;
    use glam::{Quat, Vec3};
    use scene::Gaussians;

    fn example() -> Checkpoint {
        let n = 37;
        let gaussians = Gaussians {
            means: (0..n).map(|i| Vec3::new(i as f32, -0.0, f32::MIN_POSITIVE)).collect(),
            log_scales: vec![Vec3::splat(-3.5); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![f32::NAN; n],
            sh: (0..n * 12).map(|i| i as f32 * 0.1).collect(),
            sh_degree: 1,
        };
        let model = Model::from_gaussians(&gaussians);
        let mut statistics = Statistics::default();
        statistics.reset(n);
        let place = Place { iteration: 7, position: 0.1 + 0.2, ..Place::default() };
        let state = TrainingState { place, fingerprint: "x".to_owned(), ..TrainingState::default() };
        Checkpoint { state, model, statistics, ..Checkpoint::default() }
    }

    fn write_example(folder: &Path) {
        let Checkpoint { state, rules, model, statistics } = example();
        write((&state, &rules), &model, &statistics, folder).unwrap();
    }

    #[test]
    fn a_checkpoint_comes_back_bit_for_bit() {
        let folder = std::env::temp_dir().join(format!("splat-checkpoint-{}", std::process::id()));
        let checkpoint = example();
        write_example(&folder);
        let read = Checkpoint::read(&folder, "x").unwrap().unwrap();
        assert_eq!(read.state, checkpoint.state);
        let bits = |c: &Checkpoint| -> Vec<u32> {
            arrays(&c.model, &c.statistics)
                .into_iter()
                .flat_map(|a| a.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
                .collect()
        };
        assert_eq!(bits(&read), bits(&checkpoint));
        assert!(Checkpoint::read(&folder, "y").unwrap().is_none(), "another configuration starts afresh");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_damaged_checkpoint_is_refused() {
        let folder = std::env::temp_dir().join(format!("splat-damaged-{}", std::process::id()));
        write_example(&folder);
        let bytes = std::fs::read(folder.join(FILE)).unwrap();
        for cut in [0, 4, 12, 40, bytes.len() - 1] {
            assert!(parse(&bytes[..cut]).is_err(), "{cut}");
        }
        assert!(parse(&[bytes.as_slice(), &[0]].concat()).is_err());
        for at in (0..bytes.len()).step_by(97) {
            let mut flipped = bytes.clone();
            flipped[at] ^= 4;
            assert!(parse(&flipped).is_err(), "a bit of byte {at} is wrong");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
