//! Which cameras there are and what is known of them before anything is solved.

use crate::config::{CameraSharing, SfmConfig};
use crate::error::SfmError;
use crate::knowledge::Calibration;
use crate::knowledge::Knowledge;
use crate::model_selection::camera::FOCAL_SIGMA;
use crate::plausibility::camera_prior::usual_focal_px;
use scene::{Camera, CameraModel, Frame, FrameSet, WideLens};
use std::collections::BTreeMap;

/// Cameras, and which image was taken with which.
#[derive(Default)]
pub(crate) struct Setup {
    /// Start values; numbers count from 1.
    pub cameras: Vec<Camera>,
    /// What is known of each.
    pub known: Vec<Knowledge>,
    /// For each frame the index of its camera.
    pub camera_of: Vec<usize>,
}

impl Setup {
    pub(crate) fn new(frames: &FrameSet, config: &SfmConfig) -> Result<Self, SfmError> {
        // Until the evidence has spoken, one focal length and one radial term.
        let model = config.camera_model.model().unwrap_or(CameraModel::SimpleRadial);
        let mut setup = Self::default();
        let mut index: BTreeMap<(u32, u32, u32, usize), usize> = BTreeMap::new();
        for (i, frame) in frames.frames.iter().enumerate() {
            let (group, each) = match config.cameras {
                CameraSharing::Group => (frame.camera_group, 0),
                CameraSharing::Single => (0, 0),
                CameraSharing::Each => (0, i),
            };
            let next = setup.cameras.len();
            let camera = *index.entry((group, frame.width, frame.height, each)).or_insert(next);
            setup.camera_of.push(camera);
            if camera < next {
                continue;
            }
            let guess = usual_focal_px(frame.width, frame.height);
            let prior = frame.focal_prior_px.filter(|f| f.is_finite() && *f > 0.0);
            let id = next as u32 + 1;
            let mut camera = Camera::centred(id, model, frame.width, frame.height, prior.unwrap_or(guess));
            let given = config.calibration_of(frame.width, frame.height)?.or_else(|| cut(frames, frame));
            if let Some(Calibration { camera: known, .. }) = &given {
                (camera.model, camera.params) = (known.model, known.params.clone());
            }
            camera.has_prior_focal = given.is_some() || prior.is_some();
            let focal_sigma = prior.map(|_| FOCAL_SIGMA);
            let fixed = given.is_some();
            let calibration = given.filter(|c| c.sigmas.iter().any(|s| *s > 0.0));
            setup.known.push(Knowledge { fixed, focal_sigma, calibration });
            setup.cameras.push(camera);
        }
        Ok(setup)
    }

    /// One camera a frame.
    pub(crate) fn of_frames(&self) -> Vec<Camera> {
        self.camera_of.iter().map(|&c| self.cameras[c].clone()).collect()
    }
}

/// The camera of a view that was cut from a panorama.
fn cut(frames: &FrameSet, view: &Frame) -> Option<Calibration> {
    let focal = view.focal_prior_px.filter(|_| frames.wide_lens == Some(WideLens::Panorama))?;
    let camera = Camera::centred(1, CameraModel::SimplePinhole, view.width, view.height, focal);
    Some(Calibration { sigmas: vec![0.0; camera.params.len()], camera })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames() -> FrameSet {
        let frame = |group, width, prior| Frame {
            width,
            height: 480,
            camera_group: group,
            focal_prior_px: prior,
            ..Frame::default()
        };
        let frames =
            vec![frame(0, 640, None), frame(0, 640, None), frame(0, 800, Some(900.0)), frame(1, 640, None)];
        FrameSet { frames, ..FrameSet::default() }
    }

    #[test]
    fn images_of_one_group_and_size_share_a_camera_unless_told_otherwise() {
        let with = |cameras| SfmConfig { cameras, ..SfmConfig::default() };
        let of = |cameras| Setup::new(&frames(), &with(cameras)).unwrap().camera_of;
        assert_eq!(of(CameraSharing::Group), [0, 0, 1, 2]);
        assert_eq!(of(CameraSharing::Single), [0, 0, 1, 0]);
        assert_eq!(of(CameraSharing::Each), [0, 1, 2, 3]);
    }

    #[test]
    fn the_camera_of_views_of_panoramas_is_known() {
        let mut views = frames();
        views.wide_lens = Some(WideLens::Panorama);
        let setup = Setup::new(&views, &SfmConfig::default()).unwrap();
        assert!(setup.known[1].fixed && setup.cameras[1].params == [900.0, 400.0, 240.0]);
        assert!(!setup.known[0].fixed, "nothing is known of a view without a focal length");
    }

    #[test]
    fn a_focal_length_is_guessed_unless_it_is_known() {
        let setup = Setup::new(&frames(), &SfmConfig::default()).unwrap();
        assert_eq!(setup.cameras[0].mean_focal(), 1.2 * 640.0);
        assert!(!setup.cameras[0].has_prior_focal && setup.known[0].focal_sigma.is_none());
        assert_eq!(setup.cameras[1].mean_focal(), 900.0);
        assert!(setup.cameras[1].has_prior_focal && setup.known[1].focal_sigma.is_some());
        let given = SfmConfig { intrinsics: Some(vec![500.0, 300.0, 200.0]), ..SfmConfig::default() };
        let setup = Setup::new(&frames(), &given).unwrap();
        assert!(setup.known[0].fixed && setup.cameras[0].params == [500.0, 300.0, 200.0]);
        assert!(setup.known[0].calibration.is_none());
        let near = SfmConfig { intrinsics_sigma: Some(vec![1.0, 0.0, 2.0]), ..given };
        let setup = Setup::new(&frames(), &near).unwrap();
        assert!(
            setup.known[0].fixed && setup.known[0].calibration.as_ref().unwrap().sigmas == [1.0, 0.0, 2.0]
        );
        let wrong = SfmConfig { intrinsics_sigma: Some(vec![1.0, 2.0]), ..near };
        assert!(matches!(Setup::new(&frames(), &wrong), Err(SfmError::BadSigmas { given: 2, .. })));
    }
}
