//! Tracks: keypoints of several images that show one point.

use glam::DVec2;
use scene::{Features, TwoViewGeometry};
use std::collections::HashMap;

/// "Belongs to no track" (or point).
/// Source: a value that no index has.
pub(crate) const NONE: u32 = u32::MAX;

/// Keypoints joined over images; a track has at most one keypoint an image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracks {
    /// For each image and feature: its track, or [`NONE`].
    pub of: Vec<Vec<u32>>,
    /// For each track: (image, feature), ascending by image; at least two.
    pub views: Vec<Vec<[u32; 2]>>,
}

/// For each feature the first of its image at the same place: SIFT repeats a keypoint for each of
/// its orientations, and a place must not count twice.
pub(crate) fn first_at_place(features: &Features) -> Vec<u32> {
    let mut seen: HashMap<(u32, u32), u32> = HashMap::with_capacity(features.len());
    let places = features.keypoints.iter().zip(0u32..);
    places.map(|(k, i)| *seen.entry((k.x.to_bits(), k.y.to_bits())).or_insert(i)).collect()
}

/// Keypoint positions of an image.
pub(crate) fn positions(features: &Features) -> Vec<DVec2> {
    features.keypoints.iter().map(scene::Keypoint::position).collect()
}

/// Joins the inlier matches of all pairs.
///
/// A wrong match joins two points, which shows where the union would hold two keypoints of one
/// image. So matches are taken in the order of their support (how many third keypoints match both
/// ends, then the pair's inliers), and a match that would bring about such a conflict is left out.
/// The result does not depend on the order of the pairs.
pub(crate) fn build_tracks(features: &[Features], geometries: &[TwoViewGeometry]) -> Tracks {
    let places: Vec<Vec<u32>> = features.iter().map(first_at_place).collect();
    let mut start = vec![0usize];
    for f in features {
        start.push(start[start.len() - 1] + f.len());
    }
    let nodes = start[features.len()];
    let mut image_of = vec![0u32; nodes];
    for i in 0..features.len() {
        image_of[start[i]..start[i + 1]].fill(i as u32);
    }
    let edges = edges_by_support(&places, &start, geometries);
    let mut forest = Forest::new(image_of);
    for [a, b] in edges {
        forest.join(a, b);
    }
    let mut tracks = Tracks { of: features.iter().map(|f| vec![NONE; f.len()]).collect(), views: Vec::new() };
    for root in 0..nodes {
        let members = &forest.members[root];
        if forest.parent[root] as usize != root || members.len() < 2 {
            continue;
        }
        let mut views: Vec<[u32; 2]> = Vec::with_capacity(members.len());
        for &node in members {
            let image = forest.image_of[node as usize];
            let feature = node - start[image as usize] as u32;
            tracks.of[image as usize][feature as usize] = tracks.views.len() as u32;
            views.push([image, feature]);
        }
        tracks.views.push(views);
    }
    tracks
}

fn edges_by_support(places: &[Vec<u32>], start: &[usize], geometries: &[TwoViewGeometry]) -> Vec<[u32; 2]> {
    let node = |image: usize, feature: u32| {
        places
            .get(image)
            .and_then(|p| p.get(feature as usize))
            .map(|&first| (start[image] + first as usize) as u32)
    };
    let mut edges: Vec<([u32; 2], usize)> = Vec::new();
    for g in geometries {
        let ends = g.inliers.iter().filter_map(|m| Some([node(g.a, m[0])?, node(g.b, m[1])?]));
        edges.extend(ends.map(|e| (e, g.inliers.len())));
    }
    edges.sort_unstable_by_key(|(e, n)| (*e, std::cmp::Reverse(*n)));
    edges.dedup_by_key(|(e, _)| *e);
    let mut neighbours = vec![Vec::new(); start[start.len() - 1]];
    for ([a, b], _) in &edges {
        neighbours[*a as usize].push(*b);
        neighbours[*b as usize].push(*a);
    }
    neighbours.iter_mut().for_each(|n| n.sort_unstable());
    let mut ranked: Vec<(usize, usize, [u32; 2])> = Vec::with_capacity(edges.len());
    for ([a, b], inliers) in edges {
        let support = common(&neighbours[a as usize], &neighbours[b as usize]);
        ranked.push((support, inliers, [a, b]));
    }
    ranked.sort_unstable_by_key(|(s, n, e)| (std::cmp::Reverse((*s, *n)), *e));
    ranked.into_iter().map(|(_, _, e)| e).collect()
}

