//! The growing model: poses, points and who sees what.

use super::config::MapperConfig;
use crate::skip::StepName;
use crate::tracks::{NONE, Tracks};
use crate::triangulation::{Gates, PointView, refine_point, triangulate, widest_angle};
use glam::{DVec2, DVec3};
use scene::{Camera, Pose, PosedImage, Preview, Reconstruction, ScenePoint, TwoViewGeometry};

/// Colour of points that have none yet, 8-bit sRGB. Source: chosen by hand, seen on black and on
/// white.
const GREY: [u8; 3] = [128; 3];

/// What does not change while a model grows.
#[derive(Clone, Copy)]
pub(crate) struct MappingInput<'a> {
    /// For each image its keypoints' positions.
    pub keypoints: &'a [Vec<DVec2>],
    /// For each image the standard deviation of each keypoint relative to the others'; where it is
    /// empty, all are 1.
    pub sigmas: &'a [Vec<f32>],
    /// Keypoints joined over images.
    pub tracks: &'a Tracks,
    /// For each image the index of its camera.
    pub camera_of: &'a [usize],
    /// Verified pairs.
    pub geometries: &'a [TwoViewGeometry],
    /// The user's choices.
    pub config: &'a MapperConfig,
    /// Whether images are the frames of a video, in the order of time; photos may have been rotated
    /// on their way.
    pub is_video: bool,
    /// Steps, and parts of them, that are left out.
    pub skip: &'a [StepName],
    /// Seed of all randomness.
    pub seed: u64,
}

impl MappingInput<'_> {
    /// Whether a step or a part of one is left out.
    pub(crate) fn skips(&self, step: StepName) -> bool {
        self.skip.contains(&step)
    }
}

/// A point of the growing model.
#[derive(Clone, Debug)]
pub(crate) struct MapPoint {
    /// World frame.
    pub position: DVec3,
    /// The track it stems from.
    pub track: u32,
    /// (image, feature), no image twice.
    pub views: Vec<[u32; 2]>,
}

/// The growing model.
#[derive(Clone, Debug, Default)]
pub(crate) struct MapState {
    /// Intrinsics, by camera index.
    pub cameras: Vec<Camera>,
    /// `cam_from_world` of the registered images.
    pub poses: Vec<Option<Pose>>,
    /// Points; removed ones leave a hole.
    pub points: Vec<Option<MapPoint>>,
    /// For each image and feature its point, or [`NONE`].
    pub point_of: Vec<Vec<u32>>,
    /// For each track its points.
    pub of_track: Vec<Vec<u32>>,
    /// Images in the order in which they were registered.
    pub order: Vec<usize>,
}

impl MapState {
    pub(crate) fn new(input: &MappingInput<'_>, cameras: Vec<Camera>) -> Self {
        Self {
            cameras,
            poses: vec![None; input.keypoints.len()],
            points: Vec::new(),
            point_of: input.keypoints.iter().map(|k| vec![NONE; k.len()]).collect(),
            of_track: vec![Vec::new(); input.tracks.views.len()],
            order: Vec::new(),
        }
    }

    pub(crate) fn gates(input: &MappingInput<'_>) -> Gates {
        let config = input.config;
        Gates { max_error_px: config.max_reprojection_px, min_angle: config.min_angle_deg.to_radians() }
    }

    /// Registers (or moves) an image.
    pub(crate) fn register(&mut self, image: usize, pose: Pose) {
        if self.poses[image].is_none() {
            self.order.push(image);
        }
        self.poses[image] = Some(pose);
    }

    /// Takes an image and its observations out.
    pub(crate) fn unregister(&mut self, image: usize) {
        self.poses[image] = None;
        self.order.retain(|&i| i != image);
        for feature in 0..self.point_of[image].len() {
            self.drop_view([image as u32, feature as u32]);
        }
    }

    pub(crate) fn registered_count(&self) -> usize {
        self.order.len()
    }

    /// Cameras, poses and points as they are now, for those who look on: without names,
    /// observations and colours. Image number = index of the frame + 1.
    pub(crate) fn preview(&self, camera_of: &[usize]) -> Preview {
        let mut model = Reconstruction::default();
        for (image, pose) in self.poses.iter().enumerate() {
            let Some(pose) = *pose else { continue };
            let camera = &self.cameras[camera_of[image]];
            model.cameras.insert(camera.id, camera.clone());
            let (id, name, observations) = (image as u32 + 1, String::new(), Vec::new());
            model.images.insert(id, PosedImage { id, camera: camera.id, name, pose, observations });
        }
        for (id, p) in self.live() {
            let point = ScenePoint { position: p.position, rgb: GREY, error_px: 0.0, track: Vec::new() };
            model.points.insert(u64::from(id) + 1, point);
        }
        Preview::Model(model)
    }

