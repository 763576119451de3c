//! What a view says of the colours of texels.

use super::options::TextureOptions;
use glam::{DVec2, DVec3};
use scene::PosedPhoto;
use scene::geometry::{DepthView, Mesh};

/// Depths are the least of a square that reaches so far, pixels: what lies beside the border of a
/// nearer surface may be hidden, where pose and mesh are not exact. Source: docs/decisions/16.
const AROUND_PX: usize = 2;
/// Masks are white from here, of 255. Source: the middle.
const WHITE: u8 = 128;
/// A surface seen at a flatter angle is not looked at: cosine of about 80°. Source:
/// docs/decisions/16.
const LEAST_COSINE: f64 = 0.17;

/// A colour and how much it counts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TexelSample {
    pub(super) rgb: [u8; 3],
    pub(super) weight: f32,
}

/// A view that can be asked what it sees.
pub(super) struct PreparedView<'a> {
    view: PosedPhoto<'a>,
    /// [height × width] least depth around each pixel.
    nearest: Vec<f64>,
    /// [height × width] pixels to the nearest black of the matte or the border of the photo, at
    /// most the options' `border_px`.
    inside: Vec<u16>,
    slack: f64,
    border_px: f64,
}

impl<'a> PreparedView<'a> {
    pub(super) fn new(view: PosedPhoto<'a>, mesh: &Mesh, options: &TextureOptions) -> Self {
        let (w, h) = (view.camera.width as usize, view.camera.height as usize);
        let depth = DepthView::new(mesh, view.camera, &view.pose).depth;
        let nearest = least_around(&depth, w, AROUND_PX);
        let inside = to_border(view.mask, [w, h], options.border_px as u16);
        let slack = options.slack * mesh.size();
        Self { view, nearest, inside, slack, border_px: options.border_px.max(1) as f64 }
    }

    /// What it sees of a point with a unit normal: `None` where that is hidden, outside, or looks
    /// away. Weights: area of the surface's unit square in the photo (cos² of the angle over the
    /// squared width of a pixel), times the closeness to the matte's border.
    pub(super) fn sample(&self, point: DVec3, normal: DVec3) -> Option<TexelSample> {
        let (camera, pose) = (self.view.camera, &self.view.pose);
        let x = pose.transform(point);
        if x.z <= 0.0 {
            return None;
        }
        let pixel = camera.project(x)?;
        let (w, h) = (camera.width as usize, camera.height as usize);
        if !(pixel.x >= 0.5 && pixel.y >= 0.5 && pixel.x < w as f64 - 0.5 && pixel.y < h as f64 - 0.5) {
            return None;
        }
        let cosine = (pose.centre() - point).normalize_or_zero().dot(normal);
        if cosine < LEAST_COSINE {
            return None;
        }
        let at = pixel.y as usize * w + pixel.x as usize;
        let width = x.z / camera.mean_focal();
        // A slanted surface comes nearer within the square.
        let tangent = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine;
        let slope = (AROUND_PX as f64 + 1.0) * std::f64::consts::SQRT_2 * width * tangent;
        let inside = f64::from(self.inside[at]) / self.border_px;
        if x.z > self.nearest[at] + self.slack + slope || inside <= 0.0 {
            return None;
        }
        let weight = (cosine * self.slack / width).powi(2) * inside;
        Some(TexelSample { rgb: bilinear(self.view.rgb, w, pixel), weight: weight as f32 })
    }
}

/// The colour between four pixels.
fn bilinear(rgb: &[u8], width: usize, pixel: DVec2) -> [u8; 3] {
    let p = pixel - 0.5;
    let low = p.floor();
    let f = p - low;
    let first = low.y as usize * width + low.x as usize;
    let corners = [(0, (1.0 - f.x) * (1.0 - f.y)), (1, f.x * (1.0 - f.y))];
    let corners = corners.into_iter().chain([(width, (1.0 - f.x) * f.y), (width + 1, f.x * f.y)]);
    let mut mixed = [0.0; 3];
    for (step, weight) in corners {
        let color = rgb.get(3 * (first + step)..).unwrap_or_default();
        mixed.iter_mut().zip(color).for_each(|(m, v)| *m += weight * f64::from(*v));
    }
    mixed.map(|v| v.round() as u8)
}

/// The least value within a square around each pixel.
fn least_around(values: &[f64], width: usize, reach: usize) -> Vec<f64> {
    let height = values.len() / width.max(1);
    let rows: Vec<f64> = (0..values.len())
        .map(|i| {
            let (low, high) = ((i % width).min(reach), (width - 1 - i % width).min(reach));
            values[i - low..=i + high].iter().copied().fold(f64::INFINITY, f64::min)
        })
        .collect();
    let columns = (0..rows.len()).map(|i| {
        let (low, high) = ((i / width).min(reach), (height - 1 - i / width).min(reach));
        let column = rows[i - low * width..=i + high * width].iter().step_by(width);
        column.copied().fold(f64::INFINITY, f64::min)
    });
    columns.collect()
}

