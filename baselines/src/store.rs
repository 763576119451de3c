//! Fields in files: what pictures need (`field.bin`), or all that training goes on from.
//!
//! File: magic, length of the header (u64, little endian), header (JSON), arrays of f32 (little
//! endian), CRC-32 of all that (u32, little endian). Written beside its target and renamed, so that
//! what exists is whole.

use crate::accelerator::Accelerator;
use crate::error::FieldError;
use crate::field::{Kept, RadianceField};
use crate::method::FieldShape;
use crate::train::FieldState;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use splat::{Dataset, NormalisedFrame};
use std::io::Write;
use std::path::Path;

/// Begins the file. Source: this format, in its first version.
const MAGIC: &[u8] = b"SRFIELD1";

/// What a file says before its arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Header {
    pub(crate) shape: FieldShape,
    /// Normalised frame from world.
    pub(crate) frame: NormalisedFrame,
    /// Lengths of the arrays.
    lengths: Vec<usize>,
    /// What else the field keeps.
    notes: Value,
    /// Present where training can go on.
    pub(crate) training: Option<FieldState>,
}

/// Writes a field, atomically; with the state of its training as a checkpoint.
pub(crate) fn write(
    path: &Path,
    shape: FieldShape,
    frame: NormalisedFrame,
    field: &dyn RadianceField,
    training: Option<&FieldState>,
) -> Result<(), FieldError> {
    let kept = if training.is_some() { Kept::Training } else { Kept::Pictures };
    let (arrays, notes) = field.arrays(kept);
    let lengths = arrays.iter().map(|a| a.len()).collect();
    let header = Header { shape, frame, lengths, notes, training: training.cloned() };
    write_file(path, &header, &arrays).map_err(|source| FieldError::Write { path: path.to_owned(), source })
}

fn write_file(path: &Path, header: &Header, arrays: &[&[f32]]) -> std::io::Result<()> {
    let header = serde_json::to_vec(header)?;
    std::fs::create_dir_all(path.parent().unwrap_or(path))?;
    let partial = path.with_extension("partial");
    let mut file = std::io::BufWriter::new(std::fs::File::create(&partial)?);
    let mut sum = crc32fast::Hasher::new();
    let mut bytes = [MAGIC, &(header.len() as u64).to_le_bytes(), &header].concat();
    for array in arrays {
        sum.update(&bytes);
        file.write_all(&bytes)?;
        bytes.clear();
        bytes.extend(array.iter().flat_map(|value| value.to_le_bytes()));
    }
    sum.update(&bytes);
    file.write_all(&bytes)?;
    file.write_all(&sum.finalize().to_le_bytes())?;
    file.into_inner().map_err(|e| e.into_error())?.sync_all()?;
    std::fs::rename(&partial, path)
}

/// Reads a field, to go on by an accelerator; `None` where there is no file. The data set is that
/// of its training, where that goes on; `wanted` says whether it is one to go on with.
pub(crate) fn read(
    path: &Path,
    (dataset, by): (Option<&Dataset>, &Accelerator),
    wanted: impl Fn(&Header) -> bool,
) -> Result<Option<(Header, Box<dyn RadianceField>)>, FieldError> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(unusable(path, e.to_string())),
    };
    let (header, rest) = parse(&bytes).map_err(|reason| unusable(path, reason))?;
    if !wanted(&header) {
        return Ok(None);
    }
    let field = restore(&header, rest, (dataset, by)).map_err(|reason| unusable(path, reason))?;
    Ok(Some((header, field)))
}

fn unusable(path: &Path, reason: String) -> FieldError {
    FieldError::Read { path: path.to_owned(), reason }
}

const SHORT: &str = "it is cut short";

/// The header, and the bytes of the arrays.
fn parse(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let rest = bytes.strip_prefix(MAGIC).ok_or("it is not a field of this version")?;
    let (_, sum) = bytes.split_last_chunk::<4>().ok_or(SHORT)?;
    if crc32fast::hash(&bytes[..bytes.len() - 4]) != u32::from_le_bytes(*sum) {
        return Err("it is cut short or damaged".to_owned());
    }
    let rest = rest.get(..rest.len() - 4).ok_or(SHORT)?;
    let (length, rest) = rest.split_first_chunk::<8>().ok_or(SHORT)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|e| e.to_string())?;
    let (header, rest) = rest.split_at_checked(length).ok_or(SHORT)?;
    let header: Header = serde_json::from_slice(header).map_err(|e| e.to_string())?;
    let values = header.lengths.iter().try_fold(0usize, |sum, &l| sum.checked_add(l));
    if values.and_then(|v| v.checked_mul(4)) != Some(rest.len()) {
        return Err("its arrays are not as long as it says".to_owned());
    }
    if !header.shape.is_sane() {
        return Err("its shape makes no sense".to_owned());
    }
    Ok((header, rest))
}

fn restore(
    header: &Header,
    mut rest: &[u8],
    (dataset, by): (Option<&Dataset>, &Accelerator),
) -> Result<Box<dyn RadianceField>, String> {
    let mut arrays = Vec::new();
    for &length in &header.lengths {
        let (own, next) = rest.split_at_checked(length * 4).ok_or(SHORT)?;
        arrays.push(own.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect());
        rest = next;
    }
    let mut field = header.shape.build(dataset, 0, by).map_err(|e| e.to_string())?;
    let kept = if header.training.is_some() { Kept::Training } else { Kept::Pictures };
    field.restore(kept, arrays, &header.notes)?;
    Ok(field)
}
