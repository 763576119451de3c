use super::*;

/// A body with two equal moments of inertia: `Q(t) = turn about the momentum · turn about its axis`
/// in closed form (Landau & Lifshitz, Mechanics, § 35).
#[test]
fn a_symmetric_top_precesses_about_its_momentum() {
    let (across, along) = (0.8, 1.4); // responses |L|/I, 1/s
    let body = TorqueFreeBody {
        attitude: DQuat::from_scaled_axis(DVec3::new(0.5, 0.3, -0.2)),
        momentum: DVec3::new(0.3, 0.4, 0.5).normalize(),
        log_response: DMat3::from_diagonal(DVec3::new(f64::ln(across), f64::ln(across), f64::ln(along))),
    };
    let times = [-3.0, 0.0, 0.7, 5.0, 40.0];
    let cosine = (body.attitude.conjugate() * body.momentum).z;
    for (time, found) in times.iter().zip(body.attitudes(&times)) {
        let precession = DQuat::from_axis_angle(body.momentum, across * time);
        let spin = DQuat::from_rotation_z((along - across) * cosine * time);
        let expected = precession * body.attitude * spin;
        assert!(found.dot(expected).abs() > 1.0 - 1e-11, "{time}: {found} {expected}");
    }
}

#[test]
fn energy_stays_the_same() {
    let body = crate::torque_free::fit::tests::body();
    let times: Vec<f64> = (0..200).map(|i| 0.3 * f64::from(i)).collect();
    let energy = |q: &DQuat| body.rates(*q).dot(q.conjugate() * body.momentum);
    let all: Vec<f64> = body.attitudes(&times).iter().map(energy).collect();
    assert!(all.iter().all(|e| (e / all[0] - 1.0).abs() < 1e-6), "{all:?}");
}

#[test]
fn an_impossibly_fast_body_is_not_followed_for_ever() {
    let body = TorqueFreeBody {
        attitude: DQuat::IDENTITY,
        momentum: DVec3::X,
        log_response: DMat3::from_diagonal(DVec3::splat(40.0)),
    };
    // e⁴⁰ radians a second: at 20 steps a radian this would take longer than the world is old.
    let found = body.attitudes(&[-1.0, 0.0, 1e3]);
    assert!(found.iter().all(|q| q.is_finite() && q.is_normalized()), "{found:?}");
}
