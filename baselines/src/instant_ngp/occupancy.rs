//! Which cells of space hold something: a grid of bits by cascade, and the march of rays through
//! it (Müller et al. 2022, appendix E).

use super::settings::OccupancySettings;
use crate::domain::Domain;
use glam::Vec3;
use rayon::prelude::*;
use splat::PinholeView;

/// Cells along a side of each cascade. Source: Müller et al. 2022, appendix E.1.
pub(crate) const SIDE: usize = 128;
/// Cells of a cascade.
pub(crate) const CELLS: usize = SIDE * SIDE * SIDE;

/// Densities by cell, and the cells that count as occupied.
#[derive(Clone, Debug)]
pub(crate) struct Occupancy {
    cascades: u32,
    settings: OccupancySettings,
    /// Half a side of the smallest cube is ½ here: [cascades × CELLS], −1 where no camera looks.
    pub(crate) density: Vec<f32>,
    bits: Vec<u64>,
}

/// A place along a ray, in the frame of the smallest cube (which is [0, 1]³).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sample {
    /// Position.
    pub(crate) position: [f32; 3],
    /// Distance from the origin.
    pub(crate) t: f32,
    /// Length of the step, in sides of the outermost cube: densities are 1 at first, and a ray
    /// through all of space keeps a third of its light then, and does not end at the camera.
    pub(crate) dt: f32,
}

/// A ray in the frame of the smallest cube.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalRay {
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
}

/// A march under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct March {
    ray: LocalRay,
    inverse: Vec3,
    t: f32,
    end: f32,
    left: usize,
}

/// Centre of a cell of a cascade, moved by `jitter` ∈ [−½, ½]³ cells.
pub(crate) fn cell_point(cell: usize, jitter: [f32; 3]) -> [f32; 3] {
    let (cascade, at) = (cell / CELLS, cell % CELLS);
    let place = [at % SIDE, at / SIDE % SIDE, at / (SIDE * SIDE)];
    let side = (1u32 << cascade) as f32;
    [0, 1, 2].map(|a| ((place[a] as f32 + 0.5 + jitter[a]) / SIDE as f32 - 0.5) * side + 0.5)
}

impl Occupancy {
    /// All that some camera sees may hold something.
    pub(super) fn new(domain: &Domain, settings: OccupancySettings, views: &[PinholeView]) -> Self {
        let cascades = domain.cascades;
        let density = (0..cascades as usize * CELLS)
            .into_par_iter()
            .map(|cell| if is_seen(cell, domain, views) { 0.0 } else { -1.0 })
            .collect();
        let bits = vec![0; cascades as usize * CELLS / 64];
        let mut new = Self { cascades, settings, density, bits };
        new.bits.iter_mut().enumerate().for_each(|(i, word)| {
            for bit in 0..64 {
                *word |= u64::from(new.density[i * 64 + bit] >= 0.0) << bit;
            }
        });
        new
    }

    /// Takes densities of all cells, and marks the cells whose density is above the mean, or opaque
    /// enough.
    pub(crate) fn set_density(&mut self, density: Vec<f32>) {
        self.density = density;
        let finest = &self.density[..CELLS];
        let sum: f64 = finest.iter().map(|&d| f64::from(d.max(0.0))).sum();
        let limit = (self.settings.opaque / (self.settings.shortest() * self.unit()))
            .min((sum / CELLS as f64) as f32);
        let density = &self.density;
        self.bits.par_iter_mut().enumerate().for_each(|(i, word)| {
            *word = (0..64).map(|bit| u64::from(density[i * 64 + bit] > limit) << bit).sum();
        });
    }

    /// A side of the smallest cube in sides of the outermost.
    fn unit(&self) -> f32 {
        1.0 / (1u32 << (self.cascades - 1)) as f32
    }

    /// Whether a cell counts as occupied.
    #[inline(always)]
    pub(super) fn is_occupied(&self, cell: usize) -> bool {
        self.bits[cell / 64] >> (cell % 64) & 1 == 1
    }

