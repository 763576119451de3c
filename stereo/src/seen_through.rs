//! Depths that other views look through.
//!
//! At the border of a near surface a patch is half of what lies behind, and a few neighbours agree
//! on a sheet between the two. Views from elsewhere see what is behind it, or nothing at all
//! (Merrell et al., "Real-Time Visibility-Based Fusion of Depth Maps", ICCV 2007).

use crate::field::PlaneField;
use crate::pair::PixelMap;
use crate::settings::StereoSettings;
use rayon::prelude::*;
use scene::PosedPhoto;

/// What another view says of a point.
enum Witness {
    /// Its own surface lies there.
    Meets,
    /// It sees something behind, or that there is nothing.
    LooksThrough,
    /// Something is in the way, or it knows nothing.
    Silent,
}

/// Leaves out the depths that more views look through than meet.
pub(crate) fn drop_seen_through(fields: &mut [PlaneField], views: &[PosedPhoto], settings: &StereoSettings) {
    let step = fields.len().div_ceil(settings.witnesses.max(1)).max(1);
    let all = &*fields;
    let solid: Vec<Vec<f32>> =
        (0..all.len()).into_par_iter().map(|at| solid(at, all, views, step, settings)).collect();
    fields.iter_mut().zip(solid).for_each(|(field, depth)| field.depth = depth);
}

/// The depths of a view that other views do not look through.
fn solid(
    at: usize,
    fields: &[PlaneField],
    views: &[PosedPhoto],
    step: usize,
    settings: &StereoSettings,
) -> Vec<f32> {
    let field = &fields[at];
    let mut balance = vec![0_i32; field.depth.len()];
    for other in (0..fields.len()).skip(at % step).step_by(step).filter(|&other| other != at) {
        let relative = views[other].pose.compose(&views[at].pose.inverse());
        let there = PixelMap::new(&field.camera, &fields[other].camera, &relative);
        for (i, sum) in balance.iter_mut().enumerate().filter(|(i, _)| field.depth[*i] > 0.0) {
            let (x, y) = field.place(i);
            let seen = there.apply([x as f32 + 0.5, y as f32 + 0.5], field.depth[i]);
            *sum += match fields[other].witness(seen, settings.tolerance.depth) {
                Witness::Meets => 1,
                Witness::LooksThrough => -1,
                Witness::Silent => 0,
            };
        }
    }
    field.depth.iter().zip(balance).map(|(z, sum)| if sum < 0 { 0.0 } else { *z }).collect()
}

impl PlaneField {
    /// What this view says of a point at a place of its picture and a depth; depths that differ by
    /// less than `same`, a share, are one.
    fn witness(&self, (place, depth): ([f32; 2], f32), same: f32) -> Witness {
        let [x, y] = place.map(|v| v.floor() as i64);
        let (w, h) = (i64::from(self.camera.width), i64::from(self.camera.height));
        if !(depth > 0.0 && (0..w).contains(&x) && (0..h).contains(&y)) {
            return Witness::Silent;
        }
        match self.index(x, y) {
            Some(i) if self.inside[i] => {
                let own = self.depth[i];
                match own {
                    own if !(own > 0.0) => Witness::Silent,
                    own if (own / depth - 1.0).abs() < same => Witness::Meets,
                    own if own > depth => Witness::LooksThrough,
                    _ => Witness::Silent,
                }
            }
            _ => Witness::LooksThrough,
        }
    }
}
