use super::camera_prior::{FOCAL_LOG_SIGMA, distortion_sigmas, focal_sigmas};
use super::probability::weigh;
use scene::decision::{Measurement, Quantity, Remark};
use scene::{Camera, CameraModel};

fn camera(focal: f64) -> Camera {
    Camera::centred(1, CameraModel::SimpleRadial, 640, 480, focal)
}

#[test]
fn a_focal_length_far_from_all_lenses_is_a_surprise_and_a_stated_one_is_held_tighter() {
    assert!(focal_sigmas(&camera(1.2 * 640.0), None) < 1e-9);
    assert!(focal_sigmas(&camera(9.67 * 1.2 * 640.0), None) > 4.0, "the dark bust's");
    assert!(focal_sigmas(&camera(300.0), None) < 2.0 && focal_sigmas(&camera(2000.0), None) < 2.0);
    let stated = Some((600.0, 0.05));
    assert!((focal_sigmas(&camera(600.0 * 1.1), stated) - 1.1f64.ln() / 0.05).abs() < 1e-9);
    let doubled = focal_sigmas(&camera(2.4 * 640.0), None);
    assert!((doubled - 2f64.ln() / FOCAL_LOG_SIGMA).abs() < 1e-9);
}

#[test]
fn distortion_is_judged_by_what_it_does_at_the_corner() {
    let mut bent = camera(500.0);
    assert!(distortion_sigmas(&bent) < 1e-9);
    // (400 / 500)² = 0.64: a twentieth at the corner is one standard deviation.
    bent.params[3] = -0.05 / 0.64;
    assert!((distortion_sigmas(&bent) - 1.0).abs() < 1e-9);
}

/// A model of which all is usual but what is given.
fn with(changes: &[(Quantity, f64)]) -> Vec<Measurement> {
    let usual = [
        (Quantity::CameraSurprise, 0.6),
        (Quantity::AgreeingPairs, 0.97),
        (Quantity::LeastExplained, 0.8),
        (Quantity::LeastFirm, 400.0),
        (Quantity::PointAngle, 20.0),
        (Quantity::WeakestLink, 0.8),
        (Quantity::HeldOutAgreement, 0.85),
        (Quantity::SecondDifference, 0.1),
    ];
    let changed = |q: Quantity| changes.iter().find(|c| c.0 == q).map(|c| c.1);
    usual.map(|(q, v)| Measurement::new(q, changed(q).unwrap_or(v))).to_vec()
}

#[test]
fn a_usual_model_is_probable_and_one_that_all_contradicts_is_not() {
    let (probability, against) = weigh(&with(&[]));
    assert!(probability > 0.97 && against.is_empty(), "{probability} {against:?}");
    let bust = [
        (Quantity::CameraSurprise, 4.6),
        (Quantity::LeastFirm, 36.0),
        (Quantity::HeldOutAgreement, 0.2),
        (Quantity::SecondDifference, 93.0),
    ];
    let (probability, against) = weigh(&with(&bust));
    assert!(probability < 0.1, "{probability}");
    assert!(against.contains(&Remark::UnusualCamera), "{against:?}");
    assert!(against.contains(&Remark::SolutionsDisagree), "{against:?}");
}

#[test]
fn what_is_not_known_adds_nothing() {
    let known = with(&[]);
    let mut unknown = known.clone();
    unknown.retain(|m| m.quantity != Quantity::PointAngle);
    let mut none = known;
    none.iter_mut().filter(|m| m.quantity == Quantity::PointAngle).for_each(|m| m.value = f64::NAN);
    assert_eq!(weigh(&unknown).0, weigh(&none).0);
    assert!(weigh(&[]).0.is_finite());
}
