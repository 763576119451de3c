//! Measures of shapes that are known exactly.

use super::*;
use crate::testing::{box_mesh, cylinder, sheet, sphere};
use glam::DQuat;
use rand::Rng as _;
use scene::rng::rng;

fn options() -> MeasureOptions {
    MeasureOptions { tolerance: 0.005, least_share: 0.01, most_shapes: 40, seed: 0 }
}

fn measured(mesh: &Mesh) -> Measures {
    measure(mesh, &options(), &Progress::silent()).unwrap().unwrap().0
}

/// Turned out of all axes, moved far away, scaled.
fn placed(mesh: &Mesh, scale: f64) -> Mesh {
    let turn = DQuat::from_xyzw(0.3, -0.5, 0.7, 0.2).normalize();
    let mut mesh = mesh.clone();
    mesh.vertices.iter_mut().for_each(|v| *v = (turn * *v + DVec3::new(3.0, -4.0, 5.0)) * scale);
    mesh
}

/// Vertices moved by a normal error of this standard deviation (Box and Muller 1958), the same for
/// a seed.
fn noisy(mesh: &Mesh, sigma: f64, seed: u64) -> Mesh {
    let mut random = rng(seed, "noise", 0);
    let mut mesh = mesh.clone();
    for v in &mut mesh.vertices {
        let mut normal = || {
            let (a, b): (f64, f64) = (random.random_range(1e-12..1.0), random.random());
            (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
        };
        *v += DVec3::new(normal(), normal(), normal()) * sigma;
    }
    mesh
}

fn check(what: &str, found: Estimate, expected: f64, deviations: f64) {
    let allowed = deviations * found.deviation + 1e-9 * expected.abs();
    assert!((found.value - expected).abs() <= allowed, "{what}: {found:?}, not {expected}");
    assert!(found.deviation.is_finite() && found.deviation <= 0.05 * expected.abs(), "{what}: {found:?}");
}

fn of_kind(m: &Measures, kind: FeatureKind) -> Vec<&Feature> {
    m.features.iter().filter(|f| f.kind == kind).collect()
}

#[test]
fn a_box_has_its_sides_six_planes_and_right_angles_at_any_scale() {
    for (scale, n) in [(1e-6, 1), (1.0, 1), (1e6, 1), (1.0, 30)] {
        let m = measured(&placed(&box_mesh(DVec3::new(1.0, 0.7, 0.4), n), scale));
        for (side, expected) in m.overall.sides.into_iter().zip([1.0, 0.7, 0.4]) {
            check("side", side, expected * scale, 3.0);
        }
        let centre = DVec3::new(3.0, -4.0, 5.0) * scale;
        assert!(DVec3::from_array(m.overall.centre).distance(centre) < 1e-9 * scale);
        assert_eq!(of_kind(&m, FeatureKind::Plane).len(), 6, "{scale} {n}: {m:#?}");
        assert_eq!(m.features.len(), 6);
        assert!((m.area / (2.0 * 1.38 * scale * scale) - 1.0).abs() < 1e-9);
        for f in &m.features {
            let sides: Vec<f64> = f.sizes.iter().map(|s| s.estimate().value / scale).collect();
            assert!((sides[0] * sides[1] - f.area / scale.powi(2)).abs() < 1e-6, "{sides:?} {f:?}");
        }
        let mut distances = vec![];
        for r in &m.relations {
            let right = if r.distance.is_some() { 0.0 } else { 90.0 };
            assert!((r.angle_deg.value - right).abs() < 1e-6 + 3.0 * r.angle_deg.deviation, "{r:?}");
            distances.extend(r.distance.map(|d| d.value / scale));
        }
        distances.sort_by(f64::total_cmp);
        let off = distances.iter().zip([0.4, 0.7, 1.0]).map(|(d, e)| (d - e).abs()).fold(0.0, f64::max);
        assert!(distances.len() == 3 && off < 1e-9, "{distances:?}");
    }
}

#[test]
fn a_cylinder_has_its_diameter_its_length_and_two_discs() {
    for (scale, n) in [(1e-6, 24), (1.0, 48), (1e6, 96)] {
        let m = measured(&placed(&cylinder(0.2, 1.0, n), scale));
        let [round] = of_kind(&m, FeatureKind::Cylinder)[..] else { panic!("{m:#?}") };
        let [Size::Diameter(diameter), Size::Length(long)] = round.sizes[..] else { panic!("{round:?}") };
        check("diameter", diameter, 0.4 * scale, 3.0);
        check("length", long, scale, 3.0);
        assert!(round.coverage_deg.unwrap() > 340.0);
        let discs = of_kind(&m, FeatureKind::Disc);
        assert_eq!(discs.len(), 2, "{m:#?}");
        for disc in discs {
            check("disc", disc.sizes[0].estimate(), 0.4 * scale, 3.0);
            let tilt = DVec3::from_array(disc.axis).dot(DVec3::from_array(round.axis)).abs();
            assert!(tilt > 1.0 - 1e-9);
        }
    }
}

#[test]
fn deviations_of_a_noisy_box_hold() {
    let (mut within, mut all) = (0, 0);
    for seed in 0..6 {
        let m = measured(&noisy(&placed(&box_mesh(DVec3::new(1.0, 0.7, 0.4), 40), 1.0), 0.001, seed));
        for (side, expected) in m.overall.sides.into_iter().zip([1.0, 0.7, 0.4]) {
            check("side", side, expected, 4.0);
        }
        assert_eq!(of_kind(&m, FeatureKind::Plane).len(), 6, "seed {seed}");
        for r in &m.relations {
            let right = if r.distance.is_some() { 0.0 } else { 90.0 };
            // Two tilts: an angle from parallel is the length of a vector of two.
            all += 1;
            within += u32::from((r.angle_deg.value - right).abs() < 3.0 * r.angle_deg.deviation);
            assert!(r.angle_deg.deviation < 0.2, "{r:?}");
            if let Some(d) = r.distance {
                let off = [1.0, 0.7, 0.4].map(|e| (d.value - e).abs()).into_iter().fold(1.0, f64::min);
                assert!(off < 4.0 * d.deviation && d.deviation < 1e-3, "{d:?}");
            }
        }
    }
    assert!(within * 100 >= all * 95, "{within} of {all} angles within three deviations");
}

#[test]
fn a_noisy_plane_and_a_noisy_cylinder_are_measured_within_their_deviations() {
    for seed in 0..5 {
        let m = measured(&noisy(&placed(&sheet(2.0, 1.0, 60), 1.0), 0.002, seed));
        assert_eq!((m.features.len(), m.features[0].kind), (1, FeatureKind::Plane), "seed {seed}");
        check("length", m.features[0].sizes[0].estimate(), 2.0, 3.0);
        check("width", m.features[0].sizes[1].estimate(), 1.0, 3.0);
        assert!((0.0015..0.0025).contains(&m.features[0].rms), "{}", m.features[0].rms);
        let m = measured(&noisy(&placed(&cylinder(0.2, 1.0, 100), 1.0), 0.001, seed));
        let [round] = of_kind(&m, FeatureKind::Cylinder)[..] else { panic!("seed {seed}: {m:#?}") };
        check("diameter", round.sizes[0].estimate(), 0.4, 4.0);
        check("length", round.sizes[1].estimate(), 1.0, 3.0);
    }
}

#[test]
fn what_has_no_surface_has_no_measures_and_little_surface_has_finite_ones() {
    let none = |mesh: &Mesh| measure(mesh, &options(), &Progress::silent()).unwrap().is_none();
    assert!(none(&Mesh::default()));
    let mut one = Mesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::NAN],
        triangles: vec![[0, 1, 2], [0, 1, 3], [0, 0, 1], [0, 1, 7]],
        ..Mesh::default()
    };
    let (m, labels) = measure(&one, &options(), &Progress::silent()).unwrap().unwrap();
    assert_eq!(labels, [Some(0), None, None, None]);
    let all = m.overall.sides.iter().chain([&m.features[0].sizes[0].estimate()]).copied().collect::<Vec<_>>();
    assert!(all.iter().all(|e| e.value.is_finite() && e.deviation.is_finite()), "{all:?}");
    let sides = m.overall.sides.map(|s| s.value);
    assert!((sides[0] * sides[1] - 1.0).abs() < 1e-9 && sides[2] < 1e-9, "{sides:?}");
    one.vertices = vec![DVec3::ONE; 4];
    assert!(none(&one));
    // A sphere is neither; what is found says how badly it fits.
    let m = measured(&sphere(1.0, 60));
    assert!(
        m.features
            .iter()
            .all(|f| f.rms.is_finite() && f.sizes.iter().all(|s| s.estimate().deviation.is_finite()))
    );
    check("diameter", m.overall.sides[0], 2.0, 3.0);
}

#[test]
fn the_same_seed_measures_the_same() {
    let mesh = noisy(&cylinder(0.3, 1.0, 40), 0.001, 1);
    assert_eq!(measured(&mesh), measured(&mesh));
}
