//! From a joint that explains a few tracks over a few frames to one for all frames.

use super::MOVING;
use super::joint::JointPath;
use super::posed::{LEAST_VIEWS, PosedTrack};
use super::search::joints;
use crate::statistics::median;
use glam::DVec3;
use rand::Rng as _;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Groups of neighbouring tracks that are tried. Source: derived: a part with a tenth of the odd
/// tracks is met four times.
const GROUPS: usize = 40;
/// A track belongs to a part that leaves no more than so many times the usual error. Source: two
/// standard deviations; what is left over is looked at for other parts.
const BELONGS: f64 = 2.0;
/// Tracks of a group, and frames over which it is looked at. Source: derived: an axis, a rate and
/// ten points from over a hundred observations; an angle is nearly steady over so short a time.
const GROUP: [usize; 2] = [10, 20];
/// A part has so many tracks. Source: chosen by hand, never measured.
const LEAST_TRACKS: usize = 10;
/// Standard deviation of the change of rate from frame to frame before anything is known, radians.
/// Source: derived: half a degree, more than motors do.
pub(super) const FIRST_BEND: f64 = 0.009;
/// It is never taken for less, radians. Source: derived: adds up to a degree over 100 frames.
const LEAST_BEND: f64 = 3e-5;
/// Ratio of those that are tried.
const BENDS: f64 = 3.0;
/// A part turns by so much, radians, or it is an error of the poses. Source: chosen by hand.
const LEAST_TURN: f64 = 0.05;
/// Two parts are one if one joint explains such a share of the tracks of each. Source: chosen by
/// hand, never measured.
const TOGETHER: f64 = 0.8;
/// Of a place's neighbours in the picture so many are asked which motion they follow. Source:
/// chosen by hand, never measured.
const NEIGHBOURS: usize = 6;

/// All tracks, what is known of them, and of when.
pub(super) struct Growth<'t, 'a> {
    pub all: &'t [PosedTrack<'a>],
    /// Those that the body explains.
    pub still: &'t [usize],
    pub noise: f64,
    /// What an observation counts as, were it independent of others.
    pub worth: f64,
    /// When the frames were taken; the usual time between two is 1.
    pub times: &'t Arc<[f64]>,
    pub seed: u64,
}

/// Whether a joint has tracks enough, and an angle that changes.
fn turns(path: &JointPath, own: &[usize]) -> bool {
    let angles = path.angles.iter().copied();
    let (least, most) =
        (angles.clone().fold(f64::INFINITY, f64::min), angles.fold(f64::NEG_INFINITY, f64::max));
    own.len() >= LEAST_TRACKS && most - least >= LEAST_TURN
}

impl Growth<'_, '_> {
    /// The joint that explains most of the tracks `odd`, over all frames, and which it explains;
    /// `None` where no part is found.
    pub(super) fn part(&self, odd: &[usize], number: u64) -> Option<(JointPath, Vec<usize>)> {
        let (start, _) = self.seeds(odd, number).into_iter().max_by_key(|s| s.1)?;
        let (path, own) = self.grown(start, odd);
        turns(&path, &own).then_some((path, own))
    }

    /// Parts again, each track with what explains it.
    pub(super) fn shared_out(&self, parts: &[JointPath]) -> Vec<(JointPath, Vec<usize>)> {
        let again = self.owned(parts).into_iter().map(|(path, own)| (self.settled(&path, &own), own));
        self.merged(again.filter(|(path, own)| self.is_part(path, own)).collect())
    }

    /// The parts with their tracks.
    pub(super) fn owned(&self, parts: &[JointPath]) -> Vec<(JointPath, Vec<usize>)> {
        let assigned = self.assigned(parts);
        let own = |k: usize| assigned.iter().filter(|a| a.1 == Some(k)).map(|a| a.0).collect();
        parts.iter().enumerate().map(|(k, path)| (path.clone(), own(k))).collect()
    }

