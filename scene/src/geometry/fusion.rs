//! Depth maps fused to a surface: a truncated signed distance in sparse blocks of voxels, and its
//! zero set as a mesh.
//!
//! Curless and Levoy, "A Volumetric Method for Building Complex Models from Range Images", SIGGRAPH
//! 1996; weights that fall off behind the surface: Bylow et al., "Real-Time Camera Tracking and 3D
//! Reconstruction Using Signed Distance Functions", RSS 2013. Blocks: Nießner et al., "Real-time 3D
//! Reconstruction at Scale using Voxel Hashing", 2013. Distances are to the plane of the surface
//! around a pixel: along the ray a plate that is seen aslant would be thicker than the truncation.

use super::Mesh;
use super::depth_map::DepthMap;
use super::extract::extract;
use super::facing::cosines;
use super::settle::settle;
use super::volume::{FusionBlock, FusionOptions, SIDE, VOXELS};
use crate::Progress;
use glam::{DVec2, DVec3, IVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// How much what a view says counts.
struct FusionWeights {
    /// Blocks reach this far around the surface, voxels. Source: chosen by hand, never measured.
    margin: f64,
    /// Behind the surface a view counts fully as far as this, then less and less, in truncation
    /// distances. Source: chosen by hand, never measured.
    full_behind: f32,
    /// Weight of a ray that probably meets nothing. A rod one pixel wide is missed by every third
    /// ray that should meet it: with full weight these would erase it. Share of 1. Source:
    /// docs/decisions/16.
    probably_nothing: f32,
    /// Before a surface, as far as this from the truncation on, a ray is less surely empty: the
    /// errors of depths on blank faces reach beyond the truncation, and what lies too far off would
    /// carve the surface while what lies too near says nothing of it. Truncation distances. Source:
    /// docs/decisions/16.
    less_sure: f64,
    /// Weight of a ray there, share of 1. Source: docs/decisions/16.
    less_surely_nothing: f32,
    /// Colours come from views that put the surface no farther off, in truncation distances.
    /// Source: chosen by hand, never measured.
    colour_band: f32,
}

/// The values in force.
const WEIGHTS: FusionWeights = FusionWeights {
    margin: 2.0,
    full_behind: 0.25,
    probably_nothing: 0.1,
    less_sure: 3.0,
    less_surely_nothing: 0.5,
    colour_band: 0.5,
};

/// Why there is no mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FusionError {
    /// The volume would be too large.
    #[error(
        "the surface needs {needed_mib} MiB of voxels and at most {most_mib} MiB are used; ask for a lower resolution"
    )]
    TooLarge {
        /// What it needs.
        needed_mib: usize,
        /// What is allowed.
        most_mib: usize,
    },
    /// The user asked to stop.
    #[error(transparent)]
    Cancelled(#[from] crate::Cancelled),
}

