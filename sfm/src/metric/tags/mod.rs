//! Square tags in images: AprilTag 36h11 (Olson, ICRA 2011) and the first 50 of ArUco's 4 × 4
//! dictionary (Garrido-Jurado et al., Pattern Recognition 47, 2014). Dark blobs that are
//! quadrilaterals are read as a grid of cells and looked up in the dictionaries.

mod edges;
mod quads;
mod sampling;

use glam::{DMat3, DVec2, DVec3};
use image::GrayImage;
use sampling::{Corners, sample};

/// A printed set of codes.
struct Dictionary {
    name: &'static str,
    /// Cells a side inside the border of one cell.
    cells: u32,
    /// Cells that two codes differ in at least, in all quarter turns.
    distance: u32,
    codes: Vec<u64>,
}

/// A tag that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tag {
    /// Name of its dictionary.
    pub family: &'static str,
    /// Its number there.
    pub id: usize,
    /// Corners of its black square from the upper left one of the printed tag on.
    pub corners: Corners,
}

/// Finds tags.
pub(super) struct TagReader {
    dictionaries: [Dictionary; 2],
}

impl TagReader {
    pub(super) fn new() -> Self {
        let april = include_str!("apriltag_36h11.txt");
        let aruco = include_str!("aruco_4x4_50.txt");
        Self {
            dictionaries: [
                Dictionary::parse("AprilTag 36h11", 6, 11, april),
                Dictionary::parse("ArUco 4x4_50", 4, 4, aruco),
            ],
        }
    }

    /// The tags of an image, each once.
    pub(super) fn read(&self, image: &GrayImage) -> Vec<Tag> {
        let mut tags: Vec<Tag> = Vec::new();
        for quad in quads::find(image) {
            let Some(quad) = edges::refine(image, quad) else { continue };
            let read = self.dictionaries.iter().find_map(|d| d.look_up(image, quad));
            let Some(tag) = read else { continue };
            if !tags.iter().any(|known| known.is_again(&tag)) {
                tags.push(tag);
            }
        }
        tags
    }
}

impl Tag {
    fn centre(&self) -> DVec2 {
        self.corners.iter().sum::<DVec2>() / 4.0
    }

    /// Whether another is the same tag, found a second time.
    fn is_again(&self, other: &Self) -> bool {
        let size = other.corners[0].distance(other.corners[2]);
        self.id == other.id && self.centre().distance(other.centre()) < 0.25 * size
    }
}

impl Dictionary {
    fn parse(name: &'static str, cells: u32, distance: u32, hex: &str) -> Self {
        let codes = hex.lines().filter_map(|line| u64::from_str_radix(line, 16).ok()).collect();
        Self { name, cells, distance, codes }
    }

    /// The tag whose black square has these corners.
    fn look_up(&self, image: &GrayImage, corners: Corners) -> Option<Tag> {
        let mut code = read_cells(image, &corners, self.cells)?;
        // Fewer than could be corrected: what is no tag hardly ever passes.
        let wrong_at_most = (self.distance - 1) / 4;
        for turns in 0..4 {
            if let Some(id) = self.codes.iter().position(|c| (c ^ code).count_ones() <= wrong_at_most) {
                // The corner that was first lies so many quarter turns on, on the printed tag.
                let mut corners = corners;
                corners.rotate_right(turns);
                return Some(Tag { family: self.name, id, corners });
            }
            code = turned(code, self.cells);
        }
        None
    }
}

/// The code of a tag that is turned by a quarter clockwise.
fn turned(code: u64, cells: u32) -> u64 {
    let places = (0..cells).flat_map(|row| (0..cells).map(move |column| (row, column)));
    places.fold(0, |turned, (row, column)| {
        let from = (cells - 1 - column) * cells + row;
        turned << 1 | code >> (cells * cells - 1 - from) & 1
    })
}

/// Mean grey value of a cell, of so many a side with the border; `None` outside the image.
fn cell(image: &GrayImage, homography: &DMat3, side: i32, row: i32, column: i32) -> Option<f64> {
    let mut sum = 0.0;
    for (x, y) in [0.3, 0.5, 0.7].iter().flat_map(|&y| [0.3, 0.5, 0.7].map(|x| (x, y))) {
        let at = DVec2::new(f64::from(column) + x, f64::from(row) + y) / f64::from(side);
        sum += sample(image, project(homography, at))?;
    }
    Some(sum / 9.0)
}

