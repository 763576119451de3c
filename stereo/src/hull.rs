//! The visual hull as the views see it: where rays first meet what all masks leave room for.
//!
//! The surface lies on the hull or behind it (Laurentini, "The Visual Hull Concept for
//! Silhouette-Based Image Understanding", 1994), and where it is convex and seen from all around,
//! nearly on it. Rays meet it by sphere tracing (Hart 1996): the farthest distance beside an
//! outline bounds the way to it.

use crate::field::{PinholeLens, carried};
use crate::level::LevelImage;
use crate::outline::Outline;
use crate::pair::PixelMap;
use glam::Vec3;
use rayon::prelude::*;
use scene::{Camera, Cancelled, PosedPhoto, Progress};

/// Rays are so many times fewer than pixels, along each side. Source: chosen by hand, never
/// measured; the hull is no finer.
const SHRUNK: usize = 2;

/// How rays meet a hull.
struct HullLimits {
    /// Views with an outline from which a hull is told. Source: as for pruning Gaussians.
    least_views: usize,
    /// Most steps of a ray. Source: chosen by hand, never measured.
    steps: usize,
    /// A ray meets the hull where it comes so near, pixels. Source: half of what outlines of whole
    /// pixels are known to.
    met_px: f32,
    /// Where a single outline is farther off than this, no other is asked, pixels. Source: chosen
    /// by hand, never measured.
    far_px: f32,
    /// The hull has ended where an outline is so far off, pixels. Source: outlines are known to
    /// about half of it.
    ended_px: f32,
    /// Growth of the steps by which its end is sought. Source: chosen by hand, never measured.
    growth: f32,
    /// Most of these. Source: from one pixel to a thousand, more than any object.
    widenings: usize,
    /// Where the surface may lie farther behind the hull than this, it is not expected on it,
    /// pixels. Source: docs/decisions/21.
    slack_px: f32,
    /// Of the way to the outline in the plane of the picture so much is safe: its cone is oblique.
    /// Source: cos 26°, half the field of view of a wide lens.
    safe: f32,
}

/// The values in force.
const LIMITS: HullLimits = HullLimits {
    least_views: 8,
    steps: 100,
    met_px: 0.25,
    far_px: 6.0,
    ended_px: 1.0,
    growth: 1.5,
    widenings: 17,
    slack_px: 20.0,
    safe: 0.9,
};

/// The hull in one view.
pub(crate) struct HullField {
    /// First column and row of the rectangle around the object that is kept.
    corner: [usize; 2],
    /// Its columns.
    width: usize,
    lens: PinholeLens,
    /// [rows × width] camera z; 0 where the ray meets none.
    depth: Vec<f32>,
    /// [rows × width] how far behind it the surface may lie, pixels.
    slack_px: Vec<f32>,
    /// [rows × width] towards the camera.
    normal: Vec<Vec3>,
}

/// The outlines of the views beside one, whose rays are those of a camera.
fn beside<'a>(
    views: &[PosedPhoto],
    view: usize,
    camera: &Camera,
    outlines: &'a [Option<Outline>],
) -> Vec<Beside<'a>> {
    let others = views.iter().zip(outlines).enumerate().filter(|(j, _)| *j != view);
    let known = others.filter_map(|(_, (other, outline))| {
        let (outline, relative) = (outline.as_ref()?, other.pose.compose(&views[view].pose.inverse()));
        Some(Beside {
            outline,
            map: PixelMap::new(camera, &outline.camera, &relative),
            inverse_focal: 1.0 / outline.camera.focal().x as f32,
            eye: relative.centre().as_vec3(),
        })
    });
    known.collect()
}

/// A view's outline from another view's ray.
struct Beside<'a> {
    outline: &'a Outline,
    map: PixelMap,
    inverse_focal: f32,
    /// Its camera's centre, frame of the view.
    eye: Vec3,
}