    /// A march from where the ray enters the outermost cube, begun `jitter` ∈ [0, 1) of a step on.
    pub(crate) fn march(&self, ray: LocalRay, jitter: f32) -> March {
        let inverse = ray.direction.recip();
        let half = Vec3::splat(0.5 * (1u32 << (self.cascades - 1)) as f32);
        let (a, b) = ((0.5 - half - ray.origin) * inverse, (0.5 + half - ray.origin) * inverse);
        let (begin, end) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
        let t = begin + jitter * self.step(begin);
        March {
            ray,
            inverse,
            t,
            end: if begin.is_finite() { end } else { f32::NEG_INFINITY },
            left: self.settings.most,
        }
    }

    /// Length of a step at a distance.
    #[inline(always)]
    fn step(&self, t: f32) -> f32 {
        if self.cascades == 1 {
            return self.settings.shortest();
        }
        let shortest = self.settings.shortest();
        (t * self.settings.cone).clamp(shortest, shortest * (1u32 << (self.cascades - 1)) as f32)
    }

    /// The next sample in an occupied cell.
    pub(crate) fn next(&self, march: &mut March) -> Option<Sample> {
        while march.t < march.end && march.left > 0 {
            let p = march.ray.origin + march.ray.direction * march.t;
            let dt = self.step(march.t);
            let cascade = self.cascade(p, dt);
            let side = (1u32 << cascade) as f32;
            let in_cells = ((p - 0.5) / side + 0.5) * SIDE as f32;
            let place = [0, 1, 2].map(|a| (in_cells[a].max(0.0) as usize).min(SIDE - 1));
            let cell = cascade as usize * CELLS + place[0] + SIDE * (place[1] + SIDE * place[2]);
            if self.is_occupied(cell) {
                let sample = Sample { position: p.to_array(), t: march.t, dt: dt * self.unit() };
                march.t += dt;
                march.left -= 1;
                return Some(sample);
            }
            // On by whole steps until past the wall of the cell.
            let cell = side / SIDE as f32;
            let mut wall = f32::INFINITY;
            for a in 0..3 {
                let ahead = if march.ray.direction[a] > 0.0 { 1.0 } else { 0.0 };
                let distance = (place[a] as f32 + ahead - in_cells[a]) * cell * march.inverse[a];
                if distance.is_finite() {
                    wall = wall.min(distance.max(0.0));
                }
            }
            let steps = (wall / dt).floor() + 1.0;
            march.t += if steps.is_finite() { steps * dt } else { dt };
        }
        None
    }

    /// The smallest cube around a point whose cells are not smaller than a step.
    #[inline(always)]
    fn cascade(&self, p: Vec3, dt: f32) -> u32 {
        if self.cascades == 1 {
            return 0;
        }
        let reach = (p - 0.5).abs().max_element() * 2.0;
        let by_place = reach.max(1.0).log2().ceil();
        let by_step = (dt * SIDE as f32).max(1.0).log2().ceil();
        (by_place.max(by_step) as u32).min(self.cascades - 1)
    }
}

/// Whether some camera may see a part of a cell.
fn is_seen(cell: usize, domain: &Domain, views: &[PinholeView]) -> bool {
    let centre = (Vec3::from(cell_point(cell, [0.0; 3])) - 0.5) * (2.0 * domain.half) + domain.centre;
    // Half the diagonal of a cell: what a camera sees of the cell counts, not of its centre.
    let reach = domain.half * (1u32 << (cell / CELLS)) as f32 * 3f32.sqrt() / SIDE as f32;
    views.iter().any(|v| near_frustum(v, centre, reach))
}

/// Whether a ball may be seen by a camera.
fn near_frustum(view: &PinholeView, centre: Vec3, radius: f32) -> bool {
    let c = view.rotation * centre + view.translation;
    if c.z < -radius {
        return false;
    }
    // The side of the picture's pyramid through each border, whose normals are not unit.
    let [cx, cy] = view.centre;
    let (left, right) = (cx / view.focal[0], (view.width as f32 - cx) / view.focal[0]);
    let (up, down) = (cy / view.focal[1], (view.height as f32 - cy) / view.focal[1]);
    ![(-c.x, left), (c.x, right), (-c.y, up), (c.y, down)]
        .iter()
        .any(|(along, slope)| along - slope * c.z > radius * (1.0 + slope * slope).sqrt())
}
