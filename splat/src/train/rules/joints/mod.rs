//! Angles of joints from the photos: pictures see a part where nothing of it can be followed.
//!
//! Every step turns the parts of its view by Adam on dL/d(angle), like everything else: what is
//! wrong in one stretch of the video with the shape that others show is a long way down a gentle
//! slope. Now and then the picture of each training view is made with each angle a little less and
//! more. The three errors make a parabola: a reading of the angle and what it is worth. The angles
//! of all views follow from the readings and from how slowly a joint changes its rate (`smooth`),
//! and from the joints that turn as it does (`together`).

mod smooth;
mod together;

use crate::backend::StepOutput;
use crate::dataset::{Joint, JointPlace, MovingParts};
use crate::error::SplatError;
use crate::model::{MEAN, Model};
use crate::train::context::RuleContext;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use smooth::{Reading, smoothed};
use together::tie;

/// When joints are looked at, and how.
struct JointSearch {
    /// Positions in the schedule. Source: chosen by hand: from the first shape on, each after as
    /// many more steps, and none just after the resolution changed: until Gaussians have followed
    /// they show edges elsewhere.
    looks: [f64; 12],
    /// How far the angles are tried at first, and at the least, degrees. Source: derived: the
    /// errors of angles from tracks; a pixel at the end of an array that is a hundred wide.
    widths_deg: [f64; 2],
    /// Steps of Adam at first and at the end, degrees. Source: chosen by hand: a view has its turn
    /// thirty times, and angles from tracks are some degrees off.
    steps_deg: [f64; 2],
    /// The same of axes and places, by their deviations. Source: chosen by hand on one film, whose
    /// axis was off by three of them.
    steps_unsure: [f64; 2],
    /// Pixels whose errors are as one. Source: as for poses.
    pixels_as_one: f64,
    /// What is wrong with all angles beyond their readings, pixels at the part's usual distance
    /// from the axis. Source: docs/decisions/22, one film.
    faces_px: f64,
}

/// The values in force.
const SEARCH: JointSearch = JointSearch {
    looks: [0.05, 0.07, 0.1, 0.13, 0.17, 0.21, 0.26, 0.32, 0.38, 0.5, 0.58, 0.97],
    widths_deg: [4.0, 0.5],
    steps_deg: [0.3, 0.02],
    steps_unsure: [0.05, 0.005],
    pixels_as_one: 1000.0,
    faces_px: 0.5,
};

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct JointRule {
    /// How often the joints were looked at.
    looks: usize,
    /// Adam's moments and steps, by joint and view.
    moments: Vec<Vec<[f64; 3]>>,
    /// The same of axes and places, by joint.
    #[serde(default)]
    hinges: Vec<[[f64; 3]; 6]>,
}

