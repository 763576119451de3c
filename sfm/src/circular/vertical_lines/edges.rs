//! Straight edges of what stands still, along one coordinate of the image.

use crate::error::SfmError;
use crate::sift::load_luma;
use glam::DVec2;
use scene::{FloatImage, FrameSet};

/// Frames whose mean is looked at: evenly from the video.
/// Source: docs/decisions/11, 128 instead of 32.
const FRAMES: usize = 128;
/// Least slope of an edge, luma a pixel: a step of one level of 8 bits in two pixels is what coding
/// leaves of nothing.
/// Source: chosen by hand, never measured.
const LEAST_SLOPE: f32 = 1.2 / 255.0;
/// What is nearer to the left and right border is not looked at, pixels: it may be cut off by it.
/// Source: chosen by hand, never measured.
const BORDER: usize = 6;
/// Shortest edge, as a share of the image's size along it.
/// Source: chosen by hand, never measured.
const SHORTEST: f64 = 0.052;
/// Edges are cut where they leave a straight line by more, pixels.
/// Source: chosen by hand, never measured.
const STRAIGHT_PX: f64 = 0.6;

/// An edge that is straight but for lens distortion: where it crosses the rows (or columns),
/// pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Segment {
    pub points: Vec<DVec2>,
}

/// Edges of the mean of the frames; `along_x`: those that run along the image's rows, else along
/// its columns.
pub(crate) fn segments(frames: &FrameSet, along_x: bool) -> Result<Vec<Segment>, SfmError> {
    Ok(edges_along(mean_of(frames)?, along_x))
}

/// Edges of a picture; `along_x`: those that run along its rows, else along its columns.
pub(crate) fn edges_along(picture: FloatImage, along_x: bool) -> Vec<Segment> {
    let mut found = straight_edges(&if along_x { transpose(&picture) } else { picture });
    if along_x {
        found.iter_mut().flat_map(|s| &mut s.points).for_each(|p| *p = DVec2::new(p.y, p.x));
    }
    found
}

/// The mean of some frames, which is the room without what turns in it; empty where frames differ
/// in size.
fn mean_of(frames: &FrameSet) -> Result<FloatImage, SfmError> {
    let step = frames.len().div_ceil(FRAMES).max(1);
    let mut sum = FloatImage::default();
    let mut count = 0;
    for frame in frames.frames.iter().step_by(step) {
        let picture = load_luma(frame)?;
        if count == 0 {
            sum = FloatImage::zeros(picture.width, picture.height, 1);
        }
        if sum.data.len() != picture.data.len() || sum.width != picture.width {
            return Ok(FloatImage::default());
        }
        sum.data.iter_mut().zip(&picture.data).for_each(|(s, p)| *s += p);
        count += 1;
    }
    sum.data.iter_mut().for_each(|s| *s /= count as f32);
    Ok(sum)
}

fn transpose(image: &FloatImage) -> FloatImage {
    let mut out = FloatImage::zeros(image.height, image.width, 1);
    for y in 0..image.height {
        for x in 0..image.width {
            out.data[x * out.width + y] = image.data[y * image.width + x];
        }
    }
    out
}

/// Edges along the columns of a picture.
pub(super) fn straight_edges(picture: &FloatImage) -> Vec<Segment> {
    let (width, height) = (picture.width, picture.height);
    if width < 8 || height < 8 {
        return Vec::new();
    }
    let slopes = slopes(picture);
    let shortest = ((SHORTEST * height as f64) as usize).max(12);
    let mut found = Vec::new();
    for sign in [1.0, -1.0] {
        let ridge = Ridge::new(&slopes, width, sign);
        for chain in ridge.chains(shortest) {
            cut(&chain, shortest, &mut found);
        }
    }
    found
}

/// Slope across the columns, smoothed along them; zero at the borders.
fn slopes(picture: &FloatImage) -> Vec<f32> {
    let (width, height) = (picture.width, picture.height);
    // Two means of three rows one after the other.
    let weights: [f32; 5] = [1.0, 2.0, 3.0, 2.0, 1.0].map(|w| w / 9.0);
    let mut out = vec![0.0; width * height];
    for y in 2..height - 2 {
        for x in 1..width - 1 {
            let rows = weights.iter().zip(y - 2..).map(|(w, y)| (w, y * width + x));
            out[y * width + x] =
                rows.map(|(w, i)| w * ((picture.data[i + 1] - picture.data[i - 1]) / 2.0)).sum();
        }
    }
    out
}

