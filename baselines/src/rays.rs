//! Rays through pixels, and the photos they are compared with.

use crate::composite::RayColour;
use crate::error::FieldError;
use glam::Vec3;
use rand::Rng as _;
use rayon::prelude::*;
use scene::FloatImage;
use scene::rng::rng;
use splat::{AlphaMode, Dataset, PinholeView, RenderOutput, View};

/// A half line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it begins.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Time in [0, 1].
    pub time: f32,
}

/// A ray of a photo, and what it shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sighting {
    pub(crate) ray: Ray,
    /// Colour over the background, in [0, 1].
    pub(crate) colour: [f32; 3],
    /// What lies behind everything.
    pub(crate) background: [f32; 3],
}

/// Which rays a step takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Draw {
    /// How many.
    pub(crate) count: usize,
    /// Share of a picture's sides, in its middle.
    pub(crate) crop: f32,
    /// Photos, those of the earliest times; more than there are is all.
    pub(crate) admitted: usize,
}

impl Draw {
    /// So many rays of all pixels of all photos.
    pub(crate) fn anywhere(count: usize) -> Self {
        Self { count, crop: 1.0, admitted: usize::MAX }
    }
}

/// The pixels along a side that are a share of it, in its middle; one at least.
fn middle(side: usize, share: f32) -> std::ops::Range<usize> {
    let left = (0.5 * (1.0 - share) * side as f32) as usize;
    left.min((side - 1) / 2)..(side - left).max(side / 2 + 1)
}

/// The training photos: in the order of their times.
#[derive(Debug)]
pub struct PhotoRays<'a> {
    dataset: &'a Dataset,
    views: Vec<&'a View>,
    /// Time of each training view, in [0, 1].
    times: Vec<f32>,
    /// Whether backgrounds show through and are random.
    transparent: bool,
}

/// Unit direction of the ray through a pixel, frame of the camera's world.
pub(crate) fn direction(view: &PinholeView, x: f32, y: f32) -> Vec3 {
    let [fx, fy] = view.focal;
    let in_camera = Vec3::new((x - view.centre[0]) / fx, (y - view.centre[1]) / fy, 1.0);
    (view.rotation.transpose() * in_camera).normalize()
}

impl<'a> PhotoRays<'a> {
    /// The views of a data set that are not held out; `times` has one for each view of the set,
    /// and is empty where the scene stands still.
    pub fn new(dataset: &'a Dataset, times: &[f32]) -> Self {
        let mut chosen = dataset.training_views();
        let mut all = times.to_vec();
        all.resize(dataset.views.len(), 0.0);
        chosen.sort_by(|&a, &b| all[a].total_cmp(&all[b]));
        let times = chosen.iter().map(|&i| all[i]).collect();
        let views = chosen.iter().map(|&i| &dataset.views[i]).collect();
        Self { dataset, views, times, transparent: dataset.is_transparent() }
    }

    /// Number of photos.
    pub(crate) fn len(&self) -> usize {
        self.views.len()
    }

    /// A photo and its time.
    pub(crate) fn photo(&self, index: usize) -> (&'a View, f32) {
        (self.views[index], self.times[index])
    }

    /// Whether backgrounds show through and are random.
    pub(crate) fn transparent(&self) -> bool {
        self.transparent
    }

    /// Random pixels of random photos, those of step `step`.
    pub(crate) fn sample(&self, draw: Draw, seed: u64, step: u32) -> Vec<Sighting> {
        /// Rays drawn from one stream of random numbers. Source: chosen by hand.
        const STREAM: usize = 256;
        (0..draw.count.div_ceil(STREAM))
            .into_par_iter()
            .flat_map_iter(|stream| {
                let mut rng = rng(seed, "rays", (u64::from(step) << 24) + stream as u64);
                let count = STREAM.min(draw.count - stream * STREAM);
                (0..count).filter_map(move |_| self.draw(draw, &mut rng))
            })
            .collect()
    }

