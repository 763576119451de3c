//! The methods, and the fields they make.

use crate::accelerator::Accelerator;
use crate::domain::Domain;
use crate::error::FieldError;
use crate::field::RadianceField;
use crate::instant_ngp::{InstantNgp, NgpShape};
use crate::moving::{Moving, MovingShape};
use crate::nerf::{Nerf, NerfShape};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat::{Dataset, PinholeView};

/// How a scene is represented and learnt.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// 3D Gaussians (Kerbl et al. 2023)
    #[default]
    #[value(name = "3dgs")]
    #[serde(rename = "3dgs")]
    Gaussians,
    /// Instant NeRF: hash grid and small networks (Müller et al. 2022)
    InstantNgp,
    /// NeRF: a deep perceptron, coarse and fine (Mildenhall et al. 2020)
    Nerf,
    /// D-NeRF: a NeRF that moves to each time (Pumarola et al. 2021)
    DNerf,
    /// 4D Gaussians: moved by HexPlane features (Wu et al. 2024)
    #[value(name = "4dgs")]
    #[serde(rename = "4dgs")]
    MovingGaussians,
}

impl Method {
    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gaussians => "3dgs",
            Self::InstantNgp => "instant-ngp",
            Self::Nerf => "nerf",
            Self::DNerf => "d-nerf",
            Self::MovingGaussians => "4dgs",
        }
    }
}

/// What the arrays of a field have their sizes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum FieldShape {
    InstantNgp(NgpShape),
    Nerf(NerfShape),
    Moving(MovingShape),
}

impl FieldShape {
    /// The defaults of a method for a data set whose views have `times`, or with a `budget` those
    /// of a training with a time limit; none for Gaussians, which are no field.
    pub(crate) fn of(method: Method, dataset: &Dataset, times: &[f32], budget: bool) -> Option<Self> {
        let domain = Domain::of(dataset);
        match method {
            Method::Gaussians => None,
            Method::InstantNgp => Some(Self::InstantNgp(NgpShape::new(domain))),
            Method::Nerf | Method::DNerf => {
                Some(Self::Nerf(NerfShape::new(domain, dataset, method == Method::DNerf, budget)))
            }
            Method::MovingGaussians => Some(Self::Moving(MovingShape::new(domain, dataset, times))),
        }
    }

    /// The method that makes such fields.
    pub(crate) fn method(&self) -> Method {
        match self {
            Self::InstantNgp(_) => Method::InstantNgp,
            Self::Nerf(NerfShape { deformed: false, .. }) => Method::Nerf,
            Self::Nerf(_) => Method::DNerf,
            Self::Moving(_) => Method::MovingGaussians,
        }
    }

    /// Whether a file's shape makes sense.
    pub(crate) fn is_sane(&self) -> bool {
        match self {
            Self::InstantNgp(shape) => shape.is_sane(),
            Self::Nerf(shape) => shape.is_sane(),
            Self::Moving(shape) => shape.is_sane(),
        }
    }

    /// An untrained field on an accelerator; without a data set one to be restored.
    pub(crate) fn build(
        &self,
        dataset: Option<&Dataset>,
        seed: u64,
        by: &Accelerator,
    ) -> Result<Box<dyn RadianceField>, FieldError> {
        Ok(match self {
            Self::InstantNgp(shape) => {
                let views = dataset.iter().flat_map(|d| d.views.iter().filter(|v| !v.held_out));
                let views: Vec<PinholeView> = views.map(|v| v.view).collect();
                by.instant_ngp(InstantNgp::new(*shape, &views, seed))?
            }
            Self::Nerf(shape) => by.nerf(Nerf::new(*shape, seed))?,
            Self::Moving(shape) => by.moving(Moving::new(*shape, dataset, seed)?)?,
        })
    }
}
