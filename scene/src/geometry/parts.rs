//! The connected parts of a mesh.

use super::Mesh;

impl Mesh {
    /// Leaves only the connected parts whose area is at least this share of the largest part's, and
    /// their vertices.
    pub fn keep_large_parts(&mut self, least_share: f64) {
        let mut parts = JoinedSets::new(self.vertices.len());
        for &[a, b, c] in &self.triangles {
            parts.join(a, b);
            parts.join(b, c);
        }
        let mut areas = vec![0.0; self.vertices.len()];
        for (i, triangle) in self.triangles.iter().enumerate() {
            areas[parts.root(triangle[0]) as usize] += self.triangle_area(i);
        }
        let least = least_share * areas.iter().copied().fold(0.0, f64::max);
        self.triangles.retain(|t| areas[parts.root(t[0]) as usize] >= least);
        self.drop_unused();
    }

    /// Removes vertices that no triangle names.
    pub fn drop_unused(&mut self) {
        let mut used = vec![false; self.vertices.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        let mut number = 0;
        let numbers: Vec<u32> = used.iter().map(|&u| (number, number += u32::from(u)).0).collect();
        self.triangles.iter_mut().flatten().for_each(|v| *v = numbers[*v as usize]);
        let mut keep = used.iter().copied().cycle();
        self.vertices.retain(|_| keep.next() == Some(true));
        let mut keep = used.iter().copied().cycle();
        self.colors.retain(|_| keep.next() == Some(true));
    }
}

/// Sets that are joined: each member points towards its root (Tarjan 1975, with halved paths).
#[derive(Clone, Debug)]
pub struct JoinedSets(Vec<u32>);

impl JoinedSets {
    /// So many sets of one member each.
    pub fn new(members: usize) -> Self {
        Self((0..members as u32).collect())
    }

    /// The member, the least of its set, that stands for it.
    pub fn root(&mut self, mut at: u32) -> u32 {
        while self.0[at as usize] != at {
            let above = self.0[self.0[at as usize] as usize];
            self.0[at as usize] = above;
            at = above;
        }
        at
    }

    /// Makes one set of those of `a` and `b`.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn small_parts_go_and_the_others_keep_their_colours() {
        let mut mesh = Mesh::default();
        // Three separate triangles of areas 0.5, 0.005 and 0.125, in a scene of a millionth.
        for (i, side) in [1.0, 0.1, 0.5].into_iter().enumerate() {
            let n = mesh.vertices.len() as u32;
            for (x, y) in [(0.0, 0.0), (side, 0.0), (0.0, side)] {
                mesh.vertices.push(DVec3::new(x + 5.0 * i as f64, y, 0.0) * 1e-6);
                mesh.colors.push([i as u8; 3]);
            }
            mesh.triangles.push([n, n + 1, n + 2]);
        }
        mesh.keep_large_parts(0.1);
        assert_eq!(mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(mesh.colors, [[0; 3], [0; 3], [0; 3], [2; 3], [2; 3], [2; 3]]);
        assert!((mesh.area() / 0.625e-12 - 1.0).abs() < 1e-12);
        mesh.keep_large_parts(1.0);
        assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (1, 3));
        let mut empty = Mesh::default();
        empty.keep_large_parts(0.1);
        assert_eq!(empty, Mesh::default());
    }
}
