//! Is there a screen, and of which colour?

use crate::matting::colour::{Key, hue_distance, hue_saturation_value, linear};
use crate::matting::config::KeyChoice;
use glam::Vec3;
use image::RgbImage;
use scene::decision::{Decision, MatteKind, Measurement, Quantity, Remark, Rule, Subject};

/// What pixels have a hue, and what of one hue is a screen.
struct ScreenCriteria {
    /// Pixels of less saturation have no hue to speak of. Source: chosen by hand, never measured.
    min_saturation: f32,
    /// Pixels of less value have no hue to speak of; share of white. Source: chosen by hand, never
    /// measured.
    min_value: f32,
    /// Half-width of the range of hues taken for one screen, degrees. Source: chosen by hand, never
    /// measured.
    hue_window: f32,
    /// A screen covers at least this share of the picture, in the median frame and in the worst but
    /// one in ten. Source: chosen by hand, never measured.
    min_coverage: (f32, f32),
    /// A screen is smooth: median relative step of value between neighbours in a picture of 160
    /// pixels. Source: chosen by hand, never measured.
    max_roughness: f32,
    /// A screen is saturated (median of its pixels); a grey-blue wall or table is not taken for one
    /// unless it is named. Source: chosen by hand, never measured.
    min_screen_saturation: f32,
    /// Wood, skin, brick and lamp light have these hues, degrees: a screen of such a colour is only
    /// taken if it is named. Source: chosen by hand, never measured.
    natural_hues: (f32, f32),
}

/// The values in force.
const CRITERIA: ScreenCriteria = ScreenCriteria {
    min_saturation: 0.25,
    min_value: 0.05,
    hue_window: 15.0,
    min_coverage: (0.12, 0.05),
    max_roughness: 0.03,
    min_screen_saturation: 0.5,
    natural_hues: (-30.0, 68.0),
};

/// Bins of the histogram of hues, a third of the window wide. Source: derivation.
const BINS: usize = (3.0 * 360.0 / CRITERIA.hue_window) as usize;

/// What was found, and why.
pub(crate) struct Detection {
    /// The screen; `None` where there is none.
    pub key: Option<Key>,
    /// Whether there is a screen, and the figures.
    pub decision: Decision,
}

/// Looks for a screen in thumbnails (about 160 pixels long) of some frames.
pub(crate) fn detect(thumbnails: &[&RgbImage], choice: KeyChoice) -> Detection {
    let forced = matches!(choice, KeyChoice::Hue(..));
    let Some(hue) = dominant_hue(thumbnails, choice) else {
        return Detection { key: None, decision: no_matte(Rule::NothingFound).remarked(Remark::NoHue) };
    };
    let found = HueStatistics::of(thumbnails, hue);
    let natural = (hue - CRITERIA.natural_hues.0).rem_euclid(360.0)
        <= CRITERIA.natural_hues.1 - CRITERIA.natural_hues.0;
    let is_screen = found.coverage >= CRITERIA.min_coverage.0
        && found.low_coverage >= CRITERIA.min_coverage.1
        && found.roughness <= CRITERIA.max_roughness
        && found.saturation >= CRITERIA.min_screen_saturation
        && !natural;
    let figures = [
        (Quantity::Hue, hue),
        (Quantity::Coverage, found.coverage),
        (Quantity::LeastCoverage, found.low_coverage),
        (Quantity::Saturation, found.saturation),
        (Quantity::Roughness, found.roughness),
    ]
    .map(|(quantity, value)| Measurement::new(quantity, f64::from(value)));
    let key = Key::new(found.colour).filter(|_| is_screen || (forced && found.coverage > 0.01));
    let decision = match key {
        Some(_) if forced => Decision::new(Subject::Matte, MatteKind::Screen, Rule::Requested),
        Some(_) => Decision::new(Subject::Matte, MatteKind::Screen, Rule::Evidence),
        None if natural => no_matte(Rule::NothingFound).remarked(Remark::NaturalHue),
        None => no_matte(Rule::NothingFound),
    };
    Detection { key, decision: decision.with_all(figures) }
}

/// The decision that the frames stay as they are.
pub(crate) fn no_matte(rule: Rule) -> Decision {
    Decision::new(Subject::Matte, MatteKind::Nothing, rule)
}

fn pixels(thumbnails: &[&RgbImage]) -> impl Iterator<Item = [u8; 3]> {
    thumbnails.iter().flat_map(|t| t.pixels().map(|p| p.0))
}

