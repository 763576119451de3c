//! One round over the pixels of a view: planes of neighbours and random ones are tried.
//!
//! Red and black pixels in turn, as on a chessboard; of each of eight regions around a pixel (four
//! beside it, four farther off) the plane of least cost is tried (Xu and Tao, CVPR 2019, section
//! 3.1).

use crate::agree::meeting;
use crate::correlation::{Patch, PlaneAt, Sight, WORST, costs};
use crate::field::{PinholeLens, PlaneField, carried};
use crate::hull::HullField;
use crate::level::LevelImage;
use crate::neighbours::Layout;
use crate::pair::Pair;
use crate::settings::StereoSettings;
use glam::Vec3;
use rand::Rng as _;
use scene::rng::{Rng, rng};

/// What is the same for all views.
pub(crate) struct Job<'a> {
    pub(crate) level: u32,
    pub(crate) round: u32,
    pub(crate) layout: &'a Layout,
    pub(crate) settings: &'a StereoSettings,
}

/// A view, the pictures of all and what was found so far.
pub(crate) struct ViewJob<'a> {
    pub(crate) view: usize,
    pub(crate) images: &'a [LevelImage],
    pub(crate) pairs: &'a [Pair],
    pub(crate) fields: &'a [PlaneField],
    pub(crate) hull: Option<&'a HullField>,
}

/// Views that count at most. Source: the length of an array.
const MOST_VIEWS: usize = 16;
/// A plane is seen under less than this by its pixel, cosine. Source: 84°, where a patch is ten
/// times shorter.
const LEAST_COSINE: f32 = 0.1;
/// Pixels of difference that count at most. Source: Xu and Tao, section 3.3.
const MOST_OFF_PX: f32 = 3.0;

#[derive(Clone, Copy)]
struct Plane {
    depth: f32,
    normal: Vec3,
}

/// What a pixel holds while others are tried.
struct HeldPlane {
    plane: Plane,
    /// With the roughness.
    cost: f32,
}

/// What is expected of a pixel whose picture says nothing.
struct Expected {
    /// Planes of the regions around it.
    around: [Option<Plane>; 8],
    /// The visual hull.
    hull: Option<Plane>,
}

struct SweepPass<'a> {
    settings: &'a StereoSettings,
    image: &'a LevelImage,
    pairs: &'a [Pair],
    fields: &'a [PlaneField],
    hull: Option<&'a HullField>,
    /// How many times smaller the picture is than the finest.
    shrunk: usize,
    sights: Vec<Sight<'a>>,
    lens: PinholeLens,
    range: [f32; 2],
    /// Relative change of the depth that moves a patch by a pixel in a neighbour.
    step: f32,
    geometric: bool,
    noise: f32,
}

/// The field of a view after one round.
pub(crate) fn swept(job: &Job, view: &ViewJob) -> PlaneField {
    let mut field = view.fields[view.view].clone();
    let (Some(range), false) = (job.layout.depths[view.view], view.pairs.is_empty()) else { return field };
    let image = &view.images[view.view];
    let pairs = &view.pairs[..view.pairs.len().min(MOST_VIEWS)];
    let pass = SweepPass {
        settings: job.settings,
        image,
        pairs,
        fields: view.fields,
        hull: view.hull,
        shrunk: 1 << job.level,
        sights: pairs.iter().map(|p| Sight { image: &view.images[p.view], map: p.there }).collect(),
        lens: PinholeLens::of(&image.camera),
        range,
        step: pixel_step(image, pairs, range),
        geometric: job.settings.is_geometric(job.level, job.round),
        noise: job.settings.noise_at(job.level),
    };
    let stream = u64::from(job.level) << 40 | u64::from(job.round) << 32 | view.view as u64;
    let mut random = rng(job.settings.seed, "stereo", stream);
    pass.refresh(&mut field, &mut random);
    for colour in 0..2 {
        pass.half(&mut field, colour, &mut random);
    }
    field
}

/// Relative change of the depth that moves the middle of the picture by a pixel, median neighbour.
fn pixel_step(image: &LevelImage, pairs: &[Pair], [near, far]: [f32; 2]) -> f32 {
    let middle = [image.width as f32 / 2.0, image.height as f32 / 2.0];
    let depth = 0.5 * (near + far);
    let mut moves: Vec<f32> = pairs
        .iter()
        .map(|p| {
            let (a, b) = (p.there.apply(middle, depth).0, p.there.apply(middle, depth * 1.001).0);
            ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt() / 0.001
        })
        .filter(|m| m.is_finite() && *m > 0.0)
        .collect();
    moves.sort_by(f32::total_cmp);
    moves.get(moves.len() / 2).map_or(0.01, |m| (1.0 / m).min(0.1))
}

