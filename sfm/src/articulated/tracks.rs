//! The tracks under some poses: which of them the body explains, and how noisy they are.

use super::chain::Member;
use super::grow::Growth;
use super::joint::JointPath;
use super::limits::{LEAST_NOISE_PX, MOVING, STAYS_PX};
use super::posed::{PosedFrame, PosedTrack};
use crate::klt::KltTrack;
use crate::statistics::median;
use rayon::prelude::*;
use std::sync::Arc;

/// The tracks under some poses.
pub(super) struct SortedTracks<'a> {
    /// Tracks long enough to tell.
    pub all: Vec<PosedTrack<'a>>,
    /// What each was made of.
    of: Vec<&'a KltTrack>,
    /// Those that the body explains.
    still: Vec<usize>,
    /// Standard deviation of an observation of the body, pixels.
    pub noise: f64,
    /// The standard deviation that observations would have, were they independent and worth as
    /// much: a tracker's errors add up along a track.
    pub worth: f64,
}

impl<'a> SortedTracks<'a> {
    /// Of tracks through frames, some of which have a pose.
    pub(super) fn of(tracks: &'a [KltTrack], frames: &'a [Option<PosedFrame<'a>>]) -> Self {
        let pairs = tracks.iter().filter_map(|t| Some((PosedTrack::new(t, frames)?, t)));
        let (all, of): (Vec<PosedTrack<'_>>, Vec<&KltTrack>) = pairs.unzip();
        let errors: Vec<Option<f64>> = all.par_iter().map(|t| t.still().map(|s| s.1)).collect();
        let noise = median(errors.iter().copied().flatten().collect()).max(LEAST_NOISE_PX);
        let still = (0..all.len()).filter(|&i| errors[i].is_some_and(|e| e <= MOVING * noise));
        let still: Vec<usize> = still.collect();
        let sums = still.par_iter().filter_map(|&i| Some(all[i].correlation(all[i].still()?.0)));
        let sums = sums.reduce(|| [0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        let rho = (sums[0] / sums[1].max(f64::MIN_POSITIVE)).clamp(0.0, 0.9);
        let worth = noise * ((1.0 + rho) / (1.0 - rho)).sqrt();
        Self { all, of, still, noise, worth }
    }

    /// The same, told the noise of an observation and what it is worth.
    pub(super) fn with_noise(self, noise: f64, worth: f64) -> Self {
        Self { noise, worth, ..self }
    }

    /// Tracks that the body or a joint explains.
    pub(super) fn members(&self, joints: &[JointPath], times: &Arc<[f64]>) -> Vec<Member<'a>> {
        let assigned = self.growth(times, 0).assigned(joints);
        assigned.into_iter().map(|(i, joint)| Member { track: self.of[i], joint }).collect()
    }

    /// The squared errors of all tracks under what explains each best, in variances of what an
    /// observation is worth. What nothing explains counts as what is just not explained.
    pub(super) fn misfit(&self, joints: &[JointPath]) -> f64 {
        let errors = self.all.par_iter().map(|track| {
            let body = track.still().map_or(f64::INFINITY, |f| f.1);
            let turning = joints.iter().filter_map(|path| Some(track.point(path)?.1));
            let least = turning.fold(body, f64::min).min(MOVING * self.noise) / self.worth;
            (2 * track.views.len()).saturating_sub(3) as f64 * least * least
        });
        errors.collect::<Vec<f64>>().iter().sum()
    }

    /// Tracks that the body does not explain and that may be a part's.
    pub(super) fn odd(&self) -> Vec<usize> {
        let odd = self.all.iter().enumerate().filter(|(i, track)| {
            self.still.binary_search(i).is_err() && track.travel() > STAYS_PX && track.views.len() >= 8
        });
        odd.map(|(i, _)| i).collect()
    }

    /// What looks for parts among them.
    pub(super) fn growth<'t>(&'t self, times: &'t Arc<[f64]>, seed: u64) -> Growth<'t, 'a> {
        Growth { all: &self.all, still: &self.still, noise: self.noise, worth: self.worth, times, seed }
    }
}
