//! Gaussians that stand elsewhere in each picture: trained as they are at rest, through where they
//! are moved to.
//!
//! What moves them is another crate's: it is given the gradients of the geometry at its place.

use crate::backend::{Backend, LearningRates, Round, StepInput, StepOutput};
use crate::config::TrainConfig;
use crate::cpu::CpuBackend;
use crate::dataset::Dataset;
use crate::error::SplatError;
use crate::footprint::footprint;
use crate::init::initial_model;
use crate::model::{Model, Planes};
use crate::statistics::Statistics;
use crate::train::schedule::rates;
use crate::view::{PinholeView, RenderOptions, RenderOutput};

/// Gaussians in training on the processor, in the normalised frame of a data set.
#[derive(Default)]
pub struct MovedGaussians {
    backend: CpuBackend,
}

impl MovedGaussians {
    /// The first Gaussians of a data set.
    pub fn of(dataset: &Dataset, max: usize, seed: u64) -> Result<Self, SplatError> {
        Self::new(initial_model(dataset, max, seed)?)
    }

    /// Of a model at rest.
    pub fn new(model: Model) -> Result<Self, SplatError> {
        let (mut statistics, mut backend) = (Statistics::default(), CpuBackend::default());
        statistics.reset(model.len);
        backend.upload(model, statistics)?;
        Ok(Self { backend })
    }

    /// At rest.
    pub fn model(&self) -> &Model {
        self.backend.model()
    }

    /// What training has seen since the last round of densification.
    pub fn statistics(&self) -> &Statistics {
        self.backend.statistics()
    }

    /// Takes back what was seen, as [`Self::statistics`] gave it.
    pub fn set_statistics(&mut self, statistics: Statistics) -> Result<(), SplatError> {
        let (model, _) = self.backend.release()?;
        self.backend.upload(model, statistics)
    }

    /// Width of a pixel in the scene, normalised units.
    pub fn pixel(dataset: &Dataset) -> f32 {
        footprint(dataset)
    }

    /// Step sizes at a position of a schedule of so many steps, as for Gaussians that stand still,
    /// where a pixel is so wide.
    pub fn rates(pixel: f32, position: f64, steps: f64) -> LearningRates {
        rates(position, steps, pixel, &TrainConfig::default())
    }

    /// A training step with the geometry `moved` and with `tint` added to the constant terms of the
    /// spherical harmonics ([N × 3]). Both become their own gradients. The Gaussians at rest take
    /// the step that those at their places would.
    pub fn step(
        &mut self,
        input: &StepInput,
        moved: &mut Planes,
        tint: &mut [f32],
    ) -> Result<StepOutput, SplatError> {
        self.backend.step_moved(input, moved, tint)
    }

    /// A picture with the geometry `moved` and `tint` added, as in [`Self::step`].
    pub fn render(
        &mut self,
        moved: &mut Planes,
        tint: &[f32],
        view: &PinholeView,
        options: &RenderOptions,
    ) -> Result<RenderOutput, SplatError> {
        let colours = self.backend.add_tint(tint)?;
        if let Err(e) = self.backend.swap_geometry(moved) {
            self.backend.remove_tint(&colours, tint);
            return Err(e);
        }
        let out = self.backend.render(view, options);
        self.backend.remove_tint(&colours, tint);
        self.backend.swap_geometry(moved)?;
        out
    }

    /// Splits Gaussians at which the pictures pull and removes those that do nothing; whether their
    /// number changed.
    pub fn densify(&mut self, round: &Round) -> Result<bool, SplatError> {
        let before = self.backend.gaussians();
        self.backend.densify(round)?;
        Ok(self.backend.gaussians() != before)
    }

    /// Another degree of the spherical harmonics.
    pub fn set_sh_degree(&mut self, degree: u32) -> Result<(), SplatError> {
        self.backend.set_sh_degree(degree)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Target;
    use crate::model::MEAN;
    use glam::{Mat3, Quat, Vec3};
    use scene::Gaussians;

    fn model() -> Model {
        let n = 40;
        let place = |i: usize| Vec3::new((i % 8) as f32 * 0.2 - 0.7, (i / 8) as f32 * 0.2 - 0.4, 0.0);
        Model::from_gaussians(&Gaussians {
            means: (0..n).map(place).collect(),
            log_scales: vec![Vec3::splat(-2.5); n],
            rotations: vec![Quat::IDENTITY; n],
            opacity_logits: vec![0.5; n],
            sh: (0..3 * n).map(|i| (i as f32 * 0.7).sin()).collect(),
            sh_degree: 0,
        })
    }

    const VIEW: PinholeView = PinholeView {
        rotation: Mat3::IDENTITY,
        translation: Vec3::new(0.0, 0.0, 3.0),
        focal: [40.0; 2],
        centre: [20.0, 15.0],
        width: 40,
        height: 30,
        parts: crate::parts::PartPlaces::NONE,
    };

    fn input(rgb: &[u8]) -> StepInput<'_> {
        StepInput {
            view: &VIEW,
            target: Target { rgb, mask: None, transparent: false, photo: None },
            options: RenderOptions::default(),
            rates: LearningRates {
                mean: 1e-3,
                log_scale: 1e-2,
                rotation: 1e-2,
                opacity: 1e-2,
                sh0: 1e-2,
                sh_rest: 1e-3,
            },
            lambda_dssim: 0.2,
        }
    }

