//! `render`: pictures of a trained splat along a camera path.

use crate::args::{Channel, RenderArgs, RenderPath};
use crate::outcome::Outcome;
use crate::pictures::Pictures;
use crate::record::KnownRun;
use crate::relit::Relit;
use crate::terminal::{CANCELLED, TerminalSink, Verbosity, say};
use anyhow::{Context, Result, bail};
use image::RgbImage;
use scene::{Camera, OrbitPath, Pose, Progress, Reconstruction};
use splat::RenderOutput;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

/// Renders to PNG files or an mp4.
pub fn run(args: &RenderArgs, verbosity: Verbosity) -> Result<Outcome> {
    let model = scene::io::read_model(&args.run.join("undistorted/sparse/0"))
        .with_context(|| format!("{} is not the output folder of a run with a splat", args.run.display()))?;
    let views = camera_path(&model, args)?;
    let [r, g, b] = args.background[..] else { bail!("--background takes red, green and blue") };
    let progress = Progress::new(Box::new(TerminalSink::new(verbosity, None)), &CANCELLED);
    let (mut pictures, by) = Pictures::open(&args.run, &args.device)?;
    pictures.hold_joints(&args.joint)?;
    let dataset = dataset_config(&args.run);
    let light =
        args.light.map(|angles| Relit::of(args, (&pictures, &dataset), angles, &progress)).transpose()?;
    progress.begin("render", views.len());
    let mut sink = PictureSink::open(&args.output, args.fps)?;
    let photos = matches!(args.path, RenderPath::Input | RenderPath::Test);
    let last = views.len().max(2) - 1;
    for (i, (name, camera, pose)) in views.iter().enumerate() {
        // Along a path time goes by from the first photo to the last.
        let own = || if photos { pictures.time_of(name) } else { i as f32 / last as f32 };
        let time = args.time.unwrap_or_else(own);
        let output = match &light {
            Some(light) => light.render(camera, pose, [r, g, b])?,
            None => pictures.render(camera, pose, time, [r, g, b])?,
        };
        sink.put(name, &picture(&output, args.channel, camera))?;
        progress.tick()?;
    }
    sink.finish()?;
    if verbosity > Verbosity::Quiet {
        say(&format!("{} pictures in {}, by: {by}", views.len(), args.output.display()));
        light.iter().for_each(|light| say(&light.sentence()));
    }
    Ok(light.map_or(Outcome::Done, |light| light.outcome()))
}

/// How far a spiral rises and falls, radii of the circle. Source: chosen by hand, never measured.
const SPIRAL_RISE: f64 = 0.4;

type View = (String, Camera, Pose);

/// What the run held out, as its record says; the defaults where it says nothing.
pub(crate) fn dataset_config(run: &Path) -> splat::DatasetConfig {
    KnownRun::read(run).map(|known| known.config.dataset).unwrap_or_default()
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
        .filter(|(i, image)| args.path == RenderPath::Input || dataset.holds_out(&image.name, *i, count));
    if matches!(args.path, RenderPath::Input | RenderPath::Test) {
        let views = input.filter_map(|(_, image)| {
            Some((image.name.clone(), model.cameras.get(&image.camera)?.clone(), image.pose))
        });
        return Ok(views.collect());
    }
    let poses: Vec<Pose> = images.iter().map(|i| i.pose).collect();
    let up = crate::record::up_of(&args.run, model);
    let path =
        OrbitPath::fit(&poses, up).map_err(|why| anyhow::anyhow!("{why}; render --path input instead"))?;
    let rise = if args.path == RenderPath::Spiral { SPIRAL_RISE } else { 0.0 };
    let views = path.poses(args.count as usize, rise).into_iter().enumerate();
    Ok(views.map(|(i, pose)| (format!("{i:05}"), camera.clone(), pose)).collect())
}

/// The 8-bit picture of a channel.
fn picture(output: &RenderOutput, channel: Channel, camera: &Camera) -> RgbImage {
    let (w, h) = (camera.width, camera.height);
    match channel {
        Channel::Color => output.rgb.to_rgb8(),
        Channel::Alpha => RgbImage::from_fn(w, h, |x, y| grey(output.alpha.data[(y * w + x) as usize])),
        Channel::Depth => {
            let shades = scene::image::depth_shades(&output.depth.data, &output.alpha.data);
            RgbImage::from_fn(w, h, |x, y| grey(shades[(y * w + x) as usize]))
        }
        Channel::Normals => RgbImage::from_fn(w, h, |x, y| normal_colour(output, camera, x, y)),
    }
}

fn grey(value: f32) -> image::Rgb<u8> {
    image::Rgb([(value.clamp(0.0, 1.0) * 255.0).round() as u8; 3])
}

/// The direction of the surface through a pixel and its neighbours as a colour; black where it is
/// not seen.
fn normal_colour(output: &RenderOutput, camera: &Camera, x: u32, y: u32) -> image::Rgb<u8> {
    let depths = [[x, y], [x + 1, y], [x, y + 1]].map(|[x, y]| {
        let i = (y * camera.width + x) as usize;
        let inside = x < camera.width && y < camera.height;
        (inside && output.alpha.data[i] > 0.5).then(|| f64::from(output.depth.data[i]))
    });
    let [Some(here), Some(right), Some(below)] = depths else { return image::Rgb([0; 3]) };
    let normal = camera.surface_normal([x, y], [here, right, below]);
    image::Rgb(
        [normal.x, -normal.y, -normal.z].map(|v| ((v * 0.5 + 0.5).clamp(0.0, 1.0) * 255.0).round() as u8),
    )
}

/// A folder of PNG files or ffmpeg's standard input.
enum PictureSink {
    Folder(std::path::PathBuf),
    Video { child: Option<std::process::Child>, path: std::path::PathBuf, fps: f64, size: (u32, u32) },
}

impl PictureSink {
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
