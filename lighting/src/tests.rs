//! A block on a turntable before a known lamp.

use crate::{LightError, Lighting, SolidSplat, direction};
use glam::{DMat3, DQuat, DVec3, Quat, Vec3};
use scene::gaussians::SH_C0;
use scene::{Camera, CameraModel, Gaussians, Pose, PosedPhoto, Progress};
use splat::{RenderOptions, Renderer};

/// Light from everywhere, share of the lamp's.
const AMBIENT: f64 = 0.15;

/// Middle and half the side of the small block.
const SMALL: (DVec3, f64) = (DVec3::new(0.15, 0.0, 0.5), 0.2);

/// Flat Gaussians on the faces of a block and of a smaller one on top of it, with their normals.
struct Block {
    gaussians: Gaussians,
    normals: Vec<DVec3>,
    albedo: Vec<f64>,
    unit: f64,
}

impl Block {
    fn new(unit: f64) -> Self {
        let mut block =
            Self { gaussians: Gaussians::default(), normals: Vec::new(), albedo: Vec::new(), unit };
        let large = DVec3::new(0.5, 0.35, 0.3);
        for (middle, half) in [(DVec3::ZERO, large), (SMALL.0, DVec3::splat(SMALL.1))] {
            for axis in 0..3 {
                for sign in [-1.0, 1.0] {
                    block.face(unit, middle, half, axis, sign);
                }
            }
        }
        let n = block.normals.len();
        block.gaussians.opacity_logits = vec![6.0; n];
        block.gaussians.sh = vec![0.0; 3 * n];
        block
    }

    fn face(&mut self, unit: f64, middle: DVec3, half: DVec3, axis: usize, sign: f64) {
        const ACROSS: i32 = 14;
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for a in 0..ACROSS {
            for b in 0..ACROSS {
                let mut p = middle;
                p[axis] += sign * half[axis];
                p[u] += half[u] * (f64::from(2 * a + 1) / f64::from(ACROSS) - 1.0);
                p[v] += half[v] * (f64::from(2 * b + 1) / f64::from(ACROSS) - 1.0);
                let mut size = DVec3::ZERO;
                size[axis] = 0.002;
                size[u] = 0.6 * half[u] * 2.0 / f64::from(ACROSS);
                size[v] = 0.6 * half[v] * 2.0 / f64::from(ACROSS);
                self.gaussians.means.push((unit * p).as_vec3());
                self.gaussians.log_scales.push((unit * size).as_vec3().map(f32::ln));
                self.gaussians.rotations.push(Quat::IDENTITY);
                self.normals.push(sign * DVec3::AXES[axis]);
                self.albedo.push(if (a / 2 + b / 2) % 2 == 0 { 0.7 } else { 0.4 });
            }
        }
    }

    /// With a sheet beside it, as thin as a solar array.
    fn with_sheet() -> Self {
        let mut block = Self::new(1.0);
        block.face(1.0, DVec3::new(0.0, 0.75, 0.0), DVec3::new(0.0, 0.35, 0.3), 0, 1.0);
        let n = block.normals.len();
        block.gaussians.opacity_logits = vec![6.0; n];
        block.gaussians.sh = vec![0.0; 3 * n];
        block
    }

    /// With the normals of the sheet towards an eye.
    fn seen_from(&self, eye: DVec3) -> Self {
        let (mut normals, block) = (self.normals.clone(), Self::new(self.unit).normals.len());
        for (normal, place) in normals.iter_mut().zip(&self.gaussians.means).skip(block) {
            *normal *= normal.dot(eye - place.as_dvec3()).signum();
        }
        Self { gaussians: self.gaussians.clone(), normals, albedo: self.albedo.clone(), unit: self.unit }
    }

    /// As it is under a lamp (world frame), with the shadow of the small block on the large one.
    fn lit(&self, towards: DVec3) -> Gaussians {
        let linear = (0..self.normals.len()).map(|i| {
            let free = if self.is_shaded(i, towards) { 0.0 } else { 1.0 };
            self.albedo[i] * (AMBIENT + free * self.normals[i].dot(towards).max(0.0))
        });
        let sh = linear.flat_map(|v| [(crate::colour::srgb(v) as f32 - 0.5) / SH_C0; 3]).collect();
        Gaussians { sh, ..self.gaussians.clone() }
    }
}

