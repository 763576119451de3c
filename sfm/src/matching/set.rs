//! The descriptors of many images, prepared when they are asked for.

use super::PreparedFeatures;
use scene::Features;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

/// Bytes of prepared descriptors that are kept; those of more are made again when they are needed.
/// Source: derived: 500 images of 4,096 features, so that 5,000 such images and their descriptors
/// stay below 4 GiB. Making one takes a thirtieth of the time of matching it with another.
const MOST_BYTES: usize = 1 << 29;

/// Prepared descriptors of images, at most [`MOST_BYTES`] of them at once, but for those in use.
pub(crate) struct PreparedSet<'a> {
    features: &'a [Features],
    most_bytes: usize,
    kept: Mutex<KeptDescriptors>,
}

#[derive(Default)]
struct KeptDescriptors {
    images: Vec<Option<Arc<PreparedFeatures>>>,
    /// Those of `images` that are there, in the order in which they came.
    order: VecDeque<usize>,
    bytes: usize,
}

impl<'a> PreparedSet<'a> {
    /// Of images in their order; nothing is prepared yet.
    pub(crate) fn new(features: &'a [Features]) -> Self {
        Self::within(MOST_BYTES, features)
    }

    fn within(most_bytes: usize, features: &'a [Features]) -> Self {
        let images = vec![None; features.len()];
        Self {
            features,
            most_bytes,
            kept: Mutex::new(KeptDescriptors { images, ..KeptDescriptors::default() }),
        }
    }

    /// The descriptors of an image; `None` where there is no such image. The same from any thread.
    pub(crate) fn get(&self, image: usize) -> Option<Arc<PreparedFeatures>> {
        let features = self.features.get(image)?;
        if let Some(there) = &self.kept().images[image] {
            return Some(there.clone());
        }
        // Outside the lock: two threads may do the same work, none waits for another's.
        let made = Arc::new(PreparedFeatures::new(features));
        Some(self.kept().insert(image, made, self.most_bytes))
    }

    fn kept(&self) -> MutexGuard<'_, KeptDescriptors> {
        self.kept.lock().unwrap_or_else(|e| e.into_inner())
    }
}

impl KeptDescriptors {
    /// Keeps what was made, unless another thread was first; leaves out the oldest.
    fn insert(&mut self, image: usize, made: Arc<PreparedFeatures>, most: usize) -> Arc<PreparedFeatures> {
        if let Some(there) = &self.images[image] {
            return there.clone();
        }
        self.bytes += made.bytes();
        self.order.push_back(image);
        self.images[image] = Some(made.clone());
        while self.bytes > most
            && let Some(oldest) = self.order.pop_front()
        {
            self.bytes -= self.images[oldest].take().map_or(0, |gone| gone.bytes());
        }
        made
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::{MatchConfig, match_prepared};
    use rand::Rng;
    use scene::Keypoint;

    fn images(count: u64) -> Vec<Features> {
        let of_image = |i| {
            let mut random = scene::rng::rng(1, "descriptors", i);
            let descriptors = (0..100 * Features::DIM).map(|_| random.random()).collect();
            Features { keypoints: vec![Keypoint::default(); 100], descriptors }
        };
        (0..count).map(of_image).collect()
    }

    #[test]
    fn descriptors_made_again_are_the_same_and_no_more_are_kept_than_allowed() {
        let features = images(12);
        let one = PreparedFeatures::new(&features[0]).bytes();
        let (small, large) = (PreparedSet::within(3 * one, &features), PreparedSet::new(&features));
        let all = MatchConfig { match_ratio: 1.0, match_max_distance: 2.0, ..MatchConfig::default() };
        for (a, b) in (0..12).flat_map(|a| (0..12).map(move |b| (a, b))) {
            let [found, wanted] = [&small, &large].map(|set| {
                let [left, right] = [a, b].map(|i| set.get(i).unwrap());
                match_prepared(&left, &right, &all)
            });
            assert_eq!(found, wanted, "{a}, {b}");
            assert!(a != b || found.len() == 100, "{}", found.len());
            let kept = small.kept();
            assert!(kept.bytes <= 3 * one && kept.bytes == one * kept.order.len(), "{}", kept.bytes);
            assert_eq!(kept.images.iter().flatten().count(), kept.order.len());
        }
        assert_eq!(large.kept().order.len(), 12);
        assert!(small.get(12).is_none());
    }
}
