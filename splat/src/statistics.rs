//! What the training steps since the last change saw of each Gaussian.

use crate::model::padded;
use serde::{Deserialize, Serialize};

/// What densification and pruning are decided by, summed over steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Σ |dL/dxy| in units of half the image, over the steps in which the Gaussian was visible.
    pub gradient: Vec<f32>,
    /// In how many steps it was visible.
    pub visible: Vec<f32>,
}

impl Statistics {
    /// Whether they are of no Gaussian: nothing was seen yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.gradient.is_empty() && self.visible.is_empty()
    }

    /// Forgets everything if they are not of `n` Gaussians.
    pub(crate) fn fit(&mut self, n: usize) {
        if self.gradient.len() != padded(n) || self.visible.len() != padded(n) {
            self.reset(n);
        }
    }

    /// Forgets everything, for `n` Gaussians.
    pub fn reset(&mut self, n: usize) {
        let n = padded(n);
        for plane in [&mut self.gradient, &mut self.visible] {
            plane.clear();
            plane.resize(n, 0.0);
        }
    }
}
