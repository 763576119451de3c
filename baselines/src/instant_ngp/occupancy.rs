//! Which cells of space hold something: a grid of bits by cascade, and the march of rays through
//! it (Müller et al. 2022, appendix E).

use super::settings::OccupancySettings;
use crate::domain::Domain;
use glam::{UVec3, Vec3};
use rayon::prelude::*;
use splat::PinholeView;

/// Cells along a side of each cascade. Source: Müller et al. 2022, appendix E.1.
pub(crate) const SIDE: usize = 128;
/// Cells of a cascade.
pub(crate) const CELLS: usize = SIDE * SIDE * SIDE;

/// Cells along a side of a block. Source: derived: the inner cube of a cascade ends where blocks
/// end, and a row of a block lies in one word.
const BLOCK: usize = 8;
/// Blocks along a side of a cascade. Source: derived.
const BLOCKS: usize = SIDE / BLOCK;

/// Densities by cell, and the cells that count as occupied.
#[derive(Clone, Debug)]
pub(crate) struct Occupancy {
    cascades: u32,
    settings: OccupancySettings,
    /// Half a side of the smallest cube is ½ here: [cascades × CELLS], −1 where no camera looks.
    pub(crate) density: Vec<f32>,
    bits: Vec<u64>,
    /// Which blocks hold an occupied cell: [cascades × BLOCKS³].
    blocks: Vec<bool>,
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

/// Column, row and layer of a cell of a cascade, so many on each side.
fn place_of(cell: usize, side: usize) -> [usize; 3] {
    [cell % side, cell / side % side, cell / (side * side) % side]
}

/// Centre of a cell of a cascade, moved by `jitter` ∈ [−½, ½]³ cells.
pub(crate) fn cell_point(cell: usize, jitter: [f32; 3]) -> [f32; 3] {
    let (cascade, place) = (cell / CELLS, place_of(cell, SIDE));
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
        let mut new = Self { cascades, settings, density, bits, blocks: Vec::new() };
        new.bits.iter_mut().enumerate().for_each(|(i, word)| {
            for bit in 0..64 {
                *word |= u64::from(new.density[i * 64 + bit] >= 0.0) << bit;
            }
        });
        new.mark_blocks();
        new
    }

    /// Takes densities of all cells, and marks the cells whose density is above the mean, or
    /// opaque enough.
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
        self.mark_blocks();
    }

    fn mark_blocks(&mut self) {
        let blocks = 0..self.cascades as usize * BLOCKS.pow(3);
        self.blocks = blocks.into_par_iter().map(|block| self.holds_some(block)).collect();
    }

    /// Whether a cell of a block counts as occupied.
    fn holds_some(&self, block: usize) -> bool {
        let (cascade, [x, y, z]) = (block / BLOCKS.pow(3), place_of(block, BLOCKS));
        (0..BLOCK * BLOCK).any(|row| {
            let (y, z) = (y * BLOCK + row % BLOCK, z * BLOCK + row / BLOCK);
            let cell = cascade * CELLS + x * BLOCK + SIDE * (y + SIDE * z);
            // A row of a block lies in one word.
            self.bits[cell / 64] >> (cell % 64) & 0xff != 0
        })
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
            let place = in_cells.max(Vec3::ZERO).as_uvec3().min(UVec3::splat(SIDE as u32 - 1));
            let [x, y, z] = place.to_array().map(|v| v as usize);
            if self.is_occupied(cascade as usize * CELLS + x + SIDE * (y + SIDE * z)) {
                let sample = Sample { position: p.to_array(), t: march.t, dt: dt * self.unit() };
                march.t += dt;
                march.left -= 1;
                return Some(sample);
            }
            let block = x / BLOCK + BLOCKS * (y / BLOCK + BLOCKS * (z / BLOCK));
            let holds_some = self.blocks[cascade as usize * BLOCKS.pow(3) + block];
            let cells = if holds_some { 1 } else { BLOCK as u32 };
            // On by whole steps until past the wall of the cell or the block.
            let low = (place / cells * cells).as_vec3();
            let ahead =
                Vec3::select(march.ray.direction.cmpgt(Vec3::ZERO), Vec3::splat(cells as f32), Vec3::ZERO);
            let distance = (low + ahead - in_cells) * (side / SIDE as f32) * march.inverse;
            let distance = Vec3::select(distance.is_finite_mask(), distance.max(Vec3::ZERO), Vec3::INFINITY);
            let steps = distance.min_element() / dt;
            // Beyond 2³² there is nothing, and nothing to go on to.
            march.t += dt * (steps as u32 as f32 + 1.0);
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
        doublings(reach.max(dt * SIDE as f32)).min(self.cascades - 1)
    }
}

/// How often 1 is doubled until it is at least `v`.
#[inline(always)]
fn doublings(v: f32) -> u32 {
    // The exponent, one more where there is a fraction behind it.
    let bits = v.max(1.0).to_bits();
    (bits >> 23) - 127 + u32::from(bits & 0x7f_ffff != 0)
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn no_step_in_an_occupied_cell_is_skipped() {
        let domain = Domain { centre: Vec3::ZERO, half: 1.0, cascades: 1 };
        let mut occupancy = Occupancy::new(&domain, OccupancySettings::default(), &[]);
        let mut random = scene::rng::rng(3, "occupancy", 0);
        // Most blocks hold nothing, some a few cells, some are full.
        let blocks: Vec<f64> = (0..BLOCKS.pow(3)).map(|_| random.random::<f64>() - 0.7).collect();
        let cells = (0..CELLS).map(|cell| {
            let [x, y, z] = place_of(cell, SIDE).map(|v| v / BLOCK);
            let full = random.random::<f64>() < 4.0 * blocks[x + BLOCKS * (y + BLOCKS * z)];
            if full { 2.0 } else { 0.0 }
        });
        occupancy.set_density(cells.collect());
        for _ in 0..200 {
            let [a, b] = [(); 2].map(|()| Vec3::from([(); 3].map(|()| random.random::<f32>())));
            let ray = LocalRay { origin: a * 4.0 - 1.5, direction: (b - a * 4.0 + 1.5).normalize() };
            let mut march = occupancy.march(ray, 0.5);
            let (begin, end, dt) = (march.t, march.end, occupancy.step(0.0));
            let found: Vec<f32> = std::iter::from_fn(|| occupancy.next(&mut march)).map(|s| s.t).collect();
            let all = (0..).map(|k| begin + k as f32 * dt).take_while(|t| *t < end - 1e-4);
            let expected = all.filter(|t| {
                // What lies on a wall may be on either side.
                let on_either_side = [-1e-4, 1e-4].map(|off| {
                    let place = (ray.origin + ray.direction * (t + off)) * SIDE as f32;
                    let [x, y, z] =
                        place.clamp(Vec3::ZERO, Vec3::splat(127.0)).to_array().map(|v| v as usize);
                    occupancy.is_occupied(x + SIDE * (y + SIDE * z))
                });
                on_either_side == [true; 2]
            });
            for t in expected.take(occupancy.settings.most) {
                let nearest = found.iter().map(|f| (f - t).abs()).fold(f32::INFINITY, f32::min);
                assert!(nearest < 1e-4, "{ray:?}: nothing at {t} (nearest {nearest})");
            }
        }
    }

    #[test]
    fn doublings_reach_a_number() {
        let of = [0.3, 1.0, 1.1, 2.0, 2.1, 4.0, 100.0].map(doublings);
        assert_eq!(of, [0, 0, 1, 1, 2, 2, 7]);
    }
}
