//! What a backend does: hold the Gaussians, render them, take a training step, say what it saw.

use crate::error::SplatError;
use crate::model::{MAX_SH_DEGREE, Model, padded};
use crate::parts::PartPulls;
use crate::statistics::Statistics;
use crate::view::{PinholeView, RenderOptions, RenderOutput};
use scene::Decision;

/// What a training step is compared with: 8-bit pixels at the view's size.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// [height × width × 3] sRGB, straight (not premultiplied).
    pub rgb: &'a [u8],
    /// [height × width] weight or coverage, white = keep.
    pub mask: Option<&'a [u8]>,
    /// Whether the mask is coverage (the background shows through) or a weight (0 = ignored).
    pub transparent: bool,
    /// Number of the photo: the same number and size always have the same pixels, so that a device
    /// may keep them.
    pub photo: Option<u32>,
}

/// Adam's step sizes for one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearningRates {
    /// Means, normalised scene units.
    pub mean: f32,
    /// Logarithms of the scales.
    pub log_scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Spherical harmonics of degree 0.
    pub sh0: f32,
    /// Higher spherical harmonics.
    pub sh_rest: f32,
}

/// One training step.
#[derive(Clone, Copy, Debug)]
pub struct StepInput<'a> {
    /// The camera.
    pub view: &'a PinholeView,
    /// What it should show.
    pub target: Target<'a>,
    /// Near plane, antialiasing, background, spherical-harmonic degree in use.
    pub options: RenderOptions,
    /// Step sizes.
    pub rates: LearningRates,
    /// Weight of D-SSIM against L1.
    pub lambda_dssim: f32,
}

/// A round of densification.
#[derive(Clone, Copy, Debug)]
pub struct Round<'a> {
    /// Gaussians that may be added.
    pub room: usize,
    /// Of training.
    pub seed: u64,
    /// Of training.
    pub iteration: u32,
    /// Views of which some must have a Gaussian in their picture, where those that hardly any has
    /// are removed.
    pub remove_unseen: Option<&'a [PinholeView]>,
}

/// What a step saw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepOutput {
    /// `(1 − λ) L1 + λ D-SSIM`.
    pub loss: f32,
    /// Mean squared error over the pixels that count.
    pub mse: f32,
    /// Gaussians that touch a tile.
    pub visible: usize,
    /// Gaussian–tile pairs.
    pub pairs: usize,
    /// Gaussians whose gradient was not finite (left unchanged).
    pub non_finite: usize,
    /// What pulls at moving parts; by the processor only.
    pub(crate) pulls: PartPulls,
}

/// Seconds spent in each kernel since the backend was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KernelTimes {
    /// Projection and colour.
    pub project: f64,
    /// Depth sort and binning.
    pub sort: f64,
    /// Rasterisation.
    pub forward: f64,
    /// Loss and its gradient.
    pub loss: f64,
    /// Rasterisation backward.
    pub backward: f64,
    /// Projection backward and Adam.
    pub optimise: f64,
}

