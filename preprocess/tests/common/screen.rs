//! Cut-outs composited over an unevenly lit green screen with spill, filmed with noise and 4:2:0
//! H.264; the true matte is known. And how a matte is scored.

use image::{GrayImage, RgbImage, RgbaImage};
use rand::Rng as _;
use std::path::{Path, PathBuf};
use std::process::Command;

pub(crate) const WIDTH: u32 = 640;
pub(crate) const HEIGHT: u32 = 480;

/// A cloth: its linear colour where its light is 1.
#[derive(Clone, Copy)]
pub(crate) struct Cloth {
    pub name: &'static str,
    pub linear: [f32; 3],
}

pub(crate) const CLOTHS: [Cloth; 2] = [
    Cloth { name: "green", linear: [0.045, 0.34, 0.075] },
    Cloth { name: "blue", linear: [0.035, 0.085, 0.36] },
];

impl Cloth {
    /// The channel in which it is bright.
    pub(crate) fn channel(&self) -> usize {
        (0..3).max_by(|a, b| self.linear[*a].total_cmp(&self.linear[*b])).unwrap_or(1)
    }
}

/// One frame: what is filmed and what is true.
pub(crate) struct Shot {
    pub filmed: RgbImage,
    pub alpha: GrayImage,
    /// Foreground before spill, 8-bit sRGB.
    pub clean: RgbImage,
    /// The screen's channel.
    pub channel: usize,
}

/// How much light there is and what the sensor makes of it (as in cases 3 and 4 of the test bed).
#[derive(Clone, Copy)]
pub(crate) struct Light {
    pub name: &'static str,
    /// Factor on linear light, exposure included.
    pub gain: f32,
    pub full_well: f32,
    pub read_noise: f32,
}

pub(crate) const LIGHTS: [Light; 2] = [
    Light { name: "100 %", gain: 1.0, full_well: 6000.0, read_noise: 3.0 },
    Light { name: "10 %", gain: 0.2, full_well: 1500.0, read_noise: 4.0 },
];

pub(crate) fn to_linear(v: u8) -> f32 {
    let v = f32::from(v) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

pub(crate) fn to_srgb(v: f32) -> u8 {
    let v = v.clamp(0.0, 1.0);
    let coded = if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    (coded * 255.0).round() as u8
}

/// Every `step`-th cut-out of `lego400` (its alpha) or of `temple_ring` (the stone by its light),
/// centred.
pub(crate) fn cut_outs(folder: &Path, step: usize) -> Vec<RgbaImage> {
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(folder.join("images")).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.iter().step_by(step).map(|p| centred(&image::open(p).unwrap())).collect()
}

fn centred(image: &image::DynamicImage) -> RgbaImage {
    let mut rgba = image.to_rgba8();
    if !image.color().has_alpha() {
        cut_by_light(&mut rgba);
    }
    let scale = (HEIGHT as f32 / rgba.height() as f32).min(1.0);
    if scale < 1.0 {
        let size = ((rgba.width() as f32 * scale) as u32, HEIGHT);
        rgba = image::imageops::resize(&rgba, size.0, size.1, image::imageops::FilterType::Triangle);
    }
    let mut canvas = RgbaImage::new(WIDTH, HEIGHT);
    let (x, y) = ((WIDTH - rgba.width()) / 2, (HEIGHT - rgba.height()) / 2);
    image::imageops::replace(&mut canvas, &rgba, i64::from(x), i64::from(y));
    canvas
}

/// Alpha from light: dark clefts inside the stone are closed, the outline is as soft as a camera's.
fn cut_by_light(rgba: &mut RgbaImage) {
    let (w, h) = rgba.dimensions();
    let luma = |p: &image::Rgba<u8>| (f32::from(p[0]) + f32::from(p[1]) + f32::from(p[2])) / 3.0;
    let light = GrayImage::from_fn(w, h, |x, y| image::Luma([luma(rgba.get_pixel(x, y)) as u8]));
    let smooth = image::imageops::blur(&light, 2.0);
    // Ground that is reached from the border through dark pixels.
    let mut ground = vec![false; (w * h) as usize];
    let mut todo: Vec<(u32, u32)> =
        (0..w).flat_map(|x| [(x, 0), (x, h - 1)]).chain((0..h).flat_map(|y| [(0, y), (w - 1, y)])).collect();
    while let Some((x, y)) = todo.pop() {
        let seen = &mut ground[(y * w + x) as usize];
        if *seen || smooth.get_pixel(x, y)[0] >= 60 {
            continue;
        }
        *seen = true;
        todo.extend(
            [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)]
                .into_iter()
                .filter(|(x, y)| *x < w && *y < h),
        );
    }
    let hard =
        GrayImage::from_fn(w, h, |x, y| image::Luma([if ground[(y * w + x) as usize] { 0 } else { 255 }]));
    let soft = image::imageops::blur(&hard, 0.8);
    rgba.pixels_mut().zip(soft.pixels()).for_each(|(p, s)| p[3] = s[0]);
}

