//! COLMAP's `database.db` at the border of the solver: what it supplies, and what a run leaves for
//! it.

use crate::args::PipelineArgs;
use crate::stage::describe_input;
use anyhow::{Context, Result, bail};
use scene::decision::{Choice, Decision, FeatureSource, Measurement, Quantity, Remark, Rule, Subject};
use scene::io::colmap_db::{Database, DatabaseImage, ImagePair};
use scene::{
    Camera, Features, Frame, FrameSet, Keypoint, Progress, Reconstruction, TwoViewGeometry, TwoViewKind,
};
use sfm::{SfmResult, Supplied};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a stage's fingerprint says of databases.
pub(crate) fn print(args: &PipelineArgs) -> Result<impl serde::Serialize + use<>> {
    let input: Vec<_> = args.database.iter().map(|path| describe_input(path)).collect::<Result<_>>()?;
    Ok((input, args.rematch, args.colmap_database))
}

/// An error where a database is read or asked for, but nothing is solved.
pub(crate) fn refuse(args: &PipelineArgs) -> Result<()> {
    if !args.database.is_empty() || args.colmap_database || args.pairs.is_some() {
        bail!(
            "the poses of {} are used as they are, without features: add --ignore-poses",
            args.input.display()
        );
    }
    Ok(())
}

/// Solves the poses, from `--database` where there is one.
pub(crate) fn solve(args: &PipelineArgs, frames: &FrameSet, progress: &Progress) -> Result<SfmResult> {
    let mut config = args.sfm.clone();
    (config.seed, config.keep_matches) = (args.seed, args.colmap_database);
    let Some(path) = args.database.first() else { return Ok(sfm::reconstruct(frames, &config, progress)?) };
    let mut frames = frames.clone();
    let (supplied, decision) = read(path, &together(&args.database)?, &mut frames, args.rematch)?;
    let mut result = sfm::reconstruct_from(Some(supplied), &frames, &config, progress)?;
    result.decisions.insert(0, decision);
    Ok(result)
}

/// Writes `OUT/database.db` where that is asked for; the model.
pub(crate) fn write(
    args: &PipelineArgs,
    out: &Path,
    result: SfmResult,
    frames: &FrameSet,
) -> Result<Option<Reconstruction>> {
    if !args.colmap_database {
        return Ok(result.reconstruction);
    }
    let model = result.reconstruction.clone();
    scene::io::write_database(&out.join("database.db"), &contents(result, frames))?;
    Ok(model)
}

/// Two frames of a tracked video are a pair where they share so many points.
/// Source: chosen by hand, never measured.
const FEWEST_SHARED: usize = 15;

/// The first of several databases with the matches of all: those of the parts that `--pairs` made.
fn together(paths: &[PathBuf]) -> Result<Database> {
    let [first, others @ ..] = paths else { bail!("no database is named") };
    let mut all = scene::io::read_database(first)?;
    for path in others {
        let part = scene::io::read_database(path)?;
        let mut number = BTreeMap::new();
        for (id, image) in &part.images {
            let known = all.images.iter().find(|(_, own)| own.name == image.name);
            let Some((own_id, _)) = known.filter(|(_, own)| own.features == image.features) else {
                let (a, b) = (path.display(), first.display());
                bail!("{a} has other features of {} than {b}: parts of one set share them", image.name);
            };
            number.insert(*id, *own_id);
        }
        let numbered = |pair: &ImagePair| Some((*number.get(&pair.0)?, *number.get(&pair.1)?));
        let matches = part.matches.into_iter().filter_map(|(pair, found)| Some((numbered(&pair)?, found)));
        all.matches.extend(matches);
    }
    Ok(all)
}

/// Writes `OUT/database.db` with the matches of one part of the pairs; how many pairs match.
pub(crate) fn match_part(
    args: &PipelineArgs,
    block: sfm::PairBlock,
    frames: &FrameSet,
    out: &Path,
    progress: &Progress,
) -> Result<usize> {
    let found = sfm::match_block(frames, &args.sfm, block, progress)?;
    let sfm::MatchedBlock { features, initial_cameras, matches } = found;
    let pairs = matches.iter().filter(|(_, _, m)| !m.is_empty()).count();
    let result = SfmResult { features, matches, initial_cameras, ..SfmResult::default() };
    scene::io::write_database(&out.join("database.db"), &contents(result, frames))?;
    Ok(pairs)
}

