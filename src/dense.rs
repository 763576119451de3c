//! Dense depths of a run by stereo: the cloud of `export --dense`, and what `export --mesh` fuses.

use crate::args::MeshDepths;
use anyhow::{Context, Result};
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use scene::geometry::Mesh;
use scene::io::ply::OrientedPoint;
use scene::{Gaussians, PosedPhoto, Progress};
use splat::fusion::{DepthSource, MeasuredDepth, fused_mesh};
use splat::surface::median_depth;
use splat::{Dataset, RenderOptions, Renderer};
use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;
use stereo::{DenseDepths, DepthJoin, PlaneField, StereoSettings};

/// The depths of every view of a run's training set, those held out too.
pub(crate) fn depths(run: &Path, dataset: &Dataset, progress: &Progress) -> Result<DenseDepths> {
    let model = scene::io::read_model(&run.join("undistorted/sparse/0"))?;
    let points: Vec<_> = model.points.values().map(|p| p.position).collect();
    let settings = StereoSettings { outlines: dataset.is_transparent(), ..StereoSettings::default() };
    let views = views(dataset);
    let key = key(&views, &points, &settings);
    let kept = run.join(".stages").join(KEPT);
    let file = open(&kept, &key);
    if let Some(depths) = file.and_then(|mut f| DenseDepths::read_from(&mut f, &views, &points, &settings)) {
        return Ok(depths);
    }
    let depths = stereo::dense_depths(&views, &points, &settings, progress).context("no depths by stereo")?;
    if run.join(".stages").is_dir() {
        // Where nothing can be kept, the next command computes them again.
        let _ = write(&kept, &key, &depths);
    }
    Ok(depths)
}

/// The photos with mattes, where they have none and a black sky: what the splat (with whether it
/// was trained with antialiasing) covers.
pub(crate) fn with_silhouettes(
    dataset: &Dataset,
    (gaussians, antialias): (&Gaussians, bool),
) -> Result<Option<Dataset>> {
    let mut made = None;
    dataset.with_silhouettes(|view| {
        let renderer = match &mut made {
            Some(renderer) => renderer,
            none => none.insert(Renderer::new(gaussians)?),
        };
        renderer.antialias = antialias;
        let picture = renderer.render(&view.camera, &view.pose, &RenderOptions::default())?;
        Ok(picture.alpha.data.iter().map(|a| (a * 255.0).round() as u8).collect())
    })
}

/// Gaussians nearer to a camera than this share of their median distance are not seen. Source: as
/// in training.
pub(crate) const NEAR: f64 = 0.01;

/// The file in `.stages` that keeps the depths for the next command.
const KEPT: &str = "depths.bin";

