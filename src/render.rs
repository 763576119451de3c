//! `render`: pictures of a trained splat along a camera path.

use crate::Outcome;
use crate::cli::{CameraPath, Channel, RenderArgs};
use crate::terminal::{CANCELLED, TerminalSink, Verbosity};
use anyhow::{Context, Result, bail};
use glam::{DMat3, DVec3};
use image::RgbImage;
use scene::{Camera, Pose, Progress, Reconstruction};
use splat::{RenderOptions, RenderOutput};
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

/// Renders to PNG files or an mp4.
pub fn run(args: &RenderArgs, verbosity: Verbosity) -> Result<Outcome> {
    let model = scene::io::read_model(&args.run.join("undistorted/sparse/0"))
        .with_context(|| format!("{} is not the output folder of a run with a splat", args.run.display()))?;
    let gaussians = scene::io::ply::read_splat_ply(&args.run.join("splat.ply"))?;
    let views = camera_path(&model, args)?;
    let [r, g, b] = args.background[..] else { bail!("--background takes red, green and blue") };
    let options = RenderOptions { background: [r, g, b], ..RenderOptions::default() };
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    progress.begin("render", views.len());
    let (mut renderer, device) = splat::Renderer::on(&args.device, &gaussians)?;
    renderer.antialias = crate::evaluate::trained_with_antialias(&args.run)?;
    let mut sink = Sink::open(&args.output, args.fps)?;
    for (name, camera, pose) in &views {
        let output = renderer.render(camera, pose, &options)?;
        sink.put(name, &picture(&output, args.channel, camera))?;
        progress.tick()?;
    }
    sink.finish()?;
    if verbosity > Verbosity::Quiet {
        eprintln!("{} pictures in {}, by: {}", views.len(), args.output.display(), device.sentences().choice);
    }
    Ok(Outcome::Done)
}

type View = (String, Camera, Pose);

/// What the run held out, as its record says; the defaults where it says nothing.
pub(crate) fn dataset_config(run: &Path) -> splat::DatasetConfig {
    let record = std::fs::read(run.join("run.json")).ok();
    let record: Option<serde_json::Value> = record.and_then(|text| serde_json::from_slice(&text).ok());
    record.and_then(|mut r| serde_json::from_value(r["config"]["dataset"].take()).ok()).unwrap_or_default()
}

fn camera_path(model: &Reconstruction, args: &RenderArgs) -> Result<Vec<View>> {
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let first = images.first().context("the model has no images")?;
    let camera = model.cameras.get(&first.camera).context("the model has no camera")?.clone();
    let (dataset, count) = (dataset_config(&args.run), images.len());
    let input = images
        .iter()
        .enumerate()
        .filter(|(i, _)| args.path == CameraPath::Input || dataset.holds_out(*i, count));
    if matches!(args.path, CameraPath::Input | CameraPath::Test) {
        let views = input.filter_map(|(_, image)| {
            Some((image.name.clone(), model.cameras.get(&image.camera)?.clone(), image.pose))
        });
        return Ok(views.collect());
    }
    let ring = Ring::fit(images.iter().map(|i| &i.pose))?;
    let count = args.count as usize;
    let view = |i: usize| {
        let turn = i as f64 / count as f64 * std::f64::consts::TAU;
        let rise = if args.path == CameraPath::Spiral { 0.4 * (2.0 * turn).sin() } else { 0.0 };
        (format!("{i:05}"), camera.clone(), ring.pose(turn, rise))
    };
    Ok((0..count).map(view).collect())
}

/// The circle that the input cameras suggest.
struct Ring {
    focus: DVec3,
    up: DVec3,
    start: DVec3,
    radius: f64,
    height: f64,
}

impl Ring {
    /// The focus is the point nearest to all viewing rays; up is the mean of the cameras' up.
    fn fit<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> Result<Self> {
        let mut normal = DMat3::from_diagonal(DVec3::splat(1e-9));
        let (mut right, mut up, mut n) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for pose in poses.clone() {
            let d = pose.view_direction();
            let project = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            normal += project;
            right += project * pose.centre();
            up += pose.rotation.conjugate() * -DVec3::Y;
            n += 1.0;
        }
        let focus = normal.inverse() * right;
        let up = up.try_normalize().context("the cameras have no common up; render --path input instead")?;
        let centre = poses.clone().map(Pose::centre).sum::<DVec3>() / n;
        let height = (centre - focus).dot(up);
        let flat = |c: DVec3| (c - focus) - up * (c - focus).dot(up);
        let radius = poses.clone().map(|p| flat(p.centre()).length()).sum::<f64>() / n;
        let start = poses.clone().map(|p| flat(p.centre())).next().and_then(DVec3::try_normalize);
        let start = start.unwrap_or_else(|| up.any_orthonormal_vector());
        anyhow::ensure!(
            radius.is_finite() && radius > 0.0,
            "the cameras do not go round anything; render --path input instead"
        );
        Ok(Self { focus, up, start, radius, height })
    }

    /// `turn` in radians; `rise` in radii.
    fn pose(&self, turn: f64, rise: f64) -> Pose {
        let side = self.up.cross(self.start);
        let out = self.start * turn.cos() + side * turn.sin();
        let eye = self.focus + out * self.radius + self.up * (self.height + rise * self.radius);
        Pose::look_at(eye, self.focus, self.up)
    }
}