/// Where slopes of one sign are greatest along the rows.
struct Ridge {
    width: usize,
    height: usize,
    /// For each pixel that is one: the crest's place and slope.
    crest: Vec<Option<(f64, f32)>>,
}

impl Ridge {
    fn new(slopes: &[f32], width: usize, sign: f32) -> Self {
        let height = slopes.len() / width;
        let mut crest = vec![None; slopes.len()];
        for y in 0..height {
            for x in BORDER..width.saturating_sub(BORDER) {
                let [before, here, after] =
                    [x - 1, x, x + 1].map(|x| f64::from(sign * slopes[y * width + x]));
                let bend = before - 2.0 * here + after;
                if here > f64::from(LEAST_SLOPE) && here > before && here >= after && bend < 0.0 {
                    let place = x as f64 + 0.5 + (before - after) / (2.0 * bend);
                    crest[y * width + x] = Some((place, here as f32));
                }
            }
        }
        Self { width, height, crest }
    }

    /// Crests that follow each other from row to row, at most one pixel aside and one row missing.
    fn chains(&self, shortest: usize) -> Vec<Vec<DVec2>> {
        let mut used = vec![false; self.crest.len()];
        let mut chains = Vec::new();
        for start in 0..self.crest.len() {
            let Some((place, _)) = self.crest[start].filter(|_| !used[start]) else { continue };
            let (mut x, mut y) = (start % self.width, start / self.width);
            let mut chain = vec![DVec2::new(place, y as f64 + 0.5)];
            let mut missing = 0;
            used[start] = true;
            while y + 1 < self.height && missing < 2 {
                y += 1;
                let Some((next, place)) = self.steepest(x, y, &used) else {
                    missing += 1;
                    continue;
                };
                used[y * self.width + next] = true;
                (x, missing) = (next, 0);
                chain.push(DVec2::new(place, y as f64 + 0.5));
            }
            if chain.len() >= shortest {
                chains.push(chain);
            }
        }
        chains
    }

    /// The steepest free crest of a row at most a pixel from a column: its column and place.
    fn steepest(&self, x: usize, y: usize, used: &[bool]) -> Option<(usize, f64)> {
        let near = x.saturating_sub(1)..(x + 2).min(self.width);
        let free = near.filter(|x| !used[y * self.width + x]);
        let crests =
            free.filter_map(|x| self.crest[y * self.width + x].map(|(place, slope)| (x, place, slope)));
        crests.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(x, place, _)| (x, place))
    }
}

/// The straight parts of a chain that are long enough: cut where it leaves its line most, until it
/// does not.
fn cut(chain: &[DVec2], shortest: usize, found: &mut Vec<Segment>) {
    let mut open = vec![chain];
    while let Some(part) = open.pop() {
        if part.len() < shortest {
            continue;
        }
        let off = residuals(part);
        if off.iter().all(|r| r.abs() < STRAIGHT_PX) {
            found.push(Segment { points: part.to_vec() });
            continue;
        }
        // Single crests may err; a bend shows in the mean of five.
        let bends = off.windows(5).map(|w| w.iter().sum::<f64>().abs() / 5.0);
        let bends = bends.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let at = bends.map_or(0, |(k, _)| k + 2);
        if at < 5 || at + 5 > part.len() {
            open.push(&part[5..part.len() - 5]);
        } else {
            let (above, below) = part.split_at(at);
            open.extend([above, below]);
        }
    }
}

/// Distances along the rows from the line that fits best.
fn residuals(points: &[DVec2]) -> Vec<f64> {
    let mean = points.iter().sum::<DVec2>() / points.len() as f64;
    let (mut xy, mut yy) = (0.0, 0.0);
    for d in points.iter().map(|p| *p - mean) {
        xy += d.x * d.y;
        yy += d.y * d.y;
    }
    let lean = xy / yy;
    points.iter().map(|p| p.x - mean.x - lean * (p.y - mean.y)).collect()
}
