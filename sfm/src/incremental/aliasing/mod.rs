//! Repeated structure (a can printed twice, twin solar arrays) ties images together that show
//! different sides, and aliases the model: found by the pairs it contradicts, undone by dropping
//! the pairs that cannot be true.
//!
//! A pair of neighbours agrees in the object and in all that surrounds it, a false one only in what
//! repeats. So the strongest pairs (in a video: neighbours in time) give the rotations, by a
//! spanning tree and robust averaging (Hartley, Aftab & Trumpf, CVPR 2011), and a pair whose
//! rotation differs from theirs is false (Zach, Klopschitz & Pollefeys, CVPR 2010: loops must
//! close).

use super::initial::relative_pose;
use super::state::{MapState, MappingInput};
use super::structureless_resection::{NEAR_IN_TIME, agreement};
use crate::disjoint_sets::DisjointSets;
use crate::limits::AGREEING_SHARE;
use glam::{DQuat, DVec3};
use scene::TwoViewGeometry;

/// A pair farther from the model's or the averaged rotation than this is contradicted.
/// Source: docs/decisions/07.
const CONTRADICTED_DEG: f64 = 15.0;
/// The same while the rotations of the tree have not been averaged: what they may drift.
/// Source: chosen by hand, never measured.
const DRIFT_DEG: f64 = 35.0;
/// Sweeps of the averaging; it takes about the square of the longest chain.
/// Source: derived: information passes one edge a sweep, so that 600 sweeps even out chains of 24.
const SWEEPS: usize = 600;

/// A verified pair and the rotation between its images for the present intrinsics.
#[derive(Clone)]
struct PairRotation {
    geometry: usize,
    a: usize,
    b: usize,
    b_from_a: DQuat,
    weight: f64,
}

/// The pairs that can be true together, where the model contradicts pairs that it should not;
/// `None` where it is whole. `is_video`: the images are in the order of time.
pub(crate) fn find_consistent_pairs(
    state: &MapState,
    input: &MappingInput<'_>,
    is_video: bool,
) -> Option<Vec<usize>> {
    let ranked = by_trust(input.geometries, is_video);
    let tree = spanning_tree(input, state, &ranked);
    if !tree.iter().any(|e| is_contradicted(state, input, e)) {
        return None;
    }
    let edges: Vec<PairRotation> = ranked.iter().filter_map(|&g| edge(state, input, g)).collect();
    let kept = keep_consistent(&tree, &edges, input.keypoints.len());
    let mut kept: Vec<usize> = kept.iter().map(|&i| edges[i].geometry).collect();
    kept.sort_unstable();
    (kept.len() < input.geometries.len()).then_some(kept)
}

/// The edges whose rotations agree with those of the tree, averaged over all that agree.
fn keep_consistent(tree: &[PairRotation], edges: &[PairRotation], images: usize) -> Vec<usize> {
    let mut rotations = along(tree, images);
    let near = |rotations: &[Option<DQuat>], limit: f64| -> Vec<usize> {
        (0..edges.len()).filter(|&i| residual(rotations, &edges[i]).is_some_and(|r| r < limit)).collect()
    };
    for limit in [DRIFT_DEG, 0.5 * (DRIFT_DEG + CONTRADICTED_DEG)] {
        let kept = near(&rotations, limit.to_radians());
        average(&mut rotations, &kept.iter().map(|&i| &edges[i]).collect::<Vec<_>>());
    }
    near(&rotations, CONTRADICTED_DEG.to_radians())
}

/// Matches that agree with a model: of all pairs; of a video, of neighbours in time.
pub(crate) fn count_agreeing(state: &MapState, input: &MappingInput<'_>, is_video: bool) -> usize {
    let trusted = input.geometries.iter().filter(|g| !is_video || g.a.abs_diff(g.b) <= NEAR_IN_TIME);
    trusted.filter_map(|g| agreement(state, input, g)).map(|(agreeing, _)| agreeing).sum()
}

/// Geometries by trust: in a video neighbours in time first; then by the number of matches.
fn by_trust(geometries: &[TwoViewGeometry], is_video: bool) -> Vec<usize> {
    let mut ranked: Vec<usize> = (0..geometries.len()).collect();
    ranked.sort_by_key(|&i| {
        let g = &geometries[i];
        let far = is_video && g.a.abs_diff(g.b) > NEAR_IN_TIME;
        (far, std::cmp::Reverse(g.inliers.len()), g.a, g.b)
    });
    ranked
}