/// Steps to the nearest black pixel or the border, at most so many (city block, two passes:
/// Rosenfeld and Pfaltz, JACM 1966).
fn to_border(mask: Option<&[u8]>, [width, height]: [usize; 2], most: u16) -> Vec<u16> {
    let is_white = |i: usize| mask.is_none_or(|m| m.get(i).is_some_and(|v| *v >= WHITE));
    let mut steps: Vec<u16> = (0..width * height).map(|i| if is_white(i) { most } else { 0 }).collect();
    for i in 0..steps.len() {
        let left = if i.is_multiple_of(width) { 0 } else { steps[i - 1] };
        let above = if i < width { 0 } else { steps[i - width] };
        steps[i] = steps[i].min(left.min(above) + 1);
    }
    for i in (0..steps.len()).rev() {
        let right = if (i + 1).is_multiple_of(width) { 0 } else { steps[i + 1] };
        let below = steps.get(i + width).copied().unwrap_or(0);
        steps[i] = steps[i].min(right.min(below) + 1);
    }
    steps
}

/// The colour that most of the weight agrees on: the weighted median of each channel, then the mean
/// of the samples, each by its weight and by how near it is to the median (one step of iteratively
/// reweighted least squares with Cauchy's weights). A glint in one of several views does not show.
/// `None` of no samples.
pub(super) fn blend(samples: &[TexelSample], tolerance: f64) -> Option<[u8; 3]> {
    let total: f64 = samples.iter().map(|s| f64::from(s.weight)).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let middle = [0, 1, 2].map(|k| {
        let mut sorted: Vec<(u8, f64)> = samples.iter().map(|s| (s.rgb[k], f64::from(s.weight))).collect();
        sorted.sort_by_key(|(v, _)| *v);
        let mut sum = 0.0;
        let found = sorted.iter().find(|(_, w)| {
            sum += w;
            2.0 * sum >= total
        });
        f64::from(found.map_or(0, |(v, _)| *v))
    });
    let weights = samples.iter().map(|s| {
        let off: f64 = s.rgb.iter().zip(middle).map(|(v, m)| (f64::from(*v) - m).powi(2)).sum();
        f64::from(s.weight) / (1.0 + off / tolerance.powi(2))
    });
    let weights: Vec<f64> = weights.collect();
    let total: f64 = weights.iter().sum();
    Some([0, 1, 2].map(|k| {
        let sum: f64 = samples.iter().zip(&weights).map(|(s, w)| w * f64::from(s.rgb[k])).sum();
        if total > 0.0 { (sum / total).round() as u8 } else { middle[k] as u8 }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(v: u8, weight: f32) -> TexelSample {
        TexelSample { rgb: [v, v, v / 2], weight }
    }

    #[test]
    fn a_glint_in_a_few_views_does_not_show() {
        let plain: Vec<TexelSample> = (0..6).map(|i| sample(98 + i, 1.0)).collect();
        let glint = [plain.clone(), vec![sample(255, 1.2); 2]].concat();
        let (a, b) = (blend(&plain, 12.0).unwrap(), blend(&glint, 12.0).unwrap());
        assert!(a[0].abs_diff(b[0]) <= 3, "{a:?} {b:?}");
        assert!(blend(&[], 12.0).is_none() && blend(&[sample(1, 0.0)], 12.0).is_none());
        assert_eq!(blend(&[sample(40, 1e-20)], 12.0), Some([40, 40, 20]));
    }

    #[test]
    fn steps_to_the_border_count_and_end() {
        let mut mask = vec![255; 9 * 7];
        mask[3 * 9 + 4] = 0;
        let steps = to_border(Some(&mask), [9, 7], 3);
        assert_eq!(steps[3 * 9 + 4], 0);
        assert_eq!((steps[3 * 9 + 5], steps[3 * 9 + 6], steps[2 * 9 + 5]), (1, 2, 2));
        assert_eq!((steps[0], steps[3 * 9 + 1], steps[3 * 9 + 8]), (1, 2, 1));
        assert!(to_border(None, [9, 7], 3).contains(&3));
    }

    #[test]
    fn the_least_around_ends_at_the_border() {
        let mut values = vec![5.0; 6 * 5];
        values[2 * 6 + 3] = 1.0;
        let least = least_around(&values, 6, 1);
        for (i, v) in least.iter().enumerate() {
            let near = (i % 6).abs_diff(3) <= 1 && (i / 6).abs_diff(2) <= 1;
            assert_eq!(*v, if near { 1.0 } else { 5.0 }, "{i}");
        }
    }
}
