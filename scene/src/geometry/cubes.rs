//! Marching cubes (Lorensen and Cline, SIGGRAPH 1987), its table made from its definition.
//!
//! Corner c of a cell lies at (c & 1, c >> 1 & 1, c >> 2 & 1). On each face, seen from outside and
//! walked anticlockwise, the surface enters where the corners change from outside to inside and
//! leaves where they change back: every run of corners inside is cut off by one segment. Where a
//! face is ambiguous this separates the corners inside, a rule of the face alone, so that both
//! cells at it agree and the surface has no holes. The segments close to loops; loops become fans.

use std::sync::OnceLock;

/// An edge of a cell: its corners, the one with the lower coordinates first. Source: derived.
pub(super) const EDGES: [[usize; 2]; 12] = {
    let (mut edges, mut n, mut axis) = ([[0; 2]; 12], 0, 0);
    while axis < 3 {
        let mut corner = 0;
        while corner < 8 {
            if corner >> axis & 1 == 0 {
                edges[n] = [corner, corner | 1 << axis];
                n += 1;
            }
            corner += 1;
        }
        axis += 1;
    }
    edges
};

/// The axis along which an edge of [`EDGES`] runs.
pub(super) const fn axis_of(edge: usize) -> usize {
    edge / 4
}

/// For every set of corners inside (bit c: corner c): triangles of edges, anticlockwise seen from
/// outside.
pub(super) fn table() -> &'static [Vec<[u8; 3]>; 256] {
    static TABLE: OnceLock<[Vec<[u8; 3]>; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(triangles))
}

/// Corners of the face at `side` (0 or 1) of `axis`, anticlockwise seen from outside the cell.
fn face(axis: usize, side: usize) -> [usize; 4] {
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let walk = if side == 1 { [0, u, u | v, v] } else { [0, v, u | v, u] };
    walk.map(|c| c | side << axis)
}

fn edge_between(a: usize, b: usize) -> usize {
    EDGES.iter().position(|e| *e == [a.min(b), a.max(b)]).unwrap_or(0)
}

/// Whether a corner of a cell is inside, of which `inside` has a bit each.
fn is_in(inside: usize, corner: usize) -> bool {
    inside >> corner & 1 == 1
}

fn triangles(inside: usize) -> Vec<[u8; 3]> {
    // Which edge follows which along the surface's border.
    let mut next = [None; 12];
    for (axis, side) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)] {
        let corners = face(axis, side);
        for k in 0..4 {
            if is_in(inside, corners[k]) || !is_in(inside, corners[(k + 1) % 4]) {
                continue;
            }
            let enters = edge_between(corners[k], corners[(k + 1) % 4]);
            let last = (k + 1..k + 4).find(|&j| !is_in(inside, corners[(j + 1) % 4])).unwrap_or(k + 3);
            next[enters] = Some(edge_between(corners[last % 4], corners[(last + 1) % 4]));
        }
    }
    let mut fans = Vec::new();
    for start in 0..12 {
        let mut ring = Vec::new();
        let mut at = start;
        while let Some(following) = next[at].take() {
            ring.push(at as u8);
            at = following;
        }
        for pair in ring.get(1..).unwrap_or_default().windows(2) {
            fans.push([ring[0], pair[0], pair[1]]);
        }
    }
    fans
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::collections::BTreeMap;

    fn corner(c: usize) -> DVec3 {
        DVec3::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2 & 1) as f64)
    }

    fn middle(edge: u8) -> DVec3 {
        let [a, b] = EDGES[edge as usize];
        (corner(a) + corner(b)) / 2.0
    }

    #[test]
    fn every_edge_that_changes_sides_is_used_and_no_other() {
        for (inside, fans) in table().iter().enumerate() {
            for (e, [a, b]) in EDGES.into_iter().enumerate() {
                let crosses = (inside >> a ^ inside >> b) & 1 == 1;
                let used = fans.iter().flatten().any(|&i| i as usize == e);
                assert_eq!(crosses, used, "corners {inside:08b}, edge {e}");
            }
        }
    }

    #[test]
    fn borders_lie_in_the_faces_and_a_single_corner_is_seen_from_outside() {
        for (inside, fans) in table().iter().enumerate() {
            let mut sides: BTreeMap<(u8, u8), i32> = BTreeMap::new();
            for t in fans {
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    *sides.entry((a, b)).or_default() += 1;
                }
            }
            for (&(a, b), &n) in &sides {
                assert_eq!(n, 1, "corners {inside:08b}: a side is used twice in one direction");
                let (p, q) = (middle(a), middle(b));
                let in_a_face = (0..3).any(|k| p[k] == q[k] && (p[k] == 0.0 || p[k] == 1.0));
                assert!(
                    sides.contains_key(&(b, a)) || in_a_face,
                    "corners {inside:08b}: a hole inside the cell"
                );
            }
        }
        for c in 0..8 {
            let [t] = table()[1 << c][..] else { panic!("one corner is one triangle") };
            let [p, q, r] = t.map(middle);
            let outwards = (q - p).cross(r - p).dot((p + q + r) / 3.0 - corner(c));
            assert!(outwards > 0.0, "corner {c}");
        }
    }
}
