//! Whether a finished model is right: features of it that wrong models lack, and the probability
//! that follows from them.

pub(crate) mod camera_prior;
mod graph;
mod matches;
mod points;
mod second;

use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use crate::result::Uncertainty;
use crate::statistics::median;
use crate::tracks::Tracks;
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};
use scene::{Camera, Progress};

/// A finished model and what it rests on.
pub(crate) struct FinishedModel<'a> {
    pub state: &'a MapState,
    pub input: &'a MappingInput<'a>,
    pub tracks: &'a Tracks,
    /// Cameras as they were before anything was solved.
    pub cameras: &'a [Camera],
    pub known: &'a [Knowledge],
    pub uncertainty: Option<&'a Uncertainty>,
    pub progress: &'a Progress,
}

impl FinishedModel<'_> {
    /// The features of the model.
    pub(crate) fn features(&self) -> Result<Vec<Measurement>, SfmError> {
        let Self { state, input, tracks, .. } = *self;
        let pairs = matches::pair_agreement(state, input);
        let explained = matches::explained_keypoints(state, input);
        let shares: Vec<f64> = explained.iter().map(|(n, all)| *n as f64 / (*all).max(1) as f64).collect();
        let firm: Vec<f64> = points::firm_points(state).iter().map(|n| *n as f64).collect();
        let views: Vec<Vec<usize>> =
            state.live().map(|(_, p)| p.views.iter().map(|v| v[0] as usize).collect()).collect();
        let images = state.registered_count();
        let (focal, distortion) = self.camera_surprise();
        let averaged = crate::global::averaged_rotations(input, &state.cameras, self.progress)?;
        let (turned, turned_share) = second::disagreement(state, &averaged);
        let other = second::global_rotations(state, input, tracks, self.known, self.progress)?;
        let (differs, differs_share) = second::disagreement(state, &other);
        let sigmas = self.uncertainty.iter().flat_map(|u| u.images.values());
        let sigmas: Vec<f64> =
            sigmas.map(|d| d.rotation.iter().fold(0.0_f64, |m, r| m.max(*r)).to_degrees()).collect();
        let values = [
            (Quantity::FocalSurprise, focal),
            (Quantity::DistortionSurprise, distortion),
            (Quantity::RegisteredShare, images as f64 / input.keypoints.len() as f64),
            (Quantity::AgreeingPairs, pairs.matches),
            (Quantity::ContradictingPairs, pairs.contradicting),
            (Quantity::ExplainedKeypoints, median(shares.clone())),
            (Quantity::LeastExplained, tenth(shares)),
            (Quantity::FirmPoints, median(firm.clone())),
            (Quantity::LeastFirm, tenth(firm)),
            (Quantity::PointAngle, points::median_angle_deg(state)),
            (Quantity::WeakestLink, graph::weakest_link(state.poses.len(), &views)),
            (Quantity::HeldOutAgreement, points::held_out_share(state, input, tracks).unwrap_or(f64::NAN)),
            (Quantity::AveragedDifference, turned),
            (Quantity::AveragedShare, turned_share),
            (Quantity::SecondDifference, differs),
            (Quantity::SecondShare, differs_share),
            (Quantity::Noise, self.uncertainty.map_or(f64::NAN, |u| u.sigma_px)),
            (Quantity::RotationDeviation, median(sigmas)),
        ];
        Ok(values.map(|(quantity, value)| Measurement::new(quantity, value)).to_vec())
    }

    /// How far the most unusual camera is from real ones: focal length and distortion.
    fn camera_surprise(&self) -> (f64, f64) {
        let mut most = (0.0_f64, 0.0_f64);
        for (i, camera) in self.state.cameras.iter().enumerate().filter(|(i, _)| !self.known[*i].fixed) {
            let stated = self.known[i].focal_sigma.map(|sigma| (self.cameras[i].mean_focal(), sigma));
            most.0 = most.0.max(camera_prior::focal_sigmas(camera, stated));
            most.1 = most.1.max(camera_prior::distortion_sigmas(camera));
        }
        most
    }

    /// Judges it.
    pub(crate) fn judge(&self) -> Result<Decision, SfmError> {
        let features = self.features()?;
        let probability = Measurement::new(Quantity::Probability, f64::NAN);
        Ok(Decision::new(Subject::Plausibility, probability, Rule::Evidence).with_all(features))
    }
}

/// The value below which a tenth of the values lie.
fn tenth(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 10).copied().unwrap_or(0.0)
}
