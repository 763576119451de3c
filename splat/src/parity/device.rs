//! What only an adapter has: photos that stay there, steps under way, pages of the model,
//! densification by kernels, subgroup operations, limits.

use super::scenes::{ordinary, view};
use super::steps::{Goal, RATES};
use crate::backend::{Backend, Round, StepInput, StepOutput, Target};
use crate::cpu::densify::densify_by_edit;
use crate::gpu::{GpuBackend, Opening};
use crate::model::{LOG_SCALE, MEAN, Model};
use crate::statistics::Statistics;
use crate::view::{PinholeView, RenderOptions};
use glam::{Mat3, Vec3};
use scene::Gaussians;
use scene::decision::Choice;
use std::collections::HashMap;

fn opened(opening: Opening) -> GpuBackend {
    GpuBackend::open(&opening).expect("an adapter; mesa-vulkan-drivers brings one")
}

/// Kernels for every adapter, and bindings of 64 KiB: pages of a few hundred Gaussians.
fn small() -> Opening {
    Opening { plain: true, binding: Some(64 << 10), ..Opening::default() }
}

fn plain() -> Opening {
    Opening { plain: true, ..Opening::default() }
}

fn uploaded(opening: Opening, g: &Gaussians) -> GpuBackend {
    let mut gpu = opened(opening);
    gpu.upload(Model::from_gaussians(g), Statistics::default()).unwrap();
    gpu
}

/// Views of a scene, with a photo each.
fn photos(count: usize) -> Vec<(PinholeView, Goal)> {
    let other = ordinary(62, 60, 0);
    let turned = |k: usize| {
        let v = view(40, 34);
        let v = PinholeView { rotation: Mat3::from_rotation_y(0.1 * k as f32) * v.rotation, ..v };
        (v, Goal::of(&other, &v, &RenderOptions::default()))
    };
    (0..count).map(turned).collect()
}

fn input((view, goal): &(PinholeView, Goal), photo: Option<u32>) -> StepInput<'_> {
    let input = goal.input(view, RenderOptions::default(), RATES);
    StepInput { target: Target { photo, ..input.target }, ..input }
}

#[test]
fn steps_under_way_end_in_the_same_bytes_as_steps_that_are_waited_for() {
    let (g, photos) = (ordinary(61, 900, 1), photos(3));
    let mut waiting = uploaded(plain(), &g);
    let expected: Vec<StepOutput> =
        (0..40).map(|k| waiting.step(&input(&photos[k % 3], None)).unwrap()).collect();
    let mut gpu = uploaded(plain(), &g);
    let mut found = Vec::new();
    for k in 0..40 {
        found.extend(gpu.advance(&input(&photos[k % 3], Some(k as u32 % 3))).unwrap());
    }
    assert!(found.len() < 40, "some steps are under way");
    found.extend(gpu.settle().unwrap());
    assert_eq!(found, expected);
    assert_eq!(gpu.held()[1], 3, "each photo was sent once");
    assert_eq!(gpu.download().unwrap(), waiting.download().unwrap());
}

#[test]
fn a_step_whose_pairs_do_not_fit_is_repeated_before_those_after_it() {
    // From far away each Gaussian has one pair; then the camera goes near, and the pairs of one are
    // many.
    let g = ordinary(63, 1500, 0);
    let near = view(110, 90);
    let near = (near, Goal::of(&ordinary(62, 60, 0), &near, &RenderOptions::default()));
    let far = PinholeView { translation: Vec3::new(0.0, 0.0, 40.0), ..near.0 };
    let far = (far, Goal::of(&ordinary(62, 60, 0), &far, &RenderOptions::default()));
    let order = [&far, &far, &far, &far, &near, &far, &near, &near, &far];
    let mut waiting = uploaded(plain(), &g);
    let mut gpu = uploaded(plain(), &g);
    let (mut expected, mut found) = (Vec::new(), Vec::new());
    for view in order {
        expected.push(waiting.step(&input(view, None)).unwrap());
        found.extend(gpu.advance(&input(view, Some(u32::from(view.0 == far.0)))).unwrap());
    }
    found.extend(gpu.settle().unwrap());
    assert!(expected[4].pairs > 2 * expected[3].pairs && expected[4].pairs > 2048, "{expected:?}");
    assert_eq!(found, expected);
    assert_eq!(gpu.download().unwrap(), waiting.download().unwrap());
}