impl JointRule {
    /// Looks at all joints where that is due.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let Some(moving) = &step.setup.dataset.articulation else { return Ok(()) };
        if SEARCH.looks.get(self.looks).is_none_or(|&at| step.position() < at) {
            return Ok(());
        }
        begin(step);
        let [widest, least] = SEARCH.widths_deg;
        let share = self.looks as f64 / (SEARCH.looks.len() - 1) as f64;
        let width = (widest * (least / widest).powf(share)).to_radians();
        self.looks += 1;
        for joint in 0..moving.joints.len() {
            let readings = readings(step, joint, width)?;
            if let Some(found) = smoothed(&readings, &moving.times) {
                step.state.corrections.joints[joint] = found;
            }
        }
        let mut faces = Vec::new();
        step.backend.show(&mut |model, _| {
            let joints = (1..).zip(&moving.joints);
            faces = joints.map(|(part, joint)| faces_of(joint, part, model, step.setup.pixel)).collect();
        })?;
        tie(&mut step.state.corrections.joints, &faces);
        Ok(())
    }

    /// Turns the parts of a view by what pulled at them.
    pub(super) fn after_view(&mut self, step: &mut RuleContext, view: usize, output: &StepOutput) {
        let Some(moving) = &step.setup.dataset.articulation else { return };
        begin(step);
        let camera = step.camera(view);
        let views = step.setup.dataset.views.len();
        self.moments.resize_with(moving.joints.len(), || vec![[0.0; 3]; views]);
        self.hinges.resize(moving.joints.len(), [[0.0; 3]; 6]);
        let position = step.position().min(1.0);
        let rate = fall(SEARCH.steps_deg, position).to_radians();
        let share = fall(SEARCH.steps_unsure, position);
        for (k, (joint, pull)) in moving.joints.iter().zip(&output.pulls).enumerate() {
            let camera = camera.of_part(k as u8 + 1).position();
            let hinge = &mut step.state.corrections.hinges[k];
            let angle = &mut step.state.corrections.joints[k][0][view];
            let slope = hinge.slope(pull, camera);
            let slopes = hinge.slopes(*angle, pull, camera);
            if slope.is_finite() && slope != 0.0 {
                *angle -= adam(&mut self.moments[k][view], slope, rate);
                turn(hinge, slopes, &mut self.hinges[k], joint.unsure.map(|sigma| share * sigma));
            }
        }
    }

    /// Puts the Gaussians into the order of their parts.
    pub(super) fn conclude(&self, step: &RuleContext, model: &mut Model) -> Option<MovingParts> {
        let moving = step.setup.dataset.articulation.as_ref()?;
        let parts = moving.joints.len() as u8;
        let mut order: Vec<usize> = (0..model.len).collect();
        order.sort_by_key(|&i| model.part_of(i));
        model.reorder(&order);
        let mut out = moving.clone();
        out.gaussians = (0..=parts).map(|part| model.part.iter().filter(|&&p| p == part).count()).collect();
        let found = out.joints.iter_mut().zip(&step.state.corrections.joints);
        let frame = &step.setup.dataset.normalisation;
        for (part, (joint, [angles, sigmas])) in (1..).zip(found) {
            let faces = faces_of(joint, part, model, step.setup.pixel);
            joint.angles.clone_from(angles);
            joint.sigmas = sigmas.iter().map(|sigma| sigma.hypot(faces)).collect();
        }
        for (joint, hinge) in out.joints.iter_mut().zip(&step.state.corrections.hinges) {
            (joint.axis, joint.place) = (hinge.axis, hinge.place);
        }
        // World frame.
        for joint in &mut out.joints {
            joint.place = joint.place / frame.scale + frame.centre;
            joint.unsure[1] /= frame.scale;
        }
        Some(out)
    }
}

/// What is wrong with all angles of a joint beyond their readings, radians.
fn faces_of(joint: &Joint, part: u8, model: &Model, pixel: f32) -> f64 {
    SEARCH.faces_px * f64::from(pixel) / width(joint, part, model)
}

/// Root mean square of the distances of a part's Gaussians from its axis, normalised units.
fn width(joint: &Joint, part: u8, model: &Model) -> f64 {
    let own = (0..model.len).filter(|&i| model.part_of(i) == part);
    let squares = own.map(|i| {
        let place = DVec3::from([0, 1, 2].map(|k| f64::from(model.geometry[MEAN + k][i])));
        (place - joint.place).reject_from_normalized(joint.axis).length_squared()
    });
    let squares: Vec<f64> = squares.collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt().max(f64::EPSILON)
}

/// Takes over the angles as the data set gives them.
fn begin(step: &mut RuleContext) {
    if step.state.corrections.joints.is_empty()
        && let Some(moving) = &step.setup.dataset.articulation
    {
        let given = moving.joints.iter().map(|j| [j.angles.clone(), j.sigmas.clone()]);
        step.state.corrections.joints = given.collect();
        step.state.corrections.hinges = moving.joints.iter().map(Joint::at).collect();
    }
}

/// A size that falls over the schedule.
fn fall([first, last]: [f64; 2], position: f64) -> f64 {
    first * (last / first).powf(position)
}

/// Turns and moves a joint against its slopes, by at most so much.
fn turn(hinge: &mut JointPlace, slopes: [DVec3; 2], moments: &mut [[f64; 3]; 6], rates: [f64; 2]) {
    let mut by = [DVec3::ZERO; 2];
    for (k, moments) in moments.iter_mut().enumerate() {
        by[k / 3][k % 3] = adam(moments, slopes[k / 3][k % 3], rates[k / 3]);
    }
    hinge.axis = (hinge.axis - by[0].reject_from_normalized(hinge.axis)).normalize();
    // Along the axis a place is as good as any other.
    hinge.place -= by[1].reject_from_normalized(hinge.axis);
}

