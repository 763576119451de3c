//! A field in the world: pictures from cameras and poses, to and from a file.

use crate::accelerator::Accelerator;
use crate::error::FieldError;
use crate::field::RadianceField;
use crate::method::{FieldShape, Method};
use crate::store;
use scene::{Camera, Pose};
use splat::{NormalisedFrame, RenderOutput};
use std::path::Path;

/// A trained field.
pub struct TrainedField {
    shape: FieldShape,
    frame: NormalisedFrame,
    field: Box<dyn RadianceField>,
}

impl TrainedField {
    pub(crate) fn new(shape: FieldShape, frame: NormalisedFrame, field: Box<dyn RadianceField>) -> Self {
        Self { shape, frame, field }
    }

    /// How it was made.
    pub fn method(&self) -> Method {
        self.shape.method()
    }

    /// Writes what pictures need.
    pub fn write(&self, path: &Path) -> Result<(), FieldError> {
        store::write(path, self.shape, self.frame, self.field.as_ref(), None)
    }

    /// Reads what [`Self::write`] wrote, to be shown by this accelerator.
    pub fn read(path: &Path, by: &Accelerator) -> Result<Self, FieldError> {
        let read = store::read(path, (None, by), |header| header.training.is_none())?;
        let Some((header, field)) = read else {
            let reason = "it is missing or a checkpoint".to_owned();
            return Err(FieldError::Read { path: path.to_owned(), reason });
        };
        Ok(Self { shape: header.shape, frame: header.frame, field })
    }

    /// A picture from a camera without distortion, at a time in [0, 1] (others are the nearest),
    /// over a background.
    pub fn render(
        &self,
        camera: &Camera,
        pose: &Pose,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        if camera.distortion().iter().any(|&k| k != 0.0) {
            return Err(FieldError::NotPinhole { camera: camera.id, model: camera.model.name() });
        }
        // Times beyond the photos', and NaN, are their ends.
        let time = if time > 0.0 { time.min(1.0) } else { 0.0 };
        let mut out = self.field.render(&self.frame.view(camera, pose), time, background)?;
        let unit = (1.0 / self.frame.scale) as f32;
        out.depth.data.iter_mut().for_each(|z| *z *= unit);
        Ok(out)
    }
}
