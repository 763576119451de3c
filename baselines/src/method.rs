//! The methods, and the fields they make.

use crate::domain::Domain;
use crate::field::RadianceField;
use crate::instant_ngp::{InstantNgp, NgpShape};
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
}

impl Method {
    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gaussians => "3dgs",
            Self::InstantNgp => "instant-ngp",
        }
    }
}

/// What the arrays of a field have their sizes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum FieldShape {
    InstantNgp(NgpShape),
}

impl FieldShape {
    /// The defaults of a method for a data set; none for Gaussians, which are no field.
    pub(crate) fn of(method: Method, dataset: &Dataset) -> Option<Self> {
        match method {
            Method::Gaussians => None,
            Method::InstantNgp => Some(Self::InstantNgp(NgpShape::new(Domain::of(dataset)))),
        }
    }

    /// Whether a file's shape makes sense.
    pub(crate) fn is_sane(&self) -> bool {
        match self {
            Self::InstantNgp(shape) => shape.is_sane(),
        }
    }

    /// An untrained field.
    pub(crate) fn build(&self, views: &[PinholeView], seed: u64) -> Box<dyn RadianceField> {
        match self {
            Self::InstantNgp(shape) => Box::new(InstantNgp::new(*shape, views, seed)),
        }
    }
}
