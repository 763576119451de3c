//! Which frames of a video compete with each other: one of each bucket is taken.

use crate::config::{DEFAULT_FRAMES, FrameConfig};

/// How much of its sharpness a frame loses at the border of its bucket, so that equals are evenly
/// spaced. Source: chosen by hand, never measured.
const BORDER_LOSS: f64 = 0.2;

/// The bucket of every frame.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    buckets: Vec<Option<BucketSlot>>,
    /// Number of buckets that hold a frame.
    pub len: usize,
    /// Frames inside `--start/--end`.
    pub candidates: usize,
    /// Index after the last frame of interest.
    pub end: usize,
}

/// Where a frame stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BucketSlot {
    /// Number of the bucket, rising with time.
    pub bucket: usize,
    /// Factor on sharpness, 1 in the middle of the bucket.
    pub weight: f64,
}

impl Plan {
    /// From the presentation times, seconds, in order.
    pub(crate) fn new(times_s: &[f64], config: &FrameConfig) -> Self {
        let start = config.start.unwrap_or(f64::NEG_INFINITY) - 1e-6;
        let end = config.end.unwrap_or(f64::INFINITY) + 1e-6;
        let inside: Vec<usize> =
            (0..times_s.len()).filter(|&i| times_s[i] >= start && times_s[i] <= end).collect();
        let mut buckets = vec![None; times_s.len()];
        let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
            return Self { buckets, len: 0, candidates: 0, end: 0 };
        };
        let n = inside.len();
        let step = if n > 1 { (times_s[last] - times_s[first]) / (n - 1) as f64 } else { 1.0 };
        let wanted = config.frames.unwrap_or(DEFAULT_FRAMES);
        for (rank, &i) in inside.iter().enumerate() {
            let since = times_s[i] - times_s[first];
            let position = if let Some(k) = config.every {
                (rank as f64 + 0.5) / k as f64
            } else if let Some(fps) = config.fps {
                since * fps + 1e-6
            } else if n <= wanted || step <= 0.0 {
                (rank as f64 + 0.5) * wanted.min(n) as f64 / n as f64
            } else {
                (since + step / 2.0) / (step * n as f64) * wanted as f64
            };
            let bucket = position.floor().max(0.0);
            let off = 2.0 * (position - bucket) - 1.0;
            buckets[i] = Some(BucketSlot { bucket: bucket as usize, weight: 1.0 - BORDER_LOSS * off * off });
        }
        let mut used: Vec<usize> = buckets.iter().flatten().map(|s| s.bucket).collect();
        used.dedup();
        Self { buckets, len: used.len(), candidates: n, end: last + 1 }
    }

    /// Where frame `index` stands; `None` outside the range asked for.
    pub(crate) fn slot(&self, index: usize) -> Option<BucketSlot> {
        self.buckets.get(index).copied().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(n: usize, fps: f64) -> Vec<f64> {
        (0..n).map(|i| i as f64 / fps).collect()
    }

    #[test]
    fn as_many_buckets_as_frames_are_asked_for_and_all_about_as_large() {
        let config = FrameConfig { frames: Some(48), ..FrameConfig::default() };
        let plan = Plan::new(&times(706, 30.0), &config);
        assert_eq!((plan.len, plan.candidates), (48, 706));
        let mut sizes = vec![0; 48];
        (0..706).filter_map(|i| plan.slot(i)).for_each(|s| sizes[s.bucket] += 1);
        assert!(sizes.iter().all(|s| (14..=16).contains(s)), "{sizes:?}");
    }

    #[test]
    fn rates_ranges_and_short_videos_are_respected() {
        let every = FrameConfig { every: Some(10), ..FrameConfig::default() };
        assert_eq!(Plan::new(&times(95, 30.0), &every).len, 10);
        let fps = FrameConfig { fps: Some(2.0), ..FrameConfig::default() };
        assert_eq!(Plan::new(&times(300, 30.0), &fps).len, 20);
        let all = FrameConfig { frames: Some(500), ..FrameConfig::default() };
        assert_eq!(Plan::new(&times(7, 30.0), &all).len, 7);
        let range =
            FrameConfig { every: Some(1), start: Some(1.0), end: Some(2.0), ..FrameConfig::default() };
        let plan = Plan::new(&times(300, 30.0), &range);
        assert_eq!((plan.len, plan.slot(29), plan.end), (31, None, 61));
        assert_eq!(Plan::new(&[], &range).len, 0);
        assert_eq!(Plan::new(&[0.5; 9], &FrameConfig::default()).len, 9, "equal time stamps");
    }

    #[test]
    fn a_gap_leaves_its_buckets_empty_instead_of_shifting_the_others() {
        let mut t = times(100, 10.0);
        t.iter_mut().skip(50).for_each(|t| *t += 10.0);
        let plan = Plan::new(&t, &FrameConfig { frames: Some(20), ..FrameConfig::default() });
        assert!(plan.len < 20 && plan.len > 8, "{}", plan.len);
        assert!(plan.slot(99).is_some_and(|s| s.bucket == 19));
    }
}
