//! Two models of parts of a scene become one where they share points (and so, images): the
//! similarity between them is found robustly from points of the same tracks and checked in the
//! images of both.

use super::growth::{expel, grow, settle, starts_of};
use super::state::{MapState, MappingInput};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::AGREEING_SHARE;
use crate::ransac::{Estimator, RansacConfig, ransac};
use crate::triangulation::PointView;
use glam::DVec3;
use scene::sim3::{Sim3, umeyama};
use scene::{Camera, Progress};

/// Error allowed in the images of the other model, in largest reprojection errors: each model is
/// bent in its own way.
/// Source: chosen by hand, never measured.
const TOLERANCE: f64 = 3.0;

/// A point that both models have, with an observation in each.
struct Common<'a> {
    source: DVec3,
    target: DVec3,
    in_source: PointView<'a>,
    in_target: PointView<'a>,
}

/// Finds the similarity `target_from_source`; the residual is the larger reprojection error of the
/// moved point in a view of the target and of the target's point, moved back, in a view of the
/// source. Pixels.
struct Similarity<'a>(Vec<Common<'a>>);

impl Estimator for Similarity<'_> {
    type Model = (Sim3, Sim3);

    fn sample_size(&self) -> usize {
        3
    }

    fn num_data(&self) -> usize {
        self.0.len()
    }

    fn solve(&self, sample: &[usize], models: &mut Vec<Self::Model>) {
        models.extend(self.fit(sample));
    }

    fn residual_sq(&self, (forward, backward): &Self::Model, i: usize) -> f64 {
        let c = &self.0[i];
        let there = c.in_target.error_sq(forward.transform(c.source));
        let back = c.in_source.error_sq(backward.transform(c.target));
        if there > back { there } else { back }
    }

    fn refine(&self, _: &Self::Model, inliers: &[usize]) -> Option<Self::Model> {
        self.fit(inliers)
    }
}

impl Similarity<'_> {
    fn fit(&self, indices: &[usize]) -> Option<(Sim3, Sim3)> {
        let source: Vec<DVec3> = indices.iter().map(|&i| self.0[i].source).collect();
        let target: Vec<DVec3> = indices.iter().map(|&i| self.0[i].target).collect();
        umeyama(&source, &target).map(|s| (s, s.inverse()))
    }
}

/// `base_from_other`; `None` where too few points of both agree on it.
pub(crate) fn similarity(base: &MapState, other: &MapState, input: &MappingInput<'_>) -> Option<Sim3> {
    let point = |state: &MapState, track: usize| {
        let id = *state.of_track[track].first()?;
        let p = state.points[id as usize].as_ref()?;
        Some((p.position, *p.views.first()?))
    };
    let common = |track: usize| {
        let ((target, seen_here), (source, seen_there)) = (point(base, track)?, point(other, track)?);
        let (in_target, in_source) = (base.view(input, seen_here)?, other.view(input, seen_there)?);
        Some(Common { source, target, in_source, in_target })
    };
    let all: Vec<Common<'_>> = (0..input.tracks.views.len()).filter_map(common).collect();
    let count = all.len();
    let config = RansacConfig {
        threshold: TOLERANCE * input.config.max_reprojection_px,
        min_inliers: input.config.min_observations.max((AGREEING_SHARE * count as f64) as usize),
        seed: input.seed,
        ..RansacConfig::default()
    };
    ransac(&Similarity(all), &config, count as u64).map(|found| found.model.0)
}

