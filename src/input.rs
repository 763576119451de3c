//! What the input is: a video, photos, or images that bring their poses.

mod frame_names;

use anyhow::{Context, Result, bail};
pub(crate) use frame_names::FrameNames;
use scene::decision::{Choice, Decision, Quantity, Remark, Rule, Subject};
use scene::io::ImportedPoses;
use scene::sim3::Sim3;
use scene::{FrameSet, Progress, Reconstruction};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The input, looked at but not yet read.
#[derive(Clone, Debug)]
pub(crate) enum Input {
    /// A file that is to be decoded.
    Video(PathBuf),
    /// A folder of photos.
    Photos(PathBuf),
    /// Images with a COLMAP model or another program's file of poses.
    Posed {
        /// Folder of the images.
        images: PathBuf,
        /// COLMAP model folder, `transforms.json` or another file that [`scene::io::read_poses`]
        /// reads.
        model: PathBuf,
        /// The images that are meant, by names relative to their folder; empty for all in it.
        listed: Vec<String>,
    },
}

impl Input {
    /// Looks at `path`; poses that lie beside the images are left alone with `ignore_poses`.
    pub(crate) fn detect(path: &Path, ignore_poses: bool) -> Result<Self> {
        let meta = std::fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?;
        if meta.is_file() {
            if !scene::io::is_poses_file(path) {
                return Ok(Self::Video(path.to_path_buf()));
            }
            let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
            return Self::posed(&folder, path.to_path_buf());
        }
        if !ignore_poses && let Some(model) = posed_model(path) {
            return Self::posed(path, model);
        }
        Ok(Self::Photos(images_in(path)))
    }

    fn posed(folder: &Path, model: PathBuf) -> Result<Self> {
        let listed = if model.is_file() { scene::io::listed_images(&model)? } else { Vec::new() };
        let images = if listed.is_empty() { images_in(folder) } else { folder.to_path_buf() };
        Ok(Self::Posed { images, model, listed })
    }

    /// Names of the frames that the data set's own split holds out; empty where it has none.
    pub(crate) fn held_out(&self, frames: &FrameSet) -> Result<BTreeSet<String>> {
        let Self::Posed { images, model, .. } = self else { return Ok(BTreeSet::new()) };
        let held_out = scene::io::read_poses(model, images)?.held_out;
        let names = FrameNames::of(frames);
        Ok(held_out.iter().filter_map(|photo| Some(names.find(photo)?.name.clone())).collect())
    }

    /// Poses need two frames; the message names the input.
    pub(crate) fn refuse_too_few(&self, frames: usize) -> Result<()> {
        let source = self.source().display();
        match self {
            _ if frames > 1 => Ok(()),
            Self::Video(_) => bail!(
                "{source}: {frames} frame differs from the others, at least 2 are needed; move the camera or the object"
            ),
            _ => bail!("{source}: {frames} photo given, at least 2 are needed; film from more sides"),
        }
    }

    /// The folder or file whose content the frames come from.
    pub(crate) fn source(&self) -> &Path {
        match self {
            Self::Video(path) | Self::Photos(path) | Self::Posed { images: path, .. } => path,
        }
    }
}

fn images_in(folder: &Path) -> PathBuf {
    let images = folder.join("images");
    if images.is_dir() { images } else { folder.to_path_buf() }
}

fn posed_model(folder: &Path) -> Option<PathBuf> {
    let models = [folder.join("sparse/0"), folder.join("sparse"), folder.to_path_buf()];
    models
        .into_iter()
        .find(|p| p.join("cameras.bin").is_file() || p.join("cameras.txt").is_file())
        .or_else(|| scene::io::find_poses(folder))
}

/// Poses that came with the images.
#[derive(Debug)]
pub(crate) struct Imported {
    /// Each image has the name of its frame.
    pub model: Reconstruction,
    /// From the frame of the file into that of the model.
    pub world_from_file: Sim3,
    /// Frames that it has no pose for, and why.
    pub missing: Vec<(String, String)>,
    /// What was repaired.
    pub notes: Vec<String>,
}

/// Refuses poses of pictures that were cut into views.
pub(crate) fn refuse_wide(frames: &FrameSet) -> Result<()> {
    if frames.wide_lens.is_some() {
        bail!("the poses are those of the pictures, and views were cut from them: add --ignore-poses");
    }
    Ok(())
}

