//! Rigid parts that turn on joints while the object is filmed, from tracks through the frames of a
//! video whose poses are known.
//!
//! Tracks that no place in the body explains are looked at again: groups of neighbours, over a
//! short time, as points of a part that turns about an axis at some rate (`search`). What explains
//! most tracks is refined over all frames, with an angle for each (`grow`, `fit`), and is a part
//! if it passes `is_part`. Cameras, poses and joints are then adjusted together (`adjust`).

mod adjust;
mod chain;
mod evidence;
mod fit;
mod grow;
mod joint;
mod limits;
mod loose;
mod normal;
mod part;
mod posed;
mod search;
mod steadiness;
#[cfg(test)]
mod tests;
mod tracks;
mod unit;

pub use loose::{LooseJoint, LoosePiece, loose_joints};
pub use part::{Articulation, MovingPart};

use crate::error::SfmError;
use crate::klt::{KltConfig, KltTrack, track};
use crate::statistics::median;
use chain::{Chain, Tie};
use evidence::Contest;
use joint::JointPath;
use limits::{ADJUSTMENTS, MOVING};
use posed::PosedTrack;
use scene::{FrameSet, Progress, Reconstruction};
use std::sync::Arc;
use steadiness::ChainNoise;
use tracks::SortedTracks;
use unit::ObjectUnit;

/// Looks for parts that move against the body. `model`: poses of (most of) the frames in the frame
/// of the body, and some of its points. Also the model again, where parts were found: cameras and
/// poses as they follow from all parts together, and the points of the body alone.
pub fn moving_parts(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &KltConfig,
    seed: u64,
    progress: &Progress,
) -> Result<(Articulation, Reconstruction), SfmError> {
    let tracks = track(frames, config, progress)?;
    let unit = ObjectUnit::of(model);
    let names: Vec<String> = frames.frames.iter().map(|f| f.name.clone()).collect();
    let numbers: Vec<u32> = model.cameras.keys().copied().collect();
    let posed = names.iter().map(|name| {
        let image = model.images.values().find(|i| i.name == *name)?;
        Some((numbers.binary_search(&image.camera).ok()?, unit.pose(&image.pose)))
    });
    let chain = Chain {
        cameras: model.cameras.values().cloned().collect(),
        frames: posed.collect(),
        joints: Vec::new(),
        ties: Vec::new(),
        times: frame_times(frames),
    };
    let (mut found, chain) = in_unit(&tracks, chain, seed, progress)?;
    found.parts.iter_mut().for_each(|p| unit.restore(p));
    let corrected = if found.parts.is_empty() {
        model.clone()
    } else {
        unit.corrected(model, &chain, &names, MOVING * found.noise_px)
    };
    found.frames = names;
    Ok((found, corrected))
}

/// When the frames were taken, as multiples of the usual time between two; by their numbers where
/// that is not known.
pub fn frame_times(frames: &FrameSet) -> Arc<[f64]> {
    if let Some(known) = frames.times() {
        let usual = median(known.windows(2).map(|w| w[1] - w[0]).collect());
        if usual > 0.0 {
            return known.iter().map(|t| t / usual).collect();
        }
    }
    (0..frames.frames.len()).map(|k| k as f64).collect()
}

/// The same where the object's size is 1, with cameras and poses that the parts corrected.
fn in_unit(
    tracks: &[KltTrack],
    mut chain: Chain,
    seed: u64,
    progress: &Progress,
) -> Result<(Articulation, Chain), SfmError> {
    progress.begin("parts", ADJUSTMENTS);
    let mut parts = {
        let frames = chain.posed();
        let sorted = SortedTracks::of(tracks, &frames);
        sorted.growth(&chain.times, seed).found(sorted.odd(), progress)?
    };
    for round in 0..ADJUSTMENTS {
        if parts.is_empty() {
            break;
        }
        progress.tick()?;
        chain = adjusted(tracks, &chain, &parts);
        if round + 1 < ADJUSTMENTS {
            let frames = chain.posed();
            let sorted = SortedTracks::of(tracks, &frames);
            parts = sorted.growth(&chain.times, seed).shared_out(&chain.joints);
        }
    }
    let found = told(tracks, &chain, seed);
    Ok((found, chain))
}

/// What is told of the parts.
fn told(tracks: &[KltTrack], chain: &Chain, seed: u64) -> Articulation {
    let frames = chain.posed();
    let sorted = SortedTracks::of(tracks, &frames);
    let members = sorted.members(&chain.joints, &chain.times);
    let sigmas = chain.sigmas(&members, &ChainNoise::of(chain, sorted.worth)).unwrap_or_default();
    let growth = sorted.growth(&chain.times, seed);
    let owned = growth.owned(&chain.joints).into_iter().zip(&sigmas);
    let told = owned.filter(|((path, own), _)| growth.is_part(path, own)).map(|((path, own), sigmas)| {
        let tracks: Vec<&PosedTrack<'_>> = own.iter().map(|&i| &sorted.all[i]).collect();
        MovingPart::of(&path, sigmas, &tracks)
    });
    let mut parts: Vec<MovingPart> = told.collect();
    parts.sort_by_key(|p| std::cmp::Reverse(p.observations));
    Articulation {
        frames: Vec::new(),
        parts,
        noise_px: sorted.noise,
        tracks: sorted.all.len(),
        unexplained: sorted.all.len() - members.len(),
        gaussians: Vec::new(),
        poses_probability: 1.0,
    }
}

/// Cameras, body and joints together: those that the tracks have evidence for, be they what the
/// chain has or `parts`.
fn adjusted(tracks: &[KltTrack], chain: &Chain, parts: &[(JointPath, Vec<usize>)]) -> Chain {
    let joints: Vec<JointPath> = parts.iter().map(|p| p.0.clone()).collect();
    let ties = vec![Tie::default(); joints.len()];
    let mut contest = Contest::new(tracks, chain);
    contest.enter(&Chain { joints, ties, ..chain.clone() });
    contest.settled()
}