    /// Each track that the body or a joint explains, and which. While a part hardly moves, both
    /// explain its tracks: of these it has those that lie nearer to the places that only it explains
    /// than to those that only the body does.
    pub(super) fn assigned(&self, joints: &[JointPath]) -> Vec<(usize, Option<usize>)> {
        let explained = |i: usize| -> Vec<(Option<usize>, DVec3)> {
            let still = self.all[i].still().filter(|f| f.1 <= MOVING * self.noise).map(|f| (None, f.0));
            let of_joint = |(j, path): (usize, &JointPath)| {
                let (x, _) = self.all[i].point(path).filter(|f| f.1 <= BELONGS * self.noise)?;
                Some((Some(j), x))
            };
            still.into_iter().chain(joints.iter().enumerate().filter_map(of_joint)).collect()
        };
        let all: Vec<Vec<(Option<usize>, DVec3)>> =
            (0..self.all.len()).into_par_iter().map(explained).collect();
        let sure: Vec<(Option<usize>, DVec3)> = all.iter().filter(|e| e.len() == 1).map(|e| e[0]).collect();
        let away = |(of, x): &(Option<usize>, DVec3)| {
            let same = sure.iter().filter(|s| s.0 == *of);
            same.map(|s| s.1.distance_squared(*x)).fold(f64::INFINITY, f64::min)
        };
        let nearest = |(i, found): (usize, &Vec<(Option<usize>, DVec3)>)| {
            let best = found.iter().map(|f| (away(f), f.0)).min_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((i, best.1))
        };
        all.par_iter().enumerate().filter_map(nearest).collect()
    }

    /// Parts on one axis with one angle are one.
    fn merged(&self, mut parts: Vec<(JointPath, Vec<usize>)>) -> Vec<(JointPath, Vec<usize>)> {
        let mut i = 0;
        while i < parts.len() {
            let joined = (i + 1..parts.len()).find_map(|j| Some((j, self.joined(&parts[i], &parts[j])?)));
            match joined {
                Some((j, part)) => {
                    parts[i] = part;
                    parts.remove(j);
                }
                None => i += 1,
            }
        }
        parts
    }

    /// Two parts as one, if one joint explains what both explain.
    fn joined(
        &self,
        a: &(JointPath, Vec<usize>),
        b: &(JointPath, Vec<usize>),
    ) -> Option<(JointPath, Vec<usize>)> {
        let both: Vec<usize> = a.1.iter().chain(&b.1).copied().collect();
        let steadiest = if a.0.bend < b.0.bend { &a.0 } else { &b.0 };
        let path = self.fit(steadiest, &both);
        let kept = |own: &[usize]| self.explained(&path, own).len() as f64 / own.len().max(1) as f64;
        (kept(&a.1) >= TOGETHER && kept(&b.1) >= TOGETHER).then_some((path, both))
    }

    /// Joints of groups of neighbours, each with the observations it explains.
    fn seeds(&self, odd: &[usize], number: u64) -> Vec<(JointPath, usize)> {
        let long: Vec<usize> =
            odd.iter().copied().filter(|&i| self.all[i].views.len() >= 2 * LEAST_VIEWS).collect();
        if long.len() < LEAST_TRACKS {
            return Vec::new();
        }
        let mut rng = scene::rng::rng(self.seed, "parts", number);
        let chosen: Vec<usize> = (0..GROUPS).map(|_| long[rng.random_range(0..long.len())]).collect();
        let found = chosen.into_iter().filter_map(|i| {
            let window = self.window(i);
            let group = self.group(i, &window, odd);
            if group.len() < LEAST_VIEWS {
                return None;
            }
            let tracks: Vec<&PosedTrack<'_>> = group.iter().map(|&k| &self.all[k]).collect();
            let tried = joints(&tracks, window, self.times, self.noise).into_iter().map(|start| {
                let path = start.refined(&tracks, self.noise, 15);
                let count = self.explained(&path, odd).iter().map(|&k| self.all[k].views.len()).sum();
                (path, count)
            });
            tried.max_by_key(|t| t.1)
        });
        found.collect()
    }

    /// The frames in the middle of a track.
    fn window(&self, track: usize) -> Range<usize> {
        let views = &self.all[track].views;
        let (first, last) = (views[0].0, views[views.len() - 1].0 + 1);
        let spare = (last - first).saturating_sub(GROUP[1]) / 2;
        first + spare..last - spare
    }