/// Features (and matches, unless `rematch`) of the frames, and a decision that says what was found.
/// Images are known by name, or by name without ending. Camera groups and known focal lengths are
/// put into `frames`; keypoints are scaled where the frames were.
fn read(
    path: &Path,
    database: &Database,
    frames: &mut FrameSet,
    rematch: bool,
) -> Result<(Supplied, Decision)> {
    let mut features = vec![Features::default(); frames.len()];
    let mut frame_of: BTreeMap<u32, usize> = BTreeMap::new();
    for (i, frame) in frames.frames.iter_mut().enumerate() {
        let Some((id, image)) = find(database, &frame.name) else { continue };
        let camera = &database.cameras[&image.camera];
        features[i] =
            fitted(image, camera, frame).with_context(|| format!("cannot use {}", path.display()))?;
        frame.camera_group = camera.id;
        frame_of.insert(id, i);
    }
    let found = frame_of.len();
    if found < 2 {
        let first = database.images.values().next().map_or("no images", |i| &i.name);
        bail!(
            "{} names {found} of the {} frames (it begins with {first}; the frames with {}): is it of other images?",
            path.display(),
            frames.len(),
            frames.frames.first().map_or("none", |f| &f.name)
        );
    }
    let described = features.iter().any(|f| !f.descriptors.is_empty());
    let matches = if rematch { None } else { matches(database, &frame_of) };
    if matches.is_none() && !described {
        bail!(
            "{} has neither descriptors nor matches of the frames: run COLMAP's matcher on it first",
            path.display()
        );
    }
    for f in &mut features {
        f.descriptors.resize(f.len() * Features::DIM, 0);
    }
    let keypoints: usize = features.iter().map(Features::len).sum();
    let choice = Choice::Features(FeatureSource::Database);
    let decision = Decision::new(Subject::Features, choice, Rule::Requested).with_all([
        Measurement::count(Quantity::FeatureCount, keypoints),
        Measurement::count(Quantity::Images, found),
        Measurement::count(Quantity::Frames, frames.len()),
    ]);
    let decision = match &matches {
        Some(matches) => decision.measured(Quantity::Pairs, matches.len() as f64),
        None => decision.remarked(Remark::MatchedAnew),
    };
    Ok((Supplied { features: Some(features), matches }, decision))
}

fn find<'a>(database: &'a Database, name: &str) -> Option<(u32, &'a DatabaseImage)> {
    let stem = Path::new(name).with_extension("");
    let named = database.images.iter().find(|(_, image)| image.name == name);
    let similar = database.images.iter();
    let found =
        named.or_else(|| similar.clone().find(|(_, i)| Path::new(&i.name).with_extension("") == stem));
    found.map(|(id, image)| (*id, image))
}

/// The features of an image in the pixels of its frame.
fn fitted(image: &DatabaseImage, camera: &Camera, frame: &mut Frame) -> Result<Features> {
    let sx = f64::from(frame.width) / f64::from(camera.width);
    let sy = f64::from(frame.height) / f64::from(camera.height);
    if (sx / sy - 1.0).abs() > 0.01 {
        let (w, h) = (camera.width, camera.height);
        bail!("{} is {w}×{h} there, but {}×{} here: was it rotated?", image.name, frame.width, frame.height);
    }
    if camera.has_prior_focal {
        frame.focal_prior_px = Some(camera.mean_focal() * sx);
    }
    let mut features = image.features.clone();
    if (sx, sy) != (1.0, 1.0) {
        for k in &mut features.keypoints {
            (k.x, k.y) = (k.x * sx as f32, k.y * sy as f32);
            k.scale *= (sx * sy).sqrt() as f32;
        }
    }
    Ok(features)
}

/// Matches as they were before verification, or where none were kept the verified ones; none at all
/// where there are none of the frames.
fn matches(database: &Database, frame_of: &BTreeMap<u32, usize>) -> Option<Vec<sfm::matching::PairMatches>> {
    let raw = database.matches.iter().map(|(pair, matches)| (*pair, matches.as_slice()));
    let mut chosen = of_frames(raw, frame_of);
    if chosen.is_empty() {
        chosen = of_frames(database.geometries.iter().map(|(p, g)| (*p, g.inliers.as_slice())), frame_of);
    }
    (!chosen.is_empty()).then_some(chosen)
}

