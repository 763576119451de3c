//! What stays as it is throughout a training: the data, the configuration, and what follows from
//! them.

use crate::config::TrainConfig;
use crate::dataset::{Dataset, LEVELS, Pixels, shrink};
use crate::error::SplatError;
use crate::footprint::footprint;
use crate::hull::VisualHull;
use crate::sky::BlackSky;
use rayon::prelude::*;

/// One training view in this many judges while Gaussians and degrees are added, and is trained on
/// afterwards.
/// Source: chosen by hand; what all rows of docs/benchmarks.md were trained with.
const VALIDATION_EVERY: usize = 12;
/// With fewer training views than this all are needed. Source: docs/decisions/13: only sets of 60
/// and more spare some.
const VALIDATION_FROM: usize = 60;

/// Data and configuration of a training.
pub(crate) struct TrainingSetup<'a> {
    pub(crate) dataset: &'a Dataset,
    pub(crate) config: &'a TrainConfig,
    /// Training views, ascending.
    pub(crate) views: Vec<usize>,
    /// Those of them that only judge until growth ends; none where all are needed.
    pub(crate) validation: Vec<usize>,
    /// Points of the sparse cloud, where there is one and no validation views.
    pub(crate) cloud_points: Option<usize>,
    /// The configured number of Gaussians, or what the device can hold.
    pub(crate) max_gaussians: usize,
    /// Width of a pixel in the scene, normalised units.
    pub(crate) pixel: f32,
    /// What the mattes leave room for, where the background shows through.
    pub(crate) hull: Option<VisualHull>,
    /// What is behind everything, where no masks say it.
    pub(crate) sky: Option<BlackSky>,
    /// The photos of the level in use.
    coarse: CoarsePhotos,
}

/// Photos of the training views at a level; none at full resolution, which the data set has.
#[derive(Default)]
struct CoarsePhotos {
    level: u32,
    photos: Vec<Pixels>,
}

impl<'a> TrainingSetup<'a> {
    /// For a device that holds `max_gaussians`. Errors: no training views.
    pub(crate) fn new(
        dataset: &'a Dataset,
        config: &'a TrainConfig,
        max_gaussians: usize,
    ) -> Result<Self, SplatError> {
        let views = dataset.training_views();
        if views.is_empty() {
            return Err(SplatError::TooFewViews(0));
        }
        let validation = validation(&views);
        let cloud_points = crate::init::cloud_points(dataset).filter(|_| validation.is_empty());
        let matted = views.iter().filter(|_| dataset.is_transparent()).map(|&v| &dataset.views[v]);
        let hull = VisualHull::of(matted);
        let sky = BlackSky::of(views.iter().map(|&v| &dataset.views[v]));
        let pixel = footprint(dataset);
        let coarse = CoarsePhotos::default();
        Ok(Self { dataset, config, views, validation, cloud_points, max_gaussians, pixel, hull, sky, coarse })
    }

    /// Makes the photos of a level, in place of those of the one before.
    pub(crate) fn hold(&mut self, level: u32) {
        let level = level.min(LEVELS - 1);
        if level != self.coarse.level {
            self.coarse.photos.clear();
            let views = self.views.par_iter().filter(|_| level > 0);
            let photos = views.map(|&v| shrink(&self.dataset.views[v].levels[0], level)).collect();
            self.coarse = CoarsePhotos { level, photos };
        }
    }

    /// The photo of a training view at the level in use, and that level; at full resolution for
    /// any other.
    pub(crate) fn photo(&self, view: usize, level: u32) -> (&Pixels, u32) {
        let place = self.views.binary_search(&view).ok();
        let coarse = place.filter(|_| level > 0).and_then(|p| self.coarse.photos.get(p));
        coarse.map_or((&self.dataset.views[view].levels[0], 0), |photo| (photo, self.coarse.level))
    }

    /// `count` of the training views, evenly: the middle one of each share; all where there are no
    /// more.
    pub(crate) fn some_views(&self, count: usize) -> Vec<usize> {
        evenly(&self.views, count)
    }
}

/// The training views that judge: none where all are needed.
fn validation(views: &[usize]) -> Vec<usize> {
    if views.len() < VALIDATION_FROM {
        return Vec::new();
    }
    views.iter().skip(VALIDATION_EVERY / 2).step_by(VALIDATION_EVERY).copied().collect()
}

fn evenly(views: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(views.len());
    (0..count).map(|k| views[(2 * k + 1) * views.len() / (2 * count)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_chosen_from_the_middle_of_equal_shares() {
        let views: Vec<usize> = (0..41).map(|k| 3 * k).collect();
        assert_eq!(evenly(&views, 100), views);
        assert_eq!(evenly(&views, 4), [15, 45, 75, 105]);
        assert!(evenly(&[], 4).is_empty());
    }

    #[test]
    fn validation_views_are_spared_only_where_there_are_many() {
        assert!(validation(&(0..59).collect::<Vec<_>>()).is_empty());
        assert_eq!(validation(&(0..60).collect::<Vec<_>>()), [6, 18, 30, 42, 54]);
    }
}
