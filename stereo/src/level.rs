//! A picture at one resolution, as the correlation reads it.

use scene::Camera;
use scene::PosedPhoto;

/// Masks are white from here, of 255. Source: the middle.
const WHITE: u32 = 128;

/// A grey picture, black where the mask is, and its camera.
pub(crate) struct LevelImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Of this size.
    pub(crate) camera: Camera,
    /// [height × width] whether the mask is white.
    pub(crate) inside: Vec<bool>,
    /// [height × width] the luma of a pixel, its right neighbour, those below: bytes from the
    /// lowest.
    pub(crate) packed: Vec<u32>,
    /// First and last but one column and row of what the mask keeps; empty where it keeps nothing.
    pub(crate) frame: [usize; 4],
}

impl LevelImage {
    /// A view whose sides are divided by 2^`level`; means over squares.
    pub(crate) fn new(view: &PosedPhoto, level: u32) -> Self {
        let (full_width, full_height) = (view.camera.width as usize, view.camera.height as usize);
        let step = 1_usize << level;
        let (width, height) = ((full_width / step).max(1), (full_height / step).max(1));
        let mut grey = Vec::with_capacity(width * height);
        let mut inside = Vec::with_capacity(width * height);
        for y in 0..height {
            let rows = y * step..((y + 1) * step).min(full_height);
            for x in 0..width {
                let (mut light, mut cover, mut count) = (0, 0, 0);
                for i in rows.clone().flat_map(|r| {
                    (x * step..((x + 1) * step).min(full_width)).map(move |c| r * full_width + c)
                }) {
                    let mask = view.mask.map_or(255, |m| u32::from(m[i]));
                    let [r, g, b] = [0, 1, 2].map(|c| u32::from(view.rgb[3 * i + c]));
                    // Rec. 601, in 1/1000.
                    light += (299 * r + 587 * g + 114 * b) * mask / 255;
                    cover += mask;
                    count += 1;
                }
                grey.push(((light + 500 * count) / (1000 * count)) as u8);
                inside.push(cover >= WHITE * count);
            }
        }
        let camera = view.camera.scaled(width as u32, height as u32);
        let (packed, frame) = (packed(&grey, width), frame(&inside, width));
        Self { width, height, camera, inside, packed, frame }
    }

    /// Luma of a pixel.
    #[inline(always)]
    pub(crate) fn grey(&self, i: usize) -> f32 {
        (self.packed[i] & 255) as f32
    }
}

/// Each pixel with its neighbours to the right and below (the last ones: themselves).
fn packed(grey: &[u8], width: usize) -> Vec<u32> {
    let height = grey.len() / width;
    (0..grey.len())
        .map(|i| {
            let right = usize::from(i % width + 1 < width);
            let below = if i / width + 1 < height { width } else { 0 };
            let [a, b, c, d] = [i, i + right, i + below, i + below + right].map(|j| u32::from(grey[j]));
            a | b << 8 | c << 16 | d << 24
        })
        .collect()
}

/// First column and row, and those behind the last, of what is inside.
fn frame(inside: &[bool], width: usize) -> [usize; 4] {
    let mut frame = [usize::MAX, usize::MAX, 0, 0];
    for i in (0..inside.len()).filter(|&i| inside[i]) {
        let (x, y) = (i % width, i / width);
        frame = [frame[0].min(x), frame[1].min(y), frame[2].max(x + 1), frame[3].max(y + 1)];
    }
    if frame[2] == 0 { [0; 4] } else { frame }
}
