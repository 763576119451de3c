//! Chroma key: a soft matte and the colour of the foreground alone, for a screen of any hue under
//! uneven light.

mod cleanup;
mod colour;
mod config;
mod despill;
mod luma_key;
mod morphology;
mod pool;
mod refine_network;
mod screen;
mod solve;
mod trimap;

pub use crate::pixels::THUMBNAIL_SIDE;
pub use config::{Background, KeyConfig};

use colour::Key;
use config::KeyChoice;
use image::{GrayImage, RgbImage};
use pool::Pool;
use refine_network::OutlineInputs;
use scene::decision::{Decision, MatteKind, Rule, Subject};
use screen::Screen;
use screen::clean_plate::CleanPlate;
use screen::detect::quantile;
use solve::Matte;
use trimap::Trimap;

/// A screen that was found, ready to key frames.
#[derive(Clone, Debug)]
pub struct Keyer {
    /// `None`: a dark room, keyed by light.
    key: Option<Key>,
    keep_pole: bool,
    plate: Option<CleanPlate>,
    /// Why this key.
    pub decision: Decision,
}

impl Keyer {
    /// Looks for a screen in thumbnails ([`THUMBNAIL_SIDE`] long) of some frames, as far as they
    /// are not blank. `Err` holds the decision against one.
    pub fn find(
        thumbnails: &[RgbImage],
        config: &KeyConfig,
    ) -> Result<Result<Self, Decision>, crate::PreprocessError> {
        let choice = config.choice()?;
        if choice == KeyChoice::Off {
            return Ok(Err(screen::detect::no_matte(Rule::Requested)));
        }
        let keep_pole = config.keep_pole;
        if choice == KeyChoice::Black {
            if let Some(doubt) = luma_key::doubt(thumbnails) {
                return Ok(Err(doubt));
            }
            let decision = Decision::new(Subject::Matte, MatteKind::Luminance, Rule::Requested);
            return Ok(Ok(Self { key: None, keep_pole, plate: None, decision }));
        }
        let mut telling: Vec<&RgbImage> = thumbnails.iter().filter(|t| !is_blank(t)).collect();
        if telling.is_empty() {
            telling.extend(thumbnails);
        }
        let found = screen::detect::detect(&telling, choice);
        Ok(match found.key {
            Some(key) => Ok(Self { key: Some(key), keep_pole, plate: None, decision: found.decision }),
            None => Err(found.decision),
        })
    }

    /// Learns from frames of a video, where the camera stands still: the screen's folds, what lies
    /// beside it, the pole. Returns what was found out.
    pub fn learn(&mut self, frames: &[RgbImage]) -> Option<String> {
        self.plate = self.key.and_then(|key| CleanPlate::learn(frames, &key));
        let plate = self.plate.as_ref().filter(|p| p.share > 1e-3)?;
        Some(format!(
            "the camera stands still: {:.1} % of the picture is neither screen nor moving and is {}",
            100.0 * plate.share,
            if self.keep_pole || !plate.has_pole {
                "cut beside the screen"
            } else {
                "cut (before the screen: the pole)"
            }
        ))
    }

    /// Matte (white = object) and foreground colours of one frame.
    pub fn matte(&self, image: &RgbImage, scratch: &mut Scratch) -> (GrayImage, RgbImage) {
        let (width, height) = image.dimensions();
        if is_blank(image) {
            return (GrayImage::new(width, height), image.clone());
        }
        let (alpha, colours) = match &self.key {
            None => (luma_key::matte(&scratch.0, image.as_raw(), width as usize), image.as_raw().clone()),
            Some(key) => self.soft(image, key, &scratch.0),
        };
        let matte = GrayImage::from_raw(width, height, alpha).unwrap_or_default();
        (matte, RgbImage::from_raw(width, height, colours).unwrap_or_default())
    }

    fn soft(&self, image: &RgbImage, key: &Key, pool: &Pool) -> (Vec<u8>, Vec<u8>) {
        let Some((screen, trimap, mut matte)) = self.solve(image, key, pool) else {
            // A frame without any screen shows nothing but the object.
            return (vec![255; image.as_raw().len() / 3], image.as_raw().clone());
        };
        refine_network::refine(&screen, &trimap, &mut matte, image.as_raw(), key);
        let alpha = matte.alpha.iter().map(|a| (a * 255.0 + 0.5) as u8).collect();
        (alpha, despill::foreground(&screen, &matte, key))
    }

    /// The matte before the network refines it; `None` where no light can be fitted to the screen.
    fn solve<'p>(
        &self,
        image: &RgbImage,
        key: &Key,
        pool: &'p Pool,
    ) -> Option<(Screen<'p>, Trimap<'p>, Matte<'p>)> {
        let (width, pixels) = (image.width() as usize, image.as_raw().len() / 3);
        let plate = self.plate.as_ref().filter(|p| p.width == width && p.things.len() == pixels);
        let mut screen = match plate {
            Some(plate) => Screen::before_plate(pool, image, key, plate, self.keep_pole),
            None => Screen::before_field(pool, image, key)?,
        };
        let trimap = Trimap::new(&screen, screen.noise(), image.as_raw(), key);
        solve::measure_light_beside(&mut screen, &trimap, key);
        let mut matte = Matte::solve(&screen, &trimap);
        cleanup::clean(&mut matte, &trimap, plate, self.keep_pole);
        Some((screen, trimap, matte))
    }

    /// What the network that refines a matte sees of a frame, and what it should say: rows of
    /// inputs, alpha so far, true alpha; for training it (`tools/train_outline.py`). Empty where
    /// nothing is keyed by colour or the sizes differ.
    pub fn outline_samples(&self, image: &RgbImage, truth: &GrayImage, scratch: &mut Scratch) -> Vec<f32> {
        let Some(key) = self.key.as_ref().filter(|_| !is_blank(image)) else {
            return Vec::new();
        };
        let (true, Some((screen, trimap, matte))) =
            (truth.dimensions() == image.dimensions(), self.solve(image, key, &scratch.0))
        else {
            return Vec::new();
        };
        let outline = OutlineInputs::new(&screen, &trimap, &matte.alpha, image.as_raw(), key, 1);
        let rows = outline.pixels.iter().map(|i| *i as usize).flat_map(|i| {
            let told = [matte.alpha[i], f32::from(truth.as_raw()[i]) / 255.0];
            outline.inputs(&matte, i).into_iter().chain(told)
        });
        rows.collect()
    }
}

/// All but two pixels in a thousand at either end of a blank frame differ by at most this, 8-bit
/// levels. Source: chosen by hand, never measured; noise of a black frame is less, any object more.
const BLANK_LEVELS: f32 = 6.0;

/// Whether a frame shows nothing at all: a cut, a blackout, a flash. One pixel in 61 is asked.
fn is_blank(image: &RgbImage) -> bool {
    (0..3).all(|c| {
        let mut samples: Vec<f32> = image.pixels().step_by(61).map(|p| f32::from(p[c])).collect();
        quantile(&mut samples, 0.998) - quantile(&mut samples, 0.002) <= BLANK_LEVELS
    })
}

/// Memory kept between frames; one a thread.
#[derive(Default)]
pub struct Scratch(Pool);