    /// The points that exist, with their numbers.
    pub(crate) fn live(&self) -> impl Iterator<Item = (u32, &MapPoint)> {
        self.points.iter().zip(0u32..).filter_map(|(p, id)| p.as_ref().map(|p| (id, p)))
    }

    pub(crate) fn view<'a>(
        &'a self,
        input: &MappingInput<'_>,
        [image, feature]: [u32; 2],
    ) -> Option<PointView<'a>> {
        let image = image as usize;
        let camera = &self.cameras[input.camera_of[image]];
        Some(PointView::new(self.poses[image].as_ref()?, camera, input.keypoints[image][feature as usize]))
    }

    /// Squared reprojection error of an observation, without the ray that [`PointView`] computes.
    pub(crate) fn error_sq(&self, input: &MappingInput<'_>, [image, feature]: [u32; 2], x: DVec3) -> f64 {
        let image = image as usize;
        let Some(pose) = &self.poses[image] else { return f64::INFINITY };
        let projected = self.cameras[input.camera_of[image]].project(pose.transform(x));
        projected.map_or(f64::INFINITY, |p| p.distance_squared(input.keypoints[image][feature as usize]))
    }

    fn add_view(&mut self, point: u32, view: [u32; 2]) {
        if let Some(p) = &mut self.points[point as usize] {
            p.views.push(view);
            self.point_of[view[0] as usize][view[1] as usize] = point;
        }
    }

    /// Takes an observation away; a point left with fewer than two goes too.
    pub(crate) fn drop_view(&mut self, view: [u32; 2]) {
        let point = std::mem::replace(&mut self.point_of[view[0] as usize][view[1] as usize], NONE);
        if point == NONE {
            return;
        }
        if let Some(p) = &mut self.points[point as usize] {
            p.views.retain(|v| *v != view);
            if p.views.len() < 2 {
                self.drop_point(point);
            }
        }
    }

    pub(crate) fn drop_point(&mut self, point: u32) {
        if let Some(p) = self.points[point as usize].take() {
            for [image, feature] in p.views {
                self.point_of[image as usize][feature as usize] = NONE;
            }
            self.of_track[p.track as usize].retain(|&q| q != point);
        }
    }

    /// Extends a track's points to registered images that agree with them, and triangulates what is
    /// left over. Returns how many observations were added.
    pub(crate) fn grow_track(&mut self, input: &MappingInput<'_>, track: u32) -> usize {
        let loose: Vec<[u32; 2]> = input.tracks.views[track as usize]
            .iter()
            .copied()
            .filter(|v| {
                self.poses[v[0] as usize].is_some() && self.point_of[v[0] as usize][v[1] as usize] == NONE
            })
            .collect();
        if loose.is_empty() {
            return 0;
        }
        let limit = input.config.max_reprojection_px.powi(2);
        let (mut rest, mut added) = (Vec::new(), 0);
        for view in loose {
            let point = self.of_track[track as usize].iter().copied().find(|p| {
                let point = self.points[*p as usize].as_ref();
                point.is_some_and(|x| self.error_sq(input, view, x.position) < limit)
            });
            match point {
                Some(point) => {
                    self.add_view(point, view);
                    added += 1;
                }
                None => rest.push(view),
            }
        }
        if rest.len() >= 2 {
            added += self.triangulate_views(input, track, &rest);
        }
        added
    }

    /// Gives a track a point at a known place, seen by all registered images of the track.
    pub(crate) fn place(&mut self, input: &MappingInput<'_>, track: u32, position: DVec3) {
        let point = self.points.len() as u32;
        self.points.push(Some(MapPoint { position, track, views: Vec::new() }));
        self.of_track[track as usize].push(point);
        for &[image, feature] in &input.tracks.views[track as usize] {
            if self.poses[image as usize].is_some() && self.point_of[image as usize][feature as usize] == NONE
            {
                self.add_view(point, [image, feature]);
            }
        }
    }

    fn triangulate_views(&mut self, input: &MappingInput<'_>, track: u32, loose: &[[u32; 2]]) -> usize {
        let views: Vec<PointView<'_>> = loose.iter().filter_map(|v| self.view(input, *v)).collect();
        let Some(found) = triangulate(&views, &Self::gates(input)) else { return 0 };
        let point = self.points.len() as u32;
        self.points.push(Some(MapPoint { position: found.position, track, views: Vec::new() }));
        self.of_track[track as usize].push(point);
        for &i in &found.inliers {
            self.add_view(point, loose[i]);
        }
        found.inliers.len()
    }

    /// [`MapState::grow_track`] for every track that an image sees.
    pub(crate) fn grow_image(&mut self, input: &MappingInput<'_>, image: usize) -> usize {
        let tracks: Vec<u32> = input.tracks.of[image].iter().copied().filter(|&t| t != NONE).collect();
        tracks.into_iter().map(|t| self.grow_track(input, t)).sum()
    }

    /// [`MapState::grow_track`] for every track.
    pub(crate) fn grow_all(&mut self, input: &MappingInput<'_>) -> usize {
        (0..input.tracks.views.len() as u32).map(|t| self.grow_track(input, t)).sum()
    }

    /// Moves points to their least-squares place for the present poses; `held` says which stay.
    pub(crate) fn refine_points(&mut self, input: &MappingInput<'_>, held: impl Fn(u32) -> bool) {
        (0..self.points.len() as u32).filter(|&id| !held(id)).for_each(|id| self.refine_point(input, id));
    }

    /// Moves one point to its least-squares place for the present poses.
    pub(crate) fn refine_point(&mut self, input: &MappingInput<'_>, id: u32) {
        let Some(point) = self.points[id as usize].as_ref() else { return };
        let views: Vec<PointView<'_>> =
            point.views.iter().filter_map(|v| self.bare_view(input, *v)).collect();
        let position = refine_point(point.position, views.iter(), 3);
        if let Some(p) = &mut self.points[id as usize] {
            p.position = position;
        }
    }

    /// The points that some of these images see, ascending.
    pub(crate) fn seen_by(&self, images: &[usize]) -> Vec<u32> {
        let all = images.iter().flat_map(|&i| self.point_of[i].iter().copied());
        let mut ids: Vec<u32> = all.filter(|&id| id != NONE).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// A view whose ray is not needed.
    fn bare_view<'a>(
        &'a self,
        input: &MappingInput<'_>,
        [image, feature]: [u32; 2],
    ) -> Option<PointView<'a>> {
        let pose = self.poses[image as usize]?;
        let camera = &self.cameras[input.camera_of[image as usize]];
        let pixel = input.keypoints[image as usize][feature as usize];
        Some(PointView { pose, camera, pixel, centre: DVec3::ZERO, ray: DVec3::ZERO })
    }

    /// Drops observations with a larger error than `max_error_px` or behind the camera, and points
    /// seen under too small an angle. Returns how many observations went.
    pub(crate) fn filter(&mut self, input: &MappingInput<'_>, max_error_px: f64) -> usize {
        self.filter_points(input, max_error_px, 0..self.points.len() as u32)
    }

    /// [`MapState::filter`] of the points that some of these images see.
    pub(crate) fn filter_seen_by(
        &mut self,
        input: &MappingInput<'_>,
        max_error_px: f64,
        images: &[usize],
    ) -> usize {
        self.filter_points(input, max_error_px, self.seen_by(images).into_iter())
    }

    fn filter_points(
        &mut self,
        input: &MappingInput<'_>,
        max_error_px: f64,
        points: impl Iterator<Item = u32>,
    ) -> usize {
        let (limit, min_angle) = (max_error_px * max_error_px, input.config.min_angle_deg.to_radians());
        let centres: Vec<DVec3> =
            self.poses.iter().map(|p| p.as_ref().map_or(DVec3::NAN, Pose::centre)).collect();
        let mut gone = 0;
        for id in points {
            let Some(point) = &self.points[id as usize] else { continue };
            let x = point.position;
            let bad: Vec<[u32; 2]> =
                point.views.iter().copied().filter(|v| !(self.error_sq(input, *v, x) <= limit)).collect();
            gone += bad.len();
            for view in bad {
                self.drop_view(view);
            }
            let Some(point) = &self.points[id as usize] else { continue };
            let angle = widest_angle(x, point.views.iter().map(|v| centres[v[0] as usize]));
            if angle < min_angle {
                gone += point.views.len();
                self.drop_point(id);
            }
        }
        gone
    }

    /// All residual lengths, pixels.
    pub(crate) fn errors(&self, input: &MappingInput<'_>) -> Vec<f64> {
        let observations = self.live().flat_map(|(_, p)| p.views.iter().map(|v| (*v, p.position)));
        observations.map(|(view, x)| self.error_sq(input, view, x).sqrt()).collect()
    }

    /// `Σ max(0, 1 − e²/T²)` over all observations, `T` the largest error of one that is kept.
    pub(crate) fn agreement(&self, input: &MappingInput<'_>) -> f64 {
        let limit = input.config.max_reprojection_px;
        self.errors(input).iter().map(|e| (1.0 - (e / limit).powi(2)).max(0.0)).sum()
    }

    /// How many observations of points an image has.
    pub(crate) fn observations(&self, image: usize) -> usize {
        self.point_of[image].iter().filter(|&&p| p != NONE).count()
    }
}
