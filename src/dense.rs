//! Dense depths of a run by stereo: the cloud of `export --dense`, and what `export --mesh` fuses.

use crate::args::MeshDepths;
use anyhow::{Context, Result};
use scene::geometry::Mesh;
use scene::io::ply::OrientedPoint;
use scene::{Gaussians, Progress};
use splat::Dataset;
use splat::fusion::{DepthSource, MeasuredDepth, fused_mesh};
use std::path::Path;
use stereo::{DenseDepths, PlaneField, StereoSettings, StereoView};

/// The depths of every view of a run's training set, those held out too.
pub(crate) fn depths(run: &Path, dataset: &Dataset, progress: &Progress) -> Result<DenseDepths> {
    let model = scene::io::read_model(&run.join("undistorted/sparse/0"))?;
    let points: Vec<_> = model.points.values().map(|p| p.position).collect();
    let settings = StereoSettings::default();
    stereo::dense_depths(&views(dataset), &points, &settings, progress).context("no depths by stereo")
}

/// The points on which the views agree, with their normals and the photos' colours.
pub(crate) fn cloud(depths: &DenseDepths, dataset: &Dataset) -> Vec<OrientedPoint> {
    let points = depths.cloud(&views(dataset)).into_iter();
    points.map(|p| OrientedPoint { position: p.position, normal: p.normal, rgb: p.rgb }).collect()
}

/// The mesh of a run's depths, of its splat's or of both.
pub(crate) fn mesh(
    depths: Option<&DenseDepths>,
    splat: Option<(&Gaussians, bool)>,
    dataset: &Dataset,
    resolution: u32,
    progress: &Progress,
) -> Result<Mesh> {
    let measured: Vec<MeasuredDepth> = depths.iter().flat_map(|d| &d.fields).map(whole).collect();
    let source = match (depths, splat) {
        (None, None) => return Ok(Mesh::default()),
        (Some(_), None) => DepthSource::Measured(&measured),
        (None, Some((gaussians, antialias))) => DepthSource::Splat { gaussians, antialias },
        (Some(_), Some((gaussians, antialias))) => {
            DepthSource::Both { measured: &measured, gaussians, antialias }
        }
    };
    Ok(fused_mesh(&source, dataset, resolution, progress)?)
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

fn views(dataset: &Dataset) -> Vec<StereoView<'_>> {
    let seen = dataset.views.iter().filter_map(|v| {
        let pixels = v.levels.first()?;
        let mask = pixels.mask.as_deref();
        Some(StereoView { camera: &v.camera, pose: v.pose, rgb: &pixels.rgb, mask })
    });
    seen.collect()
}

/// The depths of the whole picture.
fn whole(field: &PlaneField) -> MeasuredDepth {
    let width = field.camera.width as usize;
    let mut depth = vec![0.0; width * field.camera.height as usize];
    for (i, z) in field.depth.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        let (x, y) = field.place(i);
        depth[y * width + x] = *z;
    }
    MeasuredDepth { width, depth }
}
