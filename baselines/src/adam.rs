//! Adam (Kingma and Ba 2015), with the average of the weights that is rendered.

/// What stays the same in all steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AdamSettings {
    /// Decay of the first and of the second moment.
    pub(crate) betas: [f32; 2],
    /// Against division by nothing.
    pub(crate) epsilon: f32,
}

/// The constants of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AdamRates {
    pub(crate) settings: AdamSettings,
    /// Learning rate, with the correction of both moments' bias.
    pub(crate) rate: f32,
    /// Weight decay, added to the gradient.
    pub(crate) decay: f32,
    /// Share of the weights' average that the step keeps, where an average is kept up.
    pub(crate) average: Option<f32>,
}

impl AdamSettings {
    /// Of step `step`, counted from 1, without weight decay and average.
    pub(crate) fn rates(self, learning_rate: f32, step: u32) -> AdamRates {
        let [first, second] = self.betas.map(|beta| 1.0 - f64::from(beta).powf(f64::from(step)));
        let rate = f64::from(learning_rate) * second.sqrt() / first;
        AdamRates { settings: self, rate: rate as f32, decay: 0.0, average: None }
    }
}

/// Both moments of each weight, and the weights' average once that is wanted.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct AdamMoments {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    /// Empty until the first step with [`AdamRates::average`].
    pub(crate) average: Vec<f32>,
}

impl AdamMoments {
    /// Of so many weights.
    pub(crate) fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], average: Vec::new() }
    }

    /// A step of all weights; leaves the gradients at 0.
    pub(crate) fn step(&mut self, weights: &mut [f32], gradient: &mut [f32], rates: &AdamRates) {
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((w, g), (m, v)) in weights.iter_mut().zip(gradient).zip(moments) {
            update(w, *g + rates.decay * *w, m, v, rates);
            *g = 0.0;
        }
        self.keep_average(weights, rates);
    }

    /// A step of the weights whose gradient is not 0; leaves the gradients at 0.
    pub(crate) fn step_where_touched(
        &mut self,
        weights: &mut [f32],
        gradient: &mut [f32],
        rates: &AdamRates,
    ) {
        /// Weights that are looked at together. Source: a cache line.
        const LINE: usize = 16;
        let lines = weights.chunks_mut(LINE).zip(gradient.chunks_mut(LINE));
        let moments = self.first.chunks_mut(LINE).zip(self.second.chunks_mut(LINE));
        for ((weights, gradient), (first, second)) in lines.zip(moments) {
            if gradient.iter().all(|&g| g == 0.0) {
                continue;
            }
            let moments = first.iter_mut().zip(second);
            for ((w, g), (m, v)) in weights.iter_mut().zip(gradient).zip(moments) {
                if *g != 0.0 {
                    update(w, *g, m, v, rates);
                    *g = 0.0;
                }
            }
        }
        self.keep_average(weights, rates);
    }

    fn keep_average(&mut self, weights: &[f32], rates: &AdamRates) {
        let Some(kept) = rates.average else { return };
        if self.average.is_empty() {
            self.average = weights.to_vec();
        }
        for (a, w) in self.average.iter_mut().zip(weights) {
            *a = kept * *a + (1.0 - kept) * w;
        }
    }

    /// The weights to render with: their average where there is one.
    pub(crate) fn shown<'a>(&'a self, weights: &'a [f32]) -> &'a [f32] {
        if self.average.is_empty() { weights } else { &self.average }
    }
}

#[inline(always)]
fn update(w: &mut f32, g: f32, m: &mut f32, v: &mut f32, rates: &AdamRates) {
    let AdamSettings { betas: [beta1, beta2], epsilon } = rates.settings;
    *m = beta1 * *m + (1.0 - beta1) * g;
    *v = beta2 * *v + (1.0 - beta2) * g * g;
    *w -= rates.rate * *m / (v.sqrt() + epsilon);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_as_long_as_the_rate_and_then_follows_the_formula() {
        let (mut moments, mut w) = (AdamMoments::new(1), [1.0f32]);
        let (mut m, mut v, mut truth) = (0.0f64, 0.0f64, 1.0f64);
        for step in 1..=20 {
            let g = f64::from(step as f32 * 0.3 - 2.0);
            let settings = AdamSettings { betas: [0.9, 0.99], epsilon: 1e-8 };
            moments.step(&mut w, &mut [g as f32], &settings.rates(0.01, step));
            m = 0.9 * m + 0.1 * g;
            v = 0.99 * v + 0.01 * g * g;
            let corrected =
                (1.0 - 0.99f64.powf(f64::from(step))).sqrt() / (1.0 - 0.9f64.powf(f64::from(step)));
            truth -= 0.01 * corrected * m / (v.sqrt() + 1e-8);
            assert!((f64::from(w[0]) - truth).abs() < 1e-6, "step {step}: {} {truth}", w[0]);
        }
    }

    #[test]
    fn weights_without_a_gradient_stay_and_averages_lag() {
        let (mut moments, mut w) = (AdamMoments::new(40), vec![1.0f32; 40]);
        let mut gradient = vec![0.0; 40];
        gradient[3] = 1.0;
        let settings = AdamSettings { betas: [0.9, 0.99], epsilon: 1e-15 };
        let rates = AdamRates { average: Some(0.95), ..settings.rates(0.1, 1) };
        moments.step_where_touched(&mut w, &mut gradient, &rates);
        assert!((w[3] - 0.9).abs() < 1e-5 && w[4] == 1.0 && gradient[3] == 0.0);
        moments.step_where_touched(&mut w, &mut gradient, &rates);
        gradient[3] = 1.0;
        moments.step_where_touched(&mut w, &mut gradient, &rates);
        let shown = moments.shown(&w)[3];
        assert!(shown > w[3] && shown < 1.0, "{shown}");
    }
}
