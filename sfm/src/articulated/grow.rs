//! From a joint that explains a few tracks over a few frames to one for all frames.

use super::joint::JointPath;
use super::limits::{
    BELONGS, BENDS, FOLLOWS, GROUP, LEAST_TRACKS, LEAST_TURN, LEAST_VIEWS, MOVING, NEIGHBOURS,
};
use super::posed::PosedTrack;
use super::search::joints;
use crate::error::SfmError;
use crate::statistics::median;
use glam::DVec3;
use rand::Rng as _;
use rayon::prelude::*;
use scene::Progress;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// All tracks, what is known of them, and of when.
pub(super) struct Growth<'t, 'a> {
    /// Tracks long enough to tell.
    pub all: &'t [PosedTrack<'a>],
    /// Those that the body explains.
    pub still: &'t [usize],
    /// Standard deviation of an observation of the body, pixels.
    pub noise: f64,
    /// What it counts as, were it independent of others.
    pub worth: f64,
    /// When the frames were taken; the usual time between two is 1.
    pub times: &'t Arc<[f64]>,
    /// Of the random choices.
    pub seed: u64,
}

/// What may explain a track: the body or a joint, and its place at rest that follows.
#[derive(Clone, Copy)]
struct Explanation {
    joint: Option<usize>,
    place: DVec3,
}

impl Explanation {
    /// The squared distance to the nearest of the places that have the same explanation.
    fn away(&self, sure: &[Self]) -> f64 {
        let same = sure.iter().filter(|s| s.joint == self.joint);
        same.map(|s| s.place.distance_squared(self.place)).fold(f64::INFINITY, f64::min)
    }
}

/// Whether a joint has tracks enough, and an angle that changes.
fn turns(path: &JointPath, own: &[usize]) -> bool {
    let angles = path.angles.iter().copied();
    let (least, most) =
        (angles.clone().fold(f64::INFINITY, f64::min), angles.fold(f64::NEG_INFINITY, f64::max));
    own.len() >= LEAST_TRACKS && most - least >= LEAST_TURN
}

impl Growth<'_, '_> {
    /// Parts among the tracks `rest`, one after the other, and then each track with what explains
    /// it.
    pub(super) fn found(
        &self,
        mut rest: Vec<usize>,
        progress: &Progress,
    ) -> Result<Vec<(JointPath, Vec<usize>)>, SfmError> {
        let mut paths = Vec::new();
        loop {
            progress.check()?;
            let Some((path, own)) = self.part(&rest, paths.len() as u64) else { break };
            rest.retain(|i| !own.contains(i));
            paths.push(path);
        }
        Ok(self.shared_out(&paths))
    }

    /// The joint that explains most of the tracks `odd`, over all frames, and which it explains;
    /// `None` where no part is found.
    fn part(&self, odd: &[usize], number: u64) -> Option<(JointPath, Vec<usize>)> {
        let (start, _) = self.seeds(odd, number).into_iter().max_by_key(|s| s.1)?;
        let (path, own) = self.grown(start, odd);
        turns(&path, &own).then_some((path, own))
    }

    /// Parts again, each track with what explains it.
    pub(super) fn shared_out(&self, parts: &[JointPath]) -> Vec<(JointPath, Vec<usize>)> {
        let again = self.owned(parts).into_iter().map(|(path, own)| (self.settled(&path, &own), own));
        again.filter(|(path, own)| self.is_part(path, own)).collect()
    }

    /// The parts with their tracks.
    pub(super) fn owned(&self, parts: &[JointPath]) -> Vec<(JointPath, Vec<usize>)> {
        let assigned = self.assigned(parts);
        let owned = parts.iter().enumerate().map(|(k, path)| {
            let own = assigned.iter().filter(|a| a.1 == Some(k));
            (path.clone(), own.map(|a| a.0).collect())
        });
        owned.collect()
    }

    /// Each track that the body or a joint explains, and which. While a part hardly moves, both
    /// explain its tracks: of these it has those that lie nearer to the places that only it
    /// explains than to those that only the body does.
    pub(super) fn assigned(&self, joints: &[JointPath]) -> Vec<(usize, Option<usize>)> {
        let all: Vec<Vec<Explanation>> =
            (0..self.all.len()).into_par_iter().map(|i| self.explanations(i, joints)).collect();
        let sure: Vec<Explanation> = all.iter().filter(|e| e.len() == 1).map(|e| e[0]).collect();
        let nearest = all.par_iter().enumerate().filter_map(|(i, found)| {
            let away = found.iter().map(|e| (e.away(&sure), e.joint));
            Some((i, away.min_by(|a, b| a.0.total_cmp(&b.0))?.1))
        });
        nearest.collect()
    }

