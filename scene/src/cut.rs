//! What of a splat is kept: a box, and what hangs together.

use crate::Gaussians;
use glam::{DVec3, I64Vec3};
use std::collections::HashMap;

/// What of a splat is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatCut {
    /// Two opposite corners of a box, world frame: Gaussians whose centre lies outside go.
    pub within: Option<[DVec3; 2]>,
    /// Islands that hold less than this share of the opacity of all that lies in the box go, in
    /// [0, 1]; 0 keeps all.
    pub least_island: f64,
    /// Neighbours are joined to an island up to so many standard deviations of the usual
    /// Gaussian's longest axis.
    pub reach_sigmas: f64,
}

impl Default for SplatCut {
    /// Keeps all. A reach of three standard deviations: what overlaps at the level of 1 %.
    fn default() -> Self {
        Self { within: None, least_island: 0.0, reach_sigmas: 3.0 }
    }
}

impl SplatCut {
    /// Which Gaussians are kept.
    pub fn kept(&self, gaussians: &Gaussians) -> Vec<bool> {
        let mut kept: Vec<bool> = gaussians.means.iter().map(|m| self.is_within(m.as_dvec3())).collect();
        if self.least_island > 0.0 {
            drop_islands(gaussians, self, &mut kept);
        }
        kept
    }

    fn is_within(&self, place: DVec3) -> bool {
        self.within.is_none_or(|[a, b]| a.min(b).cmple(place).all() && place.cmple(a.max(b)).all())
    }
}

/// Takes out islands that hold too little of what is kept.
fn drop_islands(gaussians: &Gaussians, cut: &SplatCut, kept: &mut [bool]) {
    let inside: Vec<usize> = (0..kept.len()).filter(|&i| kept[i]).collect();
    let longest = inside.iter().map(|&i| f64::from(gaussians.log_scales[i].max_element().exp())).collect();
    let Some(size) = crate::overview::quantile(longest, 0.5).map(|s| s * cut.reach_sigmas) else { return };
    // Cells within reach of each other are an island.
    let cells: Vec<I64Vec3> =
        inside.iter().map(|&i| (gaussians.means[i].as_dvec3() / size).floor().as_i64vec3()).collect();
    let island_of = islands(&cells);
    let mut held: HashMap<usize, f64> = HashMap::new();
    let mut all = 0.0;
    for (&i, island) in inside.iter().zip(&island_of) {
        let opacity = f64::from(gaussians.opacity(i));
        *held.entry(*island).or_default() += opacity;
        all += opacity;
    }
    for (&i, island) in inside.iter().zip(&island_of) {
        kept[i] = held[island] >= cut.least_island * all;
    }
}

/// For each place the number of its island: cells that touch, corners included, are one.
fn islands(cells: &[I64Vec3]) -> Vec<usize> {
    let mut number: HashMap<I64Vec3, usize> = HashMap::new();
    for cell in cells {
        let next = number.len();
        number.entry(*cell).or_insert(next);
    }
    let mut parent: Vec<usize> = (0..number.len()).collect();
    for (cell, &at) in &number {
        // Half of the 26 neighbours: the other half have this one.
        for step in (14..27).map(|k| I64Vec3::new(k / 9 - 1, k / 3 % 3 - 1, k % 3 - 1)) {
            if let Some(&beside) = number.get(&cell.wrapping_add(step)) {
                let (a, b) = (root(&mut parent, at), root(&mut parent, beside));
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    cells.iter().map(|cell| root(&mut parent, number[cell])).collect()
}

/// The first of a set (disjoint sets with path halving: Tarjan and van Leeuwen, JACM 31(2), 1984).
fn root(parent: &mut [usize], mut at: usize) -> usize {
    while parent[at] != at {
        parent[at] = parent[parent[at]];
        at = parent[at];
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    /// Two walls of Gaussians at x = 0 and x = 5, one at x = 9 alone, and one far away.
    fn example() -> Gaussians {
        let mut g = Gaussians::default();
        let walls = [(0.0, 20), (5.0, 4), (9.0, 1), (1e12, 1)];
        for (x, n) in walls {
            for k in 0..n * n {
                g.means.push(Vec3::new(x, (k / n) as f32 * 0.1, (k % n) as f32 * 0.1));
                g.log_scales.push(Vec3::new(-6.0, 0.1_f32.ln(), -6.0));
                g.rotations.push(Quat::IDENTITY);
                g.opacity_logits.push(2.0);
                g.sh.extend([0.0; 3]);
            }
        }
        g
    }

    fn count(cut: SplatCut) -> usize {
        cut.kept(&example()).iter().filter(|k| **k).count()
    }

    #[test]
    fn islands_that_hold_little_go_and_large_ones_stay() {
        assert_eq!(count(SplatCut::default()), 418);
        assert_eq!(count(SplatCut { least_island: 0.01, ..SplatCut::default() }), 416);
        assert_eq!(count(SplatCut { least_island: 0.1, ..SplatCut::default() }), 400);
    }

    #[test]
    fn a_box_keeps_what_is_in_it_whatever_the_order_of_its_corners() {
        let corners = [DVec3::new(6.0, 9.0, 9.0), DVec3::new(4.0, -1.0, -1.0)];
        assert_eq!(count(SplatCut { within: Some(corners), ..SplatCut::default() }), 16);
        let alone = SplatCut { within: Some(corners), least_island: 0.9, ..SplatCut::default() };
        assert_eq!(count(alone), 16, "islands are judged by what is in the box");
        assert_eq!(alone.kept(&Gaussians::default()), Vec::<bool>::new());
    }
}
