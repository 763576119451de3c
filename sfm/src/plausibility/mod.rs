//! Whether a finished model is right: features of it that wrong models lack, and the probability
//! that follows from them (docs/decisions/20).

pub(crate) mod camera_prior;
mod graph;
mod matches;
mod points;
mod probability;
mod second;
#[cfg(test)]
mod tests;

use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use probability::weigh;
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule, Subject};
use scene::{Camera, Progress};

/// Models of less probability are doubtful.
/// Source: docs/decisions/20.
const DOUBTFUL: f64 = 0.9;
/// A finished model and what it rests on.
pub(crate) struct FinishedModel<'a> {
    pub state: &'a MapState,
    /// Its tracks are those of the verified pairs: what adjustments have left out speaks, too.
    pub input: &'a MappingInput<'a>,
    /// Cameras as they were before anything was solved.
    pub cameras: &'a [Camera],
    pub known: &'a [Knowledge],
    /// The poses follow a law of motion, a turn or a tumble: with one number an image in place of
    /// six, or a dozen for all, that is a second opinion, which agrees.
    pub follows_law: bool,
    pub progress: &'a Progress,
}

impl FinishedModel<'_> {
    /// The probability that the model is right, with all features that it follows from; what speaks
    /// against a doubtful model, too.
    pub(crate) fn judge(&self) -> Result<Decision, SfmError> {
        let link = graph::weakest_link_of(self.state);
        let tied = link.as_ref().is_none_or(graph::WeakestLink::ties);
        let mut features = self.features(link.map_or(f64::NAN, |link| link.share));
        if tied && !self.follows_law {
            features.extend(self.second_solution()?);
        }
        // Of all places that parts could take to each other the model has one.
        let untied = (0.0, vec![Remark::PartsNotTied]);
        let mut opinions = features.clone();
        if self.follows_law {
            opinions.push(Measurement::new(Quantity::SecondDifference, 0.0));
        }
        let (probability, against) = if tied { weigh(&opinions) } else { untied };
        let choice = Measurement::new(Quantity::Probability, probability);
        let mut decision = Decision::new(Subject::Plausibility, choice, Rule::Evidence).with_all(features);
        if !(probability >= DOUBTFUL) {
            decision = decision.remarked(Remark::Doubtful);
            decision.remarks.extend(against);
        }
        Ok(decision)
    }

    /// What the model shows by itself.
    fn features(&self, weakest_link: f64) -> Vec<Measurement> {
        let Self { state, input, .. } = *self;
        let explained = matches::explained_keypoints(state, input);
        let shares: Vec<f64> = explained.iter().map(|(n, all)| *n as f64 / *all as f64).collect();
        let firm: Vec<f64> = points::firm_points(state).iter().map(|n| *n as f64).collect();
        let values = [
            (Quantity::CameraSurprise, self.camera_surprise()),
            (Quantity::AgreeingPairs, matches::agreeing_share(state, input)),
            (Quantity::LeastExplained, tenth(shares)),
            (Quantity::LeastFirm, tenth(firm)),
            (Quantity::PointAngle, points::median_angle_deg(state)),
            (Quantity::WeakestLink, weakest_link),
            (Quantity::HeldOutAgreement, points::held_out_share(state, input)),
        ];
        values.map(|(quantity, value)| Measurement::new(quantity, value)).to_vec()
    }

    /// How far a second solution is from it. Nothing where no pair has a relative pose, as along
    /// the frames of a turn.
    fn second_solution(&self) -> Result<Option<Measurement>, SfmError> {
        let Self { state, input, progress, .. } = *self;
        if !input.geometries.iter().any(|g| g.f.is_some() || g.e.is_some() || g.b_from_a.is_some()) {
            return Ok(None);
        }
        let other = second::rotations(state, input, progress)?;
        Ok(Some(Measurement::new(Quantity::SecondDifference, second::difference_deg(state, &other))))
    }

    /// How far the most unusual camera is from real ones, standard deviations.
    fn camera_surprise(&self) -> f64 {
        let mut most = 0.0_f64;
        for (i, camera) in self.state.cameras.iter().enumerate().filter(|(i, _)| !self.known[*i].fixed) {
            let stated = self.known[i].focal_sigma.map(|sigma| (self.cameras[i].mean_focal(), sigma));
            let focal = camera_prior::focal_sigmas(camera, stated);
            most = most.max(focal.hypot(camera_prior::distortion_sigmas(camera)));
        }
        most
    }
}

/// The value below which a tenth of the values lie; none of none.
fn tenth(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 10).copied().unwrap_or(f64::NAN)
}