/// The surface that the depth maps agree on, with colours at its vertices; no triangles where
/// there is none. The same for any number of threads.
pub fn fuse(
    maps: &[DepthMap<'_>],
    options: &FusionOptions,
    progress: &Progress,
) -> Result<Mesh, FusionError> {
    let (mut places, mut aslant) = (BTreeSet::new(), Vec::with_capacity(maps.len()));
    progress.begin("find the surface", maps.len());
    for map in maps {
        places.extend(touched(map, options));
        aslant.push((map, cosines(map)));
        // Of a voxel: distance, weight, views, three colours and their weight.
        let needed = places.len().saturating_mul(VOXELS * 25);
        if needed > options.most_bytes {
            return Err(FusionError::TooLarge {
                needed_mib: needed >> 20,
                most_mib: options.most_bytes >> 20,
            });
        }
        progress.tick()?;
    }
    let places: Vec<[i32; 3]> = places.into_iter().collect();
    progress.begin("fuse depths", places.len().div_ceil(256));
    let mut blocks = Vec::with_capacity(places.len());
    for some in places.chunks(256) {
        blocks.par_extend(some.par_iter().map(|at| FusionBlock::fused(*at, &aslant, options)));
        progress.tick()?;
    }
    let mut mesh = extract(&blocks, options);
    if options.thicken > 0.0 {
        settle(&mut mesh, maps, options.thicken * options.voxel, options.voxel);
    }
    Ok(mesh)
}

/// The first and the last block within `margin` of a place, in units of blocks.
fn blocks_around(p: DVec3, margin: f64) -> Option<(IVec3, IVec3)> {
    let (low, high) = ((p - margin).floor(), (p + margin).floor());
    // Beyond 32 bits there is no surface, only an error of the renderer.
    let most = f64::from(i32::MAX / (2 * SIDE));
    (low.min_element() > -most && high.max_element() < most).then(|| (low.as_ivec3(), high.as_ivec3()))
}

/// The blocks around what a map measured.
fn touched(map: &DepthMap<'_>, options: &FusionOptions) -> BTreeSet<[i32; 3]> {
    let world_from_cam = map.pose.inverse();
    let block = options.voxel * f64::from(SIDE);
    let margin = (WEIGHTS.margin + options.thicken) / f64::from(SIDE);
    let rows = map.depth.len().div_ceil(4096);
    let sets = (0..rows).into_par_iter().map(|row| {
        let mut set = BTreeSet::new();
        let mut last = None;
        for i in row * 4096..((row + 1) * 4096).min(map.depth.len()) {
            let found = map.point(i, &world_from_cam).and_then(|p| blocks_around(p / block, margin));
            let Some((low, high)) = found.filter(|_| found != last) else { continue };
            last = found;
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    set.extend((low.z..=high.z).map(|z| [x, y, z]));
                }
            }
        }
        set
    });
    sets.reduce(BTreeSet::new, |mut a, b| {
        a.extend(b);
        a
    })
}

