//! A black sky without mattes: where a photo is black, most probably nothing is.
//!
//! Over black the photos do not tell a black surface from nothing, and what no photo pulls at
//! stays: black fog around the object, which shows before any other background and has depths. So
//! black pixels are now and then taken for see-through, and a random colour shows through them. A
//! surface that is black in one view and lit in others stays, since most steps speak for it; so
//! does one that is seen before another, which would show.
//!
//! What is left covers the object, its dark sides too: mattes for its shape.

use crate::dataset::{Dataset, Pixels, View, pyramid, shrink};
use rand::Rng as _;

/// What is a black sky, and how often it is see-through.
struct SkyLimits {
    /// Share of the shorter side that is the rim of a photo. Source: chosen by hand.
    rim: f64,
    /// Share of the rims' pixels that the level is at or above. Source: chosen by hand: objects may
    /// reach the rim in some views.
    share: f64,
    /// Times that photos are halved until noise is gone. Source: derived: 64 pixels are one.
    halvings: u32,
    /// Levels by which the rims may differ then. Source: docs/decisions/24: skies 1, a dark room 8.
    uneven: u8,
    /// Highest level of a black sky, of 255. Source: chosen by hand: noise of a black frame is
    /// less.
    highest: u8,
    /// Levels above that are black as well: noise beyond the share. Source: chosen by hand.
    noise: u8,
    /// Pixels to either side in which edges are mixed with what is behind. Source: derived: those
    /// of a sharp picture are one pixel wide, of a coded one two.
    reach: usize,
    /// Share of the steps in which it is see-through. Source: docs/decisions/24.
    steps: f64,
}

/// The values in force.
const LIMITS: SkyLimits =
    SkyLimits { rim: 0.05, share: 0.9, halvings: 3, uneven: 2, highest: 12, noise: 2, reach: 2, steps: 0.1 };

/// A black sky around the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BlackSky {
    /// Pixels whose channels are all at most this are black.
    level: u8,
}

impl BlackSky {
    /// That of photos without masks; none where their rims are lit, or show anything: a dark room
    /// has levels like those of a noisy sky, and walls.
    pub(crate) fn of<'a>(views: impl Iterator<Item = &'a View>) -> Option<Self> {
        let (mut rims, mut smooth) = (Levels::NONE, Levels::NONE);
        for view in views {
            let pixels = view.levels.first()?;
            if pixels.mask.is_some() {
                return None;
            }
            rims.count_rim(pixels);
            smooth.count_rim(&shrink(pixels, LIMITS.halvings));
        }
        let [darkest, lightest] = [1.0 - LIMITS.share, LIMITS.share].map(|share| smooth.at(share));
        let even = lightest? - darkest? <= LIMITS.uneven;
        let level = rims.at(LIMITS.share)?;
        (even && level <= LIMITS.highest).then(|| Self { level: level + LIMITS.noise })
    }

    /// Whether it is see-through in a step.
    pub(crate) fn shows(&self, seed: u64, iteration: u64) -> bool {
        scene::rng::rng(seed, "sky", iteration).random_bool(LIMITS.steps)
    }

    /// The photo with a matte: nothing where all around is black; beside what is black as much of
    /// the brightest near to it as a pixel has; elsewhere all.
    pub(crate) fn matted(&self, pixels: &Pixels) -> Pixels {
        let (w, h) = (pixels.width, pixels.height);
        let (colours, _) = pixels.rgb.as_chunks::<3>();
        let own: Vec<u8> = colours.iter().map(|c| brightest(*c)).collect();
        let [most, least] = [u8::max as fn(u8, u8) -> u8, u8::min].map(|of| over_window(&own, w, of));
        let cover = own.iter().zip(&most).zip(&least).map(|((&own, &most), &least)| {
            if most <= self.level {
                0
            } else if least <= self.level {
                (u32::from(own) * 255).div_ceil(u32::from(most)) as u8
            } else {
                u8::MAX
            }
        });
        let mask: Vec<u8> = cover.collect();
        let straight = colours.iter().zip(&mask).flat_map(|(colour, &m)| {
            colour.map(|v| (u32::from(v) * 255).checked_div(u32::from(m)).map_or(0, |v| v.min(255) as u8))
        });
        Pixels { width: w, height: h, rgb: straight.collect(), mask: Some(mask) }
    }
}

/// The most or the least, as `of` has it, over a window around each pixel.
fn over_window(values: &[u8], width: usize, of: fn(u8, u8) -> u8) -> Vec<u8> {
    let height = values.len().checked_div(width).unwrap_or(0);
    let near = |at: usize, side: usize| at.saturating_sub(LIMITS.reach)..(at + LIMITS.reach + 1).min(side);
    let mut rows = values.to_vec();
    for (out, row) in rows.chunks_exact_mut(width.max(1)).zip(values.chunks_exact(width.max(1))) {
        for (x, out) in out.iter_mut().enumerate() {
            *out = row[near(x, width)].iter().copied().fold(row[x], of);
        }
    }
    let mut all = rows.clone();
    for (y, out) in all.chunks_exact_mut(width.max(1)).enumerate() {
        for row in near(y, height).map(|y| &rows[y * width..(y + 1) * width]) {
            out.iter_mut().zip(row).for_each(|(out, v)| *out = of(*out, *v));
        }
    }
    all
}

impl Dataset {
    /// With mattes where the photos have none and a black sky: what `cover` says is covered in a
    /// view, [height × width] of full resolution, white: all. None where there is no such sky.
    pub fn with_silhouettes<E>(
        &self,
        mut cover: impl FnMut(&View) -> Result<Vec<u8>, E>,
    ) -> Result<Option<Self>, E> {
        if BlackSky::of(self.views.iter()).is_none() {
            return Ok(None);
        }
        let mut out = self.clone();
        for view in &mut out.views {
            let mask = Some(cover(view)?);
            let full = view.levels.drain(..).next().unwrap_or_default();
            view.levels = pyramid(Pixels { mask, ..full });
        }
        Ok(Some(out))
    }
}

