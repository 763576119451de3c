//! Photos that were rotated by 180° on their way here.
//!
//! A camera that was held both ways up, its pictures turned upright by some program that kept no
//! trace of it, has one sensor but two principal points: mirrored about the image centre. Nothing
//! else betrays it, for the pictures look alike. The observations do: with a principal point for
//! each image, two groups appear.

mod offsets;
mod rotate;
#[cfg(test)]
mod tests;
mod windows;

pub(crate) use rotate::{rotate_camera, rotate_geometry, rotate_pixel, rotate_pose, rotate_problem};

use crate::bundle::BundleProblem;
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::{FEWEST_VIEWS, JOINT_IMAGES};
use offsets::OffsetLikelihood;
use scene::Progress;

/// How many of `images` images are asked together.
pub(crate) fn group_size(images: usize) -> usize {
    images.min(JOINT_IMAGES)
}

/// Which poses of an adjusted problem may be those of images that were rotated: some assignments,
/// the likeliest first; none where one principal point a camera does as well. The larger group of a
/// camera counts as not rotated.
///
/// Every image gets a principal point `c + δᵢ` of its own. Their joint information, after poses and
/// points are eliminated, says what any assignment of signs `δᵢ = ±d` costs; good ones are found by
/// local search. More than `JOINT_IMAGES` are asked in windows, for one assignment at most.
pub(crate) fn suspects(
    problem: &BundleProblem,
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Vec<Vec<bool>>, SfmError> {
    let mut found: Vec<Vec<bool>> = Vec::new();
    for (camera, known) in known.iter().enumerate() {
        let of_camera = |&p: &usize| problem.pose_camera[p] as usize == camera;
        let poses: Vec<usize> = (0..problem.poses.len()).filter(of_camera).collect();
        if known.fixed || poses.len() < 2 * FEWEST_VIEWS {
            continue;
        }
        let splits: Vec<Vec<bool>> = if poses.len() > JOINT_IMAGES {
            windows::split(problem, camera, &poses, progress)?.into_iter().collect()
        } else {
            let quadratic = OffsetLikelihood::measure(problem, camera, &poses, progress)?;
            quadratic.map(|q| q.splits()).unwrap_or_default()
        };
        // The best of this camera go with the best of the others.
        let none = vec![false; problem.poses.len()];
        found.resize(found.len().max(splits.len()), found.first().cloned().unwrap_or(none));
        for (k, rotated) in found.iter_mut().enumerate() {
            if let Some(split) = splits.get(k).or(splits.first()) {
                poses.iter().zip(split).for_each(|(&pose, &t)| rotated[pose] = t);
            }
        }
    }
    Ok(found)
}
