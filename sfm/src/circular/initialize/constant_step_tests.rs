//! Rings of photos of an exact scene, most of whose matches are wrong.

use super::constant_step::{ConstantStepMotion, hold_on_ring};
use crate::circular::initialize::key_frames::VideoTracks;
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::circular::tests::{Filmed, Turntable};
use crate::incremental::state::MappingInput;
use crate::matching::PairMatches;
use crate::solvers::testing::unit_vector;
use crate::tracks::Tracks;
use glam::{DMat3, DQuat, DVec2};
use rand::Rng as _;
use scene::Pose;
use scene::rng::{Rng, rng};
use scene::{Camera, CameraModel};

/// Photos in the order of `places` on a table, with small motions of the camera.
fn ring(places: &[usize], step_deg: f64, seed: u64) -> Turntable {
    let most = places.iter().max().map_or(0, |m| m + 1);
    let mut table = Turntable::new(most, step_deg, seed);
    let mut r = rng(seed, "hand", 0);
    let shaken = |pose: &Pose, r: &mut Rng| {
        let shake = DQuat::from_scaled_axis(unit_vector(r) * 0.004);
        Pose::new(shake * pose.rotation, shake * pose.translation + unit_vector(r) * 0.01)
    };
    table.poses = places.iter().map(|&p| shaken(&table.poses[p], &mut r)).collect();
    table
}

/// By image where its points are seen and which they are; for images up to four apart their
/// matches, `wrong` of them at random.
fn seen(table: &Turntable, wrong: f64, seed: u64) -> (Vec<Vec<DVec2>>, Vec<Vec<u32>>, Vec<PairMatches>) {
    let n = table.poses.len();
    let of = |frame: usize| -> Vec<(DVec2, u32)> {
        let sees = |(i, x): (usize, &glam::DVec3)| Some((table.sees(frame, *x)?, i as u32));
        table.points.iter().enumerate().filter_map(sees).collect()
    };
    let all: Vec<Vec<(DVec2, u32)>> = (0..n).map(of).collect();
    let mut r = rng(seed, "wrong matches", 0);
    let mut matches = Vec::new();
    for a in 0..n {
        for b in a + 1..n {
            if b - a > 4 && b - a + 4 < n {
                continue;
            }
            let partner = |(i, p): (usize, &(DVec2, u32))| {
                Some([i as u32, all[b].iter().position(|q| q.1 == p.1)? as u32])
            };
            let mut pairs: Vec<[u32; 2]> = all[a].iter().enumerate().filter_map(partner).take(60).collect();
            for m in &mut pairs {
                if r.random_range(0.0..1.0) < wrong {
                    m[1] = r.random_range(0..all[b].len() as u32);
                }
            }
            matches.push((a, b, pairs));
        }
    }
    let places = all.iter().map(|v| v.iter().map(|p| p.0).collect()).collect();
    (places, all.iter().map(|v| v.iter().map(|p| p.1).collect()).collect(), matches)
}

fn even(table: &Turntable, wrong: f64, seed: u64) -> Option<ConstantStepMotion> {
    let (places, _, matches) = seen(table, wrong, seed);
    let guess = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 768.0);
    ConstantStepMotion::of(&guess, false, &places, &matches)
}

/// What a job needs of a scene whose tracks are exact, wrong matches aside.
fn placed(table: &Turntable, turn: &ConstantStepMotion, hold: bool) -> Option<(Vec<Option<Pose>>, f64)> {
    let n = table.poses.len();
    let (keypoints, points, _) = seen(table, 0.0, 0);
    let mut views = vec![Vec::new(); table.points.len()];
    for (image, of) in points.iter().enumerate() {
        of.iter().enumerate().for_each(|(k, p)| views[*p as usize].push([image as u32, k as u32]));
    }
    let tracks = Tracks { of: points, views };
    let filmed = Filmed::new(n, Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 768.0), false);
    let nothing = VideoTracks::of_klt(&[], n);
    let video = filmed.video();
    let input = MappingInput { keypoints: &keypoints, tracks: &tracks, ..video.input(&nothing) };
    let job = filmed.job(&input, &filmed.cameras);
    let intrinsics = crate::model_selection::camera::before_the_choice(None);
    let (state, kept) = turn.model(&job, intrinsics).unwrap()?;
    let state = if hold { hold_on_ring(&state, &job, intrinsics).unwrap() } else { state };
    Some((state.poses, kept))
}

