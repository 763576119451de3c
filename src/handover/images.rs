//! Pixels of hand-over sets.

use anyhow::{Context, Result};
use image::{GrayImage, RgbImage, Rgba, RgbaImage};
use rayon::prelude::*;
use scene::{Progress, Reconstruction};
use std::collections::BTreeSet;
use std::path::Path;

/// What becomes of the pixels outside a matte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ground {
    /// They are black: for programs that read three channels.
    Black,
    /// The matte is the alpha channel.
    Alpha,
}

/// Links a file, or copies it where the folders lie on different disks.
pub(super) fn link(source: &Path, target: &Path) -> Result<()> {
    if let Some(folder) = target.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    if std::fs::hard_link(source, target).is_err() {
        std::fs::copy(source, target).with_context(|| format!("cannot write {}", target.display()))?;
    }
    Ok(())
}

/// Puts the masks of `folder/masks` into the pixels of `folder/images`, which become PNG files; the
/// model gets their names.
pub(super) fn burn(
    folder: &Path,
    mut model: Reconstruction,
    ground: Ground,
    progress: &Progress,
) -> Result<Reconstruction> {
    let stems: BTreeSet<String> = model.images.values().map(|i| with_png(&i.name)).collect();
    let unique = stems.len() == model.images.len();
    progress.begin("mattes", model.images.len());
    let images: Vec<_> = model.images.values_mut().collect();
    images.into_par_iter().try_for_each(|image| -> Result<()> {
        progress.tick()?;
        let source = folder.join("images").join(&image.name);
        let mask = folder.join("masks").join(format!("{}.png", image.name));
        let rgb = scene::io::load_rgb(&source)?;
        let mask = mask.is_file().then(|| scene::io::load_mask(&mask)).transpose()?;
        // Linked files of the run are never written into: the new file takes the name.
        std::fs::remove_file(&source)?;
        image.name = if unique { with_png(&image.name) } else { format!("{}.png", image.name) };
        let target = folder.join("images").join(&image.name);
        let saved = match (ground, mask) {
            (Ground::Black, Some(mask)) => over_black(&rgb, &mask).save(&target),
            (Ground::Black, None) => rgb.save(&target),
            (Ground::Alpha, mask) => with_alpha(&rgb, mask.as_ref()).save(&target),
        };
        saved.with_context(|| format!("cannot write {}", target.display()))
    })?;
    Ok(model)
}

fn with_png(name: &str) -> String {
    Path::new(name).with_extension("png").to_string_lossy().into_owned()
}

fn over_black(rgb: &RgbImage, mask: &GrayImage) -> RgbImage {
    let mut black = rgb.clone();
    for (pixel, m) in black.pixels_mut().zip(mask.pixels()) {
        pixel.0 = pixel.0.map(|v| ((u32::from(v) * u32::from(m.0[0]) + 127) / 255) as u8);
    }
    black
}

fn with_alpha(rgb: &RgbImage, mask: Option<&GrayImage>) -> RgbaImage {
    RgbaImage::from_fn(rgb.width(), rgb.height(), |x, y| {
        let [r, g, b] = rgb.get_pixel(x, y).0;
        Rgba([r, g, b, mask.map_or(255, |m| m.get_pixel(x, y).0[0])])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{Pose, PosedImage};

    #[test]
    fn mattes_go_into_the_pixels_and_the_runs_own_files_stay_as_they_are() {
        let dir = std::env::temp_dir().join(format!("sat-recon-burn-{}", std::process::id()));
        for folder in ["images", "masks", "run"] {
            std::fs::create_dir_all(dir.join(folder)).unwrap();
        }
        let pixels = RgbImage::from_pixel(2, 1, image::Rgb([200, 100, 50]));
        pixels.save(dir.join("run/a.png")).unwrap();
        let own = std::fs::read(dir.join("run/a.png")).unwrap();
        let model = || {
            let image = PosedImage {
                id: 1,
                camera: 1,
                name: "a.png".into(),
                pose: Pose::IDENTITY,
                observations: vec![],
            };
            Reconstruction { images: [(1, image)].into(), ..Reconstruction::default() }
        };
        GrayImage::from_raw(2, 1, vec![255, 51]).unwrap().save(dir.join("masks/a.png.png")).unwrap();
        let burnt = |ground| {
            std::fs::remove_file(dir.join("images/a.png")).ok();
            link(&dir.join("run/a.png"), &dir.join("images/a.png")).unwrap();
            let model = burn(&dir, model(), ground, &Progress::silent()).unwrap();
            assert_eq!(model.images[&1].name, "a.png");
            image::open(dir.join("images/a.png")).unwrap()
        };
        assert_eq!(burnt(Ground::Black).to_rgb8().get_pixel(1, 0).0, [40, 20, 10]);
        assert_eq!(burnt(Ground::Alpha).to_rgba8().get_pixel(1, 0).0, [200, 100, 50, 51]);
        assert_eq!(std::fs::read(dir.join("run/a.png")).unwrap(), own);
        std::fs::remove_dir_all(dir).unwrap();
    }
}
