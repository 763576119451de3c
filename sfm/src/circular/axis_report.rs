//! How well the axis was found, for the report.

use super::axis::{Elevation, elevation};
use super::deviations::AxisDeviation;
use super::model::{AxisModel, CircularContext};
use super::motion::wrap_angle;
use super::problem::CircularCovariance;
use crate::error::SfmError;
use crate::model_selection::camera::{FreeIntrinsics, PRINCIPAL_POINT_SIGMA};
use scene::decision::{Choice, Decision, Measurement, Quantity, Remark, Rule, Subject};

/// An elevation is doubtful that leads this far away from what is usual, standard deviations.
/// Source: chosen by hand, never measured.
const DOUBTFUL: f64 = 3.0;

/// What is to be said of the axis, and of an elevation that was given; how well its direction is
/// known. `excess`: factor
/// on the observations' variances, as they err together.
pub(crate) fn decisions(
    model: &AxisModel,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
    covariance: &CircularCovariance,
    excess: f64,
) -> Result<(Vec<Decision>, AxisDeviation), SfmError> {
    let [sideways, towards] =
        with_principal_point(model, context, intrinsics, excess)?.unwrap_or(covariance.axis);
    let given = model.elevation.as_ref().map_or(0.0, |elevation| elevation.sigma);
    let deviation = AxisDeviation { sideways, towards: towards.max(given) };
    let z = model.turn.direction();
    let angles: Vec<f64> = model.turn.angles.iter().flatten().copied().collect();
    let steps: Vec<f64> = angles.windows(2).map(|w| wrap_angle(w[1] - w[0]).to_degrees()).collect();
    let mean = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
    let spread = steps.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / steps.len().max(1) as f64;
    let worst = covariance.angles.iter().copied().fold(0.0, f64::max).to_degrees();
    let axis = Decision::new(Subject::RotationAxis, Choice::Direction(z.to_array()), Rule::Evidence)
        .with_all([
            Measurement::new(Quantity::AxisTiltSideways, deviation.sideways.to_degrees()),
            Measurement::new(Quantity::AxisTiltTowards, deviation.towards.to_degrees()),
            Measurement::new(Quantity::AngleDeviation, worst),
            Measurement::estimate(Quantity::AngularStep, mean, spread.sqrt()),
            Measurement::count(Quantity::RegisteredImages, angles.len()),
        ]);
    let given = model.elevation.as_ref().or(context.elevation.as_ref());
    let given = given.map(|given| elevation_decision(model, given, context.known[0].fixed));
    Ok((std::iter::once(axis).chain(given).collect(), deviation))
}

/// Standard deviations of the axis' direction where the principal point is no better known than the
/// observations and its prior say; `None` where it was solved for or is known. Held at the centre
/// it would seem exact, and the axis with it.
fn with_principal_point(
    model: &AxisModel,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
    excess: f64,
) -> Result<Option<[f64; 2]>, SfmError> {
    let whole = FreeIntrinsics { principal_point: true, held: None, ..intrinsics };
    if context.known[0].fixed || whole == intrinsics {
        return Ok(None);
    }
    Ok(model.covariance(context, whole, excess)?.map(|(.., covariance)| covariance.axis))
}

fn elevation_decision(model: &AxisModel, given: &Elevation, known: bool) -> Decision {
    let found = elevation(&model.turn);
    let camera = &model.state.cameras[0];
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let off = camera.principal_point() - glam::DVec2::new(width, height) / 2.0;
    let usual = DOUBTFUL * PRINCIPAL_POINT_SIGMA * width.max(height);
    let far = off.length() > usual || (found - given.angle).abs() > DOUBTFUL * given.sigma;
    let rule = if model.elevation.is_none() && !known { Rule::Contradicted } else { Rule::Evidence };
    let choice = Measurement::new(Quantity::Elevation, found.to_degrees());
    let mut decision = Decision::new(Subject::CameraElevation, choice, rule).remarked(given.source);
    match (&model.elevation, known) {
        (None, true) => decision.remarks.push(Remark::KnownCamera),
        (None, false) => decision.remarks.push(given.doubt),
        (Some(_), _) if far => decision.remarks.push(given.doubt),
        (Some(_), _) => {}
    }
    let (angle, sigma) = (given.angle.to_degrees(), given.sigma.to_degrees());
    decision
        .estimated(Quantity::GivenElevation, angle, sigma)
        .with_all(given.figures.iter().copied())
        .measured(Quantity::PrincipalPointOffset, off.length())
        .measured(Quantity::UsualOffset, usual)
}