/// The screen's light: a lamp off centre, falling to half, with folds.
pub(crate) fn screen_light(x: f32, y: f32) -> f32 {
    let (u, v) = (x / WIDTH as f32 - 0.35, y / HEIGHT as f32 - 0.4);
    let folds = 0.02 * (x * 0.05 + y * 0.01).sin() + 0.012 * (x * 0.13 - y * 0.02).sin();
    (1.15 - 1.1 * (u * u + v * v)) * (1.0 + folds)
}

/// Films one cut-out.
pub(crate) fn film(cut_out: &RgbaImage, light: Light, cloth: Cloth, index: u64) -> Shot {
    let mut rng = scene::rng::rng(7, "screen", index);
    let alpha = GrayImage::from_fn(WIDTH, HEIGHT, |x, y| image::Luma([cut_out.get_pixel(x, y)[3]]));
    let wide = image::imageops::blur(&alpha, 6.0);
    let mut filmed = RgbImage::new(WIDTH, HEIGHT);
    let mut clean = RgbImage::new(WIDTH, HEIGHT);
    for (x, y, p) in cut_out.enumerate_pixels() {
        let (a, shade) = (f32::from(p[3]) / 255.0, screen_light(x as f32, y as f32));
        let near = 1.0 - f32::from(wide.get_pixel(x, y)[0]) / 255.0;
        for c in 0..3 {
            let screen = cloth.linear[c] * shade;
            let own = to_linear(p[c]);
            // Light from the screen on the object, more towards its outline.
            let lit = own + (0.02 + 0.16 * near) * screen;
            let value = light.gain * (a * lit + (1.0 - a) * screen);
            clean.get_pixel_mut(x, y)[c] = to_srgb(light.gain * own);
            let sigma = (value / light.full_well + (light.read_noise / light.full_well).powi(2)).sqrt();
            filmed.get_pixel_mut(x, y)[c] = to_srgb(value + sigma * normal(&mut rng));
        }
    }
    Shot { filmed, alpha, clean, channel: cloth.channel() }
}