/// The 8-bit picture of a channel.
fn picture(output: &RenderOutput, channel: Channel, camera: &Camera) -> RgbImage {
    let (w, h) = (camera.width, camera.height);
    let at = |x: u32, y: u32| (y * w + x) as usize;
    let grey = |v: f32| image::Rgb([(v.clamp(0.0, 1.0) * 255.0).round() as u8; 3]);
    match channel {
        Channel::Color => output.rgb.to_rgb8(),
        Channel::Alpha => RgbImage::from_fn(w, h, |x, y| grey(output.alpha.data[at(x, y)])),
        Channel::Depth => {
            let seen = || {
                output
                    .depth
                    .data
                    .iter()
                    .zip(&output.alpha.data)
                    .filter(|(d, a)| **a > 0.5 && d.is_finite())
                    .map(|(d, _)| *d)
            };
            let (near, far) = (seen().fold(f32::INFINITY, f32::min), seen().fold(0.0, f32::max));
            let shade = |i: usize| {
                let (d, a) = (output.depth.data[i], output.alpha.data[i]);
                if a > 0.5 { 1.0 - 0.9 * (d - near) / (far - near).max(1e-12) } else { 0.0 }
            };
            RgbImage::from_fn(w, h, |x, y| grey(shade(at(x, y))))
        }
        Channel::Normals => RgbImage::from_fn(w, h, |x, y| normal_colour(output, camera, x, y)),
    }
}

fn normal_colour(output: &RenderOutput, camera: &Camera, x: u32, y: u32) -> image::Rgb<u8> {
    let point = |x: u32, y: u32| {
        let i = (y * camera.width + x) as usize;
        let d = f64::from(output.depth.data[i]);
        (output.alpha.data[i] > 0.5).then(|| {
            camera.unproject(glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).extend(1.0) * d
        })
    };
    if x + 1 >= camera.width || y + 1 >= camera.height {
        return image::Rgb([0; 3]);
    }
    let (Some(p), Some(px), Some(py)) = (point(x, y), point(x + 1, y), point(x, y + 1)) else {
        return image::Rgb([0; 3]);
    };
    let n = (py - p).cross(px - p).normalize_or_zero();
    let byte = |v: f64| ((v * 0.5 + 0.5).clamp(0.0, 1.0) * 255.0).round() as u8;
    image::Rgb([byte(n.x), byte(-n.y), byte(-n.z)])
}

/// A folder of PNG files or ffmpeg's standard input.
enum Sink {
    Folder(std::path::PathBuf),
    Video { child: Option<std::process::Child>, path: std::path::PathBuf, fps: f64, size: (u32, u32) },
}

impl Sink {
    fn open(path: &Path, fps: f64) -> Result<Self> {
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4")) {
            anyhow::ensure!(fps.is_finite() && fps > 0.0, "--fps must be positive");
            return Ok(Self::Video { child: None, path: path.to_path_buf(), fps, size: (0, 0) });
        }
        std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))?;
        Ok(Self::Folder(path.to_path_buf()))
    }

    fn put(&mut self, name: &str, picture: &RgbImage) -> Result<()> {
        match self {
            Self::Folder(folder) => {
                let file = folder.join(
                    Path::new(name).with_extension("png").file_name().context("a view without a name")?,
                );
                picture.save(&file).with_context(|| format!("cannot write {}", file.display()))
            }
            Self::Video { child, path, fps, size } => {
                if child.is_none() {
                    *size = picture.dimensions();
                    *child = Some(start_ffmpeg(&partial(path), *fps, *size)?);
                }
                anyhow::ensure!(
                    picture.dimensions() == *size,
                    "the views differ in size; render to a folder instead"
                );
                let stdin = child.as_mut().and_then(|c| c.stdin.as_mut()).context("ffmpeg takes no input")?;
                stdin.write_all(picture.as_raw()).context("ffmpeg stopped early")
            }
        }
    }

    fn finish(self) -> Result<()> {
        let Self::Video { child: Some(mut child), path, .. } = self else { return Ok(()) };
        drop(child.stdin.take());
        let status = child.wait()?;
        anyhow::ensure!(status.success(), "ffmpeg failed to encode {}", path.display());
        std::fs::rename(partial(&path), &path).with_context(|| format!("cannot write {}", path.display()))
    }
}

fn partial(path: &Path) -> std::path::PathBuf {
    path.with_extension("part.mp4")
}

fn start_ffmpeg(path: &Path, fps: f64, (w, h): (u32, u32)) -> Result<std::process::Child> {
    Command::new("ffmpeg")
        .args([
            "-v",
            "error",
            "-y",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-s",
            &format!("{w}x{h}"),
            "-r",
            &fps.to_string(),
            "-i",
            "-",
        ])
        .args([
            "-vf",
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            "-c:v",
            "libx264",
            "-crf",
            "16",
            "-pix_fmt",
            "yuv420p",
        ])
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .context("ffmpeg is missing ('make setup' installs it); render to a folder of PNG files instead")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_through_a_ring_of_cameras_is_that_ring() {
        let focus = DVec3::new(1.0, 2.0, 3.0);
        let poses: Vec<Pose> = (0..12)
            .map(|i| {
                let a = f64::from(i) / 12.0 * std::f64::consts::TAU;
                Pose::look_at(focus + DVec3::new(2.0 * a.cos(), 2.0 * a.sin(), 0.5), focus, DVec3::Z)
            })
            .collect();
        let ring = Ring::fit(poses.iter()).unwrap();
        for (i, pose) in poses.iter().enumerate() {
            let ours = ring.pose(i as f64 / 12.0 * std::f64::consts::TAU, 0.0);
            assert!((ours.centre() - pose.centre()).length() < 1e-6);
        }
    }
}