impl HullField {
    /// Of all views whose pictures are halved so often first; none where masks do not show one.
    /// `ranges`: least and most depth of each view.
    pub(crate) fn of_all(
        views: &[PosedPhoto],
        ranges: &[Option<[f32; 2]>],
        level: u32,
        progress: &Progress,
    ) -> Result<Vec<Option<Self>>, Cancelled> {
        let outlines = views.par_iter().map(|v| Outline::of(&LevelImage::new(v, level)));
        let outlines: Vec<Option<Outline>> = outlines.collect();
        if outlines.iter().flatten().count() < LIMITS.least_views {
            return Ok(views.iter().map(|_| None).collect());
        }
        progress.begin("visual hull", views.len());
        let all = (0..views.len()).into_par_iter();
        all.map(|i| {
            progress.tick()?;
            let (Some(range), Some(_)) = (ranges[i], &outlines[i]) else { return Ok(None) };
            let image = LevelImage::new(&views[i], level + SHRUNK.ilog2());
            Ok(Some(Self::of(&image, &beside(views, i, &image.camera, &outlines), range)))
        })
        .collect()
    }

    fn of(image: &LevelImage, beside: &[Beside], range: [f32; 2]) -> Self {
        let lens = PinholeLens::of(&image.camera);
        let (focal, centre) = (image.camera.focal(), image.camera.principal_point());
        let (focal, centre) = (focal.as_vec2().to_array(), centre.as_vec2().to_array());
        let around = Around { beside, lens, focal, centre };
        let [left, top, right, bottom] = image.frame;
        let (width, n) = (right - left, (right - left) * (bottom - top));
        let (depth, slack_px, normal) = (vec![0.0; n], vec![f32::INFINITY; n], Vec::new());
        let mut field = Self { corner: [left, top], width, lens, depth, slack_px, normal };
        for i in 0..n {
            let [x, y] = field.place(i);
            let is_inside = image.inside[y * image.width + x];
            let Some(met) = is_inside.then(|| around.met(x, y, range)).flatten() else { continue };
            field.depth[i] = met.z;
            field.slack_px[i] = met.slack * focal[0] * SHRUNK as f32 / met.z;
        }
        field.normal = (0..n).map(|i| field.slope(i)).collect();
        field.slack_px = (0..n).map(|i| field.usual_slack(i)).collect();
        field
    }

    /// Column and row of the picture.
    fn place(&self, i: usize) -> [usize; 2] {
        [self.corner[0] + i % self.width, self.corner[1] + i / self.width]
    }

    /// The index of a place in the picture, where it is kept.
    fn index(&self, x: usize, y: usize) -> Option<usize> {
        let (column, row) = (x.checked_sub(self.corner[0])?, y.checked_sub(self.corner[1])?);
        let i = row * self.width + column;
        (column < self.width && i < self.depth.len()).then_some(i)
    }

    /// The median around a pixel: outlines of whole pixels make it uneven.
    fn usual_slack(&self, i: usize) -> f32 {
        let (x, y) = (i % self.width, i / self.width);
        let mut near = Vec::with_capacity(25);
        for v in y.saturating_sub(2)..=y + 2 {
            let row = v * self.width + x.saturating_sub(2)..v * self.width + (x + 3).min(self.width);
            near.extend(
                row.filter(|j| self.depth.get(*j).is_some_and(|z| *z > 0.0)).map(|j| self.slack_px[j]),
            );
        }
        near.sort_by(f32::total_cmp);
        near.get(near.len() / 2).copied().unwrap_or(f32::INFINITY)
    }

    /// The normal by the neighbours of a pixel; towards the camera at an edge.
    fn slope(&self, i: usize) -> Vec3 {
        let [x, y] = self.place(i);
        let towards = -self.lens.ray(x, y).normalize();
        let normal = self.tangents(x, y).and_then(|[along, across]| across.cross(along).try_normalize());
        normal.map(|n| n * n.dot(towards).signum()).unwrap_or(towards)
    }

