//! How far estimated poses are from true ones.

use super::align::{box_diagonal, residuals, robust_alignment};
use crate::pose::rotation_angle;
use crate::{PosedImage, Reconstruction};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Thresholds of [`PoseErrors::auc`], degrees. Source: Jin et al., IJCV 2021 (5, 10), with 1 and 3
/// for what is more exact.
pub const AUC_THRESHOLDS_DEG: [f64; 4] = [1.0, 3.0, 5.0, 10.0];

/// Median, mean and maximum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorStatistics {
    /// Median.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorStatistics {
    /// Of some values; `None` where there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        let max = *sorted.last()?;
        let median = (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0;
        Some(Self { median, mean: sorted.iter().sum::<f64>() / n as f64, max })
    }
}

/// The errors of one image after the alignment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageError {
    /// Its name in the ground truth.
    pub name: String,
    /// Distance of the centre from the true one, percent of the extent.
    pub centre_pct: f64,
    /// Angle to the true rotation, degrees.
    pub rotation_deg: f64,
}

/// What [`compare_poses`] found out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseErrors {
    /// Images of the ground truth that the model has.
    pub registered: usize,
    /// Images of the ground truth.
    pub total: usize,
    /// Area under the curve of recall against error up to 1, 3, 5 and 10°, percent. The error of a
    /// pair of images is the larger of the angle between relative rotations and the angle between
    /// relative translation directions; a pair with an unregistered image fails. `None` for fewer
    /// than two images.
    pub auc: Option<[f64; 4]>,
    /// Angle between estimated and true rotation after alignment, degrees, registered images.
    pub rotation_deg: Option<ErrorStatistics>,
    /// Distance of camera centres after alignment, percent of `extent`, registered images.
    pub centre_pct: Option<ErrorStatistics>,
    /// Diagonal of the box around the true centres, units of the ground truth.
    pub extent: f64,
    /// Units of the ground truth a unit of the model.
    pub scale: Option<f64>,
    /// Median over registered images of 100 (f / f_true − 1), f the mean of fx and fy, rescaled
    /// where the image widths differ.
    pub focal_err_pct: Option<f64>,
    /// The registered images, by name; empty where no alignment exists (fewer than 3 images).
    pub images: Vec<ImageError>,
}

/// Compares the poses of a model with ground truth: the definitions of the project's
/// `compare_poses.py`. Images are matched by file name without folder, and where that finds nothing
/// without extension too.
pub fn compare_poses(model: &Reconstruction, truth: &Reconstruction) -> PoseErrors {
    let names = Names::new(model);
    let mut wanted: Vec<&PosedImage> = truth.images.values().collect();
    wanted.sort_by(|a, b| a.name.cmp(&b.name));
    let pairs: Vec<(Option<&PosedImage>, &PosedImage)> =
        wanted.iter().map(|t| (names.find(&t.name), *t)).collect();
    let both: Vec<(&PosedImage, &PosedImage)> = pairs.iter().filter_map(|(e, t)| Some(((*e)?, *t))).collect();
    let true_centres: Vec<DVec3> = wanted.iter().map(|t| t.pose.centre()).collect();
    let extent = box_diagonal(&true_centres);
    let mut errors = PoseErrors {
        registered: both.len(),
        total: wanted.len(),
        auc: auc(&pairs, extent),
        rotation_deg: None,
        centre_pct: None,
        extent,
        scale: None,
        focal_err_pct: focal_error(model, truth, &both),
        images: Vec::new(),
    };
    let source: Vec<DVec3> = both.iter().map(|(e, _)| e.pose.centre()).collect();
    let target: Vec<DVec3> = both.iter().map(|(_, t)| t.pose.centre()).collect();
    if extent > 0.0
        && let Some((sim, _)) = robust_alignment(&source, &target)
    {
        let distances = residuals(&sim, &source, &target);
        errors.images = both
            .iter()
            .zip(distances)
            .map(|((e, t), distance)| {
                let aligned = e.pose.rotation * sim.rotation.conjugate();
                let rotation_deg = rotation_angle(aligned, t.pose.rotation).to_degrees();
                ImageError { name: t.name.clone(), centre_pct: 100.0 * distance / extent, rotation_deg }
            })
            .collect();
        errors.scale = Some(sim.scale);
        let column =
            |f: fn(&ImageError) -> f64| ErrorStatistics::of(&errors.images.iter().map(f).collect::<Vec<_>>());
        (errors.centre_pct, errors.rotation_deg) = (column(|e| e.centre_pct), column(|e| e.rotation_deg));
    }
    errors
}

/// Images of a model by file name, then by file name without extension.
struct Names<'a> {
    exact: BTreeMap<&'a str, &'a PosedImage>,
    stems: BTreeMap<&'a str, &'a PosedImage>,
}

fn base(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

fn stem(name: &str) -> &str {
    let base = base(name);
    base.rsplit_once('.').map_or(base, |(stem, _)| if stem.is_empty() { base } else { stem })
}

impl<'a> Names<'a> {
    fn new(model: &'a Reconstruction) -> Self {
        let mut names = Self { exact: BTreeMap::new(), stems: BTreeMap::new() };
        for image in model.images.values() {
            names.exact.entry(base(&image.name)).or_insert(image);
            names.stems.entry(stem(&image.name)).or_insert(image);
        }
        names
    }

    fn find(&self, name: &str) -> Option<&'a PosedImage> {
        self.exact.get(base(name)).or_else(|| self.stems.get(stem(name))).copied()
    }
}

