//! The object's middle and size, in which thresholds have a meaning.

use super::chain::Chain;
use super::part::MovingPart;
use crate::statistics::median;
use crate::triangulation::{PointView, nearest_to_rays, refine_point};
use glam::DVec3;
use scene::{Pose, Reconstruction, ScenePoint};
use std::collections::BTreeMap;

/// The frame in which the object's middle is the origin and its size 1.
pub(super) struct ObjectUnit {
    middle: DVec3,
    size: f64,
}

impl ObjectUnit {
    /// Of a model's points.
    pub(super) fn of(model: &Reconstruction) -> Self {
        let places = model.points.values().map(|p| p.position);
        let middle = [0, 1, 2].map(|axis| median(places.clone().map(|x| x[axis]).collect()));
        let middle = DVec3::from(middle);
        let mut away: Vec<f64> = places.map(|x| x.distance(middle)).collect();
        away.sort_by(f64::total_cmp);
        // Nine of ten points are the object's; some others are wrong.
        let radius = away.get(away.len() * 9 / 10).copied().unwrap_or(1.0);
        Self { middle, size: 2.0 * radius.max(f64::MIN_POSITIVE) }
    }

    /// A pose of the model's, in this frame.
    pub(super) fn pose(&self, pose: &Pose) -> Pose {
        Pose::new(pose.rotation, (pose.rotation * self.middle + pose.translation) / self.size)
    }

    /// The model with the cameras and poses of the chain, without points that leave a greater error
    /// (pixels).
    pub(super) fn corrected(
        &self,
        model: &Reconstruction,
        chain: &Chain,
        names: &[String],
        most: f64,
    ) -> Reconstruction {
        let mut next = model.clone();
        next.cameras.values_mut().zip(&chain.cameras).for_each(|(own, camera)| own.clone_from(camera));
        for image in next.images.values_mut() {
            let frame = names.iter().position(|n| *n == image.name).and_then(|k| chain.frames[k]);
            if let Some((_, pose)) = frame {
                let shift = pose.translation * self.size - pose.rotation * self.middle;
                image.pose = Pose::new(pose.rotation, shift);
            }
        }
        let points: BTreeMap<u64, ScenePoint> =
            next.points.iter().filter_map(|(id, p)| Some((*id, placed(p, &next, most)?))).collect();
        for observation in next.images.values_mut().flat_map(|i| &mut i.observations) {
            observation.point = observation.point.filter(|p| points.contains_key(p));
        }
        next.points = points;
        next
    }

    /// A part from this frame back to the model's.
    pub(super) fn restore(&self, part: &mut MovingPart) {
        part.place = self.restored(part.place);
        part.points.iter_mut().for_each(|p| *p = self.restored(*p));
        part.place_sigma *= self.size;
    }

    /// A place from this frame back to the model's.
    fn restored(&self, place: [f64; 3]) -> [f64; 3] {
        (DVec3::from(place) * self.size + self.middle).to_array()
    }
}

/// A point where the model's cameras and poses see it; `None` where that leaves a greater error
/// (pixels).
fn placed(point: &ScenePoint, model: &Reconstruction, most: f64) -> Option<ScenePoint> {
    let views = point.track.iter().map(|element| {
        let image = &model.images[&element.image];
        let pixel = image.observations[element.observation as usize].pixel;
        PointView::new(&image.pose, &model.cameras[&image.camera], pixel)
    });
    let views: Vec<PointView<'_>> = views.collect();
    let position = refine_point(nearest_to_rays(views.iter())?, views.iter(), 8);
    let errors = views.iter().map(|v| v.error_sq(position));
    let error_px = errors.clone().map(f64::sqrt).sum::<f64>() / views.len() as f64;
    let rms = (errors.sum::<f64>() / views.len() as f64).sqrt();
    (rms <= most).then(|| ScenePoint { position, error_px, ..point.clone() })
}
