//! What stands still in front of a camera that does not move: texture of the screen, things beside it, the pole.

use super::colour::Key;
use super::detect::quantile;
use super::field::Field;
use image::RgbImage;

/// A pixel is screen where at least this share of the samples shows it.
const SCREEN_SHARE: f32 = 0.08;
/// A pixel is still where at least this share of the samples agrees.
const STILL_SHARE: f32 = 0.6;
/// Difference up to which samples agree, 8-bit levels of the largest channel.
const STILL_LEVELS: i32 = 14;
/// Share of the picture beside the screen that must be still for the camera to count as standing.
const STANDING_SHARE: f32 = 0.6;

/// Learnt from samples of a video.
#[derive(Clone, Debug, Default)]
pub(crate) struct Still {
    /// Width of the planes.
    pub width: usize,
    /// Factor on the smooth light of the screen (folds, seams); 1 where the screen is never seen.
    pub texture: Vec<f32>,
    /// Colour of what stands still and is no screen; `None` elsewhere.
    pub things: Vec<Option<[u8; 3]>>,
    /// Pixels where the screen is never seen and nothing is still, that lie outside of it.
    pub outside: Vec<bool>,
    /// Share of the picture where something stands still.
    pub share: f32,
}

impl Still {
    /// `None` where the camera moves (what is no screen is not still) or the frames differ in size.
    pub fn learn(frames: &[RgbImage], key: &Key) -> Option<Self> {
        let (width, height) = frames.first()?.dimensions();
        if frames.len() < 6 || frames.iter().any(|f| f.dimensions() != (width, height)) {
            return None;
        }
        let (width, n) = (width as usize, (width * height) as usize);
        let fields: Vec<Option<Field>> = frames.iter().map(|f| Field::fit(f.as_raw(), width, key)).collect();
        let mut still =
            Self { width, texture: vec![1.0; n], things: vec![None; n], outside: vec![true; n], share: 0.0 };
        let (mut rows, mut ratios, mut others) = (vec![Vec::new(); frames.len()], Vec::new(), Vec::new());
        let (mut still_count, mut other_count) = (0_usize, 0_usize);
        for y in 0..n / width {
            for (row, field) in rows.iter_mut().zip(&fields) {
                row.clear();
                if let Some(field) = field {
                    field.row(y, width, row);
                }
            }
            for x in 0..width {
                let i = y * width + x;
                ratios.clear();
                others.clear();
                for (frame, row) in frames.iter().zip(&rows) {
                    let p = &frame.as_raw()[3 * i..3 * i + 3];
                    let Some(light) = row.get(x) else { continue };
                    let share = key.difference_of([p[0], p[1], p[2]]) / (light[3] + 1e-6);
                    if (0.8..1.25).contains(&share) {
                        ratios.push(share);
                    } else {
                        others.push([p[0], p[1], p[2]]);
                    }
                }
                let seen = ratios.len() as f32 >= (SCREEN_SHARE * frames.len() as f32).max(2.0);
                still.outside[i] = !seen;
                if seen {
                    still.texture[i] = quantile(&mut ratios, 0.5).clamp(0.85, 1.15);
                } else {
                    other_count += 1;
                    still.things[i] = agreed(&mut others, frames.len());
                    still_count += usize::from(still.things[i].is_some());
                }
            }
        }
        let is_standing =
            other_count * 50 < n || still_count as f32 >= STANDING_SHARE * 0.5 * other_count as f32;
        still.share = still_count as f32 / n as f32;
        is_standing.then_some(still)
    }
}

/// The colour that most samples share.
fn agreed(samples: &mut [[u8; 3]], frames: usize) -> Option<[u8; 3]> {
    let needed = (STILL_SHARE * frames as f32) as usize;
    if samples.len() < needed.max(3) {
        return None;
    }
    let median = [0, 1, 2].map(|c| {
        let mid = samples.len() / 2;
        samples.select_nth_unstable_by_key(mid, |s| s[c]).1[c]
    });
    let agreeing = samples.iter().filter(|s| departure(**s, median) <= STILL_LEVELS).count();
    (agreeing >= needed).then_some(median)
}

/// Largest difference of a channel, 8-bit levels.
pub(crate) fn departure(a: [u8; 3], b: [u8; 3]) -> i32 {
    (0..3).map(|c| (i32::from(a[c]) - i32::from(b[c])).abs()).max().unwrap_or(0)
}
