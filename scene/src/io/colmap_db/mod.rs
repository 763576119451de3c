//! COLMAP's `database.db` (<https://colmap.github.io/database.html>): cameras, images, features,
//! matches, verified pairs.
//!
//! Written with the tables of COLMAP 3.8, which 3.12 and later bring up to date themselves when
//! they open the file (rigs, frames, pose priors); read with those of either.

#[cfg(feature = "colmap-db")]
mod read;
#[cfg(feature = "colmap-db")]
mod write;

#[cfg(feature = "colmap-db")]
pub use read::read_database;
#[cfg(feature = "colmap-db")]
pub use write::write_database;

use crate::{Camera, Features, TwoViewGeometry};
use std::collections::BTreeMap;

/// The largest image number and the factor of [`pair_number`]: 2³¹ − 1. Source: COLMAP's
/// database.html.
const MAX_IMAGES: i64 = 2_147_483_647;

/// Two image numbers, the smaller one first.
pub type ImagePair = (u32, u32);

/// An image with its features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatabaseImage {
    /// File name, relative to the image folder.
    pub name: String,
    /// Number of its camera.
    pub camera: u32,
    /// Its features. A file may hold keypoints without descriptors: [`Features::descriptors`] is
    /// empty then.
    pub features: Features,
}

/// What a database holds.
#[derive(Clone, Debug, Default)]
pub struct Database {
    /// By camera number.
    pub cameras: BTreeMap<u32, Camera>,
    /// By image number.
    pub images: BTreeMap<u32, DatabaseImage>,
    /// Matches before verification: (feature of the first, feature of the second).
    pub matches: BTreeMap<ImagePair, Vec<[u32; 2]>>,
    /// Verified pairs; their `a` and `b` are the image numbers less 1.
    pub geometries: BTreeMap<ImagePair, TwoViewGeometry>,
}

/// COLMAP's number of a pair of images, `a < b`.
pub fn pair_number((a, b): ImagePair) -> i64 {
    i64::from(a) * MAX_IMAGES + i64::from(b)
}

/// The pair of a number; `None` where no two different images have it.
#[cfg(feature = "colmap-db")]
fn pair_of(number: i64) -> Option<ImagePair> {
    let pair = (u32::try_from(number / MAX_IMAGES).ok()?, u32::try_from(number % MAX_IMAGES).ok()?);
    (pair.0 < pair.1).then_some(pair)
}

#[cfg(all(test, feature = "colmap-db"))]
mod tests;
