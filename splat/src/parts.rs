//! Parts of the object that move against its body: where each stands in a view, and what pulls
//! at it.
//!
//! A Gaussian belongs to one part for good. It is kept as it is at rest: a camera that sees the
//! part moved by `T` sees it as a camera moved by `T⁻¹` sees the part at rest, so that nothing but
//! the camera differs between parts. Its shine turns with it.

use glam::{Mat3, Vec3};

/// Most parts beside the body: views are copied with what moves them.
/// Source: chosen by hand: two arrays, two antennas.
pub(crate) const MOST_PARTS: usize = 4;

/// A motion: `x_body = R x_rest + t`, frame of the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PartPlace {
    /// Rotation.
    pub(crate) rotation: Mat3,
    /// Translation.
    pub(crate) translation: Vec3,
}

impl PartPlace {
    /// Where a part at rest stands.
    pub(crate) const REST: Self = Self { rotation: Mat3::IDENTITY, translation: Vec3::ZERO };
}

/// Where the parts stand in a view: the first part is number 1, the body 0. Parts beyond those that
/// are told stand at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PartPlaces {
    count: usize,
    places: [PartPlace; MOST_PARTS],
}

impl PartPlaces {
    /// Nothing moves.
    pub(crate) const NONE: Self = Self { count: 0, places: [PartPlace::REST; MOST_PARTS] };

    /// So many of them are told.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// Where a part stands; the body always at rest.
    pub(crate) fn of(&self, part: u8) -> PartPlace {
        let place = usize::from(part).checked_sub(1).and_then(|k| self.places[..self.count].get(k));
        place.copied().unwrap_or(PartPlace::REST)
    }
}

impl Default for PartPlaces {
    fn default() -> Self {
        Self::NONE
    }
}

impl FromIterator<PartPlace> for PartPlaces {
    /// The parts in the order of their numbers; those beyond [`MOST_PARTS`] are dropped.
    fn from_iter<I: IntoIterator<Item = PartPlace>>(all: I) -> Self {
        let mut out = Self::NONE;
        for (to, place) in out.places.iter_mut().zip(all) {
            *to = place;
            out.count += 1;
        }
        out
    }
}

/// dL/d(motion) of a part in a step, as the part at rest sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PartPull {
    /// Of its Gaussians' places: the sum of dL/dmean without what their colours add.
    pub(crate) force: [f32; 3],
    /// The same about the origin, and of what turns the Gaussians themselves.
    pub(crate) torque: [f32; 3],
    /// Of the directions from which colours are seen: the sum of dL/dmean through them.
    pub(crate) colour: [f32; 3],
}

/// Of all parts, the first one first.
pub(crate) type PartPulls = [PartPull; MOST_PARTS];

