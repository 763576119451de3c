//! Features and matches judged by known homographies and by the true epipolar geometry, ours beside
//! others'.
//!
//! `cargo run --release -p sfm --example features_table [-- FOLDER]`; FOLDER holds what
//! `tests/oracle/sift.py` wrote (features of OpenCV and COLMAP of the same images). Data:
//! `../shared/data` or `$SAT_RECON_SHARED/data`.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Features, Frame, FrameSet, Keypoint, Progress};
use sfm::matching::{MatchConfig, PreparedFeatures, match_prepared};
use sfm::sift::{SiftConfig, extract_all};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A set of images with known cameras: `x ~ K (R X + t)`.
struct Truth {
    name: &'static str,
    frames: FrameSet,
    cameras: Vec<(DMat3, DMat3, DVec3)>,
}

type AnyResult<T> = Result<T, Box<dyn std::error::Error>>;

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().filter_map(|w| w.parse().ok()).collect()
}

fn row_major(v: &[f64]) -> DMat3 {
    DMat3::from_cols_array(&[v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]]).transpose()
}

fn frame(path: PathBuf) -> AnyResult<Frame> {
    let (width, height) = image::image_dimensions(&path)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Frame { name, path, width, height, ..Frame::default() })
}

/// Middlebury's `*_par.txt`: name, K, R, t a line.
fn temple(data: &Path) -> AnyResult<Truth> {
    let folder = data.join("temple_ring");
    let mut truth = Truth { name: "temple_ring", frames: FrameSet::default(), cameras: Vec::new() };
    for line in std::fs::read_to_string(folder.join("cameras_par.txt"))?.lines().skip(1) {
        let Some((name, rest)) = line.split_once(' ') else { continue };
        let v = numbers(rest);
        truth.frames.frames.push(frame(folder.join("images").join(name))?);
        truth.cameras.push((row_major(&v[0..9]), row_major(&v[9..18]), DVec3::new(v[18], v[19], v[20])));
    }
    Ok(truth)
}

/// Strecha's cameras are those of images twice as large; R is camera to world, and the centre is
/// given.
fn fountain(data: &Path) -> AnyResult<Truth> {
    let folder = data.join("fountain_p11");
    let mut truth = Truth { name: "fountain_p11", frames: FrameSet::default(), cameras: Vec::new() };
    for i in 0..11 {
        let text = std::fs::read_to_string(folder.join(format!("gt_dense_cameras/{i:04}.jpg.camera")))?;
        let v = numbers(&text);
        let k = DMat3::from_diagonal(DVec3::new(0.5, 0.5, 1.0)) * row_major(&v[0..9]);
        let r = row_major(&v[12..21]).transpose();
        truth.frames.frames.push(frame(folder.join(format!("images/{i:04}.jpg")))?);
        truth.cameras.push((k, r, -(r * DVec3::new(v[21], v[22], v[23]))));
    }
    Ok(truth)
}

impl Truth {
    /// `x_bᵀ F x_a = 0`.
    fn fundamental(&self, a: usize, b: usize) -> DMat3 {
        let ((ka, ra, ta), (kb, rb, tb)) = (self.cameras[a], self.cameras[b]);
        let r = rb * ra.transpose();
        let t = tb - r * ta;
        let cross = DMat3::from_cols(
            DVec3::new(0.0, t.z, -t.y),
            DVec3::new(-t.z, 0.0, t.x),
            DVec3::new(t.y, -t.x, 0.0),
        );
        kb.inverse().transpose() * cross * r * ka.inverse()
    }

    /// Angle between the viewing directions, degrees.
    fn step(&self, a: usize, b: usize) -> f64 {
        let z = |i: usize| self.cameras[i].1.row(2);
        z(a).angle_between(z(b)).to_degrees()
    }
}

/// Distances of a match from the true epipolar lines, the larger one, pixels. `shift`: added to
/// positions.
fn epipolar_distance(f: &DMat3, a: &Keypoint, b: &Keypoint, shift: f64) -> f64 {
    let x = (a.position() + shift).extend(1.0);
    let y = (b.position() + shift).extend(1.0);
    let (fx, fty) = (*f * x, f.transpose() * y);
    let e = y.dot(fx).abs();
    e / fx.truncate().length().min(fty.truncate().length())
}

/// Sums over the pairs of one range of steps.
#[derive(Default)]
struct Score {
    pairs: usize,
    matches: usize,
    correct: usize,
    distances: Vec<f64>,
}

const STEPS: [(f64, f64); 5] = [(3.0, 12.0), (12.0, 22.0), (22.0, 33.0), (33.0, 45.0), (45.0, 60.0)];
const CORRECT_PX: f64 = 2.0;

