//! COLMAP's text model files (<https://colmap.github.io/format.html>).

use super::colmap_bin::{check_camera, check_observation, check_pose, insert};
use super::error::{IoError, read_text};
use super::{safe_name, write_atomic};
use crate::{Camera, CameraModel, PosedImage, Reconstruction, ScenePoint, TrackElement};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::str::FromStr;

const NAMES: [&str; 3] = ["cameras.txt", "images.txt", "points3D.txt"];

pub(super) fn read(dir: &Path) -> Result<Reconstruction, IoError> {
    let paths = NAMES.map(|name| dir.join(name));
    let [cameras, images] = [read_text(&paths[0])?, read_text(&paths[1])?];
    let points = paths[2].is_file().then(|| read_text(&paths[2])).transpose()?;
    parse(dir, [&cameras, &images], points.as_deref())
}

/// The model of its files' contents: cameras and images, points.
pub(super) fn parse(
    dir: &Path,
    [cameras, images]: [&str; 2],
    points: Option<&str>,
) -> Result<Reconstruction, IoError> {
    Ok(Reconstruction {
        cameras: parse_cameras(&dir.join(NAMES[0]), cameras)?,
        images: parse_images(&dir.join(NAMES[1]), images)?,
        points: points.map(|text| parse_points(&dir.join(NAMES[2]), text)).transpose()?.unwrap_or_default(),
    })
}

/// The words of one line, with what a message about them needs.
struct Words<'a> {
    path: &'a Path,
    line: usize,
    rest: &'a str,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a str> {
        self.rest = self.rest.trim_start();
        if self.rest.is_empty() {
            return None;
        }
        let (word, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        self.rest = rest;
        Some(word)
    }

    fn value<T: FromStr>(&mut self, what: &str) -> Result<T, IoError> {
        let word = self.next().unwrap_or("the end of the line");
        word.parse().map_err(|_| self.error(&format!("expected {what}, found {:?}", clip(word))))
    }

    fn error(&self, message: &str) -> IoError {
        IoError::format(self.path, format!("line {}: {message}", self.line))
    }
}

fn clip(word: &str) -> String {
    word.chars().take(40).collect()
}

/// Lines that are not comments, numbered from 1; empty ones included (an image may have no
/// keypoints).
fn lines<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = Words<'a>> {
    let numbered = text.lines().enumerate().map(move |(i, rest)| Words { path, line: i + 1, rest });
    numbered.filter(|w| !w.rest.starts_with('#'))
}

fn is_blank(words: &Words) -> bool {
    words.rest.trim().is_empty()
}

pub(super) fn parse_cameras(path: &Path, text: &str) -> Result<BTreeMap<u32, Camera>, IoError> {
    let mut cameras = BTreeMap::new();
    for mut words in lines(path, text).filter(|w| !is_blank(w)) {
        let id = words.value("a camera number")?;
        let name: String = words.value("a camera model")?;
        let Some(model) = CameraModel::from_name(&name) else {
            return Err(IoError::UnsupportedCamera { path: path.into(), model: clip(&name) });
        };
        let size = [words.value("a width")?, words.value("a height")?];
        let mut params = Vec::new();
        while !is_blank(&words) {
            params.push(words.value("a camera parameter")?);
        }
        let camera = check_camera(path, id, model, size, params)?;
        insert(path, "camera", &mut cameras, id, camera)?;
    }
    Ok(cameras)
}

pub(super) fn parse_images(path: &Path, text: &str) -> Result<BTreeMap<u32, PosedImage>, IoError> {
    let mut images = BTreeMap::new();
    let mut lines = lines(path, text);
    while let Some(mut words) = lines.next() {
        if is_blank(&words) {
            continue;
        }
        let id = words.value("an image number")?;
        let mut pose = [0.0; 7];
        for v in &mut pose {
            *v = words.value("a number of a pose")?;
        }
        let camera = words.value("a camera number")?;
        let name = safe_name(words.rest.trim()).map_err(IoError::name(path))?.to_string();
        let pose = check_pose(path, &name, &pose)?;
        let mut observations = Vec::new();
        if let Some(mut words) = lines.next() {
            while !is_blank(&words) {
                let pixel = DVec2::new(words.value("a keypoint's x")?, words.value("a keypoint's y")?);
                let point = parse_point_number(&mut words)?;
                observations.push(check_observation(path, &name, observations.len(), pixel, point)?);
            }
        }
        insert(path, "image", &mut images, id, PosedImage { id, camera, name, pose, observations })?;
    }
    Ok(images)
}