    fn photo() -> Vec<u8> {
        (0..40 * 30 * 3).map(|i| (i * 37 % 251) as u8).collect()
    }

    #[test]
    fn what_is_not_moved_is_trained_as_a_splat_is() {
        let photo = photo();
        let mut still = CpuBackend::default();
        still.upload(model(), Statistics::default()).unwrap();
        let mut moved = MovedGaussians::new(model()).unwrap();
        for _ in 0..5 {
            let truth = still.step(&input(&photo)).unwrap();
            let still = (moved.model().geometry.clone(), vec![0.0; 3 * moved.model().len]);
            let (mut at, mut tint) = still;
            let ours = moved.step(&input(&photo), &mut at, &mut tint).unwrap();
            assert_eq!(ours, truth);
        }
        let truth = still.download().unwrap().0;
        assert_eq!(moved.model().sh, truth.sh);
        for (ours, truth) in moved.model().geometry.iter().zip(&truth.geometry) {
            for (a, b) in ours.iter().zip(truth) {
                assert!((a - b).abs() <= 1e-6 * b.abs().max(1.0), "{a} {b}");
            }
        }
    }

    #[test]
    fn the_gradient_is_that_of_the_loss_at_the_moved_place() {
        let photo = photo();
        let mut still = input(&photo);
        still.rates = LearningRates::default();
        let mut gaussians = MovedGaussians::new(model()).unwrap();
        let shifted = |by: f32, gaussian: usize| {
            let mut planes = model().geometry;
            planes[MEAN].iter_mut().for_each(|x| *x += 0.1);
            planes[MEAN][gaussian] += by;
            planes
        };
        let tinted = |by: f32, value: usize| {
            let mut tint = vec![0.2; 3 * model().len];
            tint[value] += by;
            tint
        };
        let (mut gradient, mut of_tint) = (shifted(0.0, 0), tinted(0.0, 0));
        gaussians.step(&still, &mut gradient, &mut of_tint).unwrap();
        let mut checked = 0;
        for i in [3, 11, 18, 27] {
            let mut loss =
                |by: f32| gaussians.step(&still, &mut shifted(by, i), &mut tinted(0.0, 0)).unwrap().loss;
            let slope = (loss(2e-3) - loss(-2e-3)) / 4e-3;
            let ours = gradient[MEAN][i];
            assert!((ours - slope).abs() < 0.1 * slope.abs() + 2e-4, "{i}: {ours} {slope}");
            checked += usize::from(slope.abs() > 1e-3);
        }
        for value in [9, 34, 55, 83] {
            let mut loss =
                |by: f32| gaussians.step(&still, &mut shifted(0.0, 0), &mut tinted(by, value)).unwrap().loss;
            let slope = (loss(2e-2) - loss(-2e-2)) / 4e-2;
            let ours = of_tint[value];
            assert!((ours - slope).abs() < 0.1 * slope.abs() + 2e-4, "tint {value}: {ours} {slope}");
            checked += usize::from(slope.abs() > 1e-3);
        }
        assert!(checked > 1, "some gradients are large enough to be seen");
        assert_eq!(gaussians.model().sh, model().sh, "a tint leaves nothing behind");
        for (rest, first) in gaussians.model().geometry.iter().zip(&model().geometry) {
            assert_eq!(rest, first, "without step sizes nothing moves");
        }
    }

    #[test]
    fn geometry_of_another_number_is_refused() {
        let (mut gaussians, photo) = (MovedGaussians::new(model()).unwrap(), photo());
        let tint = &mut vec![0.0; 3 * model().len];
        assert!(gaussians.step(&input(&photo), &mut Planes::default(), tint).is_err());
        assert!(gaussians.step(&input(&photo), &mut model().geometry, &mut tint[1..]).is_err());
        assert_eq!(gaussians.model().geometry, model().geometry);
    }
}
