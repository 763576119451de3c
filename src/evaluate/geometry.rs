//! ShapeEvaluation of a splat: against a true mesh where one is given, against the silhouettes
//! where there are any.

use crate::args::MeshConfig;
use crate::dense;
use crate::evaluate::metrics::number;
use crate::record::{PoseSummary, ShapeEvaluation};
use anyhow::{Context, Result};
use clap::ValueEnum;
use glam::DVec3;
use scene::geometry::{GeometryErrors, Mesh, compare_points, points_of, seen_by, thin_parts};
use scene::io::ply::OrientedPoint;
use scene::sim3::{Sim3, robust_alignment};
use scene::{Camera, Gaussians, Pose, Progress, Reconstruction};
use splat::Dataset;
use splat::fusion::DEFAULT_RESOLUTION;
use splat::surface::{median_depth, outside_hull};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// What counts as near, per cent of the mesh's size. Source: Knapitsch et al., TOG 2017, for the
/// measure; the number was chosen by hand, never measured.
const THRESHOLD_PCT: f64 = 1.0;
/// Points on the mesh. Source: chosen by hand, never measured.
const SAMPLES: usize = 200_000;
/// Depth maps that are joined to a surface. Source: chosen by hand, never measured.
const DEPTH_MAPS: usize = 36;
/// Points of the surface are one a cube of this side, per cent of the mesh's size.
/// Source: derived, a quarter of [`THRESHOLD_PCT`].
const VOXEL_PCT: f64 = 0.25;
/// Of a scene without mattes only what lies so near the mesh's box is judged, per cent of its
/// size. Source: chosen by hand, never measured.
const CROP_PCT: f64 = 5.0;
/// A surface hides another if it lies before it by more than this, per cent of the size.
/// Source: derived, half of [`THRESHOLD_PCT`].
const SLACK_PCT: f64 = 0.5;

impl ShapeEvaluation {
    /// The figures in a few words.
    pub fn sentence(&self) -> String {
        let floaters = self.floaters_pct.map(|f| format!("{f:.2} % of the opacity outside the silhouettes"));
        [
            in_words("cloud", &self.cloud),
            in_words("surface", &self.surface),
            in_words("dense cloud", &self.dense),
            in_words("mesh", &self.fused),
            floaters,
        ]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join("; ")
    }

