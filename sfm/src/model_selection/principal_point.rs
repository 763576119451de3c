//! The principal point once more, when a model has gained observations.

use super::camera::{CameraSelection, CameraTrial, FreeIntrinsics, deviation, options, point_sigma};
use super::evidence::{Comparison, is_determined};
use crate::bundle::BundleProblem;
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};
use scene::{CameraModel, Progress};

/// What slides over an object (glints) errs together in all images, and the fit takes it up, so
/// that no residual shows it: by how much a coordinate was off, in its standard deviations.
/// Source: docs/decisions/11, case 1.
const GLINTS: f64 = 18.0;

/// Whether more observations than the choice of the model had determine a principal point that was
/// held: with both terms of radial distortion, whose centre it is; else one coordinate of it, as an
/// orbit tells the one across its axis far better than the other. `None` where they determine
/// neither, or the user named a model.
pub(crate) fn free_principal_point(
    problem: &BundleProblem,
    known: &[Knowledge],
    (now, named): (FreeIntrinsics, Option<CameraModel>),
    sigma: f64,
    progress: &Progress,
) -> Result<Option<(FreeIntrinsics, Decision)>, SfmError> {
    let asked = named.is_none() && !now.principal_point && !known.iter().any(|k| k.fixed);
    let selection = CameraSelection::new(problem, known, sigma, progress);
    if !asked || !selection.has_enough() {
        return Ok(None);
    }
    let held = selection.trial(problem, now)?;
    let whole = FreeIntrinsics { model: CameraModel::Radial, principal_point: true, held: None };
    let free = selection.trial(&held.problem, whole)?;
    let held = selection.again(&held, &free)?.unwrap_or(held);
    let found = Comparison::new(&free.score, &held.score);
    let taken = found.prefers_richer() && selection.determines(&free)?;
    let mut decision = Decision::new(Subject::CameraModelWithPlane, whole.choice(), Rule::Evidence)
        .compared(now.choice(), !taken, held.scores())
        .compared_all([free.compared(&found, taken)]);
    if taken {
        return Ok(Some((whole, decision)));
    }
    for coordinate in 0..2 {
        let one = FreeIntrinsics { principal_point: true, held: Some(1 - coordinate), ..now };
        let free = selection.trial(&held.problem, one)?;
        let share = share_of_prior(&free, coordinate)?;
        let taken = is_determined(share, GLINTS, 1.0) && free.score.bic < held.score.bic;
        let mut alternative = free.as_alternative(taken);
        alternative.scores.push(Measurement::new(Quantity::ShareOfPrior, share));
        decision.alternatives.push(alternative);
        if taken {
            decision.choice = one.choice();
            return Ok(Some((one, decision)));
        }
    }
    Ok(None)
}

/// The standard deviation of a coordinate of the principal point, as a share of that beforehand: of
/// the camera that is known least.
fn share_of_prior(trial: &CameraTrial, coordinate: usize) -> Result<f64, SfmError> {
    let Some(covariance) = trial.problem.covariance(&options())? else { return Ok(f64::INFINITY) };
    let shares = trial.problem.cameras.iter().zip(&covariance.cameras).map(|(camera, c)| {
        deviation(camera, c, camera.model.num_focals() + coordinate) / point_sigma(camera)
    });
    Ok(shares.fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::BundleObservation;
    use crate::model_selection::camera::before_the_choice;
    use glam::{DMat3, DQuat, DVec3};
    use rand::Rng as _;
    use scene::rng::rng;
    use scene::{Camera, Pose};

    /// What 24 cameras see that go round points in a circle and look down on them a little; the
    /// solver's camera has its principal point at the centre, the true one has not.
    fn orbit(across: f64, noise_px: f64) -> BundleProblem {
        let mut camera = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 530.0);
        let centred = camera.clone();
        camera.params[1] += across;
        let mut r = rng(3, "freed", 0);
        let points: Vec<DVec3> =
            (0..300).map(|_| DVec3::from_array(std::array::from_fn(|_| r.random_range(-0.6..0.6)))).collect();
        let pose = |k: usize| {
            let a = std::f64::consts::TAU * k as f64 / 24.0;
            let centre = DVec3::new(2.4 * a.sin(), -2.4 * a.cos(), 0.6);
            let z = (-centre).normalize();
            let x = z.cross(DVec3::Z).normalize();
            let rotation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z).transpose());
            Pose { rotation, translation: rotation * -centre }
        };
        let poses: Vec<Pose> = (0..24).map(pose).collect();
        let mut observations = Vec::new();
        for (k, pose) in poses.iter().enumerate() {
            for (i, x) in points.iter().enumerate() {
                let off = glam::DVec2::new(r.random_range(-1.0..1.0), r.random_range(-1.0..1.0));
                let pixel = camera.project(pose.transform(*x)).unwrap() + off * noise_px * 3f64.sqrt();
                observations.push(BundleObservation {
                    pose: k as u32,
                    point: i as u32,
                    pixel,
                    sigma_px: 1.0,
                });
            }
        }
        BundleProblem {
            camera_free: vec![vec![true, false, false, true]],
            cameras: vec![centred],
            priors: Vec::new(),
            expected: None,
            pose_camera: vec![0; poses.len()],
            pose_constant: vec![false; poses.len()],
            point_constant: vec![false; points.len()],
            poses,
            points,
            observations,
        }
    }

    fn free_point_of(
        problem: &BundleProblem,
        known: Knowledge,
        named: Option<CameraModel>,
    ) -> Option<FreeIntrinsics> {
        let now = before_the_choice(None);
        free_principal_point(problem, &[known], (now, named), 0.3, &Progress::silent()).unwrap().map(|f| f.0)
    }

    #[test]
    fn an_orbit_determines_the_principal_point_across_its_axis_alone() {
        let off = orbit(9.0, 0.3);
        let found =
            free_point_of(&off, Knowledge::default(), None).expect("nine pixels across the axis show");
        assert!(found.principal_point && found.held == Some(1), "{found:?}");
    }

    #[test]
    fn a_point_at_the_centre_or_of_a_camera_that_is_given_or_named_is_left() {
        assert_eq!(free_point_of(&orbit(0.0, 0.3), Knowledge::default(), None), None);
        let off = orbit(9.0, 0.3);
        assert_eq!(free_point_of(&off, Knowledge::exact(), None), None);
        assert_eq!(free_point_of(&off, Knowledge::default(), Some(CameraModel::SimpleRadial)), None);
    }
}
