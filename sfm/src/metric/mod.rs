//! How many metres a unit of a solved model is: from a length that is known, from tags of known
//! size, or from where the photos were taken.

mod config;
mod gps;
mod tags;

pub use config::{LengthEnds, ScaleConfig};

use crate::error::SfmError;
use crate::triangulation::{Gates, PointView, triangulate};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use scene::decision::ScaleEvidence;
use scene::overview::quantile;
use scene::{FrameSet, MetricScale, PosedImage, Progress, Reconstruction};
use std::collections::BTreeMap;

/// What marked points must satisfy: an error of a few pixels of a hand that marks them or of an
/// edge that is blurred, and rays that cross at two degrees. Source: chosen by hand; the corners of
/// tags are found to a fifth of a pixel.
const GATES: Gates = Gates { max_error_px: 6.0, min_angle: 0.035 };
/// Share of the points that may lie farther out in a direction than the object: outliers. Source:
/// chosen by hand; ten of five thousand points.
const OUTSIDE: f64 = 0.002;
/// Directions in which the longest extent is looked for. Source: derived; 5° apart, which misses
/// less than 0.1 % of a length.
const DIRECTIONS: usize = 1500;

/// The scale of a solved model; `None` where nothing says it.
///
/// # Errors
/// If the user named a length or tags and they cannot be found in the model.
pub fn metric_scale(
    model: &Reconstruction,
    frames: &FrameSet,
    config: &ScaleConfig,
    progress: &Progress,
) -> Result<Option<MetricScale>, SfmError> {
    match (config.known_length, config.tag_size) {
        (Some(length), _) if config.length_ends.is_empty() => {
            let longest = longest_extent(model).ok_or(SfmError::NoScale(
                "the model has too few points for --known-length; mark its ends with --length-ends".into(),
            ))?;
            let (evidence, metres_per_unit) = (ScaleEvidence::LongestExtent, length / longest);
            Ok(Some(MetricScale { evidence, metres_per_unit, relative_deviation: None }))
        }
        (Some(length), _) => marked_length(model, &config.length_ends, length).map(Some),
        (None, Some(size)) => tag_scale(model, frames, size, progress).map(Some),
        (None, None) => Ok(gps::scale(model, frames)),
    }
}

/// A posed image by its name, with or without the ending that the input had.
fn image_named<'a>(model: &'a Reconstruction, name: &str) -> Option<&'a PosedImage> {
    let exact = model.images.values().find(|i| i.name == name);
    exact.or_else(|| model.images.values().find(|i| stem(&i.name) == stem(name)))
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// The point that these images see at these pixels.
fn point(model: &Reconstruction, seen: &[(&PosedImage, DVec2)]) -> Option<DVec3> {
    let views: Option<Vec<PointView>> = seen
        .iter()
        .map(|(image, pixel)| Some(PointView::new(&image.pose, model.cameras.get(&image.camera)?, *pixel)))
        .collect();
    triangulate(&views?, &GATES).map(|found| found.position)
}

fn marked_length(model: &Reconstruction, ends: &[LengthEnds], metres: f64) -> Result<MetricScale, SfmError> {
    let mut images = Vec::new();
    for mark in ends {
        let Some(found) = image_named(model, &mark.image) else {
            return Err(SfmError::NoScale(format!("--length-ends: {} has no pose", mark.image)));
        };
        images.push((found, mark));
    }
    let found = [0, 1].map(|k| {
        let seen: Vec<_> = images.iter().map(|(i, m)| (*i, DVec2::from_array(m.pixels[k]))).collect();
        point(model, &seen)
    });
    let [Some(a), Some(b)] = found else {
        let hint = "mark both ends, in the same order, in images that are taken from different sides";
        return Err(SfmError::NoScale(format!("the marks of --length-ends meet in no point: {hint}")));
    };
    let metres_per_unit = metres / a.distance(b);
    if !metres_per_unit.is_finite() {
        return Err(SfmError::NoScale("both ends of --length-ends are one point".into()));
    }
    let evidence = ScaleEvidence::MarkedLength;
    Ok(MetricScale { evidence, metres_per_unit, relative_deviation: None })
}

