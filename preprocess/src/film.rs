//! All frames of a video, small and grey: what repeats after a whole turn is seen in them.

use crate::PreprocessError;
use crate::output::{Staging, write_png};
use crate::pixels::Look;
use image::ExtendedColorType;
use scene::Film;

/// Its name in the output folder.
pub(crate) const FILM: &str = ".film.png";
/// Most pictures that are kept; of longer videos every second, fourth, … frame.
/// Source: chosen by hand, never measured.
const MOST: usize = 1024;

/// Pictures as they come from the decoder.
pub(crate) struct Reel {
    size: (u32, u32),
    pictures: Vec<u8>,
    times_s: Vec<f64>,
    seen: usize,
    stride: usize,
}

impl Reel {
    pub(crate) fn new() -> Self {
        Self { size: (0, 0), pictures: Vec::new(), times_s: Vec::new(), seen: 0, stride: 1 }
    }

    /// Takes a frame that came after all others.
    pub(crate) fn push(&mut self, look: &Look, time_s: f64) {
        let wanted = self.seen.is_multiple_of(self.stride);
        self.seen += 1;
        let first = self.times_s.is_empty();
        let follows = first || (self.size == look.size && self.times_s.last().is_some_and(|t| *t < time_s));
        if !wanted || !follows {
            return;
        }
        if self.times_s.len() == MOST {
            self.thin();
        }
        self.size = look.size;
        self.pictures.extend_from_slice(&look.thumbnail);
        self.times_s.push(time_s);
    }

    fn thin(&mut self) {
        let bytes = self.size.0 as usize * self.size.1 as usize;
        let kept: Vec<u8> = self.pictures.chunks_exact(bytes).step_by(2).flatten().copied().collect();
        self.pictures = kept;
        self.times_s = self.times_s.iter().copied().step_by(2).collect();
        self.stride *= 2;
    }

    /// Writes it among the staged files; `None` where it holds nothing to compare.
    pub(crate) fn write(self, staging: &Staging) -> Result<Option<Film>, PreprocessError> {
        let (width, height) = self.size;
        let frames = self.times_s.len() as u32;
        if frames < 2 || width == 0 || height == 0 {
            return Ok(None);
        }
        let path = staging.path("", FILM);
        write_png(&path, &self.pictures, width, frames * height, ExtendedColorType::L8)?;
        Ok(Some(Film { path: staging.final_path("", FILM), width, height, times_s: self.times_s }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_videos_are_thinned_evenly_and_time_only_rises() {
        let mut reel = Reel::new();
        let look = |v: u8| Look { sharpness: 0.0, thumbnail: vec![v; 6], size: (3, 2) };
        for i in 0..3000 {
            reel.push(&look((i / 16) as u8), f64::from(i));
            reel.push(&look(0), f64::from(i)); // the same time again
        }
        assert_eq!(reel.pictures.len(), 6 * reel.times_s.len());
        assert!((MOST / 2..=MOST).contains(&reel.times_s.len()), "{}", reel.times_s.len());
        let steps: Vec<f64> = reel.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        assert!(steps.iter().all(|s| *s > 0.0 && *s <= 2.0 * steps[0]), "{steps:?}");
        let last = reel.times_s.len() - 1;
        assert_eq!(reel.pictures[6 * last], (reel.times_s[last] / 16.0) as u8);
        reel.push(&Look { sharpness: 0.0, thumbnail: vec![9; 4], size: (2, 2) }, 1e9);
        assert_eq!(reel.pictures.len(), 6 * reel.times_s.len(), "another size is left out");
    }
}