/// How many values two ascending lists share.
fn common(a: &[u32], b: &[u32]) -> usize {
    let (mut i, mut k, mut count) = (0, 0, 0);
    while i < a.len() && k < b.len() {
        match a[i].cmp(&b[k]) {
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => k += 1,
            std::cmp::Ordering::Equal => {
                count += 1;
                i += 1;
                k += 1;
            }
        }
    }
    count
}

/// Disjoint sets of keypoints that refuse unions with two keypoints of one image.
struct Forest {
    parent: Vec<u32>,
    /// Of roots: members in ascending order (so ascending by image).
    members: Vec<Vec<u32>>,
    image_of: Vec<u32>,
}

impl Forest {
    fn new(image_of: Vec<u32>) -> Self {
        let n = image_of.len() as u32;
        Self { parent: (0..n).collect(), members: (0..n).map(|i| vec![i]).collect(), image_of }
    }

    fn root(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let above = self.parent[self.parent[node as usize] as usize];
            self.parent[node as usize] = above;
            node = above;
        }
        node
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let images: [Vec<u32>; 2] = [a, b]
            .map(|root| self.members[root as usize].iter().map(|&n| self.image_of[n as usize]).collect());
        if common(&images[0], &images[1]) > 0 {
            return;
        }
        let (root, child) = if a < b { (a, b) } else { (b, a) };
        let moved = std::mem::take(&mut self.members[child as usize]);
        self.members[root as usize].extend(moved);
        self.members[root as usize].sort_unstable();
        self.parent[child as usize] = root;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{Keypoint, TwoViewKind};

    fn images(n: usize, count: usize) -> Vec<Features> {
        let keypoint = |i: usize| Keypoint { x: i as f32, y: 1.0, scale: 1.0, angle: 0.0 };
        let one = Features { keypoints: (0..count).map(keypoint).collect(), descriptors: vec![] };
        vec![one; n]
    }

    fn pair(a: usize, b: usize, inliers: &[[u32; 2]]) -> TwoViewGeometry {
        let kind = TwoViewKind::Uncalibrated;
        let inliers = inliers.to_vec();
        TwoViewGeometry { a, b, kind, inliers, f: None, e: None, h: None, b_from_a: None, median_angle: 0.1 }
    }

    #[test]
    fn matches_chain_into_tracks_whatever_the_order_of_the_pairs() {
        let mut pairs = vec![pair(0, 1, &[[0, 1], [2, 3]]), pair(1, 2, &[[1, 4]]), pair(0, 2, &[[0, 4]])];
        let tracks = build_tracks(&images(3, 5), &pairs);
        assert_eq!(tracks.views, vec![vec![[0, 0], [1, 1], [2, 4]], vec![[0, 2], [1, 3]]]);
        assert_eq!(tracks.of[2], vec![NONE, NONE, NONE, NONE, 0]);
        pairs.reverse();
        assert_eq!(build_tracks(&images(3, 5), &pairs).views, tracks.views);
    }

    #[test]
    fn a_wrong_match_does_not_join_two_well_supported_tracks() {
        let good = [[0, 0], [1, 1]];
        let wrong = [[0, 0], [1, 1], [0, 1]];
        let pairs = [pair(0, 1, &good), pair(1, 2, &wrong), pair(0, 2, &good)];
        let tracks = build_tracks(&images(3, 3), &pairs);
        assert_eq!(tracks.views, vec![vec![[0, 0], [1, 0], [2, 0]], vec![[0, 1], [1, 1], [2, 1]]]);
    }

    #[test]
    fn a_keypoint_with_two_orientations_counts_once() {
        let mut features = images(2, 3);
        features[0].keypoints[1] = features[0].keypoints[0];
        let tracks = build_tracks(&features, &[pair(0, 1, &[[0, 0], [1, 2]])]);
        assert_eq!(tracks.views, vec![vec![[0, 0], [1, 0]]]);
    }

    #[test]
    fn no_pairs_and_no_images_give_no_tracks() {
        assert!(build_tracks(&[], &[]).views.is_empty());
        assert!(build_tracks(&images(2, 2), &[]).views.is_empty());
        assert!(build_tracks(&images(2, 2), &[pair(0, 1, &[[0, 9], [7, 0]])]).views.is_empty());
    }
}