fn brightest(colour: [u8; 3]) -> u8 {
    colour.into_iter().fold(0, u8::max)
}

/// How many pixels have each level.
struct Levels([u64; 256]);

impl Levels {
    const NONE: Self = Self([0; 256]);

    /// Adds the pixels of the rim by their brightest channel.
    fn count_rim(&mut self, pixels: &Pixels) {
        let (w, h) = (pixels.width, pixels.height);
        let rim = ((LIMITS.rim * w.min(h) as f64) as usize).max(1);
        let (colours, _) = pixels.rgb.as_chunks::<3>();
        for (i, colour) in colours.iter().enumerate() {
            let (x, y) = (i % w, i / w);
            if x.min(w - 1 - x).min(y.min(h - 1 - y)) < rim {
                self.0[usize::from(brightest(*colour))] += 1;
            }
        }
    }

    /// The least level that so large a share of the pixels does not exceed; none of no pixels.
    fn at(&self, share: f64) -> Option<u8> {
        let wanted = (share * self.0.iter().sum::<u64>() as f64).max(1.0);
        let so_far = self.0.iter().scan(0, |sum, n| {
            *sum += n;
            Some(*sum as f64)
        });
        so_far.zip(0..=u8::MAX).find(|(sum, _)| *sum >= wanted).map(|(_, level)| level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::tests::{config, held_out_psnr, pictures_of, truth};
    use crate::train::train;
    use glam::Vec3;
    use scene::Progress;

    const SIZE: [u32; 2] = [64, 56];

    /// Photos of a small object over black, and nothing else.
    fn dataset() -> Dataset {
        let mut small = truth();
        small.means.iter_mut().for_each(|m| *m *= 0.4);
        small.log_scales.iter_mut().for_each(|s| *s += Vec3::splat(-0.9));
        pictures_of(&small, 18, false, SIZE)
    }

    fn pixels(level: u8) -> Pixels {
        let (width, height) = (40, 30);
        let mut rgb = vec![level; width * height * 3];
        rgb[3 * (15 * width + 20)..][..3].copy_from_slice(&[0, 0, 90]);
        Pixels { width, height, rgb, mask: None }
    }

    fn view(level: u8) -> View {
        View { levels: vec![pixels(level)], ..dataset().views.swap_remove(0) }
    }

    #[test]
    fn black_rims_are_a_sky_and_lit_ones_and_mattes_are_none() {
        let of = |levels: &[u8]| BlackSky::of(levels.iter().map(|l| view(*l)).collect::<Vec<_>>().iter());
        assert_eq!(of(&[0; 3]), Some(BlackSky { level: LIMITS.noise }));
        assert_eq!(of(&[9; 3]), Some(BlackSky { level: 9 + LIMITS.noise }));
        assert_eq!(of(&[40; 3]), None);
        assert_eq!(of(&[255; 3]), None);
        assert_eq!(of(&[0, 0, 40]), None, "a third of the rims is lit");
        assert_eq!(of(&[3, 3, 9]), None, "walls of a dark room");
        assert_eq!(of(&[]), None);
        let mut matted = view(0);
        matted.levels[0].mask = Some(vec![0; 40 * 30]);
        assert_eq!(BlackSky::of([matted].iter()), None);
    }

    #[test]
    fn edges_are_mixed_and_what_is_lit_stays_as_it_is() {
        let mut photo = pixels(0);
        photo.rgb[3 * (15 * 40 + 21)..][..3].copy_from_slice(&[10, 0, 45]);
        let matted = BlackSky { level: 2 }.matted(&photo);
        let mask = matted.mask.unwrap();
        assert_eq!([20, 21].map(|x| mask[15 * 40 + x]), [255, 128]);
        assert_eq!(mask.iter().filter(|m| **m > 0).count(), 2);
        assert_eq!(matted.rgb[3 * (15 * 40 + 21)..][..3], [19, 0, 89], "as bright as the one beside it");
        let lit = BlackSky { level: 2 }.matted(&pixels(30));
        assert!(lit.mask.unwrap().iter().all(|m| *m == 255) && lit.rgb == pixels(30).rgb);
    }

    /// Over black a fog is not seen. Half of the points are of such a fog.
    #[test]
    fn black_fog_goes_and_the_object_stays() {
        let mut dataset = dataset();
        let fog: Vec<_> = dataset.points.iter().map(|(x, _)| (*x * 2.0, [0; 3])).collect();
        dataset.points.extend(fog);
        let result = train(&dataset, &config(400), None, &Progress::silent()).unwrap();
        let psnr = held_out_psnr(&dataset, &result);
        let mut renderer = crate::Renderer::new(&result.gaussians).unwrap();
        let mut covers = [(0.0, 0.0); 2];
        for view in dataset.views.iter().filter(|v| v.held_out) {
            let alpha = renderer.render(&view.camera, &view.pose, &result.render).unwrap().alpha.data;
            let colours = view.levels[0].rgb.chunks_exact(3);
            for (a, rgb) in alpha.iter().zip(colours) {
                let lit = rgb.iter().any(|v| *v > 100);
                if lit || rgb.iter().all(|v| *v == 0) {
                    covers[usize::from(lit)].0 += f64::from(*a);
                    covers[usize::from(lit)].1 += 1.0;
                }
            }
        }
        let [sky, object] = covers.map(|(sum, n)| sum / n);
        assert!(sky < 0.02 && object > 0.9 && psnr > 30.0, "{sky} {object} {psnr}");
    }
}
