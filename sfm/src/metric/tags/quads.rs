//! Dark blobs whose outline is a quadrilateral.

use super::sampling::Corners;
use glam::DVec2;
use image::GrayImage;

/// Smaller blobs are no tags that could be read, pixels. Source: derived; two pixels a cell of the
/// smaller dictionary.
const SMALLEST: u32 = 12;
/// A pixel is dark if it is below the mean of its neighbourhood by more, grey levels. Source: as
/// OpenCV's ArUco module.
const DARKER: i64 = 7;
/// Parts of the image's longer side that the neighbourhoods are wide: the border of a tag has to be
/// narrower than half of it. Source: derived; for tags of a tenth and of the whole of the image.
const NEIGHBOURHOODS: [u32; 3] = [60, 20, 7];
/// Share of the area of a blob's hull that its largest quadrilateral has. Source: chosen by hand; a
/// disc has 2/π.
const SQUARE: f64 = 0.85;

/// Candidates for tags, of all sizes.
pub(super) fn find(image: &GrayImage) -> Vec<Corners> {
    let sums = GreySums::of(image);
    let side = image.width().max(image.height());
    let radii = NEIGHBOURHOODS.map(|parts| (side / parts / 2).max(3));
    let mut quads: Vec<Corners> = Vec::new();
    for radius in radii {
        for quad in blobs(&sums.dark(image, radius), image.width()).iter().filter_map(|b| quadrilateral(b)) {
            if !quads.iter().any(|q| quad.iter().all(|a| q.iter().any(|b| b.distance(*a) < 1.5))) {
                quads.push(quad);
            }
        }
    }
    quads
}

/// Sums over all pixels above and to the left.
struct GreySums {
    width: usize,
    height: usize,
    sums: Vec<i64>,
}

impl GreySums {
    fn of(image: &GrayImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut sums = vec![0; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0;
            for x in 0..width {
                row += i64::from(image.as_raw()[y * width + x]);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        Self { width, height, sums }
    }

    /// Which pixels are darker than the square about them.
    fn dark(&self, image: &GrayImage, radius: u32) -> Vec<bool> {
        let (stride, r) = (self.width + 1, radius as usize);
        let mut dark = vec![false; self.width * self.height];
        for y in 0..self.height {
            let (top, bottom) = (y.saturating_sub(r), (y + r + 1).min(self.height));
            for x in 0..self.width {
                let (left, right) = (x.saturating_sub(r), (x + r + 1).min(self.width));
                let [a, b, c, d] = [(top, left), (top, right), (bottom, left), (bottom, right)]
                    .map(|(y, x)| self.sums[y * stride + x]);
                let count = ((bottom - top) * (right - left)) as i64;
                let value = i64::from(image.as_raw()[y * self.width + x]) + DARKER;
                dark[y * self.width + x] = value * count < a - b - c + d;
            }
        }
        dark
    }
}

/// The outermost corners of the pixels of each connected dark blob, row by row.
fn blobs(dark: &[bool], width: u32) -> Vec<Vec<DVec2>> {
    let width = width as usize;
    let height = dark.len() / width.max(1);
    let mut seen = vec![false; dark.len()];
    let mut found = Vec::new();
    for start in 0..dark.len() {
        if !dark[start] || seen[start] {
            continue;
        }
        let (mut rows, mut stack) = (std::collections::BTreeMap::new(), vec![start]);
        seen[start] = true;
        while let Some(at) = stack.pop() {
            let (x, y) = (at % width, at / width);
            let span = rows.entry(y).or_insert((x, x));
            *span = (span.0.min(x), span.1.max(x));
            let beside = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then(|| at + 1),
                (y > 0).then(|| at - width),
                (y + 1 < height).then(|| at + width),
            ];
            for next in beside.into_iter().flatten().filter(|&next| dark[next]) {
                if !std::mem::replace(&mut seen[next], true) {
                    stack.push(next);
                }
            }
        }
        found.extend(outline(&rows, width, height));
    }
    found
}

/// `None` for blobs that are too small or reach the border of the image.
fn outline(
    rows: &std::collections::BTreeMap<usize, (usize, usize)>,
    width: usize,
    height: usize,
) -> Option<Vec<DVec2>> {
    let (top, bottom) = (*rows.first_key_value()?.0, *rows.last_key_value()?.0);
    let left = rows.values().map(|r| r.0).min()?;
    let right = rows.values().map(|r| r.1).max()?;
    let small = (bottom - top).min(right - left) < SMALLEST as usize;
    if small || top == 0 || left == 0 || bottom + 1 == height || right + 1 == width {
        return None;
    }
    let corners = rows
        .iter()
        .flat_map(|(&y, &(first, last))| [(first, y), (first, y + 1), (last + 1, y), (last + 1, y + 1)]);
    Some(corners.map(|(x, y)| DVec2::new(x as f64, y as f64)).collect())
}

/// The convex hull, clockwise as seen in the image (A. M. Andrew, 1979).
fn hull(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut chain = half_hull(sorted.iter());
    chain.extend(half_hull(sorted.iter().rev()));
    chain
}

/// One side of the hull of points sorted along x, without its last point.
fn half_hull<'a>(points: impl Iterator<Item = &'a DVec2>) -> Vec<DVec2> {
    let mut chain: Vec<DVec2> = Vec::new();
    for &p in points {
        while let [.., a, b] = chain[..] {
            if (b - a).perp_dot(p - b) > 0.0 {
                break;
            }
            chain.pop();
        }
        chain.push(p);
    }
    chain.pop();
    chain
}

fn area(polygon: &[DVec2]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    0.5 * polygon.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>()
}

fn farthest(points: &[DVec2], measure: impl Fn(DVec2) -> f64) -> Option<DVec2> {
    points.iter().copied().max_by(|a, b| measure(*a).total_cmp(&measure(*b)))
}

/// The quadrilateral of a blob that is one: two far corners, and the farthest on both sides of the
/// line between them.
fn quadrilateral(outline: &[DVec2]) -> Option<Corners> {
    let hull = hull(outline);
    let whole = area(&hull);
    let centre = hull.iter().sum::<DVec2>() / hull.len().max(1) as f64;
    let first = farthest(&hull, |p| p.distance_squared(centre))?;
    let third = farthest(&hull, |p| p.distance_squared(first))?;
    let along = third - first;
    let second = farthest(&hull, |p| (p - first).perp_dot(along))?;
    let fourth = farthest(&hull, |p| along.perp_dot(p - first))?;
    let quad = [first, second, third, fourth];
    (whole > 0.0 && area(&quad) > SQUARE * whole).then_some(quad)
}
