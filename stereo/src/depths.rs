//! From views to depths, coarse to fine.

use crate::agree;
use crate::field::{PlaneField, rounded};
use crate::hull::HullField;
use crate::level::LevelImage;
use crate::neighbours::Layout;
use crate::pair::Pair;
use crate::seen_through::drop_seen_through;
use crate::settings::StereoSettings;
use crate::sweep::{Job, ViewJob, swept};
use crate::view::{StereoError, check};
use glam::DVec3;
use rayon::prelude::*;
use scene::{PosedPhoto, Progress};

/// Views whose fields are made before the old ones are replaced: two copies of so many are held at
/// once. Source: some for each core; results do not depend on the number of threads.
const AT_ONCE: usize = 16;

/// What the views see.
#[derive(Clone, Debug)]
pub struct DenseDepths {
    /// In the order of the views.
    pub fields: Vec<PlaneField>,
    pub(crate) pairs: Vec<Vec<Pair>>,
    pub(crate) settings: StereoSettings,
}

/// Depths and normals of every view, in the order of the views; those on which too few other views
/// agree are left out. `points`: some points of the surface (world frame), which say how deep it
/// lies. Views without neighbours, or with nothing to see, have none. The same on any number of
/// threads.
pub fn dense_depths(
    views: &[PosedPhoto],
    points: &[DVec3],
    settings: &StereoSettings,
    progress: &Progress,
) -> Result<DenseDepths, StereoError> {
    check(views)?;
    let layout = Layout::new(views, points, settings);
    let hulls = match settings.outlines {
        true => HullField::of_all(views, &layout.depths, settings.first_level(views), progress)?,
        false => views.iter().map(|_| None).collect(),
    };
    let mut fields: Vec<PlaneField> = Vec::new();
    let mut pairs: Vec<Vec<Pair>> = Vec::new();
    for level in (0..settings.levels).rev() {
        let images: Vec<LevelImage> =
            views.par_iter().map(|v| LevelImage::new(v, settings.first_level(views) + level)).collect();
        pairs = pairs_at(&layout, views, &images);
        fields = (0..views.len()).map(|i| PlaneField::start(&images[i], fields.get(i))).collect();
        for round in 0..settings.rounds(level) {
            progress.begin(&format!("stereo at 1/{}", 1 << level), views.len());
            let job = Job { level, round, layout: &layout, settings };
            for first in (0..views.len()).step_by(AT_ONCE) {
                let some = first..(first + AT_ONCE).min(views.len());
                let next = some.clone().into_par_iter().map(|i| {
                    let hull = hulls[i].as_ref();
                    let view = ViewJob { view: i, images: &images, pairs: &pairs[i], fields: &fields, hull };
                    let field = swept(&job, &view);
                    progress.tick().map(|()| field)
                });
                let next: Vec<PlaneField> = next.collect::<Result<_, _>>()?;
                fields[some].iter_mut().zip(&next).for_each(|(field, next)| field.take_planes(next));
            }
        }
    }
    agree::filter(&mut fields, &pairs, settings);
    drop_seen_through(&mut fields, views, settings);
    fields.iter_mut().flat_map(|f| &mut f.normal).for_each(|n| *n = rounded(*n));
    Ok(DenseDepths::new(fields, pairs, settings))
}

impl DenseDepths {
    pub(crate) fn new(fields: Vec<PlaneField>, pairs: Vec<Vec<Pair>>, settings: &StereoSettings) -> Self {
        Self { fields, pairs, settings: *settings }
    }
}

/// Every view's neighbours at one resolution.
pub(crate) fn pairs_at(layout: &Layout, views: &[PosedPhoto], images: &[LevelImage]) -> Vec<Vec<Pair>> {
    (0..views.len()).map(|i| layout.pairs(i, views, images)).collect()
}