/// −1 and 2⁶⁴−1 both mean "no point".
fn parse_point_number(words: &mut Words) -> Result<Option<u64>, IoError> {
    let number: i128 = words.value("a point number")?;
    if number == -1 || number == i128::from(u64::MAX) {
        return Ok(None);
    }
    u64::try_from(number)
        .map(Some)
        .map_err(|_| words.error(&format!("expected a point number, found {number}")))
}

pub(super) fn parse_points(path: &Path, text: &str) -> Result<BTreeMap<u64, ScenePoint>, IoError> {
    let mut points = BTreeMap::new();
    for mut words in lines(path, text).filter(|w| !is_blank(w)) {
        let id = words.value("a point number")?;
        let mut v = [0.0; 3];
        for x in &mut v {
            *x = words.value("a coordinate")?;
        }
        let position = DVec3::from_array(v);
        if !position.is_finite() {
            return Err(IoError::not_finite(path, format!("the position of point {id}")));
        }
        let rgb = [words.value("red")?, words.value("green")?, words.value("blue")?];
        let error_px = words.value("an error")?;
        let mut track = Vec::new();
        while !is_blank(&words) {
            track.push(TrackElement {
                image: words.value("an image number")?,
                observation: words.value("a keypoint number")?,
            });
        }
        insert(path, "point", &mut points, id, ScenePoint { position, rgb, error_px, track })?;
    }
    Ok(points)
}

/// The shortest text that reads back as the same number; exponents only where plain digits would be
/// long.
struct Num(f64);

impl std::fmt::Display for Num {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let size = self.0.abs();
        if size == 0.0 || (1e-5..1e16).contains(&size) {
            write!(f, "{}", self.0)
        } else {
            write!(f, "{:e}", self.0)
        }
    }
}

pub(super) fn write(model: &Reconstruction, dir: &Path) -> Result<(), IoError> {
    write_atomic(&dir.join("cameras.txt"), |w| write_cameras(model, w))?;
    write_atomic(&dir.join("images.txt"), |w| write_images(model, w))?;
    write_atomic(&dir.join("points3D.txt"), |w| write_points(model, w))
}

fn write_cameras(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    writeln!(w, "# Camera list with one line of data per camera:")?;
    writeln!(w, "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]")?;
    writeln!(w, "# Number of cameras: {}", model.cameras.len())?;
    for (id, camera) in &model.cameras {
        write!(w, "{id} {} {} {}", camera.model.name(), camera.width, camera.height)?;
        camera.params.iter().try_for_each(|&p| write!(w, " {}", Num(p)))?;
        writeln!(w)?;
    }
    Ok(())
}

fn write_images(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    let seen: usize = model.points.values().map(|p| p.track.len()).sum();
    let mean = seen as f64 / model.images.len().max(1) as f64;
    writeln!(w, "# Image list with two lines of data per image:")?;
    writeln!(w, "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME")?;
    writeln!(w, "#   POINTS2D[] as (X, Y, POINT3D_ID)")?;
    writeln!(w, "# Number of images: {}, mean observations per image: {mean}", model.images.len())?;
    for (id, image) in &model.images {
        let (q, t) = (image.pose.rotation, image.pose.translation);
        write!(w, "{id}")?;
        [q.w, q.x, q.y, q.z, t.x, t.y, t.z].iter().try_for_each(|&v| write!(w, " {}", Num(v)))?;
        writeln!(w, " {} {}", image.camera, image.name)?;
        for (i, o) in image.observations.iter().enumerate() {
            let space = if i == 0 { "" } else { " " };
            write!(w, "{space}{} {} ", Num(o.pixel.x), Num(o.pixel.y))?;
            match o.point {
                Some(id) => write!(w, "{id}")?,
                None => write!(w, "-1")?,
            }
        }
        writeln!(w)?;
    }
    Ok(())
}

fn write_points(model: &Reconstruction, w: &mut impl Write) -> io::Result<()> {
    let seen: usize = model.points.values().map(|p| p.track.len()).sum();
    let mean = seen as f64 / model.points.len().max(1) as f64;
    writeln!(w, "# 3D point list with one line of data per point:")?;
    writeln!(w, "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)")?;
    writeln!(w, "# Number of points: {}, mean track length: {mean}", model.points.len())?;
    for (id, point) in &model.points {
        let ([x, y, z], [r, g, b]) = (point.position.to_array(), point.rgb);
        write!(w, "{id} {} {} {} {r} {g} {b} {}", Num(x), Num(y), Num(z), Num(point.error_px))?;
        point.track.iter().try_for_each(|e| write!(w, " {} {}", e.image, e.observation))?;
        writeln!(w)?;
    }
    Ok(())
}