    /// A track and those nearest to it in the picture, of those seen in most of the frames.
    fn group(&self, track: usize, window: &Range<usize>, odd: &[usize]) -> Vec<usize> {
        let mut near: Vec<(f64, usize)> = odd
            .par_iter()
            .filter_map(|&k| {
                let apart: Vec<f64> = window
                    .clone()
                    .filter_map(|f| Some(self.all[k].pixel(f)?.distance(self.all[track].pixel(f)?)))
                    .collect();
                (2 * apart.len() >= window.len() && apart.len() >= LEAST_VIEWS).then(|| (median(apart), k))
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.into_iter().take(GROUP[0]).map(|n| n.1).collect()
    }

    /// Which tracks are points of a part on this joint.
    fn explained(&self, path: &JointPath, odd: &[usize]) -> Vec<usize> {
        let fits = |&i: &usize| self.all[i].point(path).is_some_and(|(_, e)| e <= BELONGS * self.noise);
        odd.par_iter().copied().filter(fits).collect()
    }

    /// The joint over all frames, a few more at a time.
    fn grown(&self, start: JointPath, odd: &[usize]) -> (JointPath, Vec<usize>) {
        let mut path = start;
        let mut own = self.explained(&path, odd);
        loop {
            let before = path.angles.len();
            path = path.extended((before / 4).max(2), self.times.len());
            path = self.fit(&path, &own);
            own = self.explained(&path, odd);
            if path.angles.len() == before {
                break;
            }
        }
        // How steady it is, the angles say themselves.
        for _ in 0..3 {
            path = self.settled(&path, &own);
            own = self.explained(&path, odd);
        }
        (path, own)
    }

    fn fit(&self, path: &JointPath, own: &[usize]) -> JointPath {
        path.refined(&self.tracks(own), self.worth, 30)
    }

    fn tracks(&self, own: &[usize]) -> Vec<&PosedTrack<'_>> {
        own.iter().map(|&i| &self.all[i]).collect()
    }

    /// The joint as unsteady as the tracks say: of some, what has the greatest evidence. Where
    /// nothing was seen of the part its rate is what it was before, the more so the steadier it is.
    fn settled(&self, path: &JointPath, own: &[usize]) -> JointPath {
        let tracks = self.tracks(own);
        let tried = (0..).map(|k| LEAST_BEND * BENDS.powi(k)).take_while(|b| *b <= FIRST_BEND);
        let tried = tried.map(|bend| {
            let start = JointPath { bend, ..path.clone() };
            let found = start.refined(&tracks, self.worth, 30);
            (found.evidence(&tracks, self.worth), found)
        });
        let best = tried.max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or_else(|| path.clone(), |b| b.1)
    }

    /// Whether it is a part that has a place in the picture to itself: reflections go over what
    /// stands still.
    pub(super) fn is_part(&self, path: &JointPath, own: &[usize]) -> bool {
        let own: Vec<usize> = own.iter().copied().filter(|i| self.still.binary_search(i).is_err()).collect();
        let own = &own[..];
        if !turns(path, own) {
            return false;
        }
        let fits = self.explained(path, self.still);
        let others: Vec<usize> =
            self.still.iter().copied().filter(|i| fits.binary_search(i).is_err()).collect();
        let alone: Vec<f64> = own.par_iter().filter_map(|&i| self.alone(i, own, &others)).collect();
        !alone.is_empty() && median(alone) > 0.5
    }

    /// Of the nearest neighbours of a track, in the middle of its time, the share that is the
    /// part's; `others` are the body's and cannot be the part's.
    fn alone(&self, track: usize, own: &[usize], others: &[usize]) -> Option<f64> {
        let views = &self.all[track].views;
        let (frame, view) = &views[views.len() / 2];
        let near = |of: &[usize], part: bool| -> Vec<(f64, bool)> {
            let others = of.iter().filter(|&&i| i != track);
            let apart = others.filter_map(|&i| Some(self.all[i].pixel(*frame)?.distance(view.pixel)));
            apart.map(|d| (d, part)).collect()
        };
        let mut all = near(own, true);
        all.extend(near(others, false));
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.truncate(NEIGHBOURS);
        let part = all.iter().filter(|n| n.1).count();
        (!all.is_empty()).then(|| part as f64 / all.len() as f64)
    }
}