fn average(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The cells inside the border, row by row, 1 = white; `None` where the border is not black or no
/// white surrounds it.
fn read_cells(image: &GrayImage, corners: &Corners, cells: u32) -> Option<u64> {
    let homography = square_to_quad(corners);
    let side = cells as i32 + 2;
    let (mut inside, mut black, mut white) = (Vec::new(), Vec::new(), Vec::new());
    for (row, column) in (0..side).flat_map(|r| (0..side).map(move |c| (r, c))) {
        let value = cell(image, &homography, side, row, column)?;
        let is_border = row.min(column) == 0 || row.max(column) == side - 1;
        if is_border { black.push(value) } else { inside.push(value) }
    }
    for (row, column) in (0..side).flat_map(|i| [(-1, i), (side, i), (i, -1), (i, side)]) {
        white.extend(cell(image, &homography, side, row, column));
    }
    let (dark, light) = (average(&black), average(&white));
    let middle = 0.5 * (dark + light);
    let off = black.iter().filter(|v| **v > middle).count() + white.iter().filter(|v| **v < middle).count();
    // One cell of ten may lie in a highlight or behind a finger.
    if light < dark + LEAST_CONTRAST || 10 * off > black.len() + white.len() {
        return None;
    }
    Some(inside.iter().fold(0, |code, v| code << 1 | u64::from(*v > middle)))
}

/// Black and white of a tag differ by more, grey levels. Source: derived; ten standard deviations
/// of a camera's noise in dim light.
const LEAST_CONTRAST: f64 = 20.0;

/// The projective map from the unit square to a quadrilateral (Heckbert, "Fundamentals of Texture
/// Mapping and Image Warping", 1989, 2.2).
fn square_to_quad(q: &Corners) -> DMat3 {
    let (a, b, s) = (q[1] - q[2], q[3] - q[2], q[0] - q[1] + q[2] - q[3]);
    let area = a.perp_dot(b);
    let (g, h) = (s.perp_dot(b) / area, a.perp_dot(s) / area);
    let (x, y) = (q[1] - q[0] + g * q[1], q[3] - q[0] + h * q[3]);
    DMat3::from_cols(x.extend(g), y.extend(h), q[0].extend(1.0))
}

fn project(homography: &DMat3, at: DVec2) -> DVec2 {
    let seen: DVec3 = *homography * at.extend(1.0);
    seen.truncate() / seen.z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Truth {
        family: String,
        id: usize,
        corners: [[f64; 2]; 4],
    }

    fn folder() -> std::path::PathBuf {
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/tags")
    }

    #[test]
    fn tags_that_opencv_drew_are_read_with_corners_to_a_fifth_of_a_pixel() {
        let image = image::open(folder().join("sheet.png")).unwrap().to_luma8();
        let truth: Vec<Truth> =
            serde_json::from_slice(&std::fs::read(folder().join("sheet.json")).unwrap()).unwrap();
        let tags = TagReader::new().read(&image);
        assert_eq!(tags.len(), truth.len(), "{tags:?}");
        let mut worst: f64 = 0.0;
        for wanted in &truth {
            let family = if wanted.family.starts_with("april") { "AprilTag 36h11" } else { "ArUco 4x4_50" };
            let tag = tags.iter().find(|t| t.family == family && t.id == wanted.id).unwrap();
            for (corner, true_corner) in tag.corners.iter().zip(wanted.corners) {
                worst = worst.max(corner.distance(DVec2::from_array(true_corner)));
            }
        }
        assert!(worst < 0.2, "{worst} px");
    }

    #[test]
    fn noise_and_black_squares_are_no_tags() {
        use rand::Rng;
        let mut rng = scene::rng::rng(3, "tags", 0);
        let noise = GrayImage::from_fn(400, 300, |_, _| image::Luma([rng.random()]));
        assert_eq!(TagReader::new().read(&noise), []);
        let squares = GrayImage::from_fn(400, 300, |x, y| {
            image::Luma([if x % 100 > 40 && y % 100 > 40 { 10 } else { 240 }])
        });
        assert_eq!(TagReader::new().read(&squares), []);
    }

    #[test]
    fn codes_turn_as_the_tags_do() {
        let reader = TagReader::new();
        for dictionary in &reader.dictionaries {
            let least = |code: u64, others: &[u64]| others.iter().map(|o| (o ^ code).count_ones()).min();
            for (i, &code) in dictionary.codes.iter().enumerate().take(60) {
                let mut turn = code;
                for _ in 0..4 {
                    turn = turned(turn, dictionary.cells);
                    let others = [&dictionary.codes[..i], &dictionary.codes[i + 1..]].concat();
                    assert!(least(turn, &others).unwrap() >= dictionary.distance, "{code:x} in {i}");
                }
                assert_eq!(turn, code, "four quarter turns");
            }
        }
        assert_eq!(reader.dictionaries.each_ref().map(|d| d.codes.len()), [587, 50]);
    }
}
