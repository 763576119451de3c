//! Gains by view and channel, where the residuals ask for them: a camera that meters each picture anew.

use super::Trainer;
use crate::backend::Target;
use crate::{RenderOptions, SplatError};

/// Positions of the schedule at which gains are looked for (the first two: what the first look suspects has to explain the
/// pictures of the second) and measured again.
const LOOKS: [f64; 5] = [0.25, 0.4, 0.55, 0.7, 0.85];
/// Part of the squared error that gains must explain.
const EXPLAINED: f64 = 0.1;
/// Views from which the first look tells whether there is something to model.
const SAMPLE: usize = 48;
/// Gains stay within this and its inverse.
const LARGEST: f64 = 2.0;

/// What a view's pixels say, by channel: Σ r t, Σ r², Σ t² of rendering r and photo t.
pub type Products = [[f64; 3]; 3];

/// Least-squares gains by view and channel, their geometric mean over the views 1 in every channel (the colours of the
/// scene carry the mean), and the part of the squared error that they explain.
pub fn gains(views: &[Products]) -> (Vec<[f32; 3]>, f64) {
    let raw = |p: &Products, c: usize| {
        let gain = if p[1][c] > 0.0 { p[0][c] / p[1][c] } else { 1.0 };
        if gain.is_finite() { gain.clamp(1.0 / LARGEST, LARGEST) } else { 1.0 }
    };
    let n = views.len().max(1) as f64;
    let mean: [f64; 3] =
        std::array::from_fn(|c| (views.iter().map(|p| raw(p, c).ln()).sum::<f64>() / n).exp());
    let own = |p: &Products| std::array::from_fn(|c| (raw(p, c) / mean[c]) as f32);
    let all: Vec<[f32; 3]> = views.iter().map(own).collect();
    let explained = explained_by(views, &all);
    (all, explained)
}

/// The part of the squared error that given gains explain.
fn explained_by(views: &[Products], gains: &[[f32; 3]]) -> f64 {
    let (mut before, mut after) = (0.0, 0.0);
    for (p, gains) in views.iter().zip(gains) {
        for (c, g) in gains.iter().map(|g| f64::from(*g)).enumerate() {
            let [rt, rr, tt] = [p[0][c], p[1][c], p[2][c]];
            before += tt - 2.0 * rt + rr;
            after += tt - 2.0 * g * rt + g * g * rr;
        }
    }
    if before > 0.0 { 1.0 - after / before } else { 0.0 }
}

impl Trainer<'_> {
    /// Looks for gains at their places in the schedule.
    pub(super) fn judge_exposure(&mut self) -> Result<(), SplatError> {
        let looks = self.state.findings.exposure_looks;
        let due = LOOKS.get(looks as usize).is_some_and(|&at| self.state.position >= at);
        let findings = &self.state.findings;
        if !due || (looks > 0 && findings.gains.is_empty() && findings.suspected.is_empty()) {
            return Ok(());
        }
        self.state.findings.exposure_looks += 1;
        if self.views.len() < 3 {
            return Ok(());
        }
        if looks == 0 {
            return self.suspect_gains();
        }
        let products = self.products_of_views(1)?;
        let (found, _) = gains(&products);
        let suspected = std::mem::take(&mut self.state.findings.suspected);
        if !suspected.is_empty() {
            // A scene that is not yet learnt has views that are too dark or too bright as a whole, other ones each time.
            let still = explained_by(&products, &suspected);
            let on = still >= EXPLAINED;
            self.note_exposure(on, &suspected, still, "that an earlier look found explain");
            if !on {
                return Ok(());
            }
        }
        self.state.findings.gains = found;
        Ok(())
    }

    /// The first look. It judges by some of the views: what it costs must not grow with their number.
    fn suspect_gains(&mut self) -> Result<(), SplatError> {
        let every = self.views.len().div_ceil(SAMPLE);
        let (mut found, explained) = gains(&self.products_of_views(every)?);
        if explained < EXPLAINED {
            self.note_exposure(false, &found, explained, "would explain");
            return Ok(());
        }
        if every > 1 {
            found = gains(&self.products_of_views(1)?).0;
        }
        self.state.findings.suspected = found;
        Ok(())
    }

    fn note_exposure(&mut self, on: bool, found: &[[f32; 3]], explained: f64, what: &str) {
        let spread = |f: fn(f32, f32) -> f32, start| found.iter().flatten().copied().fold(start, f);
        let evidence = format!(
            "gains of {:.2} to {:.2} by view and channel {what} {:.1} % of the squared error (needed: {:.0} %)",
            spread(f32::min, f32::INFINITY),
            spread(f32::max, 0.0),
            100.0 * explained,
            100.0 * EXPLAINED
        );
        self.note("exposure by view", if on { "modelled" } else { "not modelled" }.to_owned(), evidence);
    }

    /// What each `every`-th training view says at the resolution in use.
    fn products_of_views(&mut self, every: usize) -> Result<Vec<Products>, SplatError> {
        let level = self.level();
        let transparent = self.dataset.is_transparent();
        let mut products = Vec::with_capacity(self.views.len().div_ceil(every));
        for &v in self.views.iter().step_by(every) {
            let view = &self.dataset.views[v];
            let level = level.min(view.levels.len() as u32 - 1);
            let pixels = &view.levels[level as usize];
            let target =
                Target { rgb: &pixels.rgb, mask: pixels.mask.as_deref(), transparent, photo: Some(v as u32) };
            let options = RenderOptions { antialias: self.config.antialias, ..RenderOptions::default() };
            let camera = self.camera(v).at_level(level);
            products.push(self.backend.products(&camera, &target, &options)?);
        }
        Ok(products)
    }

    /// The gain of a training view: its photo shows the scene times this.
    pub(super) fn gain(&self, view: usize) -> Option<[f32; 3]> {
        let place = self.views.binary_search(&view).ok()?;
        self.state.findings.gains.get(place).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_found_up_to_their_mean_and_none_where_there_are_none() {
        let truth = [0.8, 1.0, 1.25];
        let view = |g: f64| -> Products { [[10.0 * g; 3], [10.0; 3], [10.0 * g * g; 3]] };
        let (found, explained) = gains(&truth.map(view));
        for (f, t) in found.iter().zip(truth) {
            assert!(f.iter().all(|v| (f64::from(*v) - t).abs() < 1e-6), "{found:?}");
        }
        assert!((explained - 1.0).abs() < 1e-9);
        let found_for_others: Vec<[f32; 3]> = found.iter().rev().copied().collect();
        assert!(explained_by(&truth.map(view), &found) > 0.99);
        assert!(explained_by(&truth.map(view), &found_for_others) < 0.0);
        let noise: Products = [[10.0; 3], [10.0; 3], [11.0; 3]];
        assert!(gains(&[noise; 4]).1.abs() < 1e-9);
        let black: Products = [[0.0; 3]; 3];
        assert_eq!(gains(&[black; 3]), (vec![[1.0; 3]; 3], 0.0));
    }
}
