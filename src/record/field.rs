//! What a run remembers of a field.

use baselines::Method;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use splat::train::CurvePoint;

/// What is known of the field of another method than the splat's.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct FieldSummary {
    /// How it was made.
    #[schemars(with = "String")]
    pub method: Method,
    /// Parameters learnt.
    pub parameters: usize,
    /// Steps done.
    pub iterations: u32,
    /// Where it was trained, in words.
    pub by: String,
    /// Loss and PSNR of the training rays against time.
    #[schemars(with = "Vec<super::CurveSchema>")]
    pub curve: Vec<CurvePoint>,
}
