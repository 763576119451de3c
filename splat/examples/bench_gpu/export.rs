//! A data set as another trainer reads it with a few lines: `dataset.json` and raw arrays beside
//! it.

use super::Result;
use serde_json::json;
use splat::profile::first_gaussians;
use splat::{AlphaMode, Dataset, TrainConfig};
use std::path::Path;

fn write<T: bytemuck::Pod>(folder: &Path, name: &str, values: &[T]) -> Result<()> {
    Ok(std::fs::write(folder.join(name), bytemuck::cast_slice::<T, u8>(values))?)
}

/// `dataset.json`: for each view its size, focal lengths, principal point, `cam_from_world` (R by
/// rows, t; normalised frame), whether it is held out, and its place in `rgba.bin` (8 bits; alpha
/// is 255 where there is no mask). `means.bin` [N][3], `scales.bin` [N][3], `colours.bin` [N][3]:
/// the Gaussians that our training begins with.
pub(crate) fn export(dataset: &Dataset, config: &TrainConfig, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    let mut rgba: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    for view in &dataset.views {
        let (v, pixels) = (&view.view, &view.levels[0]);
        views.push(json!({
            "name": view.name, "held_out": view.held_out, "size": [v.width, v.height], "offset": rgba.len(),
            "focal": v.focal, "centre": v.centre,
            "rotation": v.rotation.transpose().to_cols_array(), "translation": v.translation.to_array(),
        }));
        for (i, c) in pixels.rgb.chunks_exact(3).enumerate() {
            rgba.extend([c[0], c[1], c[2], pixels.mask.as_ref().map_or(255, |m| m[i])]);
        }
    }
    let first = first_gaussians(dataset, config)?;
    let k = first.sh_coefficients() * 3;
    let colours: Vec<f32> = (0..first.len())
        .flat_map(|i| [first.sh[i * k], first.sh[i * k + 1], first.sh[i * k + 2]])
        .map(|c| 0.5 + 0.282_094_8 * c)
        .collect();
    write(folder, "rgba.bin", &rgba)?;
    write(folder, "means.bin", &first.means)?;
    write(folder, "scales.bin", &first.log_scales.iter().map(|s| s.exp()).collect::<Vec<_>>())?;
    write(folder, "colours.bin", &colours)?;
    let masked = dataset.views.iter().any(|view| view.levels[0].mask.is_some());
    let transparent = masked && dataset.alpha == AlphaMode::Transparent;
    let text = json!({"transparent": transparent, "gaussians": first.len(), "views": views});
    Ok(std::fs::write(folder.join("dataset.json"), text.to_string())?)
}
