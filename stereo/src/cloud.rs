//! Depths that agree, joined to one oriented point each.

use crate::agree::{Meeting, meeting};
use crate::depths::DenseDepths;
use crate::field::PlaneField;
use crate::pair::Pair;
use glam::{DVec2, DVec3, Vec3};
use scene::PosedPhoto;

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoPoint {
    /// World frame, scene units: the mean of the views that see it.
    pub position: DVec3,
    /// Unit, outwards.
    pub normal: Vec3,
    /// sRGB, mean of the views.
    pub rgb: [u8; 3],
    /// Views that agree on it.
    pub views: u8,
}

/// Sums of what the views say.
#[derive(Default)]
struct Mean {
    position: DVec3,
    normal: DVec3,
    rgb: [u32; 3],
    views: u32,
}

impl DenseDepths {
    /// The points of the surface: each depth with those of other views that agree, once. `views`:
    /// those of the depths.
    pub fn cloud(&self, views: &[PosedPhoto]) -> Vec<StereoPoint> {
        let mut used: Vec<Vec<bool>> = self.fields.iter().map(|f| vec![false; f.depth.len()]).collect();
        let mut points = Vec::new();
        for (at, field) in self.fields.iter().enumerate() {
            for i in 0..field.depth.len() {
                if field.depth[i] > 0.0 && !used[at][i] {
                    let members = self.members(field, &self.pairs[at], i);
                    let mut mean = Mean::default();
                    mean.add(field, &views[at], i);
                    for (view, j) in members {
                        if !used[view][j] {
                            used[view][j] = true;
                            mean.add(&self.fields[view], &views[view], j);
                        }
                    }
                    points.extend(mean.point(u32::from(self.settings.agreeing) + 1));
                }
            }
        }
        points
    }

    /// Pixels of other views that agree with one.
    fn members(&self, field: &PlaneField, pairs: &[Pair], i: usize) -> Vec<(usize, usize)> {
        let (x, y) = field.place(i);
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let met = pairs.iter().filter_map(|pair| {
            let found: Meeting = meeting(pixel, field.depth[i], pair, &self.fields[pair.view])?;
            found.is_near(&self.settings.tolerance).then_some((pair.view, found.index))
        });
        met.collect()
    }
}

impl Mean {
    fn add(&mut self, field: &PlaneField, view: &PosedPhoto, i: usize) {
        let (x, y) = field.place(i);
        let world_from_cam = view.pose.inverse();
        self.position += world_from_cam.transform(field.point(i));
        self.normal += world_from_cam.rotation * field.normal[i].as_dvec3();
        let full = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
        let here = DVec2::new(f64::from(field.camera.width), f64::from(field.camera.height));
        let pixel = (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * full / here).as_uvec2();
        let k = 3 * (pixel.y * view.camera.width + pixel.x) as usize;
        (0..3).for_each(|c| self.rgb[c] += u32::from(view.rgb[k + c]));
        self.views += 1;
    }

    fn point(&self, least_views: u32) -> Option<StereoPoint> {
        let n = self.views;
        let normal = self.normal.try_normalize()?.as_vec3();
        (n >= least_views).then(|| StereoPoint {
            position: self.position / f64::from(n),
            normal,
            rgb: self.rgb.map(|v| ((v + n / 2) / n) as u8),
            views: n.min(255) as u8,
        })
    }
}