impl PartPull {
    /// Adds what pulls at another Gaussian or at others.
    pub(crate) fn add(&mut self, other: &Self) {
        let own = [&mut self.force, &mut self.torque, &mut self.colour];
        for (own, other) in own.into_iter().zip([other.force, other.torque, other.colour]) {
            own.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Backend;
    use crate::cpu::CpuBackend;
    use crate::dataset::Joint;
    use crate::model::{MEAN, Model};
    use crate::statistics::Statistics;
    use crate::view::{PinholeView, RenderOptions};
    use glam::{DQuat, DVec3, Quat};
    use rand::Rng as _;
    use scene::Gaussians;
    use scene::sim3::Sim3;

    /// Gaussians of degree 3 about the origin; which of two parts or of the body each belongs to
    /// follows no order.
    fn scene() -> (Gaussians, Vec<u8>) {
        let mut rng = scene::rng::rng(5, "parts", 0);
        let n = 203;
        let mut vector = |half: f32| Vec3::from(rng.random::<[f32; 3]>().map(|v| (2.0 * v - 1.0) * half));
        let gaussians = Gaussians {
            means: (0..n).map(|_| vector(0.5)).collect(),
            log_scales: (0..n).map(|_| Vec3::splat(-3.0) + vector(0.5)).collect(),
            rotations: (0..n).map(|_| Quat::from_scaled_axis(vector(3.0))).collect(),
            opacity_logits: (0..n).map(|_| vector(2.0).x).collect(),
            sh: (0..16 * n).flat_map(|_| vector(0.2).to_array()).collect(),
            sh_degree: 3,
        };
        let parts = (0..n).map(|i| (i * 7 % 5 % 3) as u8).collect();
        (gaussians, parts)
    }

    fn joints() -> Vec<Joint> {
        let joint = |axis: DVec3, place: DVec3| Joint {
            axis: axis.normalize(),
            place,
            angles: Vec::new(),
            sigmas: Vec::new(),
            unsure: [0.0; 2],
        };
        vec![
            joint(DVec3::new(0.2, 1.0, 0.1), DVec3::new(0.3, 0.0, 0.1)),
            joint(DVec3::new(1.0, 0.1, -0.4), DVec3::new(0.0, -0.2, 0.2)),
        ]
    }

    fn view(parts: PartPlaces) -> PinholeView {
        PinholeView {
            rotation: Mat3::from_quat(Quat::from_rotation_y(0.3)),
            translation: Vec3::new(0.1, 0.0, 2.0),
            focal: [60.0; 2],
            centre: [32.0, 24.0],
            width: 64,
            height: 48,
            parts,
        }
    }

    const ANGLES: [f64; 2] = [0.7, -1.1];

    /// The same Gaussians where angles put them, turned one by one.
    fn moved(gaussians: &Gaussians, parts: &[u8], angles: [f64; 2]) -> Gaussians {
        moved_on(&joints(), gaussians, parts, angles)
    }

    /// The same on other joints.
    fn moved_on(joints: &[Joint], gaussians: &Gaussians, parts: &[u8], angles: [f64; 2]) -> Gaussians {
        let motions: Vec<Sim3> = joints
            .iter()
            .zip(angles)
            .map(|(joint, angle)| {
                let rotation = DQuat::from_axis_angle(joint.axis, angle);
                Sim3 { scale: 1.0, rotation, translation: joint.place - rotation * joint.place }
            })
            .collect();
        let mut out = gaussians.clone();
        for (part, motion) in (1..).zip(&motions) {
            let mut all = gaussians.clone();
            all.transform(motion);
            for i in (0..out.len()).filter(|&i| parts[i] == part) {
                out.means[i] = all.means[i];
                out.rotations[i] = all.rotations[i];
                out.sh[48 * i..48 * (i + 1)].copy_from_slice(&all.sh[48 * i..48 * (i + 1)]);
            }
        }
        out
    }

    fn backend(gaussians: &Gaussians, parts: &[u8]) -> CpuBackend {
        let mut backend = CpuBackend::default();
        let model = Model { part: parts.to_vec(), ..Model::from_gaussians(gaussians) };
        backend.upload(model, Statistics::default()).unwrap();
        backend
    }

    fn places() -> PartPlaces {
        joints().iter().zip(ANGLES).map(|(joint, angle)| joint.at().place_at(angle)).collect()
    }

    #[test]
    fn a_camera_for_each_part_shows_what_moved_gaussians_do() {
        let (gaussians, parts) = scene();
        let options = RenderOptions::default();
        let ours = backend(&gaussians, &parts).render(&view(places()), &options).unwrap();
        let still = view(PartPlaces::NONE);
        let truth = backend(&moved(&gaussians, &parts, ANGLES), &[]).render(&still, &options).unwrap();
        let rest = backend(&gaussians, &parts).render(&still, &options).unwrap();
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart(&ours.rgb.data, &truth.rgb.data) < 2e-4);
        assert!(apart(&ours.depth.data, &truth.depth.data) < 2e-3);
        assert!(apart(&rest.rgb.data, &truth.rgb.data) > 0.2, "the parts move");
    }

    #[test]
    fn gradients_of_parts_are_those_of_moved_gaussians_turned_back() {
        let (gaussians, parts) = scene();
        let mut rng = scene::rng::rng(6, "parts", 0);
        let picture: Vec<f32> = (0..64 * 48 * 3).map(|_| rng.random_range(-1.0..1.0)).collect();
        let options = RenderOptions::default();
        let ours = backend(&gaussians, &parts).gradients(&view(places()), &options, &picture);
        let still = view(PartPlaces::NONE);
        let truth = backend(&moved(&gaussians, &parts, ANGLES), &[]).gradients(&still, &options, &picture);
        let mean = |planes: &crate::model::Planes, i: usize| {
            Vec3::from_array([0, 1, 2].map(|k| planes[MEAN + k][i]))
        };
        let largest = (0..parts.len()).map(|i| mean(&truth.geometry, i).length()).fold(0.0, f32::max);
        let apart = parts.iter().enumerate().map(|(i, &part)| {
            let back = places().of(part).rotation.transpose() * mean(&truth.geometry, i);
            mean(&ours.geometry, i).distance(back) / largest
        });
        // A pixel at which alpha just is or is not 1/255 makes more of a difference.
        let mut apart: Vec<f32> = apart.collect();
        apart.sort_by(f32::total_cmp);
        assert!(apart[parts.len() * 8 / 10] < 1e-3, "{apart:?}");
        assert!(apart[parts.len() - 1] < 0.03, "{apart:?}");
    }

    /// All numbers of a model in one list.
    fn numbers(planes: &crate::model::Planes, sh: &[f32]) -> Vec<f64> {
        planes.iter().flatten().chain(sh).map(|v| f64::from(*v)).collect()
    }

    /// A camera, what pulls at the parts in a picture of it, and the gradient of all Gaussians
    /// where the parts put them.
    fn pulled(gaussians: &Gaussians, parts: &[u8]) -> (PinholeView, PartPulls, Vec<f64>) {
        let mut rng = scene::rng::rng(6, "slope", 0);
        let picture: Vec<f32> = (0..64 * 48 * 3).map(|_| rng.random_range(-1.0..1.0)).collect();
        let (options, camera) = (RenderOptions::default(), view(places()));
        let ours = backend(gaussians, parts).gradients(&camera, &options, &picture).pulls;
        let still = view(PartPlaces::NONE);
        let here = backend(&moved(gaussians, parts, ANGLES), &[]).gradients(&still, &options, &picture);
        (camera, ours, numbers(&here.geometry, &here.sh))
    }

    #[test]
    fn the_slope_of_an_angle_is_what_gradients_say_of_gaussians_that_follow_it() {
        let (gaussians, parts) = scene();
        let (camera, ours, gradient) = pulled(&gaussians, &parts);
        let at = |angles: [f64; 2]| Model::from_gaussians(&moved(&gaussians, &parts, angles));
        for k in 0..2 {
            let change = |by: f64| {
                let mut angles = ANGLES;
                angles[k] += by;
                let model = at(angles);
                numbers(&model.geometry, &model.sh)
            };
            let (more, less) = (change(1e-2), change(-1e-2));
            let moves = more.iter().zip(&less).map(|(a, b)| (a - b) / 2e-2);
            let truth: f64 = gradient.iter().zip(moves).map(|(g, m)| g * m).sum();
            let slope = joints()[k].at().slope(&ours[k], camera.of_part(k as u8 + 1).position());
            assert!((slope - truth).abs() < 2e-3 * truth.abs() + 1e-3, "{k}: {slope} {truth}");
        }
    }

    #[test]
    fn the_slopes_of_an_axis_and_a_place_are_what_gradients_say_of_gaussians_that_follow_them() {
        let (gaussians, parts) = scene();
        let (camera, ours, gradient) = pulled(&gaussians, &parts);
        let hinge = joints()[0].at();
        let slopes = hinge.slopes(ANGLES[0], &ours[0], camera.of_part(1).position());
        for along in [DVec3::new(0.3, -0.1, 0.7), DVec3::new(-0.5, 0.1, 0.2)] {
            let across = along.reject_from_normalized(hinge.axis).normalize();
            let place = |by: f64| [hinge.axis, hinge.place + by * across];
            let axis = |by: f64| [(hinge.axis + by * across).normalize(), hinge.place];
            for (k, [more, less]) in
                [[axis(1e-2), axis(-1e-2)], [place(1e-2), place(-1e-2)]].into_iter().enumerate()
            {
                let model = |[axis, place]: [DVec3; 2]| {
                    let mut all = joints();
                    (all[0].axis, all[0].place) = (axis, place);
                    let model = Model::from_gaussians(&moved_on(&all, &gaussians, &parts, ANGLES));
                    numbers(&model.geometry, &model.sh)
                };
                let (more, less) = (model(more), model(less));
                let moves = more.iter().zip(&less).map(|(a, b)| (a - b) / 2e-2);
                let truth: f64 = gradient.iter().zip(moves).map(|(g, m)| g * m).sum();
                let slope = slopes[k].dot(across);
                assert!((slope - truth).abs() < 5e-3 * truth.abs() + 5e-3, "{k}: {slope} {truth}");
            }
        }
    }

    #[test]
    fn more_parts_than_there_may_be_are_dropped_and_unknown_ones_stand_still() {
        let joint = &joints()[0];
        let many: PartPlaces = (0..9).map(|k| joint.at().place_at(f64::from(k))).collect();
        assert_eq!(many.len(), MOST_PARTS);
        assert_eq!(many.of(4), joint.at().place_at(3.0));
        assert_eq!([many.of(0), many.of(5), PartPlaces::NONE.of(1)], [PartPlace::REST; 3]);
    }
}
