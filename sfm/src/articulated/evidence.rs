//! What speaks for one chain against another: which joints there are, and what they have in
//! common.

use super::chain::{Chain, Tie};
use super::limits::{HOPELESS, LEAST_TRACKS, SIMPLER, TOLERANCES};
use super::posed::PosedFrame;
use super::steadiness::ChainNoise;
use super::tracks::SortedTracks;
use crate::klt::KltTrack;

/// Chains for the same tracks, the best so far.
pub(super) struct Contest<'t> {
    tracks: &'t [KltTrack],
    /// Standard deviation of an observation of the body, pixels.
    pixel: f64,
    noise: ChainNoise,
    best: Chain,
    evidence: f64,
}

impl<'t> Contest<'t> {
    /// With cameras, body and joints of `start` adjusted together, if it has joints.
    pub(super) fn new(tracks: &'t [KltTrack], start: &Chain) -> Self {
        let frames = start.posed();
        let sorted = SortedTracks::of(tracks, &frames);
        let noise = ChainNoise::of(start, sorted.worth);
        let best = start.clone();
        let mut own = Self { tracks, pixel: sorted.noise, noise, best, evidence: f64::NEG_INFINITY };
        if !start.joints.is_empty() {
            own.enter(start);
        }
        own
    }

    /// Whether a chain, adjusted to the tracks that it explains itself, has more evidence than the
    /// best so far, which it then is.
    pub(super) fn enter(&mut self, start: &Chain) -> bool {
        self.favoured(start, 0.0, 0)
    }

    /// The same of a chain that says less, and is preferred therefore: by so much evidence, or if
    /// it explains at most `lost` tracks fewer.
    fn favoured(&mut self, start: &Chain, by: f64, lost: usize) -> bool {
        let (near, hope) = self.adjusted(start, TOLERANCES[0]);
        if hope < self.evidence - HOPELESS && !self.spares(&near, lost) {
            return false;
        }
        let (found, evidence) = self.adjusted(&near, TOLERANCES[1]);
        let wins = evidence > self.evidence - by || self.spares(&found, lost);
        if wins {
            (self.best, self.evidence) = (found, evidence);
        }
        wins
    }

    /// Whether a chain explains at most so many tracks fewer than the best, where that matters.
    fn spares(&self, chain: &Chain, lost: usize) -> bool {
        lost > 0 && self.explained(chain).len() + lost >= self.explained(&self.best).len()
    }

    /// The tracks that a chain explains: of each the joint.
    fn explained(&self, chain: &Chain) -> Vec<Option<usize>> {
        let frames = chain.posed();
        let members = self.sorted(&frames).members(&chain.joints, &chain.times);
        members.iter().map(|m| m.joint).collect()
    }

    /// How many of a joint's tracks may be wrong: fewer than make a part, or the share of all
    /// tracks that nothing explains. Such run along the outline of what lies before them, and a
    /// joint whose angle is free can follow a few of them, each of which counts as much as a good
    /// one.
    fn wrong_tracks(&self, joint: usize) -> usize {
        let explained = self.explained(&self.best);
        let own = explained.iter().filter(|j| **j == Some(joint)).count();
        let all = self.sorted(&self.best.posed()).all.len().max(1);
        (own * (all - explained.len())).div_ceil(all).max(LEAST_TRACKS - 1)
    }

    /// A chain adjusted to the tracks that it explains, and the logarithm of its evidence.
    fn adjusted(&self, start: &Chain, tolerance: f64) -> (Chain, f64) {
        let frames = start.posed();
        let members = self.sorted(&frames).members(&start.joints, &start.times);
        let (found, prior) = start.adjusted(&members, &self.noise, tolerance);
        // What determines nothing is still more than nothing at all.
        let evidence = (prior - 0.5 * self.misfit(&found)).max(f64::MIN);
        (found, evidence)
    }

    fn misfit(&self, chain: &Chain) -> f64 {
        self.sorted(&chain.posed()).misfit(&chain.joints)
    }

    fn sorted<'a>(&'a self, frames: &'a [Option<PosedFrame<'a>>]) -> SortedTracks<'a> {
        SortedTracks::of(self.tracks, frames).with_noise(self.pixel, self.noise.pixel)
    }

    /// Joints without which more is explained go, and those that are left are tied to each other
    /// where that has more evidence; parts that this makes move as one are one.
    pub(super) fn settled(mut self) -> Chain {
        let mut joint = 0;
        while joint < self.best.joints.len() {
            if self.best.joints.len() == 1 {
                break;
            }
            let lost = self.wrong_tracks(joint);
            if !self.favoured(&self.best.without(joint), SIMPLER, lost) {
                joint += 1;
            }
        }
        for j in 1..self.best.joints.len() {
            for leader in 0..j {
                let Tie { axis_of, ratio } = self.best.ties[j];
                if ratio.is_none() && axis_of.is_none_or(|own| own == leader) {
                    self.tie(j, leader);
                }
            }
        }
        self.best.without_repeats()
    }

    /// Ties a joint to one before it where that has more evidence. Of joints that turn alike, one
    /// may have lost its tracks: the other knows the angles.
    fn tie(&mut self, joint: usize, leader: usize) {
        let free = self.best.clone();
        let axis = Tie { axis_of: Some(leader), ratio: None };
        if free.ties[joint] != axis {
            self.favoured(&free.tied(joint, axis), SIMPLER, 0);
        }
        let alike = [1.0, -1.0].into_iter().flat_map(|ratio| {
            let tie = Tie { ratio: Some(ratio), ..axis };
            let led = free.ties[leader].ratio.is_none().then(|| free.led_by(joint, leader, ratio));
            [Some(&free), led.as_ref()].map(|start| start.map(|s| s.tied(joint, tie)))
        });
        let alike = alike.flatten();
        let rated = alike.map(|chain| (self.misfit(&chain), chain));
        if let Some((_, best)) = rated.min_by(|a, b| a.0.total_cmp(&b.0)) {
            self.favoured(&best, SIMPLER, 0);
        }
    }
}
