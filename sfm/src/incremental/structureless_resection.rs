//! Poses from verified pairs, for images that see too few points of the model: rotation and
//! direction from one pair, the distance from the few points or from other pairs (structure-less
//! resection: Zheng & Wu, ICCV 2015). And the same consistency as a check of every pose.

use super::initial::relative_pose;
use super::resection::visible;
use super::state::{MapState, MappingInput};
use crate::solvers::{essential_from_pose, sampson_sq};
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Camera, Pose, TwoViewGeometry};

/// Pairs of an image that give hypotheses.
/// Source: chosen by hand, never measured.
const PAIRS: usize = 4;
/// Matches of a pair that are compared.
/// Source: chosen by hand, never measured.
pub(crate) const MATCHES: usize = 200;
/// Fewest points that settle the distance.
/// Source: chosen by hand, never measured.
const MIN_POINTS: usize = 4;
/// Fewest points that settle it by agreeing on it among themselves.
/// Source: chosen by hand, never measured.
const MIN_SCALES: usize = 5;
/// How far they may be from their median, as a share of it.
/// Source: chosen by hand; the test below shows what it tells apart.
const SCALE_SPREAD: f64 = 0.12;
/// Frames of a video so few apart show the same place.
/// Source: docs/decisions/07.
pub(crate) const NEAR_IN_TIME: usize = 5;

/// Matches of an image with a registered one, in ideal pixels from the principal point.
struct Link<'a> {
    geometry: &'a TwoViewGeometry,
    other: Pose,
    focal: [f64; 2],
    /// (other image, this image).
    matches: Vec<(DVec2, DVec2)>,
}

impl Link<'_> {
    fn is_near_in_time(&self) -> bool {
        self.geometry.a.abs_diff(self.geometry.b) <= NEAR_IN_TIME
    }

    /// How many matches agree with a pose of this image.
    fn count_agreeing(&self, pose: &Pose, limit: f64) -> usize {
        let relative = pose.compose(&self.other.inverse());
        let inverse = self.focal.map(|f| DMat3::from_diagonal(DVec3::new(1.0 / f, 1.0 / f, 1.0)));
        let m = inverse[1] * essential_from_pose(&relative) * inverse[0];
        self.matches.iter().filter(|(a, b)| sampson_sq(&m, *a, *b) < limit * limit).count()
    }
}

/// The pairs that tie an image to registered ones, strongest first.
fn links<'a>(state: &MapState, input: &MappingInput<'a>, image: usize) -> Vec<Link<'a>> {
    let of_image = input.geometries.iter().filter(|g| g.a == image || g.b == image);
    let mut found: Vec<Link<'a>> = of_image.filter_map(|g| link(state, input, g, image)).collect();
    found.sort_by_key(|l| (std::cmp::Reverse(l.geometry.inliers.len()), l.geometry.a, l.geometry.b));
    found
}

/// What a pair says of `image`, one of its two; `None` where the other one is not registered.
fn link<'a>(
    state: &MapState,
    input: &MappingInput<'a>,
    geometry: &'a TwoViewGeometry,
    image: usize,
) -> Option<Link<'a>> {
    let other = if geometry.a == image { geometry.b } else { geometry.a };
    let pose = state.poses[other]?;
    let cameras = [other, image].map(|i| &state.cameras[input.camera_of[i]]);
    let focal = cameras.map(|c| c.mean_focal());
    let step = geometry.inliers.len().div_ceil(MATCHES).max(1);
    let (of_other, of_image) = (&input.keypoints[other], &input.keypoints[image]);
    let mut matches = Vec::with_capacity(geometry.inliers.len().div_ceil(step));
    for m in geometry.inliers.iter().step_by(step) {
        let [there, here] = if geometry.a == image { [m[1], m[0]] } else { *m };
        if let (Some(there), Some(here)) = (of_other.get(there as usize), of_image.get(here as usize)) {
            matches.push((cameras[0].unproject(*there) * focal[0], cameras[1].unproject(*here) * focal[1]));
        }
    }
    Some(Link { geometry, other: pose, focal, matches })
}