/// The longest distance between two points, without the few that lie outside: the widest of many
/// directions.
fn longest_extent(model: &Reconstruction) -> Option<f64> {
    let points: Vec<DVec3> =
        model.points.values().filter(|p| p.track.len() > 2).map(|p| p.position).collect();
    let widths = (0..DIRECTIONS).into_par_iter().map(|i| {
        // Half of a spiral over the ball (Saff and Kuijlaars, 1997): opposite directions are one.
        let z = (i as f64 + 0.5) / DIRECTIONS as f64;
        let turn = DVec2::from_angle(i as f64 * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt()));
        let direction = (turn * (1.0 - z * z).sqrt()).extend(z);
        let along: Vec<f64> = points.iter().map(|p| p.dot(direction)).collect();
        let low = quantile(along.clone(), OUTSIDE).unwrap_or(0.0);
        quantile(along, 1.0 - OUTSIDE).unwrap_or(0.0) - low
    });
    widths.reduce_with(f64::max).filter(|w| points.len() > 100 && *w > 0.0)
}

/// From the sides of all tags that enough images show.
fn tag_scale(
    model: &Reconstruction,
    frames: &FrameSet,
    size: f64,
    progress: &Progress,
) -> Result<MetricScale, SfmError> {
    let reader = tags::TagReader::new();
    progress.begin("tags", frames.len());
    let found: Result<Vec<_>, SfmError> = frames
        .frames
        .par_iter()
        .map(|frame| {
            progress.tick()?;
            let read = scene::io::load::load_rgb(&frame.path);
            let grey = read.map(|rgb| image::DynamicImage::ImageRgb8(rgb).into_luma8());
            Ok((frame.name.as_str(), grey.map(|g| reader.read(&g)).unwrap_or_default()))
        })
        .collect();
    let mut seen: BTreeMap<(&str, usize), Vec<(&PosedImage, [DVec2; 4])>> = BTreeMap::new();
    for (name, tags) in found? {
        let Some(image) = model.images.values().find(|i| i.name == name) else { continue };
        for tag in tags {
            seen.entry((tag.family, tag.id)).or_default().push((image, tag.corners));
        }
    }
    let sides: Vec<f64> = seen.values().filter_map(|views| tag_side(model, views)).collect();
    let middle = quantile(sides.clone(), 0.5).ok_or_else(|| {
        let numbers: Vec<String> = seen.keys().map(|(family, id)| format!("{family} number {id}")).collect();
        let what = if numbers.is_empty() { "no tag was read".to_owned() } else { numbers.join(", ") };
        SfmError::NoScale(format!(
            "--tag-size: no tag is square in three images or more ({what}); tags must be AprilTag 36h11 \
             or ArUco 4x4_50, with a white margin, each number once"
        ))
    })?;
    let spread = quantile(sides.iter().map(|s| (s / middle - 1.0).abs()).collect(), 0.5);
    // The median deviation of a normal distribution is 0.6745 of the standard deviation.
    let deviation = spread.filter(|_| sides.len() > 2).map(|s| s / 0.6745 / (sides.len() as f64).sqrt());
    Ok(MetricScale {
        evidence: ScaleEvidence::Tags(sides.len()),
        metres_per_unit: size / middle,
        relative_deviation: deviation,
    })
}

/// The side of a tag in units of the model; `None` where too few images see it or it is no square.
fn tag_side(model: &Reconstruction, views: &[(&PosedImage, [DVec2; 4])]) -> Option<f64> {
    if views.len() < 3 {
        return None;
    }
    let corners: Option<Vec<DVec3>> = (0..4)
        .map(|k| point(model, &views.iter().map(|(image, c)| (*image, c[k])).collect::<Vec<_>>()))
        .collect();
    let corners = corners?;
    let sides = [0, 1, 2, 3].map(|k| corners[k].distance(corners[(k + 1) % 4]));
    let diagonals = [0, 1].map(|k| corners[k].distance(corners[k + 2]) / std::f64::consts::SQRT_2);
    let mean = sides.iter().sum::<f64>() / 4.0;
    let square = sides.iter().chain(&diagonals).all(|s| (s / mean - 1.0).abs() < 0.1);
    (square && mean > 0.0).then_some(mean)
}

#[cfg(test)]
mod tests;
