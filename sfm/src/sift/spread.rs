//! Which keypoints stay when there are too many: the strongest of every part of the image.

use super::candidate::Candidate;

/// Cells a side of the grid over the image.
/// Source: measured: halved and doubled with the two of `noise`, temple_ring keeps its bytes and
/// the rotation error of fountain_p11 is 0.050° and 0.060° (0.060°).
const CELLS: usize = 16;
/// A candidate of every cell more than `most`: who is not among so many would not stay with several
/// directions either.
pub(super) fn with_margin(most: usize) -> usize {
    most.saturating_add(CELLS * CELLS)
}

/// At most `most` candidates: first the strongest of every cell, then the second of every cell, and
/// so on, stronger ones first within a round. The result is in the order of the input.
pub(super) fn strongest_everywhere(candidates: &[Candidate], most: usize, size: [f32; 2]) -> Vec<Candidate> {
    if candidates.len() <= most {
        return candidates.to_vec();
    }
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|&a, &b| candidates[b].strength.total_cmp(&candidates[a].strength).then(a.cmp(&b)));
    let mut taken = vec![0_u32; CELLS * CELLS];
    let mut ranked: Vec<(u32, usize)> = order
        .into_iter()
        .map(|i| {
            let k = &candidates[i].keypoint;
            let [column, row] =
                [k.x / size[0], k.y / size[1]].map(|v| ((v * CELLS as f32) as usize).min(CELLS - 1));
            let count = &mut taken[row * CELLS + column];
            *count += 1;
            (*count, i)
        })
        .collect();
    ranked.sort_by_key(|&(round, _)| round); // stable: strength decides within a round
    ranked.truncate(most);
    let mut kept: Vec<usize> = ranked.into_iter().map(|(_, i)| i).collect();
    kept.sort_unstable();
    kept.into_iter().map(|i| candidates[i]).collect()
}