/// Matches of a pair: (agreeing with the model's poses, all); `None` where an image is not
/// registered.
pub(crate) fn agreement(
    state: &MapState,
    input: &MappingInput<'_>,
    geometry: &TwoViewGeometry,
) -> Option<(usize, usize)> {
    let pose = state.poses[geometry.b]?;
    let link = link(state, input, geometry, geometry.b)?;
    Some((link.count_agreeing(&pose, 2.0 * input.config.max_reprojection_px), link.matches.len()))
}

/// Matches of an image with registered ones: (agreeing with its pose, all). Of a frame of a video
/// those with its neighbours in time, where these are enough: others may show another place that
/// looks alike.
pub(crate) fn consistency(state: &MapState, input: &MappingInput<'_>, image: usize) -> (usize, usize) {
    let Some(pose) = state.poses[image] else { return (0, 0) };
    let mut links = links(state, input, image);
    if input.is_video {
        let near = links.iter().filter(|l| l.is_near_in_time());
        if near.map(|l| l.matches.len()).sum::<usize>() >= 2 * input.config.min_observations {
            links.retain(Link::is_near_in_time);
        }
    }
    let limit = 2.0 * input.config.max_reprojection_px;
    let agreeing = links.iter().map(|l| l.count_agreeing(&pose, limit)).sum();
    (agreeing, links.iter().map(|l| l.matches.len()).sum())
}

