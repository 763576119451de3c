//! Which views look at the same side of the object, and how deep it lies.

use crate::level::LevelImage;
use crate::pair::Pair;
use crate::settings::StereoSettings;
use glam::DVec3;
use scene::PosedPhoto;

/// How the views lie.
pub(crate) struct Layout {
    /// Neighbours of each view.
    neighbours: Vec<Vec<usize>>,
    /// Least and most depth of each view, scene units; none where nothing lies before it.
    pub(crate) depths: Vec<Option<[f32; 2]>>,
}

impl Layout {
    pub(crate) fn new(views: &[PosedPhoto], points: &[DVec3], settings: &StereoSettings) -> Self {
        let points: Vec<DVec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
        let middle = DVec3::from(
            [0, 1, 2].map(|axis| quantile(points.iter().map(|p| p[axis]).collect(), 0.5).unwrap_or(0.0)),
        );
        let depths = views.iter().map(|v| depths(v, &points, settings)).collect();
        let neighbours = (0..views.len()).map(|i| neighbours(i, views, middle, settings)).collect();
        Self { neighbours, depths }
    }

    /// The neighbours of a view, at one resolution.
    pub(crate) fn pairs(&self, view: usize, views: &[PosedPhoto], images: &[LevelImage]) -> Vec<Pair> {
        let from = (&images[view], &views[view].pose);
        let others = self.neighbours[view].iter();
        others.map(|&j| Pair::new(j, from, (&images[j], &views[j].pose))).collect()
    }
}

/// The nearest and the farthest depth of the points before a view, with room.
fn depths(view: &PosedPhoto, points: &[DVec3], settings: &StereoSettings) -> Option<[f32; 2]> {
    let all: Vec<f64> = points.iter().map(|p| view.pose.transform(*p).z).filter(|z| *z > 0.0).collect();
    let (near, far) = (quantile(all.clone(), settings.tail)?, quantile(all, 1.0 - settings.tail)?);
    let room = settings.reach * (far - near) + f64::from(f32::EPSILON) * far;
    Some([(near - room).max(near / 4.0) as f32, (far + room) as f32])
}

/// The views from which the object is seen under a useful angle: as many as asked for, spread
/// evenly over the angles and, by the order of the views, over both sides.
fn neighbours(view: usize, views: &[PosedPhoto], middle: DVec3, settings: &StereoSettings) -> Vec<usize> {
    let towards: Vec<DVec3> = views.iter().map(|v| (v.pose.centre() - middle).normalize_or_zero()).collect();
    let here = towards[view];
    let [least, most] = settings.angles_deg.map(f64::to_radians);
    let others = (0..views.len()).filter(|&j| j != view);
    let mut angles: Vec<(f64, usize)> = others.map(|j| (here.angle_between(towards[j]), j)).collect();
    angles.retain(|(angle, _)| angle.is_finite() && *angle > f64::EPSILON.sqrt());
    angles.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let useful: Vec<usize> =
        angles.iter().filter(|(angle, _)| (least..=most).contains(angle)).map(|(_, j)| *j).collect();
    let wanted = settings.neighbours.max(1);
    if useful.len() >= wanted {
        return (0..wanted).map(|k| useful[k * useful.len() / wanted]).collect();
    }
    // Too few: those beyond the range, nearest first, as far as a quarter turn.
    let (near, far): (Vec<_>, Vec<_>) = angles.iter().partition(|(angle, _)| *angle < least);
    let far = far.iter().filter(|(angle, j)| *angle < std::f64::consts::FRAC_PI_4 && !useful.contains(j));
    let extra = near.iter().rev().chain(far).map(|(_, j)| *j);
    useful.iter().copied().chain(extra).take(wanted).collect()
}

/// The value below which this share of the values lies.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    values.get((share * last as f64).round() as usize).copied()
}