impl FusionBlock {
    fn fused(at: [i32; 3], maps: &[(&DepthMap<'_>, Vec<u8>)], options: &FusionOptions) -> Self {
        let (views, colour) = (vec![0; VOXELS], vec![[0.0; 4]; VOXELS]);
        let mut block = Self { at, distance: vec![0.0; VOXELS], weight: vec![0.0; VOXELS], views, colour };
        maps.iter().for_each(|(map, cosines)| block.add(map, cosines, options));
        block
    }

    /// The running mean with what one view says of every voxel; `cosines` are the map's.
    fn add(&mut self, map: &DepthMap<'_>, cosines: &[u8], options: &FusionOptions) {
        let side = f64::from(SIDE);
        let voxel = options.voxel;
        let centre = DVec3::from(self.at.map(|v| (f64::from(v) + 0.5) * side - 0.5)) * voxel;
        let (focal, middle) = (map.camera.focal(), map.camera.principal_point());
        let (w, h) = (f64::from(map.camera.width), f64::from(map.camera.height));
        // The sphere around the block against the pyramid of the view.
        let (x, radius) = (map.pose.transform(centre), 0.87 * side * voxel);
        let reach = DVec2::new(w, h) / 2.0 + (middle - DVec2::new(w, h) / 2.0).abs();
        let slope = reach / focal;
        let beside = (x.truncate().abs() - slope * x.z) / (1.0 + slope * slope).map(f64::sqrt);
        if !(x.z > -radius && beside.max_element() < radius) {
            return;
        }
        let rotation = map.pose.matrix();
        let step = [rotation.x_axis * voxel, rotation.y_axis * voxel, rotation.z_axis * voxel];
        let first = x - (step[0] + step[1] + step[2]) * ((side - 1.0) / 2.0);
        let truncation = options.truncation * voxel;
        let nearer = options.thicken / options.truncation;
        for i in 0..VOXELS {
            let [a, b, c] = [i % 8, i / 8 % 8, i / 64].map(|v| v as f64);
            let p = first + step[0] * a + step[1] * b + step[2] * c;
            let pixel = focal * p.truncate() / p.z + middle;
            if !(p.z > 0.0 && pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < w && pixel.y < h) {
                continue;
            }
            let pixel = pixel.y as usize * map.camera.width as usize + pixel.x as usize;
            let (depth, share) = match f64::from(map.depth[pixel]) {
                f64::NEG_INFINITY => (f64::INFINITY, WEIGHTS.probably_nothing),
                depth if depth > 0.0 => (depth, 1.0),
                _ => continue,
            };
            // Along the ray, not along z, and from there to the plane of the surface.
            let cosine = f64::from(cosines[pixel]) / f64::from(u8::MAX);
            let across = (depth - p.z) / p.z * p.length() * cosine / truncation - nearer;
            let share =
                if (1.0..WEIGHTS.less_sure).contains(&across) { WEIGHTS.less_surely_nothing } else { share };
            let (distance, share) = match map.outline.get(pixel) {
                // At the depth of a thin part, or beside it: how far to the side it ends.
                Some(&s) if s.is_finite() && (across < 1.0 || depth.is_infinite()) && across > -1.0 => {
                    ((f64::from(s) * p.z / focal.x / truncation).clamp(-1.0, 1.0), 1.0)
                }
                _ => (across.min(1.0), share),
            };
            let distance = distance as f32;
            if distance > -1.0 {
                self.count(i, distance, share);
                if distance.abs() < WEIGHTS.colour_band {
                    let rgb = &map.rgb[pixel * 3..pixel * 3 + 3];
                    self.colour(i, rgb, share * (cosine * cosine) as f32);
                }
            }
        }
    }

    fn count(&mut self, i: usize, distance: f32, share: f32) {
        let weight = share * ((1.0 + distance) / (1.0 - WEIGHTS.full_behind)).min(1.0);
        let sum = self.weight[i] + weight;
        self.distance[i] += (distance - self.distance[i]) * weight / sum;
        self.weight[i] = sum;
        self.views[i] = self.views[i].saturating_add(1);
    }

    /// What is seen aslant is blurred along the surface and weighs little.
    fn colour(&mut self, i: usize, rgb: &[u8], weight: f32) {
        let colour = &mut self.colour[i];
        (0..3).for_each(|c| colour[c] += weight * f32::from(rgb[c]));
        colour[3] += weight;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, CameraModel, Pose};
    use std::collections::BTreeMap;

    /// The unit sphere (times `scale`) at `centre`, red where x > 0 and green elsewhere, seen from
    /// this direction.
    fn sphere(from: DVec3, scale: f64, centre: DVec3) -> DepthMap<'static> {
        let camera = Camera::centred(1, CameraModel::Pinhole, 200, 160, 220.0);
        let pose = Pose::look_at(centre + from.normalize() * 4.0 * scale, centre, DVec3::new(0.1, 0.2, 1.0));
        let world_from_cam = pose.inverse();
        let (mut depth, mut rgb) = (Vec::new(), Vec::new());
        for i in 0..200 * 160 {
            let pixel = DVec2::new(f64::from(i % 200) + 0.5, f64::from(i / 200) + 0.5);
            let ray = ((pixel - camera.principal_point()) / camera.focal()).extend(1.0);
            // |t ray - m| = scale
            let m = pose.transform(centre);
            let (a, b, c) = (ray.dot(ray), ray.dot(m), m.dot(m) - scale * scale);
            let under = b * b - a * c;
            let t = (b - under.max(0.0).sqrt()) / a;
            depth.push(if under > 0.0 { t as f32 } else { f32::INFINITY });
            let x = world_from_cam.transform(ray * t).x - centre.x;
            rgb.extend(if x > 0.0 { [200, 0, 0] } else { [0, 100, 0] });
        }
        DepthMap { camera, pose, depth, outline: Vec::new(), rgb: rgb.into() }
    }

    fn around(scale: f64, centre: DVec3) -> Vec<DepthMap<'static>> {
        let corners =
            (0..8).map(|c| DVec3::from([0, 1, 2].map(|k| if c >> k & 1 == 1 { 1.0 } else { -1.0 })));
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|a| [a, -a]);
        corners.chain(axes).map(|from| sphere(from, scale, centre)).collect()
    }

    fn options(scale: f64) -> FusionOptions {
        FusionOptions {
            voxel: 0.04 * scale,
            truncation: 4.0,
            thicken: 0.0,
            least_views: 2,
            most_bytes: 1 << 28,
        }
    }

    fn fused(maps: &[DepthMap<'_>], scale: f64) -> Mesh {
        fuse(maps, &options(scale), &Progress::silent()).unwrap()
    }

    #[test]
    fn a_sphere_comes_back_closed_round_coloured_and_outside_out_at_any_size() {
        for (scale, centre) in
            [(1.0, DVec3::ZERO), (1e-6, DVec3::splat(3e-6)), (1e6, DVec3::new(-2e7, 0.0, 1e6))]
        {
            let mesh = fused(&around(scale, centre), scale);
            mesh.validate().unwrap();
            let mut sides: BTreeMap<(u32, u32), u32> = BTreeMap::new();
            for t in &mesh.triangles {
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    *sides.entry((a, b)).or_default() += 1;
                }
            }
            assert!(
                sides.iter().all(|(&(a, b), &n)| n == 1 && sides.contains_key(&(b, a))),
                "{scale}: not closed"
            );
            let errors: Vec<f64> =
                mesh.vertices.iter().map(|v| (v.distance(centre) / scale - 1.0).abs()).collect();
            let worst = errors.iter().copied().fold(0.0, f64::max);
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!(worst < 0.04 && mean < 0.008, "{scale}: {worst} {mean}"); // a voxel, a fifth of one
            let area = mesh.area() / (scale * scale) / (4.0 * std::f64::consts::PI);
            assert!((area - 1.0).abs() < 0.03, "{scale}: {area}");
            for ((v, n), rgb) in mesh.vertices.iter().zip(mesh.normals()).zip(&mesh.colors) {
                let out = (*v - centre) / scale;
                assert!(n.dot(out) > 0.8, "{scale}: {n} at {out}");
                let expected = if out.x > 0.0 { [200, 0, 0] } else { [0, 100, 0] };
                let same = rgb.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 8);
                assert!(out.x.abs() < 0.1 || same, "{scale}: {rgb:?} at {out}");
            }
        }
    }

    /// A plate of side 2 in the plane z = 0, seen from here; depths are `error` too large.
    fn plate(from: DVec3, error: f64) -> DepthMap<'static> {
        let mut map = sphere(from, 1.0, DVec3::ZERO);
        let world_from_cam = map.pose.inverse();
        for (i, depth) in map.depth.iter_mut().enumerate() {
            let pixel = DVec2::new((i % 200) as f64 + 0.5, (i / 200) as f64 + 0.5);
            let ray = ((pixel - map.camera.principal_point()) / map.camera.focal()).extend(1.0);
            let (origin, tip) = (world_from_cam.translation, world_from_cam.transform(ray));
            let z = origin.z / (origin.z - tip.z);
            let at = origin + (tip - origin) * z;
            let hit = z > 0.0 && at.truncate().abs().max_element() < 1.0;
            *depth = if hit { (z + error) as f32 } else { f32::INFINITY };
        }
        map
    }

    #[test]
    fn a_sheet_whose_sides_are_measured_behind_each_other_keeps_both() {
        // Each side is measured half a voxel too far off, behind the other.
        let error = 0.02;
        let maps: Vec<DepthMap> = [1.0, -1.0]
            .iter()
            .flat_map(|z| {
                [[0.5, 0.0], [-0.3, 0.5], [-0.2, -0.5], [0.1, 0.1]].map(|[x, y]| DVec3::new(x, y, *z))
            })
            .map(|from| plate(from, error))
            .collect();
        let of = |thicken: f64| {
            let options = FusionOptions { thicken, ..options(1.0) };
            fuse(&maps, &options, &Progress::silent()).unwrap()
        };
        assert!(of(0.0).area() < 2.0, "{}", of(0.0).area());
        let mesh = of(1.5);
        assert!((mesh.area() / 8.0 - 1.0).abs() < 0.1, "two sides of 4, not {}", mesh.area());
        let off: f64 = mesh.vertices.iter().map(|v| v.z.abs()).sum::<f64>() / mesh.vertices.len() as f64;
        assert!(off < 1.5 * error, "{off}");
    }

    #[test]
    fn a_plate_seen_aslant_from_above_alone_has_no_holes() {
        // Wrong by five voxels or half as much along the ray, a voxel or half of one across.
        let maps: Vec<DepthMap> = (0..12)
            .map(|i| (f64::from(i) * std::f64::consts::TAU / 12.0, if i % 3 == 0 { 0.2 } else { -0.1 }))
            .map(|(a, error)| plate(DVec3::new(a.cos(), a.sin(), 0.2), error))
            .collect();
        let mesh = fuse(&maps, &FusionOptions { thicken: 1.5, ..options(1.0) }, &Progress::silent()).unwrap();
        let above: Vec<DVec3> = mesh.sample(20_000, 0).into_iter().filter(|p| p.z.abs() < 0.02).collect();
        let cells = above.iter().map(|p| (p.truncate() * 10.0).floor().to_array().map(|v| v as i32));
        let covered: BTreeSet<[i32; 2]> = cells.collect();
        let inside = covered.iter().filter(|c| c.iter().all(|v| (-10..10).contains(v))).count();
        assert_eq!(inside, 400, "of 400 cells");
    }

    #[test]
    fn depths_too_far_by_more_than_the_truncation_carve_little() {
        // Every third view is too far by one and a half truncations.
        let maps: Vec<DepthMap> = (0..30)
            .map(|i| (f64::from(i) * 2.4, if i % 3 == 0 { 0.24 } else { 0.0 }))
            .map(|(a, error)| plate(DVec3::new(0.3 * a.cos(), 0.3 * a.sin(), 1.0), error))
            .collect();
        let mesh = fused(&maps, 1.0);
        let middle = mesh.vertices.iter().filter(|v| v.truncate().length() < 0.5);
        let depth = middle.map(|v| -v.z).fold(f64::INFINITY, f64::min);
        // With their full weight nothing would be left before them.
        assert!((0.0..0.06).contains(&depth), "{depth}");
    }

    #[test]
    fn what_one_view_claims_in_the_emptiness_of_others_is_not_there() {
        let mut maps = around(1.0, DVec3::ZERO);
        let (w, centre) = (200, 80 * 200 + 20);
        for row in 0..12 {
            maps[3].depth[centre + row * w..centre + row * w + 12].fill(3.0);
        }
        let mesh = fused(&maps, 1.0);
        let farthest = mesh.vertices.iter().map(|v| v.length()).fold(0.0, f64::max);
        assert!(farthest < 1.05, "{farthest}");
    }

    #[test]
    fn one_view_gives_the_side_that_it_sees() {
        let mut options = options(1.0);
        options.least_views = 1;
        let mesh = fuse(&[sphere(DVec3::X, 1.0, DVec3::ZERO)], &options, &Progress::silent()).unwrap();
        let area = mesh.area() / std::f64::consts::PI;
        // Of the sphere's 4 it sees 1.5; what is seen aslant goes on a little beyond the rim.
        assert!((0.95..2.1).contains(&area), "{area}");
        let off = mesh.sample(10_000, 0).iter().map(|p| (p.length() - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 0.06, "{off}");
        assert!(mesh.vertices.iter().all(|v| v.x > -0.1));
    }

    #[test]
    fn where_nothing_was_measured_there_is_no_mesh() {
        assert_eq!(fused(&[], 1.0), Mesh::default());
        for nothing in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -1.0, f32::MAX] {
            let mut map = sphere(DVec3::X, 1.0, DVec3::ZERO);
            map.depth.fill(nothing);
            assert!(fused(&[map], 1.0).triangles.is_empty(), "{nothing}");
        }
    }

    #[test]
    fn a_volume_that_is_too_large_is_refused() {
        let options = FusionOptions { voxel: 1e-3, most_bytes: 1 << 20, ..options(1.0) };
        let error = fuse(&around(1.0, DVec3::ZERO), &options, &Progress::silent()).unwrap_err();
        assert!(error.to_string().contains("lower resolution"), "{error}");
    }
}