/// A step of Adam (Kingma and Ba 2015): moments and steps so far, slope, size of a step.
fn adam([first, second, steps]: &mut [f64; 3], slope: f64, rate: f64) -> f64 {
    let betas = [0.9, 0.99];
    *steps += 1.0;
    *first += (1.0 - betas[0]) * (slope - *first);
    *second += (1.0 - betas[1]) * (slope * slope - *second);
    let [one, two] = [(*first, betas[0]), (*second, betas[1])].map(|(m, b)| m / (1.0 - f64::powf(b, *steps)));
    rate * one / two.sqrt().max(f64::MIN_POSITIVE)
}

/// What the photos say of a joint's angle in each view of the data set; nothing of those held out.
fn readings(step: &mut RuleContext, joint: usize, width: f64) -> Result<Vec<Reading>, SplatError> {
    let setup = step.setup;
    let known = step.state.corrections.joints[joint][0].clone();
    let mut all: Vec<Reading> = known.iter().map(|&angle| Reading { angle, information: 0.0 }).collect();
    for &view in &setup.views {
        let mut errors = [0.0; 3];
        for (error, by) in errors.iter_mut().zip([-width, 0.0, width]) {
            step.state.corrections.joints[joint][0][view] = known[view] + by;
            let (camera, target) = step.photo(view, step.level());
            step.backend.set_gain(step.gain(view));
            *error = step.backend.mean_square_error(&camera, &target, &step.options())?;
        }
        step.state.corrections.joints[joint][0][view] = known[view];
        let pixels = covered(step, view);
        all[view] = reading(known[view], width, errors, pixels / SEARCH.pixels_as_one);
    }
    Ok(all)
}

/// Pixels of the object in a view at full resolution.
fn covered(step: &RuleContext, view: usize) -> f64 {
    let pixels = &step.setup.dataset.views[view].levels[0];
    match &pixels.mask {
        Some(mask) => mask.iter().map(|&m| f64::from(m) / 255.0).sum(),
        None => (pixels.width * pixels.height) as f64,
    }
}

/// The parabola through three mean squared errors, `samples` independent ones each. Where they make
/// none, or one whose lowest point is farther than twice the width, one with the same slope that
/// ends there.
fn reading(angle: f64, width: f64, [low, middle, high]: [f64; 3], samples: f64) -> Reading {
    let slope = (high - low) / (2.0 * width);
    let bend = ((low - 2.0 * middle + high) / (width * width)).max(slope.abs() / (2.0 * width));
    let information = samples * bend / (2.0 * middle.max(f64::EPSILON));
    if bend > 0.0 && information.is_finite() {
        Reading { angle: angle - slope / bend, information }
    } else {
        Reading { angle, information: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_read_at_its_lowest_point() {
        let error = |angle: f64| 1e-3 + 2.0 * (angle - 0.53) * (angle - 0.53);
        let found = reading(0.5, 0.04, [0.46, 0.5, 0.54].map(error), 100.0);
        assert!((found.angle - 0.53).abs() < 1e-9, "{found:?}");
        assert!((found.information - 100.0 * 4.0 / (2.0 * error(0.5))).abs() < 1e-6 * found.information);
    }

    #[test]
    fn far_ends_and_hills_are_walked_towards_and_flat_errors_say_nothing() {
        let far = reading(0.0, 0.1, [1.3, 1.0, 0.71], 1.0);
        assert!((far.angle - 0.2).abs() < 1e-9, "{far:?}");
        let hill = reading(0.0, 0.1, [0.5, 1.0, 0.7], 1.0);
        assert!((hill.angle + 0.2).abs() < 1e-9, "{hill:?}");
        assert_eq!(reading(0.3, 0.1, [1.0; 3], 1.0).information, 0.0);
        assert_eq!(reading(0.3, 0.1, [f64::NAN; 3], 1.0).information, 0.0);
    }
}