#[test]
fn neighbours_together_show_the_turn_that_a_pair_alone_does_not() {
    for (seed, step, n) in [(0, 10.0, 36), (1, -10.0, 36), (2, 15.0, 24)] {
        let places: Vec<usize> = (0..n).collect();
        let turn = even(&ring(&places, step, seed), 0.5, seed).unwrap();
        assert!(turn.closed, "{seed}: {:?}", turn.agreeing);
        // The axis may be found upside down, with the turn in the other sense.
        assert!((turn.step_deg().abs() - step.abs()).abs() < 1e-9, "{seed}: {}", turn.step_deg());
        assert!((turn.places(0, n - 1) + 1.0).abs() < 1e-12);
    }
}

#[test]
fn its_lines_are_those_of_the_true_poses() {
    let places: Vec<usize> = (0..36).collect();
    let table = ring(&places, 10.0, 3);
    let turn = even(&table, 0.5, 3).unwrap();
    let k = DMat3::from_cols_array(&[700.0, 0.0, 0.0, 0.0, 700.0, 0.0, 320.0, 240.0, 1.0]);
    for (a, b) in [(0, 1), (5, 8), (35, 1), (20, 17)] {
        let f = turn.fundamental(a, b);
        let ideal = |frame: usize, x: glam::DVec3| {
            let p = k * table.poses[frame].transform(x);
            p.truncate() / p.z
        };
        let both =
            table.points.iter().filter(|x| table.sees(a, **x).is_some() && table.sees(b, **x).is_some());
        let off = both.map(|x| crate::solvers::sampson_sq(&f, ideal(a, *x), ideal(b, *x)).sqrt());
        let worst = off.fold(0.0, f64::max);
        // What the hand does: 0.004 rad are 3 px.
        assert!(worst < 8.0, "{a} {b}: {worst} px");
    }
}

#[test]
fn what_is_no_ring_in_the_order_of_its_files_is_none() {
    // A part of a turn has no closing.
    let part: Vec<usize> = (0..20).collect();
    let turn = even(&ring(&part, 10.0, 4), 0.4, 4).unwrap();
    assert!(!turn.closed && turn.places(0, 19) == 19.0);
    let shuffled: Vec<usize> = (0..36).map(|i| (i * i * 5 + i * 7) % 36).collect();
    // Lines alone may agree; places do not.
    let table = ring(&shuffled, 10.0, 5);
    assert!(even(&table, 0.4, 5).is_none_or(|turn| placed(&table, &turn, false).is_none()));
    let places: Vec<usize> = (0..36).collect();
    assert!(even(&ring(&places, 10.0, 6), 1.0, 6).is_none(), "all matches are wrong");
    assert!(even(&ring(&places[..7], 10.0, 7), 0.0, 7).is_none(), "too few images");
    let camera = Camera::centred(1, CameraModel::SimpleRadial, 640, 480, 768.0);
    assert!(ConstantStepMotion::of(&camera, false, &[], &[]).is_none());
    let nowhere = vec![vec![DVec2::NAN; 50]; 20];
    let matches: Vec<PairMatches> = (0..19).map(|i| (i, i + 1, (0..50).map(|k| [k, k]).collect())).collect();
    assert!(ConstantStepMotion::of(&camera, false, &nowhere, &matches).is_none());
}

#[test]
fn all_images_find_their_places_on_the_ring() {
    let places: Vec<usize> = (0..36).collect();
    let table = ring(&places, 10.0, 8);
    let turn = even(&table, 0.5, 8).unwrap();
    let (poses, kept) = placed(&table, &turn, false).unwrap();
    assert!(kept > 0.9, "{kept}");
    assert_eq!((poses.iter().flatten().count(), turn.astray(&poses)), (36, 0));
    let (poses, _) = placed(&table, &turn, true).unwrap();
    let between = |poses: &[Pose], i: usize| poses[i].compose(&poses[0].inverse()).rotation;
    let found: Vec<Pose> = poses.iter().flatten().copied().collect();
    for i in 0..36 {
        let off = between(&found, i).angle_between(between(&table.poses, i)).to_degrees();
        assert!(off < 0.1, "image {i} is off by {off}°");
    }
    // An image elsewhere is noticed, and a model of another motion altogether.
    let mut astray = poses.clone();
    astray[9] = astray[30];
    assert_eq!(turn.astray(&astray), 1);
    let spun = CircularMotion::of_poses(&poses).unwrap().0;
    let twice: Vec<Option<Pose>> = (0..36).map(|i| spun.pose((2 * i) % 36)).collect();
    assert!(turn.astray(&twice) > 20);
    assert!(wrap_angle(spun.angles[35].unwrap()).abs() < 0.2);
}
