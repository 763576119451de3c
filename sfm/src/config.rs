//! What a user can say about structure from motion, declared once: flag, default, file key and
//! report row.

use crate::circular::MotionConfig;
use crate::error::SfmError;
use crate::incremental::MapperConfig;
use crate::klt::KltConfig;
use crate::knowledge::Calibration;
use crate::matching::MatchConfig;
use crate::metric::ScaleConfig;
use crate::pairs::PairConfig;
use crate::sift::SiftConfig;
use crate::skip::{self, StepName};
use crate::two_view::TwoViewConfig;
use scene::flag::between;
use scene::{Camera, CameraModel};
use serde::{Deserialize, Serialize};

/// The camera model to solve for.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[value(rename_all = "SCREAMING_SNAKE_CASE")]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum CameraModelChoice {
    /// The evidence decides: held-out error and BIC over several models
    #[default]
    #[value(name = "auto")]
    #[serde(rename = "auto")]
    Auto,
    /// f, cx, cy
    SimplePinhole,
    /// fx, fy, cx, cy
    Pinhole,
    /// f, cx, cy, k
    SimpleRadial,
    /// f, cx, cy, k1, k2
    Radial,
    /// fx, fy, cx, cy, k1, k2, p1, p2
    Opencv,
}

impl CameraModelChoice {
    /// The model, if the user named one.
    pub(crate) fn model(self) -> Option<CameraModel> {
        match self {
            Self::Auto => None,
            Self::SimplePinhole => Some(CameraModel::SimplePinhole),
            Self::Pinhole => Some(CameraModel::Pinhole),
            Self::SimpleRadial => Some(CameraModel::SimpleRadial),
            Self::Radial => Some(CameraModel::Radial),
            Self::Opencv => Some(CameraModel::Opencv),
        }
    }
}

/// Which images share intrinsics.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraSharing {
    /// One camera for each group of equal device, focal setting and image size
    #[default]
    Group,
    /// One camera for all images of a size
    Single,
    /// A camera for every image
    Each,
}

/// Where the keypoints of the last adjustment lie.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KeypointPlaces {
    /// Where the windows about them show what one observation of the point shows, if the model fits
    /// that more closely
    #[default]
    Windows,
    /// Where they were detected
    Detected,
}

/// Configuration of [`crate::reconstruct::reconstruct`].
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SfmConfig {
    /// Seed of all randomness (set from the program's `--seed`).
    #[arg(skip)]
    pub seed: u64,
    /// Whether the matches before verification are handed back too.
    #[arg(skip)]
    pub keep_matches: bool,
    /// Camera model to solve for
    #[arg(long, value_enum, default_value_t = CameraModelChoice::Auto, help_heading = "Structure from motion")]
    pub camera_model: CameraModelChoice,
    /// Known intrinsics, kept as they are: `f,cx,cy`, `fx,fy,cx,cy`, or all parameters of
    /// --camera-model
    #[arg(long, value_parser = between::<f64>(-1e9, 1e9), value_delimiter = ',', value_name = "PARAMS", help_heading = "Structure from motion")]
    pub intrinsics: Option<Vec<f64>>,
    /// Standard deviations of --intrinsics, one a number (0: exact); the last adjustments take them
    /// for priors
    #[arg(
        long, value_parser = between::<f64>(0.0, 1e9),
        value_delimiter = ',',
        value_name = "SIGMAS",
        requires = "intrinsics",
        help_heading = "Structure from motion"
    )]
    pub intrinsics_sigma: Option<Vec<f64>>,
    /// The camera as calibrated before (set from the program's `--camera-from`).
    #[arg(skip)]
    pub calibration: Option<Calibration>,
    /// Which images share intrinsics
    #[arg(long, value_enum, default_value_t = CameraSharing::Group, help_heading = "Structure from motion")]
    pub cameras: CameraSharing,
    /// Where keypoints lie in the last adjustment of photos
    #[arg(long, value_enum, default_value_t = KeypointPlaces::Windows, help_heading = "Structure from motion")]
    pub keypoints: KeypointPlaces,
    /// Steps that are left out.
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "STEPS",
        help_heading = "Structure from motion",
        long_help = skip::HELP
    )]
    pub skip: Vec<StepName>,
    /// The motion.
    #[command(flatten)]
    pub motion: MotionConfig,
    /// The scale.
    #[command(flatten)]
    pub scale: ScaleConfig,
    /// Points followed through videos.
    #[command(flatten)]
    pub klt: KltConfig,
    /// Features.
    #[command(flatten)]
    pub sift: SiftConfig,
    /// Choice of pairs.
    #[command(flatten)]
    pub pairs: PairConfig,
    /// Matching.
    #[command(flatten)]
    pub matching: MatchConfig,
    /// Verification of pairs.
    #[command(flatten)]
    pub two_view: TwoViewConfig,
    /// The mapper.
    #[command(flatten)]
    pub mapper: MapperConfig,
}