    /// From one neighbour of a pixel to the opposite one, along the row and the column.
    fn tangents(&self, x: usize, y: usize) -> Option<[Vec3; 2]> {
        let along = self.point(x + 1, y)? - self.point(x.checked_sub(1)?, y)?;
        let across = self.point(x, y + 1)? - self.point(x, y.checked_sub(1)?)?;
        Some([along, across])
    }

    /// The point of the hull that a pixel sees, frame of the camera.
    fn point(&self, x: usize, y: usize) -> Option<Vec3> {
        let z = self.depth[self.index(x, y)?];
        (z > 0.0).then(|| self.lens.ray(x, y) * z)
    }

    /// The hull at a pixel of a picture that is `step` times smaller than the finest, where the
    /// surface is expected on it: its depth along the ray, and its normal.
    pub(crate) fn at(&self, [x, y]: [usize; 2], step: usize, ray: Vec3) -> Option<(f32, Vec3)> {
        let [u, v] = [x, y].map(|c| c * step / SHRUNK);
        let i = self.index(u, v)?;
        let z = Some(self.depth[i]).filter(|z| *z > 0.0 && self.slack_px[i] < LIMITS.slack_px)?;
        Some((carried(z, self.normal[i], self.lens.ray(u, v), ray), self.normal[i]))
    }
}

/// Where a ray meets the hull.
struct Met {
    /// Camera z.
    z: f32,
    /// How far behind the hull the surface may lie, scene units.
    slack: f32,
}

/// The outlines of all other views around one view.
struct Around<'a> {
    beside: &'a [Beside<'a>],
    lens: PinholeLens,
    focal: [f32; 2],
    centre: [f32; 2],
}

/// Distance from an outline, scene units and pixels, and whose it is.
#[derive(Clone, Copy)]
struct Away {
    distance: f32,
    px: f32,
    view: usize,
}

impl Around<'_> {
    /// The farthest outline from a place (frame of the view).
    fn farthest(&self, x: Vec3) -> Option<Away> {
        let pixel = self.pixel(x);
        let all = (0..self.beside.len()).filter_map(|view| self.beside[view].away(pixel, x.z, view));
        all.max_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    fn pixel(&self, x: Vec3) -> [f32; 2] {
        [x.x / x.z * self.focal[0] + self.centre[0], x.y / x.z * self.focal[1] + self.centre[1]]
    }

    /// Where the ray of a pixel meets the hull.
    fn met(&self, x: usize, y: usize, [near, far]: [f32; 2]) -> Option<Met> {
        let ray = self.lens.ray(x, y);
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let (mut z, mut last) = (near, 0);
        for _ in 0..LIMITS.steps {
            let alone = self.beside.get(last)?.away(pixel, z, last).filter(|a| a.px > LIMITS.far_px);
            let away = match alone {
                Some(away) => away,
                None => self.farthest(ray * z)?,
            };
            last = away.view;
            if away.px <= LIMITS.met_px {
                return Some(Met { z, slack: self.slack(ray * z, last) });
            }
            z += LIMITS.safe * away.distance / ray.length();
            if z > far {
                return None;
            }
        }
        None
    }

    /// How far behind the hull the surface may lie at a place that the outline of `view` bounds.
    /// The ray along that outline touches the surface somewhere between its ends on the hull: the
    /// farther these are apart, and the more the hull turns at both, the less is known.
    fn slack(&self, x: Vec3, view: usize) -> f32 {
        let bound = &self.beside[view];
        let along = (x - bound.eye).normalize();
        let pixel = bound.inverse_focal * (x - bound.eye).length();
        let Some(normal) = self.normal(x, view) else { return f32::INFINITY };
        let [a, b] = [1.0, -1.0].map(|sense| self.end(x, along * sense, pixel, normal));
        (a[0] + b[0]) * a[1].min(b[1])
    }

    /// How far the hull goes on along a direction, and the sine of the angle by which it turns
    /// there.
    fn end(&self, x: Vec3, along: Vec3, pixel: f32, normal: Vec3) -> [f32; 2] {
        let mut length = pixel;
        for _ in 0..LIMITS.widenings {
            let there = x + along * length;
            let Some(away) = self.farthest(there).filter(|_| there.z > 0.0) else { break };
            if away.px > LIMITS.ended_px {
                let sine = self.normal(there, away.view).map_or(1.0, |n| n.cross(normal).length());
                return [length, sine];
            }
            length *= LIMITS.growth;
        }
        [length, 1.0]
    }

    /// Normal of the cone of a view's outline near a place.
    fn normal(&self, x: Vec3, view: usize) -> Option<Vec3> {
        let b = &self.beside[view];
        let (there, _) = b.map.apply(self.pixel(x), x.z);
        let [gx, gy] = b.outline.outwards(there)?;
        let line = [gx, gy, -(gx * there[0] + gy * there[1])];
        // The plane of all that projects to the line: `Kᵀ Aᵀ l`.
        let a = &b.map.a;
        let l: [f32; 3] = std::array::from_fn(|c| (0..3).map(|r| a[3 * r + c] * line[r]).sum());
        let [cx, cy] = self.centre;
        Vec3::new(self.focal[0] * l[0], self.focal[1] * l[1], cx * l[0] + cy * l[1] + l[2]).try_normalize()
    }
}

