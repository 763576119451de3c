//! What is known of cameras before anything is solved.

use crate::bundle::IntrinsicsPrior;
use scene::Camera;
use serde::{Deserialize, Serialize};

/// A camera as an earlier calibration found it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Model, image size and parameters.
    pub camera: Camera,
    /// Standard deviations of the parameters; 0: exact.
    pub sigmas: Vec<f64>,
}

impl Calibration {
    /// The same camera at another size of its images; `None` where their shape is another.
    pub fn scaled_to(&self, width: u32, height: u32) -> Option<Self> {
        let [w, h] = [self.camera.width, self.camera.height].map(u64::from);
        // Sides are rounded when images are made smaller.
        let skew = (w * u64::from(height)).abs_diff(h * u64::from(width));
        if skew > w.max(h) || w == 0 || h == 0 {
            return None;
        }
        let camera = self.camera.scaled(width, height);
        let in_pixels = camera.model.num_focals() + 2;
        let factor = f64::from(width) / w as f64;
        let sigmas = self.sigmas.iter().enumerate().map(|(i, s)| if i < in_pixels { s * factor } else { *s });
        Some(Self { sigmas: sigmas.collect(), camera })
    }
}

/// What is known of one of the cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct Knowledge {
    /// All of it: the model grows with it as it is, and nothing is chosen.
    pub fixed: bool,
    /// Standard deviation of the focal length known beforehand, as a share of it.
    pub focal_sigma: Option<f64>,
    /// How well what is `fixed` is known; `None`: exactly. The last adjustments solve for it with
    /// this as a prior.
    pub calibration: Option<Calibration>,
}

impl Knowledge {
    /// Nothing is to be solved for, ever.
    #[cfg(test)]
    pub(crate) fn exact() -> Self {
        Self { fixed: true, ..Self::default() }
    }

    /// Which parameters of camera `index`, all of it known, the last adjustments solve for, and
    /// what holds them.
    pub(crate) fn freedom(&self, index: usize, parameters: usize) -> (Vec<bool>, Vec<IntrinsicsPrior>) {
        let Some(Calibration { camera, sigmas }) = &self.calibration else {
            return (vec![false; parameters], Vec::new());
        };
        let prior = |(parameter, (&mean, &sigma)): (usize, (&f64, &f64))| {
            (sigma > 0.0).then_some(IntrinsicsPrior { camera: index, parameter, mean, sigma })
        };
        let priors = camera.params.iter().zip(sigmas).enumerate().filter_map(prior).collect();
        (sigmas.iter().map(|s| *s > 0.0).collect(), priors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::CameraModel;

    #[test]
    fn a_calibration_follows_the_size_of_the_images_and_refuses_another_shape() {
        let camera = Camera::centred(1, CameraModel::SimpleRadial, 1920, 1080, 1500.0);
        let known = Calibration { camera, sigmas: vec![3.0, 1.5, 0.0, 0.01] };
        let half = known.scaled_to(960, 540).unwrap();
        assert_eq!(half.camera.params, [750.0, 480.0, 270.0, 0.0]);
        assert_eq!(half.sigmas, [1.5, 0.75, 0.0, 0.01]);
        assert!(known.scaled_to(320, 180).is_some() && known.scaled_to(321, 180).is_some());
        assert!(known.scaled_to(640, 480).is_none() && known.scaled_to(1080, 1920).is_none());
    }

    #[test]
    fn what_is_known_exactly_is_held_and_the_rest_has_priors() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 500.0);
        let calibration = Some(Calibration { camera, sigmas: vec![2.0, 0.5, 0.0] });
        let (free, priors) = Knowledge { calibration, ..Knowledge::exact() }.freedom(4, 3);
        assert_eq!(free, [true, true, false]);
        assert_eq!(priors.len(), 2);
        assert_eq!(priors[1], IntrinsicsPrior { camera: 4, parameter: 1, mean: 320.0, sigma: 0.5 });
        assert_eq!(Knowledge::exact().freedom(0, 3), (vec![false; 3], Vec::new()));
    }
}