/// Area under the recall curve over all pairs of images: the mean of `max(0, 1 − e / T)`, percent.
fn auc(pairs: &[(Option<&PosedImage>, &PosedImage)], extent: f64) -> Option<[f64; 4]> {
    let mut sums = [0.0; 4];
    let mut count = 0.0;
    for (i, a) in pairs.iter().enumerate() {
        for b in &pairs[i + 1..] {
            count += 1.0;
            let (Some(ea), Some(eb)) = (a.0, b.0) else { continue };
            let error = pair_error_deg([ea, eb], [a.1, b.1], extent);
            sums.iter_mut().zip(AUC_THRESHOLDS_DEG).for_each(|(s, t)| *s += (1.0 - error / t).max(0.0));
        }
    }
    (count > 0.0).then(|| sums.map(|s| 100.0 * s / count))
}

/// The larger of the relative rotation's and the relative translation direction's error. Where the
/// true centres coincide only the rotation counts; coinciding estimated centres are 180° off.
fn pair_error_deg(estimated: [&PosedImage; 2], truth: [&PosedImage; 2], extent: f64) -> f64 {
    let [(re, de), (rt, dt)] = [estimated, truth].map(|[a, b]| {
        let baseline = a.pose.rotation * (b.pose.centre() - a.pose.centre());
        (b.pose.rotation * a.pose.rotation.conjugate(), baseline)
    });
    let direction = if dt.length() <= 1e-9 * extent {
        0.0
    } else if de.length() == 0.0 {
        std::f64::consts::PI
    } else {
        de.normalize().cross(dt.normalize()).length().atan2(de.normalize().dot(dt.normalize()))
    };
    rotation_angle(re, rt).max(direction).to_degrees()
}

fn focal_error(
    model: &Reconstruction,
    truth: &Reconstruction,
    both: &[(&PosedImage, &PosedImage)],
) -> Option<f64> {
    let errors = both.iter().filter_map(|(e, t)| {
        let (ce, ct) = (model.cameras.get(&e.camera)?, truth.cameras.get(&t.camera)?);
        let known = ct.width > 0 && ce.width > 0;
        let rescale = if known { f64::from(ct.width) / f64::from(ce.width) } else { 1.0 };
        Some(100.0 * (ce.mean_focal() * rescale / ct.mean_focal() - 1.0))
    });
    ErrorStatistics::of(&errors.collect::<Vec<_>>()).map(|s| s.median)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim3::Sim3;
    use crate::{Camera, CameraModel, Pose};
    use glam::DQuat;

    fn ring(n: u32) -> Reconstruction {
        let mut model = Reconstruction::default();
        model.cameras.insert(1, Camera::centred(1, CameraModel::Pinhole, 640, 480, 800.0));
        for id in 1..=n {
            let angle = f64::from(id) * 0.3;
            let eye = DVec3::new(angle.cos(), angle.sin(), 0.2 * (3.0 * angle).sin());
            let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
            let name = format!("folder/view{id:02}.png");
            model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: Vec::new() });
        }
        model
    }

    #[test]
    fn a_moved_copy_has_no_error_and_missing_images_fail_their_pairs() {
        let truth = ring(10);
        let sim = Sim3 {
            scale: 1e-4,
            rotation: DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5),
            translation: DVec3::splat(9.0),
        };
        let mut model = sim.transform_reconstruction(&truth);
        model
            .images
            .values_mut()
            .for_each(|i| i.name = i.name.replace("folder/", "").replace(".png", ".jpg"));
        let errors = compare_poses(&model, &truth);
        assert_eq!((errors.registered, errors.total), (10, 10));
        assert!(errors.auc.unwrap().iter().all(|&a| a > 99.999) && errors.rotation_deg.unwrap().max < 1e-6);
        assert!((errors.scale.unwrap() - 1e4).abs() < 1e-3 && errors.focal_err_pct.unwrap().abs() < 1e-12);
        model.images.remove(&3);
        let errors = compare_poses(&model, &truth);
        assert_eq!(errors.registered, 9);
        assert!((errors.auc.unwrap()[0] - 80.0).abs() < 1e-3, "36 of 45 pairs are left");
    }

    #[test]
    fn one_turned_camera_shows_in_the_maximum_only() {
        let truth = ring(12);
        let mut model = truth.clone();
        let pose = &mut model.images.get_mut(&5).unwrap().pose;
        *pose = Pose::from_centre(DQuat::from_rotation_z(0.05) * pose.rotation, pose.centre());
        let errors = compare_poses(&model, &truth);
        let rotation = errors.rotation_deg.unwrap();
        assert!(rotation.median < 1e-6 && (rotation.max - 0.05_f64.to_degrees()).abs() < 1e-6);
        let expected = 100.0 * (1.0 - 11.0 / 66.0 * (0.05_f64.to_degrees() / 10.0));
        assert!(errors.auc.unwrap()[3] < expected + 1e-9, "{:?}", errors.auc);
    }

    #[test]
    fn nothing_registered_is_a_value_and_not_an_error() {
        let errors = compare_poses(&Reconstruction::default(), &ring(3));
        assert_eq!((errors.registered, errors.auc, errors.scale), (0, Some([0.0; 4]), None));
        assert_eq!(compare_poses(&ring(3), &Reconstruction::default()).auc, None);
    }
}
