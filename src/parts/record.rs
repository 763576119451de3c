//! `parts.json`.

use crate::stage::write_json;
use anyhow::{Context, Result};
use scene::Gaussians;
use sfm::Articulation;
use std::path::Path;

/// Its name in the folder of the parts.
const RECORD: &str = "parts.json";

/// Writes it into the folder.
pub(super) fn write(folder: &Path, found: &Articulation) -> Result<()> {
    write_json(&folder.join(RECORD), found)
}

/// Removes the splat and the meshes of parts that were found before: without their record they
/// would look like something that stands still.
pub(super) fn forget_splat(folder: &Path) {
    let before = std::fs::read(folder.join(RECORD)).ok();
    let before = before.and_then(|text| serde_json::from_slice::<Articulation>(&text).ok());
    if before.is_some_and(|parts| !parts.gaussians.is_empty()) {
        for name in ["splat.ply", "parts.glb"] {
            std::fs::remove_file(folder.join(name)).ok();
        }
    }
}

/// The record of a folder with a splat `gaussians` whose parts move, if it is one.
pub(crate) fn read_moving(folder: &Path, gaussians: &Gaussians) -> Result<Option<Articulation>> {
    let path = folder.join(RECORD);
    if !path.is_file() {
        return Ok(None);
    }
    let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let parts: Articulation = serde_json::from_slice(&text)
        .with_context(|| format!("{} is damaged; run sat-recon parts again", path.display()))?;
    if parts.gaussians.is_empty() {
        return Ok(None);
    }
    let fits = parts.gaussians.len() == parts.parts.len() + 1;
    anyhow::ensure!(
        fits && parts.gaussians.iter().sum::<usize>() == gaussians.len(),
        "{} belongs to another splat than the one beside it; run sat-recon parts again",
        path.display()
    );
    Ok(Some(parts))
}

/// The part of each Gaussian of a splat, 0: the body.
pub(crate) fn labels(parts: &Articulation) -> Vec<u8> {
    (0..).zip(&parts.gaussians).flat_map(|(part, &count)| std::iter::repeat_n(part, count)).collect()
}