#[test]
fn a_model_in_pages_is_drawn_and_trained_as_one_in_a_single_page() {
    let (g, photos) = (ordinary(64, 1000, 2), photos(2));
    let run = |opening: Opening| {
        let mut gpu = uploaded(opening, &g);
        let picture = gpu.render(&photos[0].0, &RenderOptions::default()).unwrap();
        for k in 0..3 {
            gpu.step(&input(&photos[k % 2], None)).unwrap();
        }
        gpu.set_sh_degree(3).unwrap();
        let out = gpu.step(&input(&photos[0], None)).unwrap();
        (gpu.held()[0], picture, out, gpu.download().unwrap())
    };
    let (one, many) = (run(plain()), run(small()));
    assert!(one.0 == 1 && many.0 > 3, "{} and {} pages", one.0, many.0);
    assert_eq!(one.1, many.1);
    assert_eq!(one.2, many.2);
    assert_eq!(one.3, many.3);
}

/// Gaussians that may be judged otherwise here than on the host: those on a picture's border.
const MOST_OTHERWISE: usize = 2;

#[test]
fn a_round_of_densification_by_kernels_is_that_of_the_host() {
    let (g, photos) = (ordinary(65, 700, 1), photos(3));
    let views: Vec<PinholeView> = (0..40)
        .map(|k| {
            let v = photos[k % 3].0;
            PinholeView { translation: v.translation + Vec3::X * (0.02 * k as f32 - 0.7), ..v }
        })
        .collect();
    for (opening, room) in [(plain(), 150), (small(), 150), (plain(), 2000), (plain(), 0)] {
        let at = format!("{opening:?} room {room}");
        let both = [false, true].map(|by_kernels| {
            let mut gpu = uploaded(opening.clone(), &g);
            for photo in photos.iter().cycle().take(6) {
                gpu.step(&input(photo, None)).unwrap();
            }
            let before = gpu.download().unwrap();
            let round = Round { room, seed: 4, iteration: 6, remove_unseen: Some(&views[..]) };
            let unseen = if by_kernels { gpu.densify(&round) } else { densify_by_edit(&mut gpu, &round) };
            (before, unseen.unwrap(), gpu.download().unwrap(), gpu)
        });
        let [(before, unseen, (host, _), _), (_, unseen_here, (here, statistics), mut gpu)] = both;
        // The halves lie a little elsewhere, so that one on a picture's border may be judged
        // otherwise.
        assert!(
            unseen > 10 && unseen.abs_diff(unseen_here) <= MOST_OTHERWISE,
            "{at}: {unseen} and {unseen_here}"
        );
        assert!(here.len.abs_diff(host.len) <= MOST_OTHERWISE, "{at}: {} and {}", host.len, here.len);
        assert!(
            room == 0 || here.len + unseen_here > before.0.len + 30,
            "{at}: {} of {}",
            here.len,
            before.0.len
        );
        let zero = |p: &Vec<f32>| p.iter().all(|&v| v == 0.0);
        assert!(zero(&statistics.gradient) && zero(&statistics.visible));
        if here.len == host.len && unseen == unseen_here {
            compare_halves(&before, &host, &here, &at);
        }
        // And training goes on.
        let out = gpu.step(&input(&photos[0], None)).unwrap();
        assert!(out.loss.is_finite() && out.visible > 100 && out.non_finite == 0, "{at}: {out:?}");
    }
}

/// What a half has of its Gaussian unchanged.
fn inherited(m: &Model, i: usize) -> Vec<u32> {
    let unmoved = (0..11).filter(|p| !(MEAN..LOG_SCALE + 3).contains(p)).map(|p| m.geometry[p][i]);
    let k = m.sh_stride();
    unmoved.chain(m.sh[i * k..(i + 1) * k].iter().copied()).map(f32::to_bits).collect()
}