    /// Rows of a table: quantity, then cloud, surface, dense cloud, mesh.
    pub(crate) fn rows(&self) -> Vec<(&'static str, [String; 4])> {
        let rows: [(&'static str, fn(&GeometryErrors) -> Option<f64>); 10] = [
            ("accuracy, mean, % of the size", |e| Some(e.accuracy_mean_pct)),
            ("accuracy, median", |e| Some(e.accuracy_median_pct)),
            ("completeness, mean", |e| Some(e.completeness_mean_pct)),
            ("completeness, median", |e| Some(e.completeness_median_pct)),
            ("precision at 1 %, %", |e| Some(e.precision_pct)),
            ("recall at 1 %, %", |e| Some(e.recall_pct)),
            ("F-score at 1 %, %", |e| Some(e.f_score_pct)),
            ("F-score at 0.5 %, %", |e| Some(e.f_score_half_pct)),
            ("Chamfer distance, %", |e| Some(e.chamfer_pct)),
            ("rods and edges of sheets found at 1 %, %", |e| e.thin_recall_pct),
        ];
        let judged = [&self.cloud, &self.surface, &self.dense, &self.fused];
        rows.map(|(name, pick)| (name, judged.map(|e| number(e.as_ref().and_then(pick), 3)))).to_vec()
    }
}

fn in_words(name: &str, errors: &Option<GeometryErrors>) -> Option<String> {
    errors.map(|e| {
        format!(
            "{name} F-score {:.1} % (precision {:.1}, recall {:.1}) at {} %, Chamfer {:.3} %",
            e.f_score_pct, e.precision_pct, e.recall_pct, e.threshold_pct, e.chamfer_pct
        )
    })
}

/// Judges the model in `out` and its splat. `None` where there is neither a mesh nor a matte.
pub fn measure(
    out: &Path,
    config: &MeshConfig,
    dataset: &Dataset,
    (gaussians, antialias): (&Gaussians, bool),
    progress: &Progress,
) -> Result<Option<ShapeEvaluation>> {
    let floaters_pct = outside_hull(gaussians, dataset).map(|share| 100.0 * share);
    let Some(path) = &config.mesh else {
        let protocol =
            "opacity of Gaussians whose centre is black in the mask of a view, 2 px allowed".to_owned();
        return Ok(floaters_pct.map(|_| ShapeEvaluation {
            protocol,
            floaters_pct,
            ..ShapeEvaluation::default()
        }));
    };
    let mesh = scene::io::read_mesh(path)?;
    let model = scene::io::read_model(&out.join("undistorted/sparse/0"))?;
    let (mesh_from_model, aligned) = match &config.mesh_truth {
        Some(truth) => align(&model, truth)?,
        None => (source_from_world(out)?, "in the frame of the input".to_owned()),
    };
    let views: Vec<(&Camera, Pose)> = dataset.views.iter().map(|v| (&v.camera, v.pose)).collect();
    let moved: Vec<(&Camera, Pose)> =
        views.iter().map(|(c, p)| (*c, mesh_from_model.transform_pose(p))).collect();
    let size = mesh.size();
    let all = mesh.sample(SAMPLES, 0);
    let surface = seen_by(&all, &mesh, &moved, SLACK_PCT / 100.0 * size);
    // Rods up to 1.6 % in diameter, and sheets up to 0.5 % thick, are thin.
    let thin = thin_parts(&surface, &all, 2.0 * THRESHOLD_PCT / 100.0 * size);
    anyhow::ensure!(
        !surface.is_empty(),
        "no camera sees the mesh {}: are the frames the same? --mesh-truth names true cameras in its frame",
        path.display()
    );
    let cropped = !dataset.is_transparent();
    let judge = |points: Vec<DVec3>| {
        let points = points.into_iter().map(|p| mesh_from_model.transform(p));
        let inside = box_around(&mesh, CROP_PCT / 100.0 * size);
        let points: Vec<DVec3> = points.filter(|p| !cropped || inside(*p)).collect();
        compare_points(&points, &mesh, &surface, &thin, THRESHOLD_PCT)
    };
    let cloud = judge(model.points.values().map(|p| p.position).collect());
    let voxel = VOXEL_PCT / 100.0 * size / mesh_from_model.scale;
    let splat = judge(surface_points(&views, (gaussians, antialias), voxel, progress)?);
    let from = config.mesh_depths;
    let matted = dense::with_silhouettes(dataset, (gaussians, antialias))?;
    let dataset = matted.as_ref().unwrap_or(dataset);
    let depths = if from.by_stereo() { Some(dense::depths(out, dataset, progress)?) } else { None };
    let dense = judge(depths.as_ref().map_or(Vec::new(), |d| some_points(&dense::cloud(d, dataset))));
    let by_splat = from.by_splat().then_some((gaussians, antialias));
    let mesh_made = dense::mesh(depths, by_splat, dataset, DEFAULT_RESOLUTION, progress)?;
    let fused = judge(mesh_made.sample(SAMPLES, 0));
    let seen = 100.0 * surface.len() as f64 / SAMPLES as f64;
    let protocol = format!(
        "{aligned}; distances in % of the mesh's size ({size:.4} units); of the mesh the {seen:.1} % that the views see ({SAMPLES} \
         samples); surface: depths at half transmittance of {} views, one point a cube of {VOXEL_PCT} %; dense cloud: at most {SAMPLES} of its points; fused mesh: {SAMPLES} samples of what export --mesh --mesh-error 0 --mesh-depths {} writes{}",
        views.len().min(DEPTH_MAPS),
        from.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned()),
        if cropped {
            format!("; points farther than {CROP_PCT} % from the mesh's box are left out")
        } else {
            String::new()
        }
    );
    Ok(Some(ShapeEvaluation { protocol, cloud, surface: splat, dense, fused, floaters_pct }))
}