fn edge(state: &MapState, input: &MappingInput<'_>, geometry: usize) -> Option<PairRotation> {
    let g = &input.geometries[geometry];
    let cameras = [g.a, g.b].map(|i| &state.cameras[input.camera_of[i]]);
    let b_from_a = relative_pose(input, cameras, g).or(g.b_from_a)?.rotation;
    Some(PairRotation { geometry, a: g.a, b: g.b, b_from_a, weight: (g.inliers.len() as f64).sqrt() })
}

/// Kruskal's tree of the most trusted pairs.
fn spanning_tree(input: &MappingInput<'_>, state: &MapState, ranked: &[usize]) -> Vec<PairRotation> {
    let mut parts = DisjointSets::new(input.keypoints.len());
    let mut tree = Vec::new();
    for &g in ranked {
        let (a, b) = (input.geometries[g].a, input.geometries[g].b);
        if parts.find(a) == parts.find(b) {
            continue;
        }
        if let Some(edge) = edge(state, input, g) {
            parts.join(a, b);
            tree.push(edge);
        }
    }
    tree
}

/// Whether a model has both images, another rotation between them, and poses that their matches do
/// not agree with.
fn is_contradicted(state: &MapState, input: &MappingInput<'_>, edge: &PairRotation) -> bool {
    let rotation = |i: usize| state.poses[i].map(|p| p.rotation);
    residual_of(rotation(edge.a), rotation(edge.b), edge)
        .is_some_and(|angle| angle > CONTRADICTED_DEG.to_radians())
        && agreement(state, input, &input.geometries[edge.geometry])
            .is_some_and(|(agreeing, all)| (agreeing as f64) < AGREEING_SHARE * all as f64)
}

fn residual(rotations: &[Option<DQuat>], edge: &PairRotation) -> Option<f64> {
    residual_of(rotations[edge.a], rotations[edge.b], edge)
}

fn residual_of(a: Option<DQuat>, b: Option<DQuat>, edge: &PairRotation) -> Option<f64> {
    Some((edge.b_from_a * a?).angle_between(b?))
}

/// Rotations `image_from_world` along the tree, from its most trusted image; others stay unknown.
fn along(tree: &[PairRotation], images: usize) -> Vec<Option<DQuat>> {
    let mut rotations = vec![None; images];
    let Some(first) = tree.first() else { return rotations };
    rotations[first.a] = Some(DQuat::IDENTITY);
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for e in tree {
            match (rotations[e.a], rotations[e.b]) {
                (Some(a), None) => rotations[e.b] = Some((e.b_from_a * a).normalize()),
                (None, Some(b)) => rotations[e.a] = Some((e.b_from_a.inverse() * b).normalize()),
                _ => continue,
            }
            changed = true;
        }
    }
    rotations
}

/// Moves every rotation to the weighted L1 mean of what its pairs say (one Weiszfeld step each),
/// sweep after sweep.
fn average(rotations: &mut [Option<DQuat>], edges: &[&PairRotation]) {
    let mut of_image = vec![Vec::new(); rotations.len()];
    for e in edges {
        of_image[e.a].push((e.b, e.b_from_a.inverse(), e.weight));
        of_image[e.b].push((e.a, e.b_from_a, e.weight));
    }
    for _ in 0..SWEEPS {
        let mut largest = 0.0_f64;
        for i in 0..rotations.len() {
            let Some(own) = rotations[i] else { continue };
            let mut sum = DVec3::ZERO;
            let mut weights = 0.0;
            for (j, own_from_other, weight) in &of_image[i] {
                let Some(other) = rotations[*j] else { continue };
                let step = shortest(*own_from_other * other * own.inverse());
                let weight = weight / step.length().max(0.01);
                sum += step * weight;
                weights += weight;
            }
            if weights > 0.0 {
                let step = sum / weights;
                largest = largest.max(step.length());
                rotations[i] = Some((DQuat::from_scaled_axis(step) * own).normalize());
            }
        }
        if largest < 1e-5 {
            break;
        }
    }
}

/// Axis times angle, the angle at most π.
fn shortest(q: DQuat) -> DVec3 {
    if q.w < 0.0 { (-q).to_scaled_axis() } else { q.to_scaled_axis() }
}

#[cfg(test)]
mod tests;