/// The hue with the most saturated pixels around it.
fn dominant_hue(thumbnails: &[&RgbImage], choice: KeyChoice) -> Option<f32> {
    let mut counts = [0.0_f32; BINS];
    for rgb in pixels(thumbnails) {
        let (hue, saturation, value) = hue_saturation_value(rgb);
        if saturation >= CRITERIA.min_saturation && value >= CRITERIA.min_value && choice.allows(hue) {
            counts[(hue / 360.0 * BINS as f32) as usize % BINS] += saturation;
        }
    }
    let smoothed: [f32; BINS] =
        std::array::from_fn(|i| counts[(i + BINS - 1) % BINS] + 2.0 * counts[i] + counts[(i + 1) % BINS]);
    let best = (0..BINS).max_by(|a, b| smoothed[*a].total_cmp(&smoothed[*b]))?;
    if smoothed[best] <= 0.0 {
        return None;
    }
    let (before, here, after) = (counts[(best + BINS - 1) % BINS], counts[best], counts[(best + 1) % BINS]);
    let offset = (after - before) / (before + here + after);
    Some(((best as f32 + 0.5 + offset) * 360.0 / BINS as f32).rem_euclid(360.0))
}

fn is_near(rgb: [u8; 3], hue: f32) -> bool {
    let (h, saturation, value) = hue_saturation_value(rgb);
    saturation >= CRITERIA.min_saturation
        && value >= CRITERIA.min_value
        && hue_distance(h, hue) <= CRITERIA.hue_window
}

struct HueStatistics {
    coverage: f32,
    low_coverage: f32,
    roughness: f32,
    saturation: f32,
    colour: Vec3,
}

impl HueStatistics {
    fn of(thumbnails: &[&RgbImage], hue: f32) -> Self {
        let (mut coverage, mut steps, mut saturations) = (Vec::new(), Vec::new(), Vec::new());
        let mut channels = [Vec::new(), Vec::new(), Vec::new()];
        for image in thumbnails {
            let mut inside = 0;
            for (x, y, p) in image.enumerate_pixels() {
                if !is_near(p.0, hue) {
                    continue;
                }
                inside += 1;
                saturations.push(hue_saturation_value(p.0).1);
                channels.iter_mut().zip(linear(&p.0).to_array()).for_each(|(all, v)| all.push(v));
                for (dx, dy) in [(1, 0), (0, 1)] {
                    if x + dx < image.width()
                        && y + dy < image.height()
                        && is_near(image.get_pixel(x + dx, y + dy).0, hue)
                    {
                        let (a, b) = (value(p.0), value(image.get_pixel(x + dx, y + dy).0));
                        steps.push((a - b).abs() / a.max(b));
                    }
                }
            }
            coverage.push(inside as f32 / (image.width() * image.height()).max(1) as f32);
        }
        let colour = channels.map(|mut all| quantile(&mut all, 0.5)).into();
        Self {
            coverage: quantile(&mut coverage, 0.5),
            low_coverage: quantile(&mut coverage, 0.1),
            roughness: if steps.is_empty() { 1.0 } else { quantile(&mut steps, 0.5) },
            saturation: quantile(&mut saturations, 0.5),
            colour,
        }
    }
}

fn value(rgb: [u8; 3]) -> f32 {
    f32::from(rgb[0].max(rgb[1]).max(rgb[2]))
}

/// The q-quantile; 0 of nothing.
pub(crate) fn quantile(values: &mut [f32], q: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let rank = ((values.len() - 1) as f32 * q).round() as usize;
    *values.select_nth_unstable_by(rank, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn frame(screen: [u8; 3], share: u32) -> RgbImage {
        RgbImage::from_fn(160, 120, |x, y| {
            let v = (x * 37 + y * 91) % 97;
            if x * 100 / 160 < share {
                Rgb(screen.map(|c| c.saturating_add((v % 3) as u8)))
            } else {
                Rgb([v as u8 + 60, 80, 100])
            }
        })
    }

    #[test]
    fn screens_of_any_hue_are_found_and_rooms_are_not() {
        for screen in [[30, 190, 60], [40, 60, 180], [190, 20, 170], [125, 180, 10], [20, 60, 24]] {
            let found = detect(&[&frame(screen, 60), &frame(screen, 50)], KeyChoice::Auto);
            assert!(found.key.is_some(), "{screen:?}: {:?}", found.decision);
            let hue = found.decision.value(Quantity::Hue).unwrap() as f32;
            assert!(hue_distance(hue, hue_saturation_value(screen).0) < 4.0, "{screen:?} {hue}");
        }
        for (screen, share) in [
            ([30, 190, 60], 4),
            ([90, 85, 88], 70),
            ([180, 120, 70], 70),
            ([0, 0, 0], 90),
            ([82, 90, 150], 80),
        ] {
            let found = detect(&[&frame(screen, share)], KeyChoice::Auto);
            assert!(found.key.is_none(), "{screen:?}: {:?}", found.decision);
        }
        assert!(detect(&[], KeyChoice::Auto).key.is_none());
    }
}