impl Block {
    /// Whether the small block lies between a place and the lamp: the ray against its slabs.
    fn is_shaded(&self, i: usize, towards: DVec3) -> bool {
        let start = self.gaussians.means[i].as_dvec3() / self.unit + 1e-3 * self.normals[i];
        let [one, other] = [-1.0, 1.0].map(|s| (SMALL.0 + s * DVec3::splat(SMALL.1) - start) / towards);
        let (enters, leaves) = (one.min(other).max_element(), one.max(other).min_element());
        leaves > enters.max(0.0)
    }
}

fn solid(gaussians: &Gaussians) -> SolidSplat<'_> {
    SolidSplat { gaussians, antialias: false }
}

fn camera() -> Camera {
    Camera::centred(1, CameraModel::Pinhole, 96, 96, 110.0)
}

/// The camera stands still, the block turns, tilted: of faces along and across the axis alone none
/// tells how high the lamp is.
fn poses(unit: f64) -> Vec<Pose> {
    let still = Pose::look_at(unit * DVec3::new(0.0, -2.5, 0.9), DVec3::ZERO, DVec3::Z);
    let tilt = DQuat::from_rotation_x(0.5) * DQuat::from_rotation_y(0.3);
    let turned = |k: u32| Pose::new(DQuat::from_rotation_z(f64::from(k) * 0.2618) * tilt, DVec3::ZERO);
    (0..24).map(|k| still.compose(&turned(k))).collect()
}

fn picture(gaussians: &Gaussians, pose: &Pose) -> Vec<u8> {
    let out = Renderer::new(gaussians).unwrap().render(&camera(), pose, &RenderOptions::default()).unwrap();
    out.rgb.to_rgb8().into_raw()
}

/// What a lamp, camera frame, shows in each pose.
fn film(block: &Block, poses: &[Pose], lamp: DVec3) -> Vec<Vec<u8>> {
    let shown =
        |pose: &Pose| picture(&block.seen_from(pose.centre()).lit(pose.rotation.inverse() * lamp), pose);
    poses.iter().map(shown).collect()
}

fn solved(gaussians: &Gaussians, poses: &[Pose], film: &[Vec<u8>]) -> Result<Lighting, LightError> {
    let camera = camera();
    let both = poses.iter().zip(film);
    let photos: Vec<PosedPhoto> =
        both.map(|(pose, rgb)| PosedPhoto { camera: &camera, pose: *pose, rgb, mask: None }).collect();
    Lighting::solve(&solid(gaussians), &photos, &Progress::silent())
}

fn psnr(a: &[u8], b: &[u8]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (255.0 * 255.0 * a.len() as f64 / square.max(1e-9)).log10()
}

#[test]
fn a_lamp_beside_the_camera_is_found_and_can_be_moved() {
    let (block, poses, lamp) = (Block::new(1.0), poses(1.0), direction(-35.0, 25.0));
    let film = film(&block, &poses, lamp);
    // As a splat of these photos would be, which knows one colour for each place.
    let shown = block.lit(poses[3].rotation.inverse() * lamp);
    let lighting = solved(&shown, &poses, &film).unwrap();
    let off = lighting.lamp.towards.angle_between(lamp).to_degrees();
    assert!(off < 6.0 && off < 3.0 * lighting.lamp.deviation_deg.max(1.0), "{off} {:?}", lighting.lamp);
    assert!((lighting.lamp.ambient - AMBIENT).abs() < 0.08, "{:?}", lighting.lamp);
    let moved = direction(30.0, 25.0);
    let truth = block.lit(poses[3].rotation.inverse() * moved);
    let truth = picture(&truth, &poses[3]);
    let as_it_is = psnr(&picture(&shown, &poses[3]), &truth);
    let relit = psnr(&picture(&lighting.relit(&solid(&shown), &poses[3], moved), &poses[3]), &truth);
    assert!(relit > as_it_is + 4.0, "{as_it_is} {relit}");
    // Where it was, nothing changes much.
    let same = lighting.relit(&solid(&shown), &poses[3], lighting.lamp.towards);
    let again = psnr(&picture(&same, &poses[3]), &picture(&shown, &poses[3]));
    assert!(again > 24.0, "{again}");
}

