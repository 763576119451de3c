//! Speed and memory of rendering, by the paper's protocol: a warm-up, the test set looped, mean of
//! the median five; of fewer, or of the first views alone, where pictures are slow.

use crate::pictures::Pictures;
use crate::record::RenderingCost;
use anyhow::Result;
use scene::{Camera, Pose, Progress};
use splat::DatasetConfig;
use std::path::Path;
use std::time::{Duration, Instant};

/// The warm-up and all loops end after this long each, with the view at hand, and so do other
/// pictures that are not held out. Source: chosen by
/// hand: a NeRF takes minutes for one loop.
pub(super) const LONGEST: Duration = Duration::from_secs(20);
/// Runs in the middle whose mean is reported. Source: chosen by hand, never measured.
const MIDDLE: usize = 5;

impl RenderingCost {
    /// The figures in a sentence.
    pub fn sentence(&self) -> String {
        format!(
            "Rendering: {:.1} frames/s; a frame takes {:.1} ms (median), 95 % at most {:.1}, 99 % at most {:.1}; {:.0} MiB.",
            self.frames_per_second, self.frame_ms_median, self.frame_ms_p95, self.frame_ms_p99, self.peak_mib
        )
    }
}

/// Names, cameras and poses of the views that are held out of training.
pub fn held_out_cameras(training_set: &Path, config: &DatasetConfig) -> Result<Vec<(String, Camera, Pose)>> {
    let model = scene::io::read_model(&training_set.join("sparse/0"))?;
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let count = images.len();
    let chosen = images.iter().enumerate().filter(|(i, image)| config.holds_out(&image.name, *i, count));
    Ok(chosen
        .filter_map(|(_, i)| Some((i.name.clone(), model.cameras.get(&i.camera)?.clone(), i.pose)))
        .collect())
}

/// Renders the views `loops` times.
pub fn measure(
    pictures: &mut Pictures,
    views: &[(String, Camera, Pose)],
    loops: u32,
    progress: &Progress,
) -> Result<RenderingCost> {
    if views.is_empty() {
        return Ok(RenderingCost::default());
    }
    let meter = crate::stage::Meter::start();
    loop_of(pictures, views, Instant::now(), progress)?; // warm-up
    let (mut rates, mut frames) = (Vec::new(), Vec::new());
    let begun = Instant::now();
    for _ in 0..loops {
        let round = loop_of(pictures, views, begun, progress)?;
        if round.len() == views.len() || rates.is_empty() {
            rates.push(1e3 * round.len() as f64 / round.iter().sum::<f64>());
        }
        frames.extend(round);
        if begun.elapsed() > LONGEST {
            break;
        }
    }
    frames.sort_by(f64::total_cmp);
    Ok(RenderingCost {
        frames_per_second: mean_of_middle(&mut rates),
        frame_ms_median: nearest_rank(&frames, 0.5),
        frame_ms_p95: nearest_rank(&frames, 0.95),
        frame_ms_p99: nearest_rank(&frames, 0.99),
        loops: rates.len(),
        peak_mib: meter.stop().peak_mib,
    })
}

/// Milliseconds that each view took, until it is [`LONGEST`] since `begun`.
fn loop_of(
    pictures: &mut Pictures,
    views: &[(String, Camera, Pose)],
    begun: Instant,
    progress: &Progress,
) -> Result<Vec<f64>> {
    let mut frames = Vec::new();
    for (name, camera, pose) in views {
        progress.check()?;
        let frame = Instant::now();
        pictures.render(camera, pose, pictures.time_of(name), [0.0; 3])?;
        frames.push(frame.elapsed().as_secs_f64() * 1e3);
        if begun.elapsed() > LONGEST {
            break;
        }
    }
    Ok(frames)
}

/// The value that a share of the sorted values stays below.
fn nearest_rank(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Mean of the five values in the middle, or of all where there are fewer.
fn mean_of_middle(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let count = MIDDLE.min(values.len());
    let from = (values.len() - count) / 2;
    values[from..from + count].iter().sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_the_median_five_ignores_what_is_slow_and_what_is_fast() {
        assert_eq!(mean_of_middle(&mut [100.0, 3.0, 1.0, 2.0, 4.0, 5.0, 0.0]), 3.0);
        assert_eq!(mean_of_middle(&mut [2.0, 4.0]), 3.0);
    }
}