/// From the world in which a run was written into the frame of its input.
fn source_from_world(out: &Path) -> Result<Sim3> {
    let world = crate::stage::last::<PoseSummary>(out, "sfm")?.and_then(|poses| poses.value.world);
    Ok(world.map_or(Sim3::IDENTITY, |w| w.sim3().inverse()))
}

/// Onto the true camera centres; and how well that went.
fn align(model: &Reconstruction, truth: &Path) -> Result<(Sim3, String)> {
    let truth = scene::io::read_truth(truth)?;
    let stem = |name: &str| Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned());
    let by_name: BTreeMap<_, _> = truth.images.values().map(|i| (stem(&i.name), i.pose.centre())).collect();
    let pairs = model.images.values().filter_map(|i| Some((i.pose.centre(), *by_name.get(&stem(&i.name))?)));
    let (ours, theirs): (Vec<DVec3>, Vec<DVec3>) = pairs.unzip();
    let found = robust_alignment(&ours, &theirs).with_context(|| {
        format!("{} of the images are among the true cameras, and at least 3 are needed", ours.len())
    })?;
    let extent = theirs.iter().map(|c| c.distance(theirs[0])).fold(0.0, f64::max);
    let mut off: Vec<f64> =
        ours.iter().zip(&theirs).map(|(a, b)| found.0.transform(*a).distance(*b)).collect();
    off.sort_by(f64::total_cmp);
    let median = 100.0 * off[off.len() / 2] / extent;
    Ok((
        found.0,
        format!("aligned by {} true camera centres (median {median:.3} % of their extent)", ours.len()),
    ))
}

/// Every so many points that [`SAMPLES`] are left, evenly in their order, which is by views.
fn some_points(cloud: &[OrientedPoint]) -> Vec<DVec3> {
    cloud.iter().step_by(cloud.len().div_ceil(SAMPLES).max(1)).map(|p| p.position).collect()
}

fn box_around(mesh: &Mesh, margin: f64) -> impl Fn(DVec3) -> bool + use<> {
    let low = mesh.vertices.iter().fold(DVec3::INFINITY, |a, v| a.min(*v)) - margin;
    let high = mesh.vertices.iter().fold(DVec3::NEG_INFINITY, |a, v| a.max(*v)) + margin;
    move |p| p.cmpge(low).all() && p.cmple(high).all()
}

/// Points at half transmittance as the views see them, one (the mean) a cube of side `voxel`.
fn surface_points(
    views: &[(&Camera, Pose)],
    (gaussians, antialias): (&Gaussians, bool),
    voxel: f64,
    progress: &Progress,
) -> Result<Vec<DVec3>> {
    let count = views.len().min(DEPTH_MAPS);
    progress.begin("surface", count);
    let mut cubes: HashMap<[i64; 3], (DVec3, f64)> = HashMap::new();
    for k in 0..count {
        let (camera, pose) = &views[k * views.len() / count];
        let near = 0.01 * gaussians.median_distance(pose.centre());
        let depth = median_depth(gaussians, camera, pose, near, antialias);
        for p in points_of(&depth, camera, pose) {
            let cube = (p / voxel).floor().to_array().map(|v| v as i64);
            let sum = cubes.entry(cube).or_default();
            *sum = (sum.0 + p, sum.1 + 1.0);
        }
        progress.tick()?;
    }
    let mut points: Vec<([i64; 3], DVec3)> = cubes.into_iter().map(|(c, (sum, n))| (c, sum / n)).collect();
    points.sort_by_key(|(cube, _)| *cube); // the same order every time
    Ok(points.into_iter().map(|(_, p)| p).collect())
}