impl Beside<'_> {
    /// How far what a pixel of the view sees at a depth lies from the outline.
    #[inline]
    fn away(&self, pixel: [f32; 2], z: f32, view: usize) -> Option<Away> {
        let (there, depth) = self.map.apply(pixel, z);
        let px = (depth > 0.0).then(|| self.outline.distance(there)).flatten()?;
        Some(Away { distance: px * depth * self.inverse_focal, px, view })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{StereoSettings, dense_depths};
    use glam::{DVec2, DVec3};
    use scene::{CameraModel, Pose};

    /// What a ray (from a place, in a direction) meets first, as a multiple of the direction.
    type Shape = fn(DVec3, DVec3) -> Option<f64>;

    /// A white shape before black, without any texture, from a ring around the z axis.
    struct Blank {
        unit: f64,
        shape: Shape,
        camera: Camera,
        poses: Vec<Pose>,
        rgb: Vec<u8>,
        masks: Vec<Vec<u8>>,
    }

    impl Blank {
        fn new(shape: Shape, unit: f64, elevation: f64, width: u32) -> Self {
            let camera = Camera::centred(1, CameraModel::Pinhole, width, width * 3 / 4, f64::from(width));
            let pose = |k: usize| {
                let (sin, cos) = (k as f64 / 60.0 * std::f64::consts::TAU).sin_cos();
                let (up, out) = elevation.sin_cos();
                Pose::look_at(DVec3::new(cos * out, sin * out, up) * 4.0 * unit, DVec3::ZERO, DVec3::Z)
            };
            let poses: Vec<Pose> = (0..60).map(pose).collect();
            let rgb = vec![200; (width * width * 3 / 4 * 3) as usize];
            let mut blank = Self { unit, shape, camera, poses, rgb, masks: Vec::new() };
            let mask = |pose: &Pose| {
                (0..blank.pixels()).map(|i| if blank.truth(pose, i).is_some() { 255 } else { 0 }).collect()
            };
            blank.masks = blank.poses.iter().map(mask).collect();
            blank
        }

        fn pixels(&self) -> usize {
            self.rgb.len() / 3
        }

        /// Depth of a pixel, scene units.
        fn truth(&self, pose: &Pose, i: usize) -> Option<f64> {
            let width = self.camera.width as usize;
            let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let ray = ((pixel - self.camera.principal_point()) / self.camera.focal()).extend(1.0);
            let direction = pose.rotation.inverse() * ray;
            (self.shape)(pose.centre() / self.unit, direction).map(|z| z * self.unit)
        }

        fn views(&self) -> Vec<PosedPhoto<'_>> {
            (0..self.poses.len())
                .map(|i| PosedPhoto {
                    camera: &self.camera,
                    pose: self.poses[i],
                    rgb: &self.rgb,
                    mask: Some(&self.masks[i]),
                })
                .collect()
        }

        /// Errors of the hull in the first view as a share of the depth, where the surface is
        /// expected on it; and of how many pixels.
        fn errors(&self) -> (Vec<f64>, usize) {
            let views = self.views();
            let ranges = vec![Some([2.0, 6.0].map(|z: f64| (z * self.unit) as f32)); views.len()];
            let hulls = HullField::of_all(&views, &ranges, 0, &Progress::silent()).unwrap();
            let hull = hulls[0].as_ref().expect("masks show a hull");
            let lens = PinholeLens::of(&self.camera);
            let seen = (0..self.pixels()).filter_map(|i| Some((i, self.truth(&self.poses[0], i)?)));
            let seen: Vec<(usize, f64)> = seen.collect();
            let off = seen.iter().filter_map(|(i, truth)| {
                let at = [i % self.camera.width as usize, i / self.camera.width as usize];
                let (z, _) = hull.at(at, 1, lens.ray(at[0], at[1]))?;
                Some((f64::from(z) / truth - 1.0).abs())
            });
            (off.collect(), seen.len())
        }
    }

    fn ball(from: DVec3, direction: DVec3) -> Option<f64> {
        let (a, b, c) = (direction.length_squared(), direction.dot(from), from.length_squared() - 0.64);
        let under = b * b - a * c;
        (under > 0.0).then(|| (-b - under.sqrt()) / a)
    }

    fn disc(from: DVec3, direction: DVec3) -> Option<f64> {
        let z = -from.z / direction.z;
        (z > 0.0 && (from + direction * z).length() < 1.0).then_some(z)
    }

    #[test]
    fn a_ball_is_its_hull_at_any_size() {
        for unit in [1.0, 1e-6, 1e6] {
            let (mut off, seen) = Blank::new(ball, unit, 0.0, 128).errors();
            off.sort_by(f64::total_cmp);
            assert!(off.len() * 10 > seen * 6, "unit {unit}: {} of {seen}", off.len());
            // A tenth of a pixel in the picture is 0.003 of the depth at 45°.
            assert!(off[off.len() / 2] < 0.004, "unit {unit}: {}", off[off.len() / 2]);
        }
    }

    #[test]
    fn a_plate_from_above_is_not_expected_to_be_the_roof_that_its_hull_has() {
        let (off, seen) = Blank::new(disc, 1.0, 0.3, 320).errors();
        assert!(off.len() * 10 < seen * 4, "{} of {seen}", off.len());
    }

    #[test]
    fn a_blank_ball_has_depths_where_its_outlines_tell_them() {
        let shot = Blank::new(ball, 1.0, 0.0, 64);
        let points = [-0.8, 0.8].map(|v| [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| axis * v)).concat();
        let share = |outlines| {
            let settings = StereoSettings { outlines, ..StereoSettings::default() };
            let found = dense_depths(&shot.views(), &points, &settings, &Progress::silent()).unwrap();
            let field = &found.fields[0];
            let right = (0..field.depth.len()).filter(|&i| {
                let (x, y) = field.place(i);
                let truth = shot.truth(&shot.poses[0], y * 64 + x);
                truth.is_some_and(|t| (f64::from(field.depth[i]) / t - 1.0).abs() < 0.01)
            });
            let white = shot.masks[0].iter().filter(|m| **m > 0).count();
            right.count() as f64 / white as f64
        };
        let (with, without) = (share(true), share(false));
        assert!(with > 0.6 && with > 2.0 * without, "{with} {without}");
    }

    #[test]
    fn few_views_and_masks_of_one_colour_show_no_hull() {
        let mut shot = Blank::new(ball, 1.0, 0.0, 64);
        shot.masks[9..].iter_mut().for_each(|m| m.fill(255));
        shot.masks[7..9].iter_mut().for_each(|m| m.fill(0));
        let views = shot.views();
        let hulls = HullField::of_all(&views, &[Some([2.0, 6.0]); 60], 0, &Progress::silent()).unwrap();
        assert!(hulls.iter().all(Option::is_none));
    }
}