/// Of all that the depths come from.
fn key(views: &[PosedPhoto<'_>], points: &[DVec3], settings: &StereoSettings) -> [u8; blake3::OUT_LEN] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(format!("{} {settings:?} {points:?}", env!("STEREO_SOURCES")).as_bytes());
    for view in views {
        hasher.update(format!("{:?} {:?}", view.camera, view.pose).as_bytes());
        hasher.update(view.rgb);
        hasher.update(view.mask.unwrap_or(&[]));
    }
    *hasher.finalize().as_bytes()
}

/// What was kept under this key.
fn open(path: &Path, key: &[u8]) -> Option<impl Read> {
    let mut file = BufReader::new(File::open(path).ok()?);
    let mut own = [0; blake3::OUT_LEN];
    file.read_exact(&mut own).ok()?;
    (own == key).then(|| GzDecoder::new(file))
}

fn write(path: &Path, key: &[u8], depths: &DenseDepths) -> Result<()> {
    Ok(scene::io::write_atomic(path, |file| {
        file.write_all(key)?;
        let mut packed = GzEncoder::new(file, Compression::fast());
        depths.write_to(&mut packed)?;
        packed.finish().map(|_| ())
    })?)
}

/// The depths, in every view, of what masks of the views' size show white: by stereo joined with
/// those of the splat. `points` are some of its places.
pub(crate) fn part_depths(
    dataset: &Dataset,
    masks: &[Vec<u8>],
    points: &[DVec3],
    splat: &[MeasuredDepth],
    progress: &Progress,
) -> Result<Vec<MeasuredDepth>> {
    let mut seen = views(dataset);
    seen.iter_mut().zip(masks).for_each(|(view, mask)| view.mask = Some(mask));
    let depths = stereo::dense_depths(&seen, points, &StereoSettings::default(), progress);
    let depths = depths.context("no depths by stereo")?;
    let join = DepthJoin::new(&depths, &seen);
    let both = depths.fields.iter().zip(splat).enumerate();
    Ok(both.map(|(at, (field, splat))| measured(field, join.joined(at, &sampled(splat, field)))).collect())
}

/// The depths of a picture of any size at the pixels of a field.
fn sampled(splat: &MeasuredDepth, field: &PlaneField) -> Vec<f32> {
    let size = [field.camera.width as usize, field.camera.height as usize];
    let all = (0..field.depth.len()).map(|i| {
        let (x, y) = field.place(i);
        splat.at(x * splat.size[0] / size[0], y * splat.size[1] / size[1]).unwrap_or(0.0)
    });
    all.collect()
}

/// The points on which the views agree, with their normals and the photos' colours.
pub(crate) fn cloud(depths: &DenseDepths, dataset: &Dataset) -> Vec<OrientedPoint> {
    let points = depths.cloud(&views(dataset)).into_iter();
    points.map(|p| OrientedPoint { position: p.position, normal: p.normal, rgb: p.rgb }).collect()
}

/// The mesh of a run's depths by stereo, of its splat's (with whether it was trained with
/// antialiasing) or of both.
pub(crate) fn mesh(
    depths: Option<DenseDepths>,
    splat: Option<(&Gaussians, bool)>,
    dataset: &Dataset,
    resolution: u32,
    progress: &Progress,
) -> Result<Mesh> {
    let measured = match (depths, splat) {
        (None, None) => return Ok(Mesh::default()),
        (None, Some((gaussians, antialias))) => {
            let source = DepthSource::Splat { gaussians, antialias };
            return Ok(fused_mesh(&source, dataset, resolution, progress)?);
        }
        (Some(depths), None) => only_depths(depths),
        (Some(depths), Some(splat)) => with_splat(&depths, splat, dataset, progress)?,
    };
    Ok(fused_mesh(&DepthSource::Measured(&measured), dataset, resolution, progress)?)
}

/// Depths by stereo joined with those of the splat.
fn with_splat(
    depths: &DenseDepths,
    (gaussians, antialias): (&Gaussians, bool),
    dataset: &Dataset,
    progress: &Progress,
) -> Result<Vec<MeasuredDepth>> {
    let views = views(dataset);
    let join = DepthJoin::new(depths, &views);
    progress.begin("depths of the splat", views.len());
    let mut all = Vec::with_capacity(views.len());
    for (at, (field, view)) in depths.fields.iter().zip(&views).enumerate() {
        let near = NEAR * gaussians.median_distance(view.pose.centre());
        let depth = median_depth(gaussians, &field.camera, &view.pose, near, antialias);
        let depth = depth.into_iter().map(|z| z.map_or(0.0, |z| z as f32)).collect();
        let size = [field.camera.width as usize, field.camera.height as usize];
        let splat = MeasuredDepth { size, corner: [0; 2], columns: size[0], depth };
        all.push(measured(field, join.joined(at, &sampled(&splat, field))));
        progress.tick()?;
    }
    Ok(all)
}

impl MeshDepths {
    /// Whether stereo is needed.
    pub(crate) fn by_stereo(self) -> bool {
        self != Self::Splat
    }

    /// Whether the splat is needed.
    pub(crate) fn by_splat(self) -> bool {
        self != Self::Stereo
    }
}

fn views(dataset: &Dataset) -> Vec<PosedPhoto<'_>> {
    let seen = dataset.views.iter().filter_map(|v| {
        let pixels = v.levels.first()?;
        let mask = pixels.mask.as_deref();
        Some(PosedPhoto { camera: &v.camera, pose: v.pose, rgb: &pixels.rgb, mask })
    });
    seen.collect()
}

/// What is fused: without normals and costs, which take four times the memory.
fn only_depths(depths: DenseDepths) -> Vec<MeasuredDepth> {
    let fields = depths.fields.into_iter();
    let kept = fields.map(|mut field| {
        let depth = std::mem::take(&mut field.depth);
        measured(&field, depth)
    });
    kept.collect()
}

/// Depths of a field's pixels.
fn measured(field: &PlaneField, depth: Vec<f32>) -> MeasuredDepth {
    let size = [field.camera.width as usize, field.camera.height as usize];
    MeasuredDepth { size, corner: field.corner, columns: field.width, depth }
}