fn normal(rng: &mut scene::rng::Rng) -> f32 {
    let (a, b): (f32, f32) = (rng.random_range(1e-6..1.0), rng.random());
    (-2.0 * a.ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

/// H.264, 4:2:0, Rec. 709, as a phone writes it.
pub(crate) fn encode(shots: &[Shot], video: &Path) {
    let folder = video.with_extension("png");
    std::fs::create_dir_all(&folder).unwrap();
    for (i, shot) in shots.iter().enumerate() {
        shot.filmed.save(folder.join(format!("{i:04}.png"))).unwrap();
    }
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y", "-framerate", "10", "-i"])
        .arg(folder.join("%04d.png"))
        .args([
            "-vf",
            "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p",
            "-colorspace",
            "bt709",
            "-color_range",
            "tv",
        ])
        .args([
            "-color_primaries",
            "bt709",
            "-color_trc",
            "bt709",
            "-c:v",
            "libx264",
            "-preset",
            "medium",
            "-crf",
            "18",
        ])
        .arg(video)
        .status()
        .unwrap();
    assert!(status.success());
}

/// How good mattes are, averaged over frames.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Score {
    pub iou: f64,
    pub alpha_error: f64,
    pub boundary_f: f64,
    /// Left-over colour difference in the edge band, 8-bit levels.
    pub spill: f64,
    /// Share of the parts up to four pixels thick that is kept.
    pub thin: f64,
    /// Share of the solid inside that is lost.
    pub holes: f64,
    /// Share of the picture that is kept although it is far from the object.
    pub garbage: f64,
}

impl Score {
    pub(crate) fn mean(scores: &[Self]) -> Self {
        let n = scores.len() as f64;
        let mean = |f: fn(&Self) -> f64| scores.iter().map(f).sum::<f64>() / n;
        Self {
            iou: mean(|s| s.iou),
            alpha_error: mean(|s| s.alpha_error),
            boundary_f: mean(|s| s.boundary_f),
            spill: mean(|s| s.spill),
            thin: mean(|s| s.thin),
            holes: mean(|s| s.holes),
            garbage: mean(|s| s.garbage),
        }
    }
}

/// Scores one matte (and its foreground colours) against the truth.
pub(crate) fn score(matte: &GrayImage, colours: &RgbImage, shot: &Shot) -> Score {
    let (a, b): (Vec<bool>, Vec<bool>) = (inside(matte), inside(&shot.alpha));
    let both = a.iter().zip(&b).filter(|(a, b)| **a && **b).count() as f64;
    let either = a.iter().zip(&b).filter(|(a, b)| **a || **b).count() as f64;
    let error: f64 =
        matte.iter().zip(shot.alpha.iter()).map(|(a, b)| f64::from(a.abs_diff(*b)) / 255.0).sum();
    Score {
        iou: both / either.max(1.0),
        alpha_error: error / a.len() as f64,
        boundary_f: boundary_f(&a, &b),
        spill: spill(matte, colours, shot, &b),
        thin: thin(&a, &b),
        holes: share(&a, &grown(&b, 3, false), false),
        garbage: {
            let close = grown(&b, 4, true);
            (0..a.len()).filter(|i| a[*i] && !close[*i]).count() as f64 / a.len() as f64
        },
    }
}

/// Share of `mask` where `a` equals `wanted`; 1 or 0 of an empty mask, whichever is good.
fn share(a: &[bool], mask: &[bool], wanted: bool) -> f64 {
    let all = mask.iter().filter(|m| **m).count();
    if all == 0 {
        return f64::from(u8::from(wanted));
    }
    (0..a.len()).filter(|i| mask[*i] && a[*i] == wanted).count() as f64 / all as f64
}

/// The mask with `wanted = true` grown, with `false` shrunk by `r` pixels.
fn grown(mask: &[bool], r: i32, wanted: bool) -> Vec<bool> {
    (0..mask.len()).map(|i| near(mask, i, r, wanted) == wanted).collect()
}

/// Share kept of what an opening with a square of five pixels takes away: rods, seen within one
/// pixel.
fn thin(a: &[bool], truth: &[bool]) -> f64 {
    let opened = grown(&grown(truth, 2, false), 2, true);
    let rods: Vec<bool> = (0..truth.len()).map(|i| truth[i] && !opened[i]).collect();
    share(&grown(a, 1, true), &rods, true)
}

fn inside(matte: &GrayImage) -> Vec<bool> {
    matte.iter().map(|v| *v >= 128).collect()
}

fn near(mask: &[bool], i: usize, r: i32, wanted: bool) -> bool {
    let (w, h) = (WIDTH as i32, HEIGHT as i32);
    let (x, y) = (i as i32 % w, i as i32 / w);
    (-r..=r).any(|dy| {
        (-r..=r).any(|dx| {
            let (u, v) = (x + dx, y + dy);
            u >= 0 && v >= 0 && u < w && v < h && mask[(v * w + u) as usize] == wanted
        })
    })
}

/// F-score of boundary pixels that have one of the other mask within one pixel.
fn boundary_f(a: &[bool], b: &[bool]) -> f64 {
    let edge = |m: &[bool]| -> Vec<bool> { (0..m.len()).map(|i| m[i] && near(m, i, 1, false)).collect() };
    let (ea, eb) = (edge(a), edge(b));
    let share = |p: &[bool], q: &[bool]| {
        let all = p.iter().filter(|v| **v).count() as f64;
        (0..p.len()).filter(|i| p[*i] && near(q, *i, 1, true)).count() as f64 / all.max(1.0)
    };
    let (precision, recall) = (share(&ea, &eb), share(&eb, &ea));
    2.0 * precision * recall / (precision + recall).max(1e-9)
}

/// Mean of `max(0, G − max(R, B))` (of a blue screen `max(0, B − max(R, G))`) beyond that of the
/// clean foreground, where both mattes show the object, within four pixels of its outline.
fn spill(matte: &GrayImage, colours: &RgbImage, shot: &Shot, truth: &[bool]) -> f64 {
    let (own, a, b) = (shot.channel, (shot.channel + 1) % 3, (shot.channel + 2) % 3);
    let excess = |p: &image::Rgb<u8>| (f64::from(p[own]) - f64::from(p[a].max(p[b]))).max(0.0);
    let (mut sum, mut n) = (0.0, 0.0_f64);
    for i in 0..truth.len() {
        let (x, y) = (i as u32 % WIDTH, i as u32 / WIDTH);
        if shot.alpha.get_pixel(x, y)[0] > 25 && matte.get_pixel(x, y)[0] > 25 && near(truth, i, 4, false) {
            sum += (excess(colours.get_pixel(x, y)) - excess(shot.clean.get_pixel(x, y))).max(0.0);
            n += 1.0;
        }
    }
    sum / n.max(1.0)
}