/// Moments and clock of a Gaussian.
fn moments(m: &Model, i: usize) -> Vec<f32> {
    let planes = m.geometry_m.iter().chain(&m.geometry_v).chain(&m.sh_v).chain([&m.steps]);
    planes.map(|plane| plane[i]).collect()
}

/// Everything is the same but the centres of halves, which lie 0.4 to 0.6 of the longest axis from
/// the old ones, and the order of halves whose scores are quotients that hardly differ: WGSL's
/// division is off by up to 2.5 ULP, and the host's by a half.
fn compare_halves(before: &(Model, Statistics), host: &Model, here: &Model, at: &str) {
    let (old, statistics) = before;
    let origin: HashMap<Vec<u32>, usize> = (0..old.len).map(|i| (inherited(old, i), i)).collect();
    assert_eq!(origin.len(), old.len, "all differ");
    let score = |i: usize| statistics.gradient[i] / statistics.visible[i];
    let mut places: HashMap<Vec<u32>, Vec<usize>> = HashMap::new();
    (0..here.len).for_each(|i| places.entry(inherited(here, i)).or_default().push(i));
    let (mut moved, mut swapped, mut missing) = (0, 0, 0);
    for i in 0..host.len {
        let own = inherited(host, i);
        let there = places.get(&own).and_then(|p| p.iter().copied().min_by_key(|j| j.abs_diff(i)));
        // A half on a picture's border may be judged otherwise; those behind it lie elsewhere then.
        let Some(j) = there else {
            missing += 1;
            continue;
        };
        let [a, b] = [&own, &inherited(host, j)].map(|own| score(origin[own]));
        let same_rank = i.abs_diff(j) <= MOST_OTHERWISE || (a - b).abs() <= 3.0 * f32::EPSILON * a;
        assert!(same_rank, "{at} gaussian {i} at {j}: {a} and {b}");
        swapped += usize::from(i.abs_diff(j) > MOST_OTHERWISE);
        assert_eq!(moments(host, i), moments(here, j), "{at} gaussian {i}");
        let scale = |m: &Model, i| Vec3::from_array(std::array::from_fn(|k| m.geometry[LOG_SCALE + k][i]));
        assert!((scale(host, i) - scale(here, j)).abs().max_element() < 1e-5, "{at} gaussian {i}");
        let longest = (scale(host, i) + Vec3::splat(std::f32::consts::LN_2)).max_element().exp();
        let apart = host.mean(i).distance(here.mean(j));
        let is_half = scale(host, i) != scale(old, origin[&own]);
        assert!(is_half || apart <= 0.0, "{at} gaussian {i} was not split and moved by {apart}");
        // Where one half was removed here and the other there.
        missing += usize::from(apart > 0.21 * longest + 1e-5);
        moved += usize::from(apart > 0.0);
    }
    println!("{at}: {moved} of {} lie elsewhere, {swapped} at other places of the list", host.len);
    // Each counts where it is and where its other half is.
    assert!(missing <= 2 * MOST_OTHERWISE, "{at}: {missing} were judged otherwise");
    assert!(swapped * 20 <= host.len, "{at}: {swapped} of {} have other places", host.len);
}

#[test]
fn kernels_with_subgroup_operations_agree_with_those_without() {
    let mut gpu = opened(Opening::default());
    println!("subgroup operations: {}", gpu.gpu().subgroups);
    assert!(!opened(plain()).gpu().subgroups);
    let (g, photos) = (ordinary(66, 3000, 1), photos(2));
    gpu.upload(Model::from_gaussians(&g), Statistics::default()).unwrap();
    let mut other = uploaded(plain(), &g);
    let options = RenderOptions::default();
    // Integers are sorted and added up exactly, whoever does it.
    assert_eq!(gpu.render(&photos[0].0, &options).unwrap(), other.render(&photos[0].0, &options).unwrap());
    for photo in &photos {
        let [a, b] = [&mut gpu, &mut other].map(|b| b.step(&input(photo, None)).unwrap());
        assert_eq!((a.visible, a.pairs), (b.visible, b.pairs));
        assert!((a.loss - b.loss).abs() < 1e-4 * a.loss, "{a:?} {b:?}");
    }
    let [a, b] = [&mut gpu, &mut other].map(|b| b.download().unwrap().0);
    let astray = |(x, y): (&f32, &f32)| (x - y).abs() > 0.1 * RATES.log_scale;
    let differ: usize =
        a.geometry.iter().zip(&b.geometry).map(|(x, y)| x.iter().zip(y).filter(|&v| astray(v)).count()).sum();
    assert!(differ * 200 < 11 * a.len, "{differ} of {} parameters", 11 * a.len);
}