impl SfmConfig {
    /// What is known of a camera whose images have this size: an earlier calibration, or what
    /// `--intrinsics` and `--intrinsics-sigma` say.
    pub(crate) fn calibration_of(&self, width: u32, height: u32) -> Result<Option<Calibration>, SfmError> {
        if let Some(known) = &self.calibration {
            let (of_width, of_height) = (known.camera.width, known.camera.height);
            let scaled = known.scaled_to(width, height);
            return scaled.map(Some).ok_or(SfmError::OtherShape { width, height, of_width, of_height });
        }
        let Some((model, params)) = self.known_intrinsics()? else { return Ok(None) };
        let sigmas = self.intrinsics_sigma.clone().unwrap_or_else(|| vec![0.0; params.len()]);
        if sigmas.len() != params.len() || !sigmas.iter().all(|s| s.is_finite() && *s >= 0.0) {
            return Err(SfmError::BadSigmas { given: sigmas.len(), wanted: params.len() });
        }
        let camera = Camera { model, params, ..Camera::centred(1, model, width, height, 1.0) };
        Ok(Some(Calibration { camera, sigmas }))
    }

    /// The model and parameters that `--intrinsics` means; an error where their number fits no
    /// model.
    pub(crate) fn known_intrinsics(&self) -> Result<Option<(CameraModel, Vec<f64>)>, SfmError> {
        let Some(params) = &self.intrinsics else { return Ok(None) };
        let named = self.camera_model.model();
        let model = named.or(match params.len() {
            3 => Some(CameraModel::SimplePinhole),
            4 => Some(CameraModel::Pinhole),
            5 => Some(CameraModel::Radial),
            8 => Some(CameraModel::Opencv),
            _ => None,
        });
        let fits = model.filter(|m| m.num_params() == params.len());
        let sane = params.iter().all(|p| p.is_finite());
        match fits {
            Some(model) if sane && params[..model.num_focals()].iter().all(|&f| f > 0.0) => {
                Ok(Some((model, params.clone())))
            }
            _ => Err(SfmError::BadIntrinsics {
                given: params.len(),
                model: model.map_or("any model", CameraModel::name).to_owned(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_intrinsics_names_the_model_unless_one_is_given() {
        let with = |model, n: usize| SfmConfig {
            camera_model: model,
            intrinsics: Some(vec![100.0; n]),
            ..SfmConfig::default()
        };
        let model = |c: SfmConfig| c.known_intrinsics().map(|k| k.map(|(m, _)| m));
        assert_eq!(model(with(CameraModelChoice::Auto, 3)).unwrap(), Some(CameraModel::SimplePinhole));
        assert_eq!(model(with(CameraModelChoice::SimpleRadial, 4)).unwrap(), Some(CameraModel::SimpleRadial));
        assert!(model(with(CameraModelChoice::Opencv, 4)).is_err());
        assert!(model(with(CameraModelChoice::Auto, 6)).is_err());
        assert_eq!(model(SfmConfig::default()).unwrap(), None);
    }

    #[test]
    fn flags_and_default_agree() {
        #[derive(clap::Parser)]
        struct Cli {
            #[command(flatten)]
            sfm: SfmConfig,
        }
        let parsed = <Cli as clap::Parser>::parse_from(["x"]).sfm;
        assert_eq!(parsed, SfmConfig::default());
        let text = serde_json::to_string(&parsed).unwrap();
        assert_eq!(serde_json::from_str::<SfmConfig>(&text).unwrap(), parsed);
    }
}
