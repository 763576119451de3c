//! The published JSON schema of `run.json`: `docs/run.schema.json`.

use super::RunRecord;
use schemars::Schema;

/// The schema of `run.json`, as `docs/run.schema.json` holds it.
pub fn run_schema() -> Schema {
    schemars::schema_for!(RunRecord)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::decision::{
        Choice, Decision, Measurement, MotionModel, PrincipalPoint, Quantity, Remark, Rule, Subject,
    };

    #[test]
    fn the_published_schema_is_that_of_the_types() {
        let published: serde_json::Value =
            serde_json::from_str(include_str!("../../docs/run.schema.json")).unwrap();
        assert_eq!(
            published,
            serde_json::to_value(run_schema()).unwrap(),
            "run 'cargo run --example run_schema > docs/run.schema.json'"
        );
    }

    #[test]
    fn decisions_of_every_form_follow_the_schema_and_others_do_not() {
        let schema = serde_json::to_value(schemars::schema_for!(Decision)).unwrap();
        let validator = jsonschema::validator_for(&schema).unwrap();
        let camera = Choice::Camera { model: None, principal_point: PrincipalPoint::FreeX };
        let choices = [
            camera,
            MotionModel::Orbit.into(),
            true.into(),
            Choice::share(3, 4),
            Choice::Value(Measurement::estimate(Quantity::Elevation, 12.0, 0.5)),
            Choice::Direction([0.0, 1.0, 0.0]),
            Choice::Device("processor".to_owned()),
        ];
        for choice in choices {
            let decision = Decision::new(Subject::Motion, choice, Rule::Evidence)
                .remarked(Remark::NoCircle)
                .measured(Quantity::Bic, f64::NAN)
                .compared(MotionModel::Free, false, vec![Measurement::new(Quantity::Noise, 0.3)])
                .quoting("as it is");
            let json = serde_json::to_value(&decision).unwrap();
            assert!(validator.is_valid(&json), "{json}");
        }
        let old = serde_json::json!(["motion", "single-axis", "BIC 12"]);
        assert!(!validator.is_valid(&old));
    }
}
