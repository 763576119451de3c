//! Tracks through frames whose poses are known.

use super::joint::{JointPath, at_rest};
use super::limits::{FARTHEST, LEAST_VIEWS};
use crate::klt::KltTrack;
use crate::triangulation::{PointView, nearest_to_rays, refine_point};
use glam::{DVec2, DVec3};
use scene::{Camera, Pose};

/// A frame that has a pose: camera from the object, whose middle is the origin and whose size is 1.
pub(super) struct PosedFrame<'a> {
    /// Camera from the object.
    pub pose: Pose,
    /// What it was taken with.
    pub camera: &'a Camera,
}

/// A point followed through frames.
#[derive(Clone, Debug)]
pub(super) struct PosedTrack<'a> {
    /// Frame and what was seen there, in rising order.
    pub views: Vec<(usize, PointView<'a>)>,
}

impl<'a> PosedTrack<'a> {
    /// Of a track through frames, some of which have a pose; `None` where too few do.
    pub(super) fn new(track: &KltTrack, frames: &'a [Option<PosedFrame<'a>>]) -> Option<Self> {
        let places = track.positions.iter().enumerate().map(|(k, pixel)| (track.first + k, *pixel));
        let views: Vec<(usize, PointView<'a>)> = places
            .filter_map(|(k, pixel)| {
                let frame = frames.get(k)?.as_ref()?;
                Some((k, PointView::new(&frame.pose, frame.camera, pixel)))
            })
            .collect();
        (views.len() >= LEAST_VIEWS).then_some(Self { views })
    }

    /// The place in the body, and the standard deviation (pixels) that is left, were it a part of
    /// the body.
    pub(super) fn still(&self) -> Option<(DVec3, f64)> {
        fitted(&self.views.iter().map(|(_, v)| *v).collect::<Vec<_>>())
    }

    /// Of the errors as a part of the body: the sum of products of one with the next, and that of
    /// squares.
    pub(super) fn correlation(&self, x: DVec3) -> [f64; 2] {
        let errors: Vec<(usize, DVec2)> = self
            .views
            .iter()
            .filter_map(|(k, v)| Some((*k, v.camera.project(v.pose.transform(x))? - v.pixel)))
            .collect();
        let next = errors.windows(2).filter(|w| w[1].0 == w[0].0 + 1);
        let (mut products, mut squares) = (0.0, 0.0);
        for w in next {
            products += w[0].1.dot(w[1].1);
            squares += 0.5 * (w[0].1.length_squared() + w[1].1.length_squared());
        }
        [products, squares]
    }

    /// The same of a part that turns on a joint, from the frames that the joint knows of.
    pub(super) fn point(&self, path: &JointPath) -> Option<(DVec3, f64)> {
        let seen = self.views.iter().filter_map(|(k, v)| path.pose(*k).map(|m| at_rest(v, &m)));
        let seen: Vec<PointView<'_>> = seen.collect();
        (seen.len() >= LEAST_VIEWS).then(|| fitted(&seen)).flatten()
    }

    /// Where it was seen in a frame.
    pub(super) fn pixel(&self, frame: usize) -> Option<DVec2> {
        let found = self.views.binary_search_by_key(&frame, |v| v.0).ok()?;
        Some(self.views[found].1.pixel)
    }

    /// The farthest it goes from its first place in the picture, pixels.
    pub(super) fn travel(&self) -> f64 {
        let start = self.views[0].1.pixel;
        self.views.iter().map(|(_, v)| v.pixel.distance(start)).fold(0.0, f64::max)
    }
}

fn fitted(views: &[PointView<'_>]) -> Option<(DVec3, f64)> {
    let start = nearest_to_rays(views.iter())?;
    let x = refine_point(start, views.iter(), 8);
    let squared: f64 = views.iter().map(|v| v.error_sq(x)).sum();
    let left = squared / (2 * views.len()).saturating_sub(3) as f64;
    (left.is_finite() && x.length() < FARTHEST).then(|| (x, left.sqrt()))
}