fn judge(truth: &Truth, who: &str, features: &[Features], config: &MatchConfig, shift: f64) {
    let prepared: Vec<_> = features.par_iter().map(PreparedFeatures::new).collect();
    let count = features.iter().map(Features::len).sum::<usize>() / features.len().max(1);
    let n = features.len();
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    let cpu = cpu_seconds();
    let matched: Vec<_> =
        pairs.par_iter().map(|&(a, b)| match_prepared(&prepared[a], &prepared[b], config)).collect();
    let matching = cpu_seconds() - cpu;
    let mut scores: [Score; 5] = Default::default();
    let mut far = (0, 0);
    for (&(a, b), matches) in pairs.iter().zip(&matched) {
        let step = truth.step(a, b);
        if step > 100.0 {
            far = (far.0 + 1, far.1 + matches.len());
        }
        let Some(bin) = STEPS.iter().position(|&(lo, hi)| (lo..hi).contains(&step)) else { continue };
        let f = truth.fundamental(a, b);
        let s = &mut scores[bin];
        s.pairs += 1;
        s.matches += matches.len();
        for &[i, j] in matches {
            let d = epipolar_distance(
                &f,
                &features[a].keypoints[i as usize],
                &features[b].keypoints[j as usize],
                shift,
            );
            if d < CORRECT_PX {
                s.correct += 1;
                s.distances.push(d);
            }
        }
    }
    for (s, (lo, hi)) in scores.iter_mut().zip(STEPS) {
        if s.pairs == 0 {
            continue;
        }
        s.distances.sort_by(f64::total_cmp);
        let median = s.distances.get(s.distances.len() / 2).copied().unwrap_or(f64::NAN);
        println!(
            "{:<14} {:<10} {:>6} {:>5.0}-{:<3.0}° {:>4} {:>8.1} {:>8.1} {:>7.1}% {:>8.3}",
            truth.name,
            who,
            count,
            lo,
            hi,
            s.pairs,
            s.matches as f64 / s.pairs as f64,
            s.correct as f64 / s.pairs as f64,
            100.0 * s.correct as f64 / s.matches.max(1) as f64,
            median,
        );
    }
    println!(
        "{:<14} {:<10} matching {:.2} CPU s ({} pairs); views over 100° apart: {:.1} matches a pair",
        truth.name,
        who,
        matching,
        pairs.len(),
        far.1 as f64 / far.0.max(1) as f64
    );
}

/// Features that a homography moves into the other image, and those that are found there again: the
/// repeatability of Mikolajczyk and Schmid (IJCV 2004), and how many matches are right.
fn judge_homography(case: &str, who: &str, features: &[Features; 2], h: &DMat3, size: (u32, u32)) {
    const SCALE_RATIO: f32 = 1.5;
    let inside = |p: DVec2| {
        (8.0..f64::from(size.0) - 8.0).contains(&p.x) && (8.0..f64::from(size.1) - 8.0).contains(&p.y)
    };
    let apply = |h: &DMat3, p: DVec2| {
        let q = *h * p.extend(1.0);
        q.truncate() / q.z
    };
    let back = h.inverse();
    let common = |f: &Features, m: &DMat3| {
        let seen = f.keypoints.iter().filter(|k| inside(apply(m, k.position())));
        first_at_places(seen.copied().collect())
    };
    let (a, b) = (common(&features[0], h), common(&features[1], &back));
    let grow = |p: DVec2| {
        let step = 0.5;
        apply(h, p + DVec2::X * step).distance(apply(h, p - DVec2::X * step)) as f32
    };
    let again = a.iter().filter(|k| {
        let (p, scale) = (apply(h, k.position()), k.scale * grow(k.position()));
        let ratio = |o: &Keypoint| (o.scale / scale).max(scale / o.scale);
        b.iter().any(|o| o.position().distance(p) < CORRECT_PX && ratio(o) < SCALE_RATIO)
    });
    let repeated = again.count();
    let [fa, fb] = features;
    let matches =
        match_prepared(&PreparedFeatures::new(fa), &PreparedFeatures::new(fb), &MatchConfig::default());
    let mut errors: Vec<f64> = matches
        .iter()
        .map(|m| {
            apply(h, fa.keypoints[m[0] as usize].position()).distance(fb.keypoints[m[1] as usize].position())
        })
        .filter(|e| *e < CORRECT_PX)
        .collect();
    errors.sort_by(f64::total_cmp);
    println!(
        "| {case} | {who} | {} / {} | {:.1} % | {} | {:.1} % | {:.3} |",
        a.len(),
        b.len(),
        100.0 * repeated as f64 / a.len().min(b.len()).max(1) as f64,
        matches.len(),
        100.0 * errors.len() as f64 / matches.len().max(1) as f64,
        errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN)
    );
}