/// The unregistered image, and its pose, for which verified pairs and few points agree best; `None`
/// where no distance is settled.
pub(crate) fn resect_structureless(
    state: &MapState,
    input: &MappingInput<'_>,
    skip: &[bool],
) -> Option<(usize, Pose)> {
    let mut ranked: Vec<(usize, usize, Vec<Link<'_>>)> = (0..state.poses.len())
        .filter(|&i| state.poses[i].is_none() && !skip[i])
        .map(|i| {
            let links = links(state, input, i);
            (links.iter().map(|l| l.geometry.inliers.len()).sum(), i, links)
        })
        .filter(|(n, ..)| *n > 0)
        .collect();
    ranked.sort_by_key(|(n, i, _)| (std::cmp::Reverse(*n), *i));
    ranked
        .into_iter()
        .find_map(|(_, image, links)| Some((image, pose_from_links(state, input, image, &links)?)))
}

/// A line of poses: `x_cam = R X + t₀ + s t₁`, `s > 0`.
struct Line {
    rotation: DQuat,
    start: DVec3,
    step: DVec3,
}

impl Line {
    fn at(&self, s: f64) -> Pose {
        Pose { rotation: self.rotation, translation: self.start + self.step * s }
    }
}

fn pose_from_links(
    state: &MapState,
    input: &MappingInput<'_>,
    image: usize,
    links: &[Link<'_>],
) -> Option<Pose> {
    let camera = &state.cameras[input.camera_of[image]];
    let seen: Vec<(DVec2, DVec3)> = visible(state, input, image)
        .into_iter()
        .filter_map(|(f, p)| {
            let position = state.points[p as usize].as_ref()?.position;
            Some((camera.unproject(input.keypoints[image][f as usize]), position))
        })
        .collect();
    let limit = 2.0 * input.config.max_reprojection_px;
    let mut best: Option<(usize, Pose)> = None;
    for (i, link) in links.iter().take(PAIRS).enumerate() {
        let Some(line) = line_of(state, input, image, link) else { continue };
        let mut scales: Vec<f64> = seen.iter().filter_map(|(u, x)| scale_from_point(&line, *u, *x)).collect();
        let common = common_scale(&scales);
        scales.extend(common);
        let others = || links.iter().enumerate().filter(move |(k, _)| *k != i).map(|(_, l)| l);
        scales.extend(others().filter_map(|l| scale_from_pair(&line, l)));
        for s in scales.into_iter().filter(|s| s.is_finite() && *s > 0.0) {
            let pose = line.at(s);
            let points = seen.iter().filter(|(u, x)| error_px(camera, &pose, *u, *x) < limit).count();
            let agreeing: usize = others().map(|l| l.count_agreeing(&pose, limit)).sum();
            let all: usize = others().map(|l| l.matches.len()).sum();
            let by_points = points >= MIN_POINTS && points * 10 >= seen.len() * 3;
            let by_pairs = agreeing >= input.config.min_observations && agreeing * 10 >= all * 6;
            // Rotation and direction of the pair may be off by more pixels than the distance by per
            // cent.
            let by_scale = common == Some(s);
            let contradicted = all >= 2 * input.config.min_observations && agreeing * 10 < all * 4;
            let score = 3 * points + agreeing;
            if (by_points || by_pairs || by_scale) && !contradicted && best.is_none_or(|(b, _)| score > b) {
                best = Some((score, pose));
            }
        }
    }
    best.map(|(_, pose)| pose)
}

/// Distance of a point's image from where it is seen (a ray's `x/z, y/z`), pixels; infinite behind
/// the camera.
fn error_px(camera: &Camera, pose: &Pose, ray: DVec2, x: DVec3) -> f64 {
    let c = pose.transform(x);
    if c.z > 0.0 { (c.truncate() / c.z).distance(ray) * camera.mean_focal() } else { f64::INFINITY }
}

/// The distance on which nearly all points agree to some per cent: wrong matches scatter over
/// orders of magnitude.
fn common_scale(scales: &[f64]) -> Option<f64> {
    let mut sorted = scales.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = *sorted.get(sorted.len() / 2)?;
    let agreeing = sorted.iter().filter(|s| (*s / middle - 1.0).abs() < SCALE_SPREAD).count();
    (middle > 0.0 && agreeing >= MIN_SCALES && agreeing * 10 >= sorted.len() * 8).then_some(middle)
}

/// The poses that one pair allows.
fn line_of(state: &MapState, input: &MappingInput<'_>, image: usize, link: &Link<'_>) -> Option<Line> {
    let g = link.geometry;
    let cameras = [g.a, g.b].map(|i| &state.cameras[input.camera_of[i]]);
    let b_from_a = relative_pose(input, cameras, g)?;
    let relative = if g.b == image { b_from_a } else { b_from_a.inverse() };
    Some(Line {
        rotation: (relative.rotation * link.other.rotation).normalize(),
        start: relative.rotation * link.other.translation,
        step: relative.translation.try_normalize()?,
    })
}

/// The distance at which a point falls on its pixel, in the least-squares sense: `u × (a + s b) =
/// 0`.
fn scale_from_point(line: &Line, u: DVec2, x: DVec3) -> Option<f64> {
    let (a, b) = (line.rotation * x + line.start, line.step);
    let (p, q) = (a.truncate() - u * a.z, b.truncate() - u * b.z);
    (q.length_squared() > 1e-12).then(|| -p.dot(q) / q.length_squared())
}

/// The distance at which a pair's matches fulfil its epipolar constraint, `u · ((t₀ + s t₁) × v) =
/// 0`: the median.
fn scale_from_pair(line: &Line, link: &Link<'_>) -> Option<f64> {
    let relative = line.rotation * link.other.rotation.conjugate();
    let offset = line.start - relative * link.other.translation;
    let mut scales = Vec::with_capacity(link.matches.len());
    for (other, own) in &link.matches {
        let v = relative * (*other / link.focal[0]).extend(1.0);
        let u = (*own / link.focal[1]).extend(1.0);
        scales.push(-u.dot(offset.cross(v)) / u.dot(line.step.cross(v)));
    }
    scales.retain(|s| s.is_finite());
    scales.sort_unstable_by(f64::total_cmp);
    scales.get(scales.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distance_is_settled_by_points_that_agree_and_by_nothing_else() {
        assert_eq!(common_scale(&[1.0, 1.05, 0.97, 1.02, 0.99]), Some(1.0));
        assert_eq!(common_scale(&[1.0, 1.05, 0.97, 1.02, 0.99, 40.0]), Some(1.02));
        assert_eq!(common_scale(&[1.0, 1.05, 0.97, 1.02]), None, "too few");
        assert_eq!(common_scale(&[1.0, 1.05, 0.97, 1.02, 0.99, 40.0, 0.1]), None, "two of seven disagree");
        assert_eq!(common_scale(&[-1.0; 9]), None, "behind");
        assert_eq!(common_scale(&[0.3, 0.6, 1.2, 2.5, 5.0, 9.0]), None);
        assert_eq!(common_scale(&[]), None);
    }
}