impl SweepPass<'_> {
    /// The costs of what the pixels hold, a random plane where they hold nothing.
    fn refresh(&self, field: &mut PlaneField, random: &mut Rng) {
        for i in 0..field.depth.len() {
            if !field.inside[i] {
                continue;
            }
            let (x, y) = field.place(i);
            if !(field.depth[i] > 0.0) {
                field.depth[i] = self.random_depth(random);
                field.normal[i] = self.random_normal(x, y, random);
            }
            let plane = Plane { depth: field.depth[i], normal: field.normal[i] };
            let patch = Patch::new(self.image, x, y, self.settings.sigma_grey, self.noise);
            field.cost[i] = patch.map_or(WORST, |patch| self.cost(&patch, x, y, plane));
        }
    }

    fn half(&self, field: &mut PlaneField, colour: usize, random: &mut Rng) {
        for i in 0..field.depth.len() {
            let (x, y) = field.place(i);
            if (x + y) % 2 != colour || !field.inside[i] {
                continue;
            }
            let patch = Patch::new(self.image, x, y, self.settings.sigma_grey, self.noise);
            let Some(patch) = patch else { continue };
            let own = Plane { depth: field.depth[i], normal: field.normal[i] };
            let expected = Expected { around: self.around(field, x, y), hull: self.hull(x, y) };
            // Neighbours may have changed since.
            let cost = field.cost[i] + self.roughness(&patch, own.depth, &expected);
            let mut choice = HeldPlane { plane: own, cost };
            for plane in expected.around.iter().chain([&expected.hull]).flatten() {
                self.attempt(&patch, x, y, *plane, &expected, &mut choice);
            }
            for kind in 0..4 {
                let plane = self.perturbed(choice.plane, kind, x, y, random);
                self.attempt(&patch, x, y, plane, &expected, &mut choice);
            }
            let Plane { depth, normal } = choice.plane;
            let cost = choice.cost - self.roughness(&patch, depth, &expected);
            (field.depth[i], field.normal[i], field.cost[i]) = (depth, normal, cost);
        }
    }

    /// Takes the plane if it costs less.
    #[inline]
    fn attempt(
        &self,
        patch: &Patch,
        x: usize,
        y: usize,
        plane: Plane,
        expected: &Expected,
        choice: &mut HeldPlane,
    ) {
        let own = choice.plane;
        let [same_px, same_normal] = self.settings.same;
        let same = (plane.depth - own.depth).abs() < same_px * self.step * own.depth
            && (plane.normal - own.normal).length_squared() < same_normal * same_normal;
        let [near, far] = self.range;
        if same || !(plane.depth >= near && plane.depth <= far) {
            return;
        }
        let rough = self.roughness(patch, plane.depth, expected);
        if rough >= choice.cost {
            return;
        }
        let cost = self.cost(patch, x, y, plane) + rough;
        if cost < choice.cost {
            *choice = HeldPlane { plane, cost };
        }
    }

    /// The planes around a pixel, as they are at it: the cheapest of each region.
    #[inline]
    fn around(&self, field: &PlaneField, x: usize, y: usize) -> [Option<Plane>; 8] {
        let here = self.lens.ray(x, y);
        self.sources(field, x as i64, y as i64).map(|source| {
            let (i, normal) = (source?, field.normal[source?]);
            let (u, v) = field.place(i);
            Some(Plane { depth: carried(field.depth[i], normal, self.lens.ray(u, v), here), normal })
        })
    }

    /// How far a depth lies from the planes around it and from the hull, where the picture says
    /// nothing: there the planes of what has texture go on, or the surface is that of the hull.
    #[inline]
    fn roughness(&self, patch: &Patch, depth: f32, expected: &Expected) -> f32 {
        let blankness = patch.blankness();
        let off_px = |plane: &Plane| ((plane.depth - depth).abs() / (self.step * depth)).min(MOST_OFF_PX);
        let (mut sum, mut count) = (0.0, 0.0);
        for plane in expected.around.iter().flatten() {
            sum += off_px(plane);
            count += 1.0;
        }
        let rough = if count > 0.0 { self.settings.smooth * sum / count } else { 0.0 };
        let off_hull = expected.hull.as_ref().map_or(0.0, |hull| self.settings.hull * off_px(hull));
        blankness * (rough + off_hull)
    }

    /// The hull at a pixel, where the surface is expected on it.
    #[inline]
    fn hull(&self, x: usize, y: usize) -> Option<Plane> {
        let (depth, normal) = self.hull?.at([x, y], self.shrunk, self.lens.ray(x, y))?;
        Some(Plane { depth, normal })
    }

    /// The mean of the least costs of the views.
    fn cost(&self, patch: &Patch, x: usize, y: usize, plane: Plane) -> f32 {
        let row = self.lens.row(plane.normal);
        let pixel = [x as f32 + 0.5, y as f32 + 0.5];
        let d = plane.depth * (row[0] * pixel[0] + row[1] * pixel[1] + row[2]);
        let at = PlaneAt { pixel, depth: plane.depth, row: row.map(|v| v / d) };
        let mut all = [WORST; MOST_VIEWS];
        let n = self.sights.len();
        costs(patch, &at, &self.sights, &mut all[..n]);
        if self.geometric {
            for (cost, pair) in all.iter_mut().zip(self.pairs) {
                *cost += self.settings.geometric * self.off_px(pixel, plane.depth, pair);
            }
        }
        let best = self.settings.best.clamp(1, n);
        let all = &mut all[..n];
        if best < n {
            all.select_nth_unstable_by(best - 1, f32::total_cmp);
        }
        all[..best].iter().sum::<f32>() / best as f32
    }

    /// Pixels between where a point is and where it comes back to through the depth of a neighbour.
    #[inline]
    fn off_px(&self, pixel: [f32; 2], depth: f32, pair: &Pair) -> f32 {
        let met = meeting(pixel, depth, pair, &self.fields[pair.view]);
        met.map_or(MOST_OFF_PX, |m| m.off_px.min(MOST_OFF_PX))
    }

    /// The pixel of least cost in each of the regions.
    #[inline]
    fn sources(&self, field: &PlaneField, x: i64, y: i64) -> [Option<usize>; 8] {
        std::array::from_fn(|region| {
            let mut found: Option<usize> = None;
            for &[along, across] in if region < 4 { &BESIDE[..] } else { &FARTHER[..] } {
                let (dx, dy) = match region % 4 {
                    0 => (along, across),
                    1 => (-along, across),
                    2 => (across, along),
                    _ => (across, -along),
                };
                let Some(j) = field.index(x + dx, y + dy) else { continue };
                if field.inside[j] && found.is_none_or(|k| field.cost[j] < field.cost[k]) {
                    found = Some(j);
                }
            }
            found
        })
    }

    /// From the largest change to the least, each size as often: a share of 1.
    fn size(&self, random: &mut Rng) -> f32 {
        self.settings.least_change.powf(random.random::<f32>())
    }

    fn random_depth(&self, random: &mut Rng) -> f32 {
        // Even in one over the depth, as pixels are.
        let [near, far] = self.range;
        let t: f32 = random.random();
        1.0 / (1.0 / far + t * (1.0 / near - 1.0 / far))
    }

    fn random_normal(&self, x: usize, y: usize, random: &mut Rng) -> Vec3 {
        let towards = -self.lens.ray(x, y).normalize();
        let normal = (towards + signed_vector(random)).try_normalize();
        normal.filter(|n| n.dot(towards) > LEAST_COSINE).unwrap_or(towards)
    }

    /// The plane with its depth, its normal or both changed a little, or another at random.
    fn perturbed(&self, plane: Plane, kind: u32, x: usize, y: usize, random: &mut Rng) -> Plane {
        let [most_px, most_tilt] = self.settings.changes;
        let change = most_px * self.size(random) * signed(random);
        let depth = plane.depth * (1.0 + self.step * change);
        let normal = plane.normal + most_tilt * self.size(random) * signed_vector(random);
        let facing = -self.lens.ray(x, y).normalize();
        let normal = normal.try_normalize().filter(|n| n.dot(facing) > LEAST_COSINE).unwrap_or(plane.normal);
        match kind {
            0 => Plane { depth, ..plane },
            1 => Plane { normal, ..plane },
            2 => Plane { depth, normal },
            _ => Plane { depth: self.random_depth(random), normal: self.random_normal(x, y, random) },
        }
    }
}

/// Between −1 and 1.
fn signed(random: &mut Rng) -> f32 {
    random.random_range(-1.0..1.0)
}

fn signed_vector(random: &mut Rng) -> Vec3 {
    Vec3::new(signed(random), signed(random), signed(random))
}

/// Of the other colour: pixels beside a pixel, by how far along an axis and across it. Source: Xu
/// and Tao, CVPR 2019, figure 2.
const BESIDE: [[i64; 2]; 7] = [[1, 0], [2, -1], [2, 1], [3, -2], [3, 2], [4, -3], [4, 3]];
/// Of the other colour: pixels farther off along an axis. Source: as [`BESIDE`].
const FARTHER: [[i64; 2]; 9] = [[3, 0], [5, 0], [7, 0], [9, 0], [11, 0], [13, 0], [15, 0], [17, 0], [19, 0]];
