//! When the photos of a run were taken, for the methods whose scene moves.

use crate::input::{FrameNames, Input};
use anyhow::{Context, Result};
use scene::FrameSet;
use std::collections::BTreeMap;
use std::path::Path;

/// The file of the times in a run folder.
pub(crate) const TIMES: &str = "times.json";

/// Times of photos by name, in [0, 1]: the first was taken at 0, the last at 1. Empty where they
/// are not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times(BTreeMap<String, f32>);

impl Times {
    /// Of what a video or a file of poses says; empty where one has no time.
    pub(crate) fn of(frames: &FrameSet, input: &Input) -> Result<Self> {
        let from_file = match input {
            Input::Posed { model, images, .. } if model.is_file() => times_of_poses(model, images, frames)?,
            _ => BTreeMap::new(),
        };
        let time = |name: &str, own: Option<f64>| own.or_else(|| from_file.get(name).copied());
        let known: Option<Vec<(&str, f64)>> =
            frames.frames.iter().map(|f| Some((f.name.as_str(), time(&f.name, f.time_s)?))).collect();
        let known = known.unwrap_or_default();
        let first = known.iter().map(|k| k.1).fold(f64::INFINITY, f64::min);
        let length = known.iter().map(|k| k.1).fold(f64::NEG_INFINITY, f64::max) - first;
        if !(length.is_finite() && length > 0.0) {
            return Ok(Self::default());
        }
        let share = |(name, t): (&str, f64)| (name.to_owned(), ((t - first) / length) as f32);
        Ok(Self(known.into_iter().map(share).collect()))
    }

    /// Of a run folder; empty where it has none.
    pub fn read(run: &Path) -> Result<Self> {
        let path = run.join(TIMES);
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let times = serde_json::from_slice(&text);
        Ok(Self(times.with_context(|| format!("{} has no times; train again", path.display()))?))
    }

    /// Writes what [`Self::read`] reads; nothing where no time is known.
    pub fn write(&self, folder: &Path) -> Result<()> {
        if self.0.is_empty() { Ok(()) } else { crate::stage::write_json(&folder.join(TIMES), &self.0) }
    }

    /// By name.
    pub(crate) fn by_name(&self) -> &BTreeMap<String, f32> {
        &self.0
    }

    /// Of a photo; 0 where it is not known.
    pub fn of_view(&self, name: &str) -> f32 {
        self.0.get(name).copied().unwrap_or(0.0)
    }
}

/// By the names of frames, in the file's unit.
fn times_of_poses(model: &Path, images: &Path, frames: &FrameSet) -> Result<BTreeMap<String, f64>> {
    let times = scene::io::read_poses(model, images)?.times;
    let names = FrameNames::of(frames);
    Ok(times.iter().filter_map(|(photo, time)| Some((names.find(photo)?.name.clone(), *time))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::Frame;

    fn frames(times: &[Option<f64>]) -> FrameSet {
        let frame = |(i, time_s): (usize, &Option<f64>)| Frame {
            name: format!("{i}.png"),
            time_s: *time_s,
            ..Frame::default()
        };
        FrameSet { frames: times.iter().enumerate().map(frame).collect(), ..FrameSet::default() }
    }

    #[test]
    fn times_of_a_video_run_from_0_to_1_and_are_kept_in_the_run() {
        let input = Input::Video("x.mp4".into());
        let times = Times::of(&frames(&[Some(2.0), Some(3.0), Some(6.0)]), &input).unwrap();
        let of = |name| times.of_view(name);
        assert_eq!((of("0.png"), of("1.png"), of("2.png"), of("3.png")), (0.0, 0.25, 1.0, 0.0));
        let folder = std::env::temp_dir().join(format!("times-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        assert_eq!(Times::read(&folder).unwrap(), Times::default());
        times.write(&folder).unwrap();
        assert_eq!(Times::read(&folder).unwrap(), times);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn without_all_times_or_with_a_single_one_nothing_moves() {
        let input = Input::Photos("x".into());
        for times in [&[Some(1.0), None][..], &[Some(1.0), Some(1.0)], &[]] {
            assert_eq!(Times::of(&frames(times), &input).unwrap(), Times::default());
        }
    }
}