/// One keypoint a place: SIFT repeats one for each of its orientations.
fn first_at_places(mut keypoints: Vec<Keypoint>) -> Vec<Keypoint> {
    keypoints.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    keypoints.dedup_by_key(|k| (k.x, k.y));
    keypoints
}

fn homographies(folder: &Path, config: &SiftConfig) -> AnyResult<()> {
    let mut cases: Vec<PathBuf> = std::fs::read_dir(folder)?.filter_map(|e| Some(e.ok()?.path())).collect();
    cases.sort();
    println!(
        "| photo and change | features of | in both views, a / b | repeatability | matches | precision | median px |"
    );
    println!("|---|---|---|---|---|---|---|");
    for case in &cases {
        let name = case.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let h = row_major(&numbers(&std::fs::read_to_string(case.join("h.txt"))?));
        let frames =
            ["a.png", "b.png"].iter().map(|side| frame(case.join(side))).collect::<AnyResult<Vec<_>>>()?;
        let size = (frames[0].width, frames[0].height);
        let ours = extract_all(&FrameSet { frames, ..FrameSet::default() }, config, &Progress::silent())?;
        let [a, b] = &ours[..] else { continue };
        judge_homography(&name, "sat-recon", &[a.clone(), b.clone()], &h, size);
        for who in ["opencv", "colmap"] {
            let read = |side: &str| read_features(&case.join(who).join(side));
            judge_homography(&name, who, &[read("a.png.bin")?, read("b.png.bin")?], &h, size);
        }
    }
    Ok(())
}

/// User and system time of this process, seconds.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<f64> = numbers(stat.rsplit(')').next().unwrap_or_default());
    // After the name: state (not a number), ppid, …; utime and stime are the 14th and 15th of the
    // whole.
    fields.get(10).zip(fields.get(11)).map_or(f64::NAN, |(u, s)| (u + s) / 100.0)
}

/// What `tests/oracle/sift.py` writes: u32 count, count × (x, y, scale, angle) f32, count × 128
/// bytes.
fn read_features(path: &Path) -> AnyResult<Features> {
    let bytes = std::fs::read(path)?;
    let n = u32::from_le_bytes(bytes[0..4].try_into()?) as usize;
    let f = |i: usize| f32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
    let keypoints = (0..n).map(|k| 4 + 16 * k).map(|i| Keypoint {
        x: f(i),
        y: f(i + 4),
        scale: f(i + 8),
        angle: f(i + 12),
    });
    Ok(Features { keypoints: keypoints.collect(), descriptors: bytes[4 + 16 * n..].to_vec() })
}

fn main() -> AnyResult<()> {
    let shared = std::env::var("SAT_RECON_SHARED").unwrap_or_else(|_| "../shared".into());
    let data = Path::new(&shared).join("data");
    let others = std::env::args().nth(1).map(PathBuf::from);
    let shift: f64 = std::env::var("SHIFT").ok().and_then(|s| s.parse().ok()).unwrap_or(0.0);
    let env = |name: &str| std::env::var(name).ok().and_then(|s| s.parse::<f32>().ok());
    let mut config = SiftConfig::default();
    config.contrast_threshold = env("CONTRAST").unwrap_or(config.contrast_threshold);
    config.noise_threshold = env("NOISE").unwrap_or(config.noise_threshold);
    let mut matching = MatchConfig::default();
    matching.match_max_distance = env("MAX_DISTANCE").unwrap_or(matching.match_max_distance);
    matching.match_ratio = env("RATIO").unwrap_or(matching.match_ratio);
    if let Some(folder) = others.as_ref().map(|o| o.join("homography")).filter(|f| f.is_dir()) {
        homographies(&folder, &config)?;
    }
    println!("set            features   /image      step pairs  matches  correct precision median px");
    let only = std::env::var("ONLY").ok();
    for truth in [temple(&data)?, fountain(&data)?] {
        if only.as_ref().is_some_and(|o| o != truth.name) {
            continue;
        }
        let (cpu, wall) = (cpu_seconds(), Instant::now());
        let features = extract_all(&truth.frames, &config, &Progress::silent())?;
        println!(
            "{:<14} ours       extraction {:.2} CPU s, {:.2} s",
            truth.name,
            cpu_seconds() - cpu,
            wall.elapsed().as_secs_f64()
        );
        judge(&truth, "ours", &features, &matching, shift);
        for who in ["opencv", "colmap"] {
            let Some(folder) = others.as_ref().map(|o| o.join(truth.name).join(who)).filter(|f| f.is_dir())
            else {
                continue;
            };
            let features: Vec<Features> = truth
                .frames
                .frames
                .iter()
                .map(|f| read_features(&folder.join(format!("{}.bin", f.name))))
                .collect::<AnyResult<_>>()?;
            judge(&truth, who, &features, &matching, shift);
        }
    }
    Ok(())
}
