//! Verifies all pairs of `temple_ring` and compares the relative poses with the truth.
//!
//! `cargo run --release -p sfm --example two_view_table [FOLDER]`

use glam::{DMat3, DVec3};
use scene::pose::rotation_angle;
use scene::{Camera, CameraModel, Features, Frame, FrameSet, Pose, Progress, TwoViewGeometry, TwoViewKind};
use sfm::matching::{MatchConfig, match_pairs};
use sfm::sift::{SiftConfig, extract_all};
use sfm::two_view::{TwoViewConfig, verify_pairs};
use std::path::{Path, PathBuf};

type Truth = Vec<(String, DMat3, Pose)>;
type Matches = Vec<(usize, usize, Vec<[u32; 2]>)>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let shared = std::env::var("SAT_RECON_SHARED").unwrap_or_else(|_| "../shared".into());
    let folder = std::env::args().nth(1).unwrap_or_else(|| format!("{shared}/data/temple_ring"));
    let folder = PathBuf::from(folder);
    let truth = read_truth(&folder.join("cameras_par.txt"))?;
    let frames = read_frames(&folder.join("images"), &truth)?;
    let progress = Progress::silent();
    let features = extract_all(&frames, &SiftConfig::default(), &progress)?;
    let n = frames.frames.len();
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    let matches = match_pairs(&features, &pairs, &MatchConfig::default(), &progress)?;
    println!(
        "{n} images, {} features, {} pairs",
        features.iter().map(Features::len).sum::<usize>(),
        pairs.len()
    );
    let guessed: Vec<Camera> = frames
        .frames
        .iter()
        .map(|f| {
            let focal = 1.2 * f64::from(f.width.max(f.height));
            Camera::centred(1, CameraModel::SimplePinhole, f.width, f.height, focal)
        })
        .collect();
    let known: Vec<Camera> = frames
        .frames
        .iter()
        .zip(&truth)
        .map(|(f, (_, k, _))| {
            let params = vec![k.x_axis.x, k.y_axis.y, k.z_axis.x, k.z_axis.y];
            Camera {
                id: 1,
                model: CameraModel::Pinhole,
                width: f.width,
                height: f.height,
                params,
                has_prior_focal: true,
            }
        })
        .collect();
    for (name, cameras) in [("focal length guessed (1.2 × the larger side)", guessed), ("true K", known)] {
        table(name, &features, &cameras, &matches, &truth)?;
    }
    Ok(())
}

/// Verifies with these cameras and prints errors by the true angle between the views.
fn table(
    name: &str,
    features: &[Features],
    cameras: &[Camera],
    matches: &Matches,
    truth: &Truth,
) -> Result<(), Box<dyn std::error::Error>> {
    let start = cpu_seconds();
    let verified =
        verify_pairs(features, cameras, matches.clone(), &TwoViewConfig::default(), 0, &Progress::silent())?;
    println!("\n{name}: {} pairs verified in {:.2} CPU s", verified.len(), cpu_seconds() - start);
    println!(
        "views apart   pairs verified  calibrated F planar panoramic  inliers  rotation error median 90 %  translation"
    );
    for (low, high) in [(0.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 40.0), (40.0, 60.0), (60.0, 181.0)] {
        let apart =
            |a: usize, b: usize| rotation_angle(truth[a].2.rotation, truth[b].2.rotation).to_degrees();
        let inside = |a: usize, b: usize| (low..high).contains(&apart(a, b));
        let all = matches.iter().filter(|(a, b, _)| inside(*a, *b)).count();
        let here: Vec<&TwoViewGeometry> = verified.iter().filter(|g| inside(g.a, g.b)).collect();
        let kinds = |kind: TwoViewKind| here.iter().filter(|g| g.kind == kind).count();
        let errors: Vec<(f64, f64)> = here.iter().filter_map(|g| pose_errors(g, truth)).collect();
        let rotation = quantiles(errors.iter().map(|e| e.0).collect());
        let translation = quantiles(errors.iter().map(|e| e.1).collect());
        let inliers = quantiles(here.iter().map(|g| g.inliers.len() as f64).collect());
        println!(
            "{low:4}–{high:4}°   {all:5} {:8}  {:10} {:1} {:6} {:9}  {:7.0}  {:20.2}° {:5.2}°  {:8.2}° {:5.2}°",
            here.len(),
            kinds(TwoViewKind::Calibrated),
            kinds(TwoViewKind::Uncalibrated),
            kinds(TwoViewKind::Planar),
            kinds(TwoViewKind::Panoramic),
            inliers.0,
            rotation.0,
            rotation.1,
            translation.0,
            translation.1,
        );
    }
    Ok(())
}

/// Errors of rotation and of the direction of translation, degrees.
fn pose_errors(geometry: &TwoViewGeometry, truth: &Truth) -> Option<(f64, f64)> {
    let found = geometry.b_from_a?;
    let expected = truth[geometry.b].2.compose(&truth[geometry.a].2.inverse());
    let (t, u) = (found.translation, expected.translation);
    let direction = t.cross(u).length().atan2(t.dot(u));
    Some((rotation_angle(found.rotation, expected.rotation).to_degrees(), direction.to_degrees()))
}

/// Median and 90 % quantile; NaN of nothing.
fn quantiles(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |q: f64| values.get((q * values.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    (at(0.5), at(0.9))
}

/// User and system time of this process so far, seconds (Linux; 100 ticks a second).
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2).filter_map(|w| w.parse::<f64>().ok());
    ticks.sum::<f64>() / 100.0
}

/// Names, K and poses of a Middlebury `*_par.txt` file.
fn read_truth(path: &Path) -> Result<Truth, Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut truth = Vec::new();
    for line in text.lines().skip(1) {
        let mut words = line.split_whitespace();
        let Some(name) = words.next() else { continue };
        let v: Vec<f64> = words.map(str::parse).collect::<Result<_, _>>()?;
        let matrix = |i: usize| DMat3::from_cols_slice(&v[i..i + 9]).transpose();
        truth.push((name.to_owned(), matrix(0), Pose::from_matrix(matrix(9), DVec3::from_slice(&v[18..21]))));
    }
    Ok(truth)
}

fn read_frames(folder: &Path, truth: &Truth) -> Result<FrameSet, Box<dyn std::error::Error>> {
    let mut frames = FrameSet::default();
    for (i, (name, _, _)) in truth.iter().enumerate() {
        let path = folder.join(name);
        let (width, height) = image::image_dimensions(&path)?;
        let frame = Frame { name: name.clone(), path, width, height, source_index: i, ..Frame::default() };
        frames.frames.push(frame);
    }
    Ok(frames)
}
