//! Where fields learn and are shown: the processor, or a graphics adapter.

use crate::error::FieldError;
use crate::field::RadianceField;
#[cfg(feature = "gpu")]
use crate::gpu::FieldKit;
use crate::instant_ngp::InstantNgp;
use crate::moving::Moving;
use crate::nerf::Nerf;
#[cfg(not(feature = "gpu"))]
use splat::BackendChoice;
use splat::DeviceConfig;
#[cfg(feature = "gpu")]
use std::sync::Arc;

/// What computes: by default this processor.
#[derive(Clone, Default)]
pub struct Accelerator {
    #[cfg(feature = "gpu")]
    kit: Option<Arc<FieldKit>>,
}

impl Accelerator {
    /// What the configuration asks for; without a wish the first graphics card, if there is one,
    /// else the processor.
    pub fn open(config: &DeviceConfig) -> Result<Self, FieldError> {
        #[cfg(feature = "gpu")]
        return Ok(Self { kit: FieldKit::open(config)? });
        #[cfg(not(feature = "gpu"))]
        if config.backend == BackendChoice::Gpu || config.gpu.is_some() {
            let present = "none: this program was built without the feature gpu".to_owned();
            let wanted = config.gpu.clone().unwrap_or_else(|| "any".to_owned());
            return Err(splat::SplatError::NoAdapter { wanted, present }.into());
        }
        #[cfg(not(feature = "gpu"))]
        Ok(Self::default())
    }

    /// In words.
    pub fn name(&self) -> String {
        #[cfg(feature = "gpu")]
        if let Some(kit) = &self.kit {
            return kit.device.name().to_owned();
        }
        "the processor".to_owned()
    }

    /// An Instant NeRF here.
    pub(crate) fn instant_ngp(&self, field: InstantNgp) -> Result<Box<dyn RadianceField>, FieldError> {
        #[cfg(feature = "gpu")]
        if let Some(kit) = &self.kit {
            return Ok(Box::new(crate::instant_ngp::NgpOnDevice::new(field, kit)?));
        }
        Ok(Box::new(field))
    }

    /// A NeRF or D-NeRF here.
    pub(crate) fn nerf(&self, field: Nerf) -> Result<Box<dyn RadianceField>, FieldError> {
        #[cfg(feature = "gpu")]
        if let Some(kit) = &self.kit {
            return Ok(Box::new(crate::nerf::NerfOnDevice::new(field, kit)?));
        }
        Ok(Box::new(field))
    }

    /// Moving Gaussians here.
    pub(crate) fn moving(&self, field: Moving) -> Result<Box<dyn RadianceField>, FieldError> {
        #[cfg(feature = "gpu")]
        if let Some(kit) = &self.kit {
            return Ok(Box::new(field.on_device(kit)?));
        }
        Ok(Box::new(field))
    }
}