    /// One pixel; none where what was hit a few times over does not count.
    fn draw(&self, draw: Draw, rng: &mut scene::rng::Rng) -> Option<Sighting> {
        /// Tries to hit a pixel that counts. Source: chosen by hand.
        const TRIES: usize = 16;
        for _ in 0..TRIES {
            let view = rng.random_range(0..draw.admitted.min(self.views.len()));
            let pixels = &self.views[view].levels[0];
            let x = rng.random_range(middle(pixels.width, draw.crop));
            let y = rng.random_range(middle(pixels.height, draw.crop));
            let at = y * pixels.width + x;
            let cover = pixels.mask.as_ref().map_or(1.0, |m| f32::from(m[at]) / 255.0);
            if self.dataset.alpha == AlphaMode::Ignore && cover < 0.5 {
                continue;
            }
            let background = if self.transparent { rng.random::<[f32; 3]>() } else { [0.0; 3] };
            let seen = [0, 1, 2].map(|c| f32::from(pixels.rgb[at * 3 + c]) / 255.0);
            let cover = if self.transparent { cover } else { 1.0 };
            let colour = [0, 1, 2].map(|c| cover * seen[c] + (1.0 - cover) * background[c]);
            let camera = &self.views[view].view;
            let direction = direction(camera, x as f32 + 0.5, y as f32 + 0.5);
            let ray = Ray { origin: camera.position(), direction, time: self.times[view] };
            return Some(Sighting { ray, colour, background });
        }
        None
    }
}

/// Pixels along a side of the blocks that are traced together: rays beside each other read the same
/// tables. Source: chosen by hand.
pub(crate) const BLOCK: usize = 8;
/// The same on graphics adapters, which want many rays at a time.
/// Source: chosen by hand: 2¹⁷ samples in a round of an Instant NeRF.
#[cfg(feature = "gpu")]
pub(crate) const LARGE_BLOCK: usize = 128;
/// What traces the rays of a block.
pub(crate) type Tracer<'a> = dyn Fn(&[Ray], &mut [RayColour]) -> Result<(), FieldError> + Sync + 'a;

/// The pixels of a block of a picture.
fn pixels(view: &PinholeView, block: usize, side: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
    let columns = view.width.div_ceil(side);
    let (x, y) = (block % columns * side, block / columns * side);
    let (right, below) = ((x + side).min(view.width), (y + side).min(view.height));
    (y..below).flat_map(move |y| (x..right).map(move |x| (x, y)))
}

/// A picture of rays through the centres of its pixels, traced in parallel in blocks of `side`
/// pixels.
pub(crate) fn picture(
    view: &PinholeView,
    time: f32,
    (background, side): ([f32; 3], usize),
    trace: &Tracer,
) -> Result<RenderOutput, FieldError> {
    let blocks: Vec<usize> = (0..view.width.div_ceil(side) * view.height.div_ceil(side)).collect();
    let traced: Result<Vec<Vec<RayColour>>, FieldError> = blocks
        .par_iter()
        .map(|&block| {
            let rays: Vec<Ray> = pixels(view, block, side)
                .map(|(x, y)| {
                    let direction = direction(view, x as f32 + 0.5, y as f32 + 0.5);
                    Ray { origin: view.position(), direction, time }
                })
                .collect();
            let mut out = vec![RayColour { rgb: background, ..RayColour::default() }; rays.len()];
            trace(&rays, &mut out)?;
            // From distances along the rays to depths along the axis.
            let axis = view.rotation.row(2);
            out.iter_mut().zip(&rays).for_each(|(o, r)| o.distance *= r.direction.dot(axis));
            Ok(out)
        })
        .collect();
    let (w, h) = (view.width, view.height);
    let mut output = RenderOutput {
        rgb: FloatImage::zeros(w, h, 3),
        alpha: FloatImage::zeros(w, h, 1),
        depth: FloatImage::zeros(w, h, 1),
    };
    for (&block, colours) in blocks.iter().zip(&traced?) {
        for ((x, y), colour) in pixels(view, block, side).zip(colours) {
            let (at, cover) = (y * w + x, 1.0 - colour.transmittance);
            output.rgb.data[at * 3..][..3].copy_from_slice(&colour.rgb);
            output.alpha.data[at] = cover;
            output.depth.data[at] = if cover > 0.0 { colour.distance / cover } else { 0.0 };
        }
    }
    Ok(output)
}