#[test]
fn a_sheet_has_a_light_and_a_dark_side() {
    let (block, poses, lamp) = (Block::with_sheet(), poses(1.0), direction(-35.0, 25.0));
    let film = film(&block, &poses, lamp);
    let in_view =
        |k: usize, lamp: DVec3| block.seen_from(poses[k].centre()).lit(poses[k].rotation.inverse() * lamp);
    let lighting = solved(&in_view(3, lamp), &poses, &film).unwrap();
    let off = lighting.lamp.towards.angle_between(lamp).to_degrees();
    assert!(off < 6.0, "{off} {:?}", lighting.lamp);
    assert!((lighting.lamp.ambient - AMBIENT).abs() < 0.08, "{:?}", lighting.lamp);
    // From both sides of the sheet, and only where it is.
    for k in [3, 15] {
        let (shown, moved) = (in_view(k, lamp), direction(30.0, 25.0));
        let towards = poses[k].rotation.inverse() * moved;
        let truth = picture(&in_view(k, moved), &poses[k]);
        let without = picture(&Block::new(1.0).lit(towards), &poses[k]);
        let of_sheet = |rgb: Vec<u8>| -> Vec<u8> {
            let pixels = rgb.iter().zip(&truth).zip(&without);
            pixels.filter(|((_, t), w)| t != w).map(|((v, _), _)| *v).collect()
        };
        let relit = picture(&lighting.relit(&solid(&shown), &poses[k], moved), &poses[k]);
        let [truth_there, as_it_is, relit] = [truth.clone(), picture(&shown, &poses[k]), relit].map(of_sheet);
        assert!(truth_there.len() > 300, "{k}: {}", truth_there.len());
        let [before, after] = [as_it_is, relit].map(|rgb| psnr(&rgb, &truth_there));
        assert!(after > 24.0 && before < 20.0, "{k}: {before} {after}");
    }
}

#[test]
fn the_unit_of_the_scene_does_not_matter() {
    let lamp = direction(20.0, 40.0);
    let found = [1e-6, 1.0, 1e6].map(|unit| {
        let (block, poses) = (Block::new(unit), poses(unit));
        solved(&block.lit(lamp), &poses, &film(&block, &poses, lamp)).unwrap().lamp.towards
    });
    for other in found {
        assert!(other.angle_between(found[1]).to_degrees() < 1.0, "{found:?}");
    }
}

#[test]
fn light_that_does_not_go_round_tells_of_no_lamp() {
    let (block, poses) = (Block::new(1.0), poses(1.0));
    let shown = block.lit(DVec3::new(0.6, -0.6, 0.53));
    let film: Vec<Vec<u8>> = poses.iter().map(|pose| picture(&shown, pose)).collect();
    assert_eq!(solved(&shown, &poses, &film).unwrap_err(), LightError::NoLamp);
    for value in [0, 255] {
        let flat: Vec<Vec<u8>> = film.iter().map(|f| vec![value; f.len()]).collect();
        assert_eq!(solved(&shown, &poses, &flat).unwrap_err(), LightError::NoLamp, "{value}");
    }
}

#[test]
fn nothing_to_see_is_an_error() {
    let (block, poses) = (Block::new(1.0), poses(1.0));
    let film = film(&block, &poses, direction(0.0, 0.0));
    let none = Gaussians::default();
    assert_eq!(solved(&none, &poses, &film).unwrap_err(), LightError::Unseen);
    assert_eq!(solved(&block.gaussians, &poses[..1], &film[..1]).unwrap_err(), LightError::Unseen);
    let mut broken = block.gaussians.clone();
    broken.means.iter_mut().for_each(|m| *m = Vec3::NAN);
    assert_eq!(solved(&broken, &poses, &film).unwrap_err(), LightError::Unseen);
}

#[test]
fn angles_lead_to_directions_and_back() {
    assert!(direction(0.0, 0.0).abs_diff_eq(DVec3::NEG_Z, 1e-12));
    assert!(direction(90.0, 0.0).abs_diff_eq(DVec3::X, 1e-12));
    assert!(direction(0.0, 90.0).abs_diff_eq(DVec3::NEG_Y, 1e-12));
    let turned = DMat3::from_rotation_y(-0.5) * DVec3::NEG_Z;
    assert!(direction(0.5_f64.to_degrees(), 0.0).abs_diff_eq(turned, 1e-12));
    let lamp = crate::Lamp { towards: direction(-30.0, 20.0), deviation_deg: 0.0, ambient: 0.0, gain: 0.0 };
    let [azimuth, elevation] = lamp.angles_deg();
    assert!((azimuth + 30.0).abs() < 1e-9 && (elevation - 20.0).abs() < 1e-9);
}
