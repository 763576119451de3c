//! `export --for TOOL`: a folder that the tool loads as it is, with nothing in it that would
//! mislead it.

mod images;

use crate::args::Tool;
use crate::record::KnownRun;
use crate::transforms;
use anyhow::{Context, Result, bail};
use images::Ground;
use scene::io::TransformsOptions;
use scene::{Frame, FrameSet, Progress, Reconstruction};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A finished run, as far as it is handed over.
struct Handed {
    folder: PathBuf,
    known: KnownRun,
    model: Reconstruction,
    /// Frames with a pose, as they lie in the folder now.
    frames: FrameSet,
}

/// Writes the set of a run into a new folder; what to type, in the tool's own words.
pub(crate) fn write(run: &Path, tool: Tool, output: &Path, progress: &Progress) -> Result<String> {
    if output.is_dir() && std::fs::read_dir(output)?.next().is_some() {
        bail!("{} is not empty; name a new folder with -o", output.display());
    }
    let handed = Handed::open(run)?;
    scene::io::replace_folder(output, |folder| handed.write(tool, folder, progress))?;
    Ok(handed.advice(tool, output))
}

impl Handed {
    fn open(run: &Path) -> Result<Self> {
        let model = scene::io::read_model(&run.join("sparse/0"))
            .with_context(|| format!("{} is not the output folder of a run with poses", run.display()))?;
        let known = KnownRun::read(run)?;
        let mut frames = known.frames.clone().context("run.json names no frames; run sat-recon again")?;
        let recorded = std::mem::take(&mut frames.frames);
        for frame in &recorded {
            if model.image_named(&frame.name).is_some() {
                frames.frames.push(here(run, frame)?);
            }
        }
        Ok(Self { folder: run.to_path_buf(), known, model, frames })
    }

    fn write(&self, tool: Tool, folder: &Path, progress: &Progress) -> Result<()> {
        let model = match tool {
            Tool::Colmap => self.as_filmed(folder, |name| format!("{name}.png"))?,
            Tool::Metashape => self.as_filmed(folder, |name| {
                format!("{}_mask.png", Path::new(name).with_extension("").display())
            })?,
            Tool::Gs3d | Tool::Gsplat => self.undistorted(folder, Ground::Black, progress)?,
            Tool::Brush | Tool::Nerfstudio => self.undistorted(folder, Ground::Alpha, progress)?,
        };
        match tool {
            Tool::Metashape => scene::io::write_metashape(&folder.join("cameras.xml"), &model)?,
            Tool::Nerfstudio => self.nerfstudio(folder, &model)?,
            _ => scene::io::write_model_bin(&model, &folder.join("sparse/0"))?,
        }
        let database = self.folder.join("database.db");
        if tool == Tool::Colmap && database.is_file() {
            images::link(&database, &folder.join("database.db"))?;
        }
        if tool == Tool::Gs3d {
            std::fs::write(folder.join("sparse/0/test.txt"), self.held_out(&model))?;
        }
        self.times(folder, &model)
    }

    /// Images and masks with the lens' distortion, as the model knows them.
    fn as_filmed(&self, folder: &Path, mask_name: impl Fn(&str) -> String) -> Result<Reconstruction> {
        for frame in &self.frames.frames {
            images::link(&frame.path, &folder.join("images").join(&frame.name))?;
            if let Some(mask) = &frame.mask {
                images::link(mask, &folder.join("masks").join(mask_name(&frame.name)))?;
            }
        }
        Ok(self.model.clone())
    }

    /// PINHOLE images with the mattes in them, and their model.
    fn undistorted(&self, folder: &Path, ground: Ground, progress: &Progress) -> Result<Reconstruction> {
        let model = sfm::undistort(&self.frames, &self.model, folder, progress)?.model;
        std::fs::remove_dir_all(folder.join("sparse"))?;
        let masks = folder.join("masks");
        if !masks.is_dir() {
            return Ok(model);
        }
        let model = images::burn(folder, model, ground, progress)?;
        std::fs::remove_dir_all(masks)?;
        Ok(model)
    }

    fn nerfstudio(&self, folder: &Path, model: &Reconstruction) -> Result<()> {
        let has_cloud = !model.points.is_empty();
        if has_cloud {
            transforms::write_cloud(&folder.join(transforms::CLOUD), model)?;
        }
        let options = TransformsOptions {
            image_folder: "images".into(),
            ply_file_path: has_cloud.then(|| transforms::CLOUD.into()),
            held_out: transforms::held_out(model, &self.known.config.dataset),
            times_s: self.seconds(),
            masks: BTreeMap::new(),
        };
        Ok(scene::io::write_transforms(&folder.join("transforms.json"), model, &options)?)
    }

    /// Times of the frames by image number, seconds.
    fn seconds(&self) -> BTreeMap<u32, f64> {
        let frames = self.frames.frames.iter();
        frames.filter_map(|f| Some((self.model.image_named(&f.name)?.id, f.time_s?))).collect()
    }

    /// `frame_times.csv`, where the frames have times.
    fn times(&self, folder: &Path, model: &Reconstruction) -> Result<()> {
        let seconds = self.seconds();
        if seconds.is_empty() {
            return Ok(());
        }
        let mut table = "image,time_s\n".to_owned();
        for (id, time) in seconds {
            writeln!(table, "{},{time}", model.images[&id].name)?;
        }
        std::fs::write(folder.join("frame_times.csv"), table).context("cannot write frame_times.csv")
    }

    /// Names of the views that training did not see, one a line.
    fn held_out(&self, model: &Reconstruction) -> String {
        let held_out = transforms::held_out(model, &self.known.config.dataset);
        held_out.iter().map(|id| format!("{}\n", model.images[id].name)).collect()
    }

    fn advice(&self, tool: Tool, output: &Path) -> String {
        let (at, split) = (output.display(), self.known.config.dataset.every());
        let every = split.unwrap_or(0);
        let advice = match tool {
            Tool::Colmap => format!(
                "colmap gui --import_path {at}/sparse/0 --image_path {at}/images --database_path {at}/database.db"
            ),
            Tool::Gs3d => format!("python train.py -s {at} --eval"),
            Tool::Gsplat => format!(
                "python simple_trainer.py default --data_dir {at} --data_factor 1 --test_every {}",
                if every == 0 { self.model.images.len() } else { every }
            ),
            Tool::Brush => format!("brush {at} --eval-split-every {every}"),
            Tool::Nerfstudio => format!("ns-train splatfacto --data {at}"),
            Tool::Metashape => format!(
                "add {at}/images; File > Import > Import Cameras: cameras.xml; Import Masks: {{filename}}_mask.png"
            ),
        };
        match (split, tool) {
            (None, Tool::Gsplat | Tool::Brush) => {
                format!("{advice}\n(it takes no list of views to hold out: it trains on all)")
            }
            _ => advice,
        }
    }
}

/// A frame as it lies in a folder that may have been moved.
fn here(run: &Path, frame: &Frame) -> Result<Frame> {
    let path = run.join("images").join(scene::io::safe_name(&frame.name)?);
    anyhow::ensure!(path.is_file(), "{} is missing; run sat-recon again", path.display());
    let mask = frame.mask.as_ref().and_then(|m| m.file_name()).map(|m| run.join("masks").join(m));
    Ok(Frame { path, mask: mask.filter(|m| m.is_file()), ..frame.clone() })
}
