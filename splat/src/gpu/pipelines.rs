//! Compiled pipelines, kept between runs where the adapter has a cache for them: in the user's
//! cache folder, one file an adapter and driver. A file that is damaged or of another driver is not
//! used, and replaced.

use std::io::Write;
use std::path::{Path, PathBuf};

/// Begins the file; the number is that of its layout. Source: ours.
const MAGIC: &str = "SPLATPC1";

/// The cache of one device.
pub(crate) struct Pipelines {
    cache: wgpu::PipelineCache,
    path: PathBuf,
    /// Bytes that were read.
    read: usize,
}

/// `$XDG_CACHE_HOME` or `~/.cache`.
fn folder() -> Option<PathBuf> {
    let [cache, home] = ["XDG_CACHE_HOME", "HOME"]
        .map(|name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from));
    let base = cache.or_else(|| home.map(|home| home.join(".cache")))?;
    Some(base.join("sat-recon").join("pipelines"))
}

/// FNV-1a (Fowler, Noll, Vo), 64 bits.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
}

/// The contents of a file of ours; nothing where it is missing, cut short or damaged.
fn unpack(file: &[u8]) -> Option<&[u8]> {
    let (sum, data) = file.strip_prefix(MAGIC.as_bytes())?.split_first_chunk::<8>()?;
    (u64::from_le_bytes(*sum) == checksum(data)).then_some(data)
}

/// Writes beside the file and renames, so that what exists is whole.
fn write(path: &Path, data: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let partial = path.with_extension(format!("{}.partial", std::process::id()));
    let mut file = std::fs::File::create(&partial)?;
    file.write_all(MAGIC.as_bytes())?;
    file.write_all(&checksum(data).to_le_bytes())?;
    file.write_all(data)?;
    drop(file);
    std::fs::rename(&partial, path)
}

impl Pipelines {
    /// The cache of an adapter that has one; what was kept is checked by us (whole) and by wgpu
    /// (this adapter and driver).
    pub(crate) fn open(device: &wgpu::Device, info: &wgpu::AdapterInfo) -> Option<Self> {
        Self::at(&folder()?, device, info)
    }

    /// The same in a folder.
    pub(crate) fn at(folder: &Path, device: &wgpu::Device, info: &wgpu::AdapterInfo) -> Option<Self> {
        if !device.features().contains(wgpu::Features::PIPELINE_CACHE) {
            return None;
        }
        let key = wgpu::util::pipeline_cache_key(info)?;
        let path = folder.join(format!("{key}_{}.bin", env!("CARGO_PKG_VERSION")));
        let file = std::fs::read(&path).unwrap_or_default();
        let data = unpack(&file);
        let descriptor = wgpu::PipelineCacheDescriptor { label: Some("splat"), data, fallback: true };
        // SAFETY: the data's checksum says that it is what `get_data` gave to `write`.
        let cache = unsafe { device.create_pipeline_cache(&descriptor) };
        Some(Self { cache, path, read: data.map_or(0, <[u8]>::len) })
    }

    /// For the making of pipelines.
    pub(crate) fn cache(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    /// Keeps what is new. A folder that cannot be written to costs time at the next start, nothing
    /// else.
    pub(crate) fn store(&self) {
        if let Some(data) = self.cache.get_data().filter(|data| data.len() != self.read) {
            let _ = write(&self.path, &data);
        }
    }

    /// Where it is kept.
    #[cfg(test)]
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that were there from earlier runs.
    #[cfg(test)]
    pub(crate) fn kept(&self) -> usize {
        self.read
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_comes_back_and_what_is_damaged_does_not() {
        let folder = std::env::temp_dir().join(format!("splat-pipelines-{}", std::process::id()));
        let path = folder.join("a").join("b.bin");
        let data: Vec<u8> = (0..1000u32).map(|i| (i * i % 251) as u8).collect();
        write(&path, &data).unwrap();
        let file = std::fs::read(&path).unwrap();
        assert_eq!(unpack(&file), Some(&data[..]));
        assert_eq!(
            std::fs::read_dir(path.parent().unwrap()).unwrap().count(),
            1,
            "nothing is left beside it"
        );
        for cut in [0, 7, 12, 16, file.len() - 1] {
            assert_eq!(unpack(&file[..cut]), None, "{cut}");
        }
        for at in [0, 9, 500] {
            let mut damaged = file.clone();
            damaged[at] ^= 1;
            assert_eq!(unpack(&damaged), None, "{at}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