/// A place where Gaussians are rendered and trained. All work on the same [`Model`] layout.
pub trait Backend {
    /// What it runs on, in words.
    fn name(&self) -> String;
    /// Takes parameters, moments, and what the steps since the last change saw.
    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError>;
    /// The present parameters, moments and statistics.
    fn download(&mut self) -> Result<(Model, Statistics), SplatError>;
    /// The same, and nothing may stay behind until something is uploaded: no copy where they lie in
    /// the host's memory.
    fn release(&mut self) -> Result<(Model, Statistics), SplatError> {
        self.download()
    }
    /// Shows them to the host as they are, without a copy where they lie in its memory.
    fn show(&mut self, look: &mut dyn FnMut(&Model, &Statistics)) -> Result<(), SplatError> {
        let (model, statistics) = self.download()?;
        look(&model, &statistics);
        Ok(())
    }
    /// Changes between steps: densification, pruning, another spherical-harmonic degree.
    fn edit(&mut self, change: &mut dyn FnMut(&mut Model, &mut Statistics)) -> Result<(), SplatError>;
    /// A round of densification; statistics begin anew. How many were removed because hardly any
    /// view has them.
    fn densify(&mut self, round: &Round) -> Result<usize, SplatError>;
    /// Another spherical-harmonic degree: new coefficients are zero.
    fn set_sh_degree(&mut self, degree: u32) -> Result<(), SplatError> {
        self.edit(&mut |model, _| model.set_sh_degree(degree))
    }
    /// Gaussians held.
    fn gaussians(&self) -> usize;
    /// Spherical-harmonic degree held.
    fn sh_degree(&self) -> u32;
    /// The most Gaussians of a degree that can be trained on views of so many pixels, and what
    /// limits them.
    fn capacity(&self, sh_degree: u32, pixels: usize) -> Option<(usize, String)>;
    /// Renders the Gaussians.
    fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<RenderOutput, SplatError>;
    /// Renders and leaves the picture where it is, as for a display.
    fn render_only(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<(), SplatError> {
        self.render(view, options).map(|_| ())
    }
    /// Bytes allocated on a device, by buffer; nothing where everything lies in the host's memory.
    fn memory(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }
    /// Forward, loss, backward and Adam.
    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError>;
    /// Takes a step or begins it: what those steps saw that have ended since this was last asked,
    /// oldest first.
    fn advance(&mut self, input: &StepInput) -> Result<Vec<StepOutput>, SplatError> {
        self.step(input).map(|output| vec![output])
    }
    /// Waits for the steps that were begun: what those saw that was not yet told.
    fn settle(&mut self) -> Result<Vec<StepOutput>, SplatError> {
        Ok(Vec::new())
    }
    /// What had to be done otherwise than asked for, and why; each is told once.
    fn remarks(&mut self) -> Vec<Decision> {
        Vec::new()
    }
    /// Mean squared error of a picture against a target, over its pixels that count; statistics
    /// stay as they are.
    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError>;
    /// dL/d(logit of the opacity) of each Gaussian where dL/d(colour) is `gradient`
    /// ([height × width × 3]). Adam's moments may be lost.
    fn opacity_gradients(
        &mut self,
        view: &PinholeView,
        options: &RenderOptions,
        gradient: &[f32],
    ) -> Result<Vec<f32>, SplatError>;
    /// The gain of the view to come: its photo shows the scene times this, so that targets are
    /// divided by it.
    fn set_gain(&mut self, gain: Option<[f32; 3]>);
    /// Sums over the pixels that count, by channel: Σ r t, Σ r², Σ t² of the rendering r and the
    /// photo t (no gain).
    fn products(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<[[f64; 3]; 3], SplatError> {
        let rgb = self.render(view, options)?.rgb;
        let mut sums = [[0.0; 3]; 3];
        for (i, &r) in rgb.data.iter().enumerate() {
            let m = target.mask.map_or(1.0, |m| f64::from(m[i / 3]) / 255.0);
            let (r, photo) = (f64::from(r), f64::from(target.rgb[i]) / 255.0);
            let behind = f64::from(options.background[i % 3]);
            let (w, t) = if target.transparent { (1.0, behind + m * (photo - behind)) } else { (m, photo) };
            for (sum, product) in sums.iter_mut().zip([r * t, r * r, t * t]) {
                sum[i % 3] += w * product;
            }
        }
        Ok(sums)
    }
    /// Time by kernel.
    fn times(&self) -> KernelTimes;
}

/// Refuses a model whose arrays are not as long as its invariant says, and statistics of another
/// number of Gaussians (none at all will do: nothing was seen yet).
pub(crate) fn check(model: &Model, statistics: &Statistics) -> Result<(), SplatError> {
    let (n, values) = (padded(model.len), model.len * model.sh_stride());
    let planes = [&model.geometry, &model.geometry_m, &model.geometry_v].into_iter().flatten();
    let mut planes = planes.chain(&model.sh_v).chain([&model.steps]);
    let mut sums = [&statistics.gradient, &statistics.visible].into_iter();
    let wrong = if model.sh_degree > MAX_SH_DEGREE {
        "the degree of the spherical harmonics is above 3"
    } else if planes.any(|plane| plane.len() != n) {
        "a plane has another length than the number of Gaussians asks for"
    } else if model.sh.len() != values {
        "there are not as many spherical harmonics as their degree asks for"
    } else if !model.part.is_empty() && model.part.len() != model.len {
        "the parts are of another number of Gaussians"
    } else if !statistics.is_empty() && sums.any(|sums| sums.len() != n) {
        "the statistics are of another number of Gaussians"
    } else {
        return Ok(());
    };
    Err(SplatError::InvalidGaussians(wrong.to_owned()))
}