/// Matches by the indices of their frames; those of other images, and empty ones, are left out.
fn of_frames<'a>(
    matches: impl Iterator<Item = (ImagePair, &'a [[u32; 2]])>,
    frame_of: &BTreeMap<u32, usize>,
) -> Vec<sfm::matching::PairMatches> {
    let numbered = matches.filter(|(_, m)| !m.is_empty()).filter_map(|((a, b), m)| {
        let (a, b) = (*frame_of.get(&a)?, *frame_of.get(&b)?);
        Some((a, b, m.to_vec()))
    });
    numbered.collect()
}

/// What COLMAP is to find: cameras as they were solved (with their focal lengths marked as known)
/// or else as they were assumed, features, matches and verified pairs. Image number = 1 + index of
/// the frame, as in the model.
///
/// Of a tracked video the features are those of the key frames and after them the tracked points
/// (without descriptors), the pairs all frames that share points: keypoints are numbered as in the
/// model.
fn contents(result: SfmResult, frames: &FrameSet) -> Database {
    let SfmResult { reconstruction, initial_cameras, mut features, matches, geometries, .. } = result;
    let model = reconstruction.unwrap_or_default();
    let mut database = Database::default();
    for (id, camera) in &model.cameras {
        database.cameras.insert(*id, Camera { has_prior_focal: true, ..camera.clone() });
    }
    database.matches = matches.into_iter().map(|(a, b, m)| (pair_of(a, b), m)).collect();
    database.geometries = geometries.into_iter().map(|g| (pair_of(g.a, g.b), g)).collect();
    features.resize(frames.len(), Features::default());
    let mut followed = false;
    for (i, (frame, mut features)) in frames.frames.iter().zip(features).enumerate() {
        let posed = model.images.get(&(i as u32 + 1));
        let more = posed.map_or(&[][..], |p| p.observations.get(features.len()..).unwrap_or(&[]));
        followed |= !more.is_empty();
        features.keypoints.extend(more.iter().map(|o| {
            let [x, y] = o.pixel.as_vec2().to_array();
            Keypoint { x, y, scale: 1.0, angle: 0.0 }
        }));
        features.descriptors.resize(features.len() * Features::DIM, 0);
        let assumed = &initial_cameras[i];
        let camera = posed.map_or(assumed.id, |p| p.camera);
        database.cameras.entry(camera).or_insert_with(|| assumed.clone());
        database.images.insert(i as u32 + 1, DatabaseImage { name: frame.name.clone(), camera, features });
    }
    if followed {
        database.geometries = shared_points(&model);
        database.matches = database.geometries.iter().map(|(p, g)| (*p, g.inliers.clone())).collect();
    }
    database
}

/// The numbers of the images of two frames.
fn pair_of(a: usize, b: usize) -> ImagePair {
    (a as u32 + 1, b as u32 + 1)
}

/// Pairs of images that see the same points, with those observations as matches.
fn shared_points(model: &Reconstruction) -> BTreeMap<ImagePair, TwoViewGeometry> {
    let mut matches: BTreeMap<ImagePair, Vec<[u32; 2]>> = BTreeMap::new();
    for point in model.points.values() {
        for (i, a) in point.track.iter().enumerate() {
            for b in &point.track[i + 1..] {
                let (a, b) = if a.image < b.image { (a, b) } else { (b, a) };
                matches.entry((a.image, b.image)).or_default().push([a.observation, b.observation]);
            }
        }
    }
    matches.retain(|(a, b), m| a != b && m.len() >= FEWEST_SHARED);
    let pairs = matches.into_iter().map(|(pair, inliers)| {
        let (a, b) = (pair.0 as usize - 1, pair.1 as usize - 1);
        let kind = TwoViewKind::Calibrated;
        let (f, e, h, b_from_a) = (None, None, None, None);
        (pair, TwoViewGeometry { a, b, kind, inliers, f, e, h, b_from_a, median_angle: 0.0 })
    });
    pairs.collect()
}