/// Takes the images that `other` alone has over into `base`, then adjusts and grows it; `None`
/// where the models share too little or the whole is no larger.
pub(crate) fn join(
    base: &MapState,
    other: &MapState,
    input: &MappingInput<'_>,
    (cameras, known): (&[Camera], &[Knowledge]),
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    let lacking: Vec<usize> = other.order.iter().copied().filter(|&i| base.poses[i].is_none()).collect();
    if lacking.is_empty() {
        return Ok(None);
    }
    let Some(moved) = similarity(base, other, input) else { return Ok(None) };
    let mut whole = base.clone();
    for &image in &lacking {
        if let Some(pose) = &other.poses[image] {
            whole.register(image, moved.transform_pose(pose));
        }
    }
    for &image in &lacking {
        whole.grow_image(input, image);
    }
    let starts = starts_of(cameras, known, &whole);
    settle(&mut whole, input, known, &starts, progress)?;
    expel(&mut whole, input);
    grow(&mut whole, input, known, &starts, input.keypoints.len(), progress)?;
    settle(&mut whole, input, known, &starts, progress)?;
    expel(&mut whole, input);
    Ok((whole.registered_count() > base.registered_count()).then_some(whole))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::incremental::MapperConfig;
    use crate::tracks::{Tracks, build_tracks, positions};
    use glam::{DQuat, DVec2};
    use scene::synthetic::{SyntheticOptions, SyntheticScene, synthetic_scene};
    use scene::{TwoViewGeometry, TwoViewKind};

    fn geometries(scene: &SyntheticScene) -> Vec<TwoViewGeometry> {
        let n = scene.features.len();
        let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
        let pair = |(a, b)| TwoViewGeometry {
            a,
            b,
            kind: TwoViewKind::Calibrated,
            inliers: scene.matches(a, b),
            f: None,
            e: None,
            h: None,
            b_from_a: None,
            median_angle: 0.2,
        };
        pairs.map(pair).filter(|g| g.inliers.len() >= 15).collect()
    }

    /// What mapping needs to know of a scene.
    struct MergeScene {
        scene: SyntheticScene,
        keypoints: Vec<Vec<DVec2>>,
        geometries: Vec<TwoViewGeometry>,
        tracks: Tracks,
        camera_of: Vec<usize>,
        config: MapperConfig,
    }

    impl MergeScene {
        fn new() -> Self {
            let options = SyntheticOptions { num_cameras: 14, noise_px: 0.3, ..Default::default() };
            let scene = synthetic_scene(&options, 4);
            let geometries = geometries(&scene);
            Self {
                keypoints: scene.features.iter().map(positions).collect(),
                tracks: build_tracks(&scene.features, &geometries),
                camera_of: vec![0; scene.features.len()],
                config: MapperConfig::default(),
                geometries,
                scene,
            }
        }

        fn input(&self) -> MappingInput<'_> {
            MappingInput {
                keypoints: &self.keypoints,
                sigmas: &[],
                tracks: &self.tracks,
                camera_of: &self.camera_of,
                geometries: &self.geometries,
                config: &self.config,
                is_video: true,
                skip: &[],
                seed: 0,
            }
        }

        fn cameras(&self) -> Vec<Camera> {
            self.scene.truth.cameras.values().cloned().collect()
        }

        /// The true model of some images, moved.
        fn part(&self, images: std::ops::Range<usize>, moved: &Sim3) -> MapState {
            let mut state = MapState::new(&self.input(), self.cameras());
            for i in images {
                state.register(i, moved.transform_pose(&self.scene.truth.images[&(i as u32 + 1)].pose));
            }
            state.grow_all(&self.input());
            state
        }
    }

    fn elsewhere() -> Sim3 {
        let rotation = DQuat::from_scaled_axis(DVec3::new(0.4, -1.0, 0.3));
        Sim3 { scale: 7.5, rotation, translation: DVec3::new(3.0, -20.0, 11.0) }
    }

    #[test]
    fn two_parts_of_a_ring_that_share_points_become_the_whole_ring() {
        let known = MergeScene::new();
        let base = known.part(0..8, &Sim3::IDENTITY);
        let other = known.part(7..14, &elsewhere());
        let found = similarity(&base, &other, &known.input()).expect("they share points");
        let there_and_back = found.compose(&elsewhere());
        assert!((there_and_back.scale - 1.0).abs() < 0.01, "{there_and_back:?}");
        let knowledge = [Knowledge::exact()];
        let cameras = known.cameras();
        let whole = join(&base, &other, &known.input(), (&cameras, &knowledge), &Progress::silent());
        let whole = whole.unwrap().expect("a larger model");
        assert_eq!(whole.registered_count(), 14);
        for (i, pose) in whole.poses.iter().enumerate() {
            let truth = known.scene.truth.images[&(i as u32 + 1)].pose;
            let away = pose.unwrap().centre().distance(truth.centre());
            assert!(away < 0.1, "image {i} is {away} from its place, at a distance of 4");
        }
    }

    #[test]
    fn parts_without_common_points_or_without_new_images_stay_apart() {
        let known = MergeScene::new();
        let base = known.part(0..4, &Sim3::IDENTITY);
        let mut other = known.part(7..11, &elsewhere());
        for id in 0..other.points.len() as u32 {
            let shared = other.points[id as usize]
                .as_ref()
                .is_some_and(|p| !base.of_track[p.track as usize].is_empty());
            if shared {
                other.drop_point(id);
            }
        }
        let cameras = known.cameras();
        let knowledge = [Knowledge::exact()];
        assert!(similarity(&base, &other, &known.input()).is_none());
        let same = join(&base, &base, &known.input(), (&cameras, &knowledge), &Progress::silent());
        assert!(same.unwrap().is_none());
    }
}
