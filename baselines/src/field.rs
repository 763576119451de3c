//! What all methods have in common.

use crate::error::FieldError;
use crate::rays::PhotoRays;
use serde_json::Value;
use splat::{PinholeView, RenderOutput};

/// Where a step stands in its training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepPlace {
    /// Steps done before.
    pub step: u32,
    /// Position in the schedule, [0, 1].
    pub position: f64,
    /// Seed of all randomness.
    pub seed: u64,
}

/// What a step saw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Mean loss of its rays.
    pub loss: f64,
    /// Mean squared error of its rays.
    pub square_error: f64,
    /// Rays that were compared with photos.
    pub rays: usize,
    /// Places at which the field was evaluated.
    pub samples: usize,
    /// Products and sums of the networks' layers, forward and backward.
    pub operations: f64,
}

/// What of a field is kept in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kept {
    /// What pictures need.
    Pictures,
    /// What going on with training needs.
    Training,
}

/// A scene that is learnt from photos and shown from anywhere, at any time.
///
/// Cameras, rays and depths are in the normalised frame of the data set; times are in [0, 1].
pub trait RadianceField: Send + Sync {
    /// One step of training.
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError>;

    /// A picture over a background: colour, opacity, and depth along the camera's axis.
    fn render(&self, view: &PinholeView, time: f32, background: [f32; 3])
    -> Result<RenderOutput, FieldError>;

    /// Steps that a time limit is filled with at most, with so many photos: more do not help.
    fn most_steps(&self, _photos: usize) -> f64 {
        f64::INFINITY
    }

    /// Brings what was learnt elsewhere into this process's memory: before [`Self::arrays`].
    fn fetch(&mut self) -> Result<(), FieldError> {
        Ok(())
    }

    /// Numbers that say what the field has learnt, for the curve of a training: parameters in use.
    fn size(&self) -> usize;

    /// All arrays to keep, and what else there is to know, in the order of [`Self::restore`].
    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value);

    /// Takes back what [`Self::arrays`] gave; says what does not fit.
    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, notes: &Value) -> Result<(), String>;
}
