//! The matches of a pair as points that solvers can use.

use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Features};
use std::collections::HashSet;

/// One-to-one matches with finite points.
pub(crate) struct Correspondences {
    /// (feature of a, feature of b).
    pub matches: Vec<[u32; 2]>,
    /// Ideal (undistorted) pixels from the principal point, image a.
    pub a: Vec<DVec2>,
    /// The same of image b.
    pub b: Vec<DVec2>,
    /// Mean focal lengths, pixels.
    pub focal: [f64; 2],
    /// Principal points, pixels.
    pub principal: [DVec2; 2],
    /// The larger image side, pixels: the unit that makes points of the order of 1.
    pub size: f64,
    /// Whether the matches are sorted by the distance of their descriptors, the most similar first.
    pub best_first: bool,
}

impl Correspondences {
    /// Of the matches whose features exist, are finite and are not taken by an earlier match.
    pub(crate) fn new(
        features_a: &Features,
        features_b: &Features,
        camera_a: &Camera,
        camera_b: &Camera,
        matches: &[[u32; 2]],
    ) -> Self {
        let focal = [camera_a.mean_focal(), camera_b.mean_focal()];
        let sides = [camera_a.width, camera_a.height, camera_b.width, camera_b.height];
        let mut result = Self {
            matches: Vec::with_capacity(matches.len()),
            a: Vec::with_capacity(matches.len()),
            b: Vec::with_capacity(matches.len()),
            focal,
            principal: [camera_a.principal_point(), camera_b.principal_point()],
            size: f64::from(sides.into_iter().max().unwrap_or(1).max(1)),
            best_first: false,
        };
        let (mut seen_a, mut seen_b) = (HashSet::new(), HashSet::new());
        let sorted = most_similar_first(features_a, features_b, matches);
        result.best_first = sorted.is_some();
        for &[i, j] in sorted.as_deref().unwrap_or(matches) {
            let (Some(p), Some(q)) =
                (features_a.keypoints.get(i as usize), features_b.keypoints.get(j as usize))
            else {
                continue;
            };
            let p = camera_a.unproject(p.position()) * focal[0];
            let q = camera_b.unproject(q.position()) * focal[1];
            if p.is_finite() && q.is_finite() && seen_a.insert(i) && seen_b.insert(j) {
                result.matches.push([i, j]);
                result.a.push(p);
                result.b.push(q);
            }
        }
        result
    }

    /// Only these, in this order.
    pub(crate) fn subset(&self, indices: &[usize]) -> Self {
        Self {
            matches: indices.iter().map(|&i| self.matches[i]).collect(),
            a: indices.iter().map(|&i| self.a[i]).collect(),
            b: indices.iter().map(|&i| self.b[i]).collect(),
            ..*self
        }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.matches.len()
    }

    /// Rays of match `i`, `z = 1`, camera frames.
    pub(crate) fn rays(&self, i: usize) -> (DVec3, DVec3) {
        ((self.a[i] / self.focal[0]).extend(1.0), (self.b[i] / self.focal[1]).extend(1.0))
    }

    /// How far match `i` moves between the images, pixels.
    pub(crate) fn displacement(&self, i: usize) -> f64 {
        (self.a[i] + self.principal[0]).distance(self.b[i] + self.principal[1])
    }

    /// The points divided by [`Correspondences::size`].
    pub(crate) fn scaled(&self) -> (Vec<DVec2>, Vec<DVec2>) {
        (self.a.iter().map(|p| *p / self.size).collect(), self.b.iter().map(|p| *p / self.size).collect())
    }

    /// Takes pixels of a (0) or b (1) to the scaled points.
    fn scaled_from_pixels(&self, image: usize) -> DMat3 {
        let (s, t) = (1.0 / self.size, -self.principal[image] / self.size);
        DMat3::from_cols(DVec3::X * s, DVec3::Y * s, t.extend(1.0))
    }

    /// A fundamental matrix of scaled points as one of pixels, unit norm.
    pub(crate) fn fundamental_to_pixels(&self, f: &DMat3) -> DMat3 {
        unit(self.scaled_from_pixels(1).transpose() * *f * self.scaled_from_pixels(0))
    }

    /// A fundamental matrix of ideal pixels from the principal point as one of pixels, unit norm.
    pub(crate) fn ideal_to_pixels(&self, f: &DMat3) -> DMat3 {
        let [a, b] = self.principal.map(|p| DMat3::from_cols(DVec3::X, DVec3::Y, (-p).extend(1.0)));
        unit(b.transpose() * *f * a)
    }

    /// A homography of scaled points as one of pixels, unit norm.
    pub(crate) fn homography_to_pixels(&self, h: &DMat3) -> DMat3 {
        unit(self.scaled_from_pixels(1).inverse() * *h * self.scaled_from_pixels(0))
    }

    /// A homography of scaled points as one of normalised coordinates.
    pub(crate) fn homography_to_rays(&self, h: &DMat3) -> DMat3 {
        scaling(self.size / self.focal[1]) * *h * scaling(self.focal[0] / self.size)
    }

    /// A fundamental matrix of scaled points as the matrix that is essential if the focal lengths
    /// are right.
    pub(crate) fn fundamental_to_rays(&self, f: &DMat3) -> DMat3 {
        unit(scaling(self.focal[1] / self.size) * *f * scaling(self.focal[0] / self.size))
    }
}

/// The matches by descending similarity of their descriptors; `None` where a descriptor is missing.
fn most_similar_first(a: &Features, b: &Features, matches: &[[u32; 2]]) -> Option<Vec<[u32; 2]>> {
    if matches.is_empty() || !matches.iter().all(|&[i, j]| has_descriptor(a, i) && has_descriptor(b, j)) {
        return None;
    }
    let mut sorted = matches.to_vec();
    sorted.sort_by_cached_key(|&[i, j]| {
        let pairs = a.descriptor(i as usize).iter().zip(b.descriptor(j as usize));
        (pairs.map(|(p, q)| u32::from(p.abs_diff(*q)).pow(2)).sum::<u32>(), [i, j])
    });
    Some(sorted)
}

fn has_descriptor(features: &Features, i: u32) -> bool {
    let start = i as usize * Features::DIM;
    (i as usize) < features.len() && start + Features::DIM <= features.descriptors.len()
}

/// Scales the plane by `s`, in homogeneous coordinates.
pub(super) fn scaling(s: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::new(s, s, 1.0))
}

fn unit(m: DMat3) -> DMat3 {
    let norm = m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    m * (1.0 / norm)
}
