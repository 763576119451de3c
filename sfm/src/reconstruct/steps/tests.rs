use super::ties::{STRONG_TIE, strong_tie};
use super::*;
use crate::sift::{Doubling, SiftConfig};
use clap::ValueEnum as _;
use std::collections::BTreeSet;

#[test]
fn fewer_features_are_tied_by_fewer_matches_and_more_by_no_more() {
    let tie =
        |max_features, doubling| strong_tie(&SiftConfig { max_features, doubling, ..SiftConfig::default() });
    assert_eq!(strong_tie(&SiftConfig::default()), STRONG_TIE);
    assert_eq!(tie(8192, Doubling::Auto), STRONG_TIE);
    assert_eq!(tie(2048, Doubling::Auto), STRONG_TIE / 2);
    assert_eq!(tie(2048, Doubling::Never), STRONG_TIE / 4);
}

#[test]
fn the_help_names_all_steps_in_their_order() {
    let names: Vec<&str> = STEPS.iter().map(|s| s.name).collect();
    assert!(crate::skip::HELP.ends_with(&names.join(", ")), "{}", names.join(", "));
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
}

#[test]
fn steps_are_skipped_by_their_names_and_every_name_is_a_step_or_a_part_of_one() {
    let parts = [
        StepName::StructurelessResection,
        StepName::RotatedImages,
        StepName::PhotometricClosure,
        StepName::VerticalLines,
    ];
    for name in StepName::value_variants() {
        let flag = name.to_possible_value().unwrap();
        let steps: Vec<&str> = STEPS.iter().filter(|s| s.skip == Some(*name)).map(|s| s.name).collect();
        let wanted = if parts.contains(name) { vec![] } else { vec![flag.get_name()] };
        assert_eq!(steps, wanted);
    }
}