/// Reads the poses that came with the images in the folder `images` and gives each posed image the
/// name of its frame.
pub(crate) fn import_poses(model: &Path, images: &Path, frames: &FrameSet) -> Result<Imported> {
    let ImportedPoses { model: mut reconstruction, world_from_file, .. } =
        scene::io::read_poses(model, images)?;
    let names = FrameNames::of(frames);
    let mut sizes: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
    let mut missing = Vec::new();
    for image in reconstruction.images.values_mut() {
        let Some(frame) = names.find(&image.name) else {
            missing.push(image.name.clone());
            continue;
        };
        image.name.clone_from(&frame.name);
        let size = (frame.width, frame.height);
        if *sizes.entry(image.camera).or_insert(size) != size {
            bail!(
                "images of camera {} differ in size ({} is {}×{})",
                image.camera,
                frame.name,
                size.0,
                size.1
            );
        }
    }
    if let Some(first) = missing.first() {
        bail!(
            "{} of the {} images that {} names are not among the photos (first: {first}); put them beside it",
            missing.len(),
            reconstruction.images.len(),
            model.display()
        );
    }
    let mut notes = Vec::new();
    for (id, (width, height)) in sizes {
        notes.extend(fit_camera(&mut reconstruction, id, width, height)?);
    }
    let repaired = reconstruction.admit().map_err(|e| anyhow::anyhow!("{}: {e}", model.display()))?;
    notes.extend(repaired);
    if reconstruction.images.len() < 2 {
        bail!(
            "{} has poses for {} of {} images; at least 2 are needed (--ignore-poses estimates them)",
            model.display(),
            reconstruction.images.len(),
            frames.len()
        );
    }
    let why = format!("no pose in {}", model.display());
    let posed: BTreeSet<&str> = reconstruction.images.values().map(|i| i.name.as_str()).collect();
    let names = frames.frames.iter().map(|f| &f.name).filter(|name| !posed.contains(name.as_str()));
    let missing = names.map(|name| (name.clone(), why.clone())).collect();
    Ok(Imported { model: reconstruction, world_from_file, missing, notes })
}

/// Poses that come without points get those that their photos agree on, and a decision says so.
/// Where all photos have mattes there is nothing to gain: Gaussians begin inside the visual hull as
/// well.
pub(crate) fn with_points(
    given: Reconstruction,
    frames: &FrameSet,
    config: &sfm::SfmConfig,
    progress: &Progress,
) -> Result<(Reconstruction, Vec<Decision>)> {
    if !given.points.is_empty() || frames.frames.iter().all(|f| f.mask.is_some()) {
        return Ok((given, Vec::new()));
    }
    let found = sfm::triangulate_given(frames, &given, config, progress)?;
    let well_observed = found.points.values().filter(|p| p.track.len() > 2).count();
    let choice = Choice::count(found.points.len());
    let decision = Decision::new(Subject::TriangulatedPoints, choice, Rule::Evidence)
        .measured(Quantity::WellObservedPoints, well_observed as f64);
    Ok((found, vec![decision]))
}

/// Leaves out images whose photos contradict the poses that came with them; where most do, the
/// poses are refused. Also images that no other photo confirms, and why, and a doubt where the
/// poses are off altogether.
pub(crate) fn against_photos(
    mut imported: Imported,
    frames: &FrameSet,
    config: &sfm::SfmConfig,
    progress: &Progress,
) -> Result<(Imported, Vec<(String, String)>, Option<Decision>)> {
    let sfm::GivenCheck { contradicted, unconfirmed, is_off } =
        sfm::check_given(frames, &imported.model, config, progress)?;
    let (wrong, all) = (contradicted.len(), imported.model.images.len());
    if let Some((name, why)) = contradicted.first().filter(|_| 2 * wrong > all) {
        bail!(
            "the poses do not fit the photos: {wrong} of {all} photos contradict them ({name}: {why}); \
             mend them, or leave them out with --ignore-poses"
        );
    }
    imported.model.without_images(&contradicted.iter().map(|(name, _)| name.as_str()).collect());
    imported.missing.extend(contradicted);
    let doubt = is_off.then(|| {
        let doubt = Decision::new(Subject::Plausibility, Choice::Taken(false), Rule::Evidence);
        doubt.remarked(Remark::Doubtful).remarked(Remark::PosesOff)
    });
    Ok((imported, unconfirmed, doubt))
}

/// Scales a camera (and its keypoints) to the size of the frames on disk, and says so; another
/// aspect ratio is an error.
fn fit_camera(
    reconstruction: &mut Reconstruction,
    id: u32,
    width: u32,
    height: u32,
) -> Result<Option<String>> {
    let Some(camera) = reconstruction.cameras.get_mut(&id) else { return Ok(None) };
    if (camera.width, camera.height) == (width, height) {
        return Ok(None);
    }
    let note = format!(
        "camera {id} was scaled from {}×{} to its images' {width}×{height}",
        camera.width, camera.height
    );
    let (sx, sy) = (f64::from(width) / f64::from(camera.width), f64::from(height) / f64::from(camera.height));
    if (sx / sy - 1.0).abs() > 0.01 {
        bail!("camera {id} is {}×{} but its images are {width}×{height}", camera.width, camera.height);
    }
    *camera = camera.scaled(width, height);
    for image in reconstruction.images.values_mut().filter(|image| image.camera == id) {
        for observation in &mut image.observations {
            observation.pixel *= glam::DVec2::new(sx, sy);
        }
    }
    Ok(Some(note))
}