    /// All that may explain a track, the body first.
    fn explanations(&self, track: usize, joints: &[JointPath]) -> Vec<Explanation> {
        let track = &self.all[track];
        let still = track.still().filter(|f| f.1 <= MOVING * self.noise);
        let still = still.map(|(place, _)| Explanation { joint: None, place });
        let turning = joints.iter().enumerate().filter_map(|(j, path)| {
            let (place, _) = track.point(path).filter(|f| f.1 <= BELONGS * self.noise)?;
            Some(Explanation { joint: Some(j), place })
        });
        still.into_iter().chain(turning).collect()
    }

    /// Joints of groups of neighbours, each with the observations it explains.
    fn seeds(&self, odd: &[usize], number: u64) -> Vec<(JointPath, usize)> {
        let long: Vec<usize> =
            odd.iter().copied().filter(|&i| self.all[i].views.len() >= 2 * LEAST_VIEWS).collect();
        if long.len() < LEAST_TRACKS {
            return Vec::new();
        }
        let [groups, ..] = GROUP;
        let mut rng = scene::rng::rng(self.seed, "parts", number);
        let chosen: Vec<usize> = (0..groups).map(|_| long[rng.random_range(0..long.len())]).collect();
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
        let spare = (last - first).saturating_sub(GROUP[2]) / 2;
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
        near.into_iter().take(GROUP[1]).map(|n| n.1).collect()
    }

    /// Which tracks are points of a part on this joint.
    fn explained(&self, path: &JointPath, odd: &[usize]) -> Vec<usize> {
        let most = BELONGS * self.noise;
        odd.par_iter().copied().filter(|&i| self.all[i].point(path).is_some_and(|p| p.1 <= most)).collect()
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

    /// The joint that explains these tracks best.
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
        let tried = BENDS.into_iter().map(|bend| {
            let start = JointPath { bend, ..path.clone() };
            let found = start.refined(&tracks, self.worth, 30);
            (found.evidence(&tracks, self.worth), found)
        });
        let best = tried.max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or_else(|| path.clone(), |b| b.1)
    }

    /// Whether the camera goes round it hardly as far as round the body: so do highlights on, and
    /// outlines of, what is round.
    fn follows_camera(&self, path: &JointPath, own: &[usize]) -> bool {
        let seen = own.iter().flat_map(|&i| &self.all[i].views);
        let eyes: BTreeMap<usize, DVec3> = seen.map(|(frame, v)| (*frame, v.pose.centre())).collect();
        let arms = eyes.iter().filter_map(|(frame, eye)| {
            let arm = (*eye - path.place).normalize();
            Some((arm, path.pose(*frame)?.rotation.conjugate() * arm))
        });
        let (body, part): (Vec<DVec3>, Vec<DVec3>) = arms.unzip();
        let way = |arms: &[DVec3]| arms.windows(2).map(|w| w[0].angle_between(w[1])).sum::<f64>();
        way(&part) < FOLLOWS * way(&body)
    }

    /// Whether it is a part that has a place in the picture to itself: reflections go over what
    /// stands still.
    pub(super) fn is_part(&self, path: &JointPath, own: &[usize]) -> bool {
        let own: Vec<usize> = own.iter().copied().filter(|i| self.still.binary_search(i).is_err()).collect();
        let own = &own[..];
        if !turns(path, own) || self.follows_camera(path, own) {
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
        let mut all: Vec<(f64, bool)> = self.apart(track, own).into_iter().map(|d| (d, true)).collect();
        all.extend(self.apart(track, others).into_iter().map(|d| (d, false)));
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.truncate(NEIGHBOURS);
        let part = all.iter().filter(|n| n.1).count();
        (!all.is_empty()).then(|| part as f64 / all.len() as f64)
    }

    /// How far tracks are from this one in the picture, in the middle of its time, pixels.
    fn apart(&self, track: usize, others: &[usize]) -> Vec<f64> {
        let views = &self.all[track].views;
        let (frame, view) = &views[views.len() / 2];
        let others = others.iter().filter(|&&i| i != track);
        others.filter_map(|&i| Some(self.all[i].pixel(*frame)?.distance(view.pixel))).collect()
    }
}
