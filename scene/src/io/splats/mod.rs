//! Splat formats other than the 3DGS `.ply`: `.splat`, compressed `.ply`, `.spz`, `.sog`,
//! `.ksplat`, glTF.
//!
//! All but `.ply` lose precision. `.spz` and glTF have y up; clouds are rotated by 180° about x on
//! the way, so that a capture with y down stands upright there.

mod compressed;
mod glb;
mod item;
mod ksplat;
mod plain;
mod ready;
mod sog;
mod spz;

pub use compressed::write_compressed_ply;
pub(super) use glb::write_chunks;
pub use glb::write_splat_glb;
pub use plain::write_dot_splat;
pub use sog::write_sog;
pub use spz::{encode_spz, write_spz};

use super::error::{IoError, read_file};
use super::ply::{Ply, decode_splat_ply, write_splat_ply};
use crate::Gaussians;
use std::path::Path;

/// The formats, by file name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    /// 3DGS `.ply`.
    Ply,
    /// PlayCanvas `.compressed.ply`.
    CompressedPly,
    /// `.splat`.
    Splat,
    /// Niantic `.spz`.
    Spz,
    /// `.ksplat` (read only).
    Ksplat,
    /// PlayCanvas `.sog`.
    Sog,
    /// glTF `.glb` with KHR_gaussian_splatting.
    Glb,
}

impl SplatFormat {
    /// The format a file name asks for.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let formats = [
            (".compressed.ply", Self::CompressedPly),
            (".ply", Self::Ply),
            (".splat", Self::Splat),
            (".spz", Self::Spz),
            (".sog", Self::Sog),
            (".ksplat", Self::Ksplat),
            (".glb", Self::Glb),
        ];
        formats.into_iter().find(|(ending, _)| name.ends_with(ending)).map(|f| f.1)
    }
}

fn unknown(path: &Path, formats: &str) -> IoError {
    IoError::format(path, format!("no splat format is known by this name; use {formats}"))
}

/// Reads a splat in the format its name says (`.ply` may be compressed); one without Gaussians is
/// refused.
pub fn read_splat(path: &Path) -> Result<Gaussians, IoError> {
    parse_splat(path, &read_file(path)?)
}

/// The same, of the file's content. `path` says the format and names the file in messages.
pub fn parse_splat(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let splat = match SplatFormat::of(path) {
        Some(SplatFormat::Ply | SplatFormat::CompressedPly) => parse_ply(path, data)?,
        Some(SplatFormat::Splat) => plain::parse(path, data)?,
        Some(SplatFormat::Spz) => spz::parse(path, data)?,
        Some(SplatFormat::Sog) => sog::parse(path, data)?,
        Some(SplatFormat::Ksplat) => ksplat::parse(path, data)?,
        Some(SplatFormat::Glb) => glb::parse(path, data)?,
        None => return Err(unknown(path, ".ply, .splat, .spz, .sog, .ksplat or .glb")),
    };
    if splat.is_empty() {
        return Err(IoError::format(path, "holds no gaussians; export it again"));
    }
    Ok(splat)
}

fn parse_ply(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let ply = Ply::parse(path, data)?;
    if compressed::is_compressed(&ply) { compressed::decode(&ply) } else { decode_splat_ply(&ply) }
}

/// Writes a splat in the format its name says.
pub fn write_splat(path: &Path, g: &Gaussians) -> Result<(), IoError> {
    g.validate().map_err(|message| IoError::format(path, message))?;
    match SplatFormat::of(path) {
        Some(SplatFormat::Ply) => write_splat_ply(path, g),
        Some(SplatFormat::CompressedPly) => write_compressed_ply(path, g),
        Some(SplatFormat::Splat) => write_dot_splat(path, g),
        Some(SplatFormat::Spz) => write_spz(path, g),
        Some(SplatFormat::Sog) => write_sog(path, g),
        Some(SplatFormat::Glb) => write_splat_glb(path, g),
        Some(SplatFormat::Ksplat) | None => {
            Err(unknown(path, ".ply, .compressed.ply, .splat, .spz, .sog or .glb"))
        }
    }
}
