//! What was measured of other tools: `data/bench/peers.json`, or a file like it.

use super::point::Point;
use anyhow::{Context, Result};
use serde::Deserialize;
use std::path::Path;

/// The figures that come with the program.
const KNOWN: &str = include_str!("../../data/bench/peers.json");

/// Figures of one data set.
#[derive(Deserialize)]
struct Peers {
    /// A folder of this name lies on the input's path.
    dataset: String,
    /// Where, when and how they were measured.
    source: String,
    points: Vec<Point>,
}

/// What is known of other tools on this input, and where it is from: by the names of the folders on
/// its path, or everything in `file`.
pub(crate) fn of(input: &Path, file: Option<&Path>) -> Result<Option<(Vec<Point>, String)>> {
    let mut all: Vec<Peers> = match file {
        Some(path) => {
            let text =
                std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
            serde_json::from_str(&text)
                .with_context(|| format!("{} is not a table of peers", path.display()))?
        }
        None => serde_json::from_str(KNOWN).context("the table of peers is damaged")?,
    };
    if file.is_none() {
        let absolute = std::path::absolute(input).unwrap_or_else(|_| input.to_path_buf());
        all.retain(|p| absolute.components().any(|c| c.as_os_str() == p.dataset.as_str()));
    }
    let source = all.iter().map(|p| p.source.clone()).collect::<Vec<_>>().join("; ");
    let points: Vec<Point> = all.into_iter().flat_map(|p| p.points).collect();
    Ok((!points.is_empty()).then_some((points, source)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_data_set_has_its_own_peers_and_another_has_none() {
        let (points, source) = of(Path::new("data/fox_undistorted_640"), None).unwrap().unwrap();
        assert_eq!(points.len(), 12);
        assert!(
            points.iter().any(|p| p.psnr == 25.12 && p.cpu_s == Some(230.0)) && source.contains("2-core")
        );
        assert_eq!(of(Path::new("/x/temple_ring/images"), None).unwrap().unwrap().0.len(), 2);
        assert!(of(Path::new("/x/fox"), None).unwrap().is_none());
        assert!(of(Path::new("/x"), Some(Path::new("/no/such/file"))).is_err());
    }
}
