//! Where the lamp is.

use crate::fit::{Brightness, GROUPS};
use crate::trial::{Trial, sphere};
use glam::DVec3;
use rayon::prelude::*;

/// A lamp at infinity that is fixed to the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Unit, from the object to the lamp, camera frame (x right, y down, z forwards).
    pub towards: DVec3,
    /// Standard deviation of the direction, degrees: jackknife over eight parts of the object, and
    /// what is wrong with the model in all of them alike.
    pub deviation_deg: f64,
    /// Light from everywhere, as a share of the lamp's.
    pub ambient: f64,
    /// Mean logarithm of how much smaller the squared errors are than without a lamp.
    pub gain: f64,
}

/// Azimuth and elevation in degrees to a direction in the camera frame: (0, 0) is where the camera
/// is, azimuth grows to the camera's right, elevation upwards.
pub fn direction(azimuth_deg: f64, elevation_deg: f64) -> DVec3 {
    let [a, e] = [azimuth_deg, elevation_deg].map(f64::to_radians);
    DVec3::new(a.sin() * e.cos(), -e.sin(), -a.cos() * e.cos())
}

impl Lamp {
    /// Azimuth and elevation, degrees, of [`direction`].
    pub fn angles_deg(&self) -> [f64; 2] {
        let d = self.towards;
        [d.x.atan2(-d.z).to_degrees(), (-d.y).clamp(-1.0, 1.0).asin().to_degrees()]
    }
}

/// How the lamp is looked for.
struct LampSearch {
    /// Directions of the first look: 12° apart. Source: derived, 4π / 300.
    directions: usize,
    /// Ambient light of the first look, shares of the lamp's. Source: chosen by hand, never
    /// measured.
    ambient: [f64; 3],
    /// Sides to which a step goes. Source: chosen by hand, never measured.
    sides: u32,
    /// Best directions of the first look from which steps begin. Source: chosen by hand, never
    /// measured.
    starts: usize,
    /// First and last step of the search, radians. Source: half of 12°; a third of a degree.
    steps: [f64; 2],
    /// What the jackknife's deviation is multiplied by, and what is added to it (degrees, root of
    /// the sum of squares): light that faces throw at each other bends what all parts say. Source:
    /// docs/decisions/23: eight films, one of them unseen.
    shared: [f64; 2],
}

/// The values in force.
const LIMITS: LampSearch = LampSearch {
    directions: 300,
    ambient: [0.1, 0.3, 0.8],
    sides: 8,
    starts: 2,
    steps: [0.1, 0.005],
    shared: [2.0, 5.0],
};

/// The lamp under which albedo times light explains the photos best.
pub(crate) fn found(brightness: &Brightness) -> Option<Lamp> {
    let first: Vec<Trial> = sphere(LIMITS.directions)
        .into_iter()
        .flat_map(|towards| LIMITS.ambient.map(|ambient| Trial { towards, ambient }))
        .collect();
    let sums: Vec<[f64; GROUPS]> = first.par_iter().map(|t| brightness.errors(Some(t))).collect();
    let whole = looked(brightness, &first, &sums, None)?;
    // Without one part of the object at a time: neighbours err alike, parts do not.
    let others: Vec<DVec3> =
        (0..GROUPS).filter_map(|out| Some(looked(brightness, &first, &sums, Some(out))?.towards)).collect();
    let squares: f64 = others.iter().map(|d| d.angle_between(whole.towards).powi(2)).sum();
    let deviation = ((GROUPS - 1) as f64 / GROUPS as f64 * squares).sqrt();
    let [times, more] = LIMITS.shared;
    let still: f64 = brightness.errors(None).iter().sum();
    let with: f64 = brightness.errors(Some(&whole)).iter().sum();
    Some(Lamp {
        towards: whole.towards,
        deviation_deg: (times * deviation.to_degrees()).hypot(more),
        ambient: whole.ambient,
        gain: (still - with) / brightness.count(),
    })
}

/// From the best directions of the first look step by step.
fn looked(
    brightness: &Brightness,
    first: &[Trial],
    sums: &[[f64; GROUPS]],
    without: Option<usize>,
) -> Option<Trial> {
    let mut order: Vec<usize> = (0..first.len()).filter(|&k| total(&sums[k], without).is_finite()).collect();
    order.sort_by(|&a, &b| total(&sums[a], without).total_cmp(&total(&sums[b], without)));
    let mut starts: Vec<Trial> = Vec::new();
    for trial in order.iter().map(|&k| first[k]) {
        if starts.len() < LIMITS.starts && starts.iter().all(|s| s.towards != trial.towards) {
            starts.push(trial);
        }
    }
    let ends: Vec<Trial> = starts.into_iter().map(|start| climbed(brightness, start, without)).collect();
    let errors: Vec<[f64; GROUPS]> = ends.iter().map(|end| brightness.errors(Some(end))).collect();
    best(&ends, &errors, without)
}

fn best(trials: &[Trial], sums: &[[f64; GROUPS]], without: Option<usize>) -> Option<Trial> {
    let all = trials.iter().zip(sums).map(|(t, s)| (*t, total(s, without)));
    all.filter(|(_, e)| e.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(t, _)| t)
}

fn total(sums: &[f64; GROUPS], without: Option<usize>) -> f64 {
    sums.iter().enumerate().filter(|(g, _)| Some(*g) != without).map(|(_, v)| v).sum()
}

/// From a trial step by step to where none beside it is better.
fn climbed(brightness: &Brightness, start: Trial, without: Option<usize>) -> Trial {
    let error = |t: &Trial| total(&brightness.errors(Some(t)), without);
    let (mut here, mut step) = (start, LIMITS.steps[0]);
    let mut least = error(&here);
    while step > LIMITS.steps[1] {
        let beside = beside(&here, step);
        let sums: Vec<[f64; GROUPS]> = beside.par_iter().map(|t| brightness.errors(Some(t))).collect();
        let next = best(&beside, &sums, without).map(|t| (t, error(&t))).filter(|(_, e)| *e < least);
        match next {
            Some((trial, e)) => (here, least) = (trial, e),
            None => step /= 2.0,
        }
    }
    here
}

/// The direction a step to all sides, and stayed, with the ambient light a little and much changed:
/// where only faces round the axis are seen, one makes up for the other.
fn beside(here: &Trial, step: f64) -> Vec<Trial> {
    let u = here.towards.any_orthonormal_vector();
    let v = here.towards.cross(u);
    let around = (0..LIMITS.sides).map(|k| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(LIMITS.sides)).sin_cos();
        (here.towards + step * (cos * u + sin * v)).normalize()
    });
    let factors = [0.0, 0.25, -0.25, 2.0, -2.0].map(|f| (f * step).exp());
    let trials = std::iter::once(here.towards)
        .chain(around)
        .flat_map(|towards| factors.map(|factor| Trial { towards, ambient: here.ambient * factor }));
    trials.skip(1).collect()
}