#[test]
fn pairs_for_which_there_is_no_room_are_left_out_aloud() {
    // Bindings of 56 KiB hold the picture and 2,048 pairs.
    let (mut g, photos) = (ordinary(67, 1000, 0), photos(1));
    g.log_scales.iter_mut().for_each(|s| *s += 0.5);
    let mut gpu = uploaded(Opening { binding: Some(56 << 10), ..small() }, &g);
    let first = gpu.step(&input(&photos[0], None)).unwrap();
    assert!(first.pairs > 2048, "{first:?}");
    let remarks = gpu.remarks();
    assert!(remarks.len() == 1 && remarks[0].choice == Choice::count(2048), "{remarks:?}");
    let mut last = first;
    for _ in 0..20 {
        last = gpu.step(&input(&photos[0], None)).unwrap();
    }
    assert!(last.loss < 0.95 * first.loss, "{} to {}", first.loss, last.loss);
    assert!(gpu.remarks().is_empty(), "each is told once");
}

#[test]
fn growth_for_which_there_is_no_room_ends_aloud() {
    // Bindings of 64 KiB hold the records of 2,048 Gaussians.
    let (g, photos) = (ordinary(69, 1900, 0), photos(1));
    let mut gpu = uploaded(small(), &g);
    gpu.step(&input(&photos[0], None)).unwrap();
    let round = Round { room: 600, seed: 1, iteration: 1, remove_unseen: None };
    gpu.densify(&round).unwrap();
    assert!(gpu.gaussians() > 1700 && gpu.gaussians() <= 2048, "{}", gpu.gaussians());
    let remarks = gpu.remarks();
    assert!(remarks.iter().any(|r| r.choice == Choice::count(1900)), "{remarks:?}");
    let out = gpu.step(&input(&photos[0], None)).unwrap();
    assert!(out.loss.is_finite() && out.visible > 500, "{out:?}");
}

#[test]
fn a_lost_device_is_an_error_and_not_the_end_of_the_program() {
    let (g, photos) = (ordinary(68, 50, 0), photos(1));
    let mut gpu = uploaded(Opening::default(), &g);
    gpu.step(&input(&photos[0], None)).unwrap();
    gpu.gpu().device.destroy();
    let failed = (0..3).find_map(|_| gpu.advance(&input(&photos[0], Some(0))).err());
    let message =
        failed.or_else(|| gpu.settle().err()).expect("a destroyed device does not train").to_string();
    assert!(message.contains("--backend cpu"), "{message}");
}

#[test]
fn compiled_pipelines_are_kept_where_the_adapter_has_a_cache() {
    let again = [opened(Opening::default()), opened(Opening::default())];
    let [_, second] = again.each_ref().map(|b| b.gpu().pipelines.as_ref());
    match second {
        Some(pipelines) => assert!(pipelines.kept() > 0 && pipelines.path().is_file()),
        None => println!("{} has no cache", again[0].adapter()),
    }
}

#[test]
fn models_of_wrong_lengths_are_refused() {
    let mut gpu = opened(Opening::default());
    let whole = Model::from_gaussians(&ordinary(70, 40, 1));
    let broken: [fn(&mut Model); 4] =
        [|m| m.len = 4000, |m| m.sh_degree = 7, |m| m.sh.truncate(9), |m| m.geometry[MEAN].truncate(3)];
    for change in broken {
        let mut model = whole.clone();
        change(&mut model);
        assert!(gpu.upload(model, Statistics::default()).is_err());
    }
    gpu.upload(whole, Statistics::default()).unwrap();
    assert_eq!(gpu.gaussians(), 40);
}
