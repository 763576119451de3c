//! The door for models that come from outside: refused, or repaired and said.

use super::{Reconstruction, ScenePoint, TrackElement};
use crate::Camera;
use std::collections::{BTreeMap, BTreeSet};

/// Focal lengths that cameras have, longer image sides. Source: derived; angles of view from 0.6°
/// to 170°.
const FOCAL: std::ops::RangeInclusive<f64> = 0.04..=100.0;
/// Coordinates are smaller, scene units. Source: derived; a splat is trained in f32, which tells
/// 1e7 from 1e7 + 1.
const FARTHEST: f64 = 1e7;
/// Poses are equal where rotations (as quaternions) and centres (of their own size) differ by less.
/// Source: derived; what text files with six digits leave.
const EQUAL: f64 = 1e-6;
/// Poses and points fit each other where half of the observations lie nearer to their points than
/// this share of the longer image side. Source: derived; ten times what video stabilisation, the
/// worst that a camera model leaves, adds at 1000 pixels.
const MEDIAN_ERROR: f64 = 0.02;

impl Reconstruction {
    /// Checks a model that was read from outside, beyond [`Reconstruction::validate`]: images have
    /// names of their own, cameras are possible, poses differ, numbers have a sensible size, and
    /// observations agree with poses and points: half of all, and half of each image's. Repairs
    /// what can be (repeated track elements, single observations that do not agree) and says so.
    ///
    /// # Errors
    /// What is wrong, where nothing sensible can be made of it.
    pub fn admit(&mut self) -> Result<Vec<String>, String> {
        let mut notes = self.without_repeated_elements();
        self.validate()?;
        self.check_names()?;
        self.cameras.values().try_for_each(check_camera)?;
        self.check_numbers()?;
        self.check_poses_differ()?;
        notes.extend(self.without_contradictions()?);
        Ok(notes)
    }

    /// Takes out track elements that stand twice in a track, and points that are left with less
    /// than two.
    fn without_repeated_elements(&mut self) -> Vec<String> {
        let mut repeated = 0;
        for point in self.points.values_mut() {
            let before = point.track.len();
            let mut seen: BTreeSet<TrackElement> = BTreeSet::new();
            point.track.retain(|element| seen.insert(*element));
            repeated += before - point.track.len();
        }
        if repeated == 0 {
            return Vec::new();
        }
        let lost = self.without_unseen_points();
        vec![format!(
            "{repeated} observations stood twice in their tracks and were taken out, with {lost} points that had no other"
        )]
    }

    /// Takes out points that are left with less than two observations; how many.
    fn without_unseen_points(&mut self) -> usize {
        let lost: BTreeSet<u64> =
            self.points.iter().filter(|(_, p)| p.track.len() < 2).map(|(id, _)| *id).collect();
        self.points.retain(|id, _| !lost.contains(id));
        for observation in self.images.values_mut().flat_map(|image| &mut image.observations) {
            observation.point = observation.point.filter(|id| !lost.contains(id));
        }
        lost.len()
    }

    fn check_names(&self) -> Result<(), String> {
        let mut seen = BTreeMap::new();
        for image in self.images.values() {
            if let Some(other) = seen.insert(&image.name, image.id) {
                return Err(format!("images {other} and {} are both called {}", image.id, image.name));
            }
        }
        Ok(())
    }

    fn check_numbers(&self) -> Result<(), String> {
        for image in self.images.values() {
            if image.pose.centre().abs().max_element() > FARTHEST {
                return Err(format!("the camera of {} lies farther away than {FARTHEST:e}", image.name));
            }
            if image.observations.iter().any(|o| !o.pixel.is_finite()) {
                return Err(format!("{} has keypoints that are not finite", image.name));
            }
        }
        match self.points.iter().find(|(_, p)| p.position.abs().max_element() > FARTHEST) {
            Some((id, _)) => Err(format!("point {id} lies farther away than {FARTHEST:e}")),
            None => Ok(()),
        }
    }

    fn check_poses_differ(&self) -> Result<(), String> {
        let mut images = self.images.values();
        let Some(first) = images.next().map(|image| image.pose) else { return Ok(()) };
        let centre = first.centre();
        let near = EQUAL * centre.length().max(1e-12);
        let all_equal = images.all(|image| {
            let apart = (image.pose.centre() - centre).length();
            first.rotation.dot(image.pose.rotation).abs() > 1.0 - EQUAL && apart <= near
        });
        if self.images.len() > 1 && all_equal {
            return Err(format!("all {} images have the same pose", self.images.len()));
        }
        Ok(())
    }

    /// At least half of the observations of every image lie near what its camera makes of their
    /// points; those that do not are taken out.
    fn without_contradictions(&mut self) -> Result<Option<String>, String> {
        let mut of_image: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
        for point in self.points.values() {
            for element in &point.track {
                of_image.entry(element.image).or_default().push(self.share_of_side(point, element));
            }
        }
        let all = sorted(of_image.values().flatten().copied().collect());
        if let Some(median) = all.get(all.len() / 2).filter(|median| !(**median <= MEDIAN_ERROR)) {
            return Err(format!(
                "poses and points do not fit the images: half of the {} observations lie {:.0} % of an image side or more from where their points should be seen",
                all.len(),
                100.0 * median.min(1.0)
            ));
        }
        for (image, shares) in of_image {
            let (count, shares) = (shares.len(), sorted(shares));
            if !(shares[count / 2] <= MEDIAN_ERROR) {
                return Err(format!(
                    "the pose of {} does not fit its {count} observations: half of them lie {:.0} % of an image side or more from where their points should be seen",
                    self.images[&image].name,
                    100.0 * shares[count / 2].min(1.0)
                ));
            }
        }
        let wrong = all.iter().filter(|share| !(**share <= MEDIAN_ERROR)).count();
        Ok((wrong > 0).then(|| {
            let lost = self.drop_contradictions();
            format!(
                "{wrong} of {} observations lay more than {:.0} % of an image side from where their points should be seen and were taken out, with {lost} points that had no other",
                all.len(),
                100.0 * MEDIAN_ERROR
            )
        }))
    }

    /// How far an observation lies from where its point should be seen, longer image sides;
    /// infinite where it cannot be seen.
    fn share_of_side(&self, point: &ScenePoint, element: &TrackElement) -> f64 {
        let camera = self.images.get(&element.image).and_then(|i| self.cameras.get(&i.camera));
        let side = camera.map_or(1.0, |c| f64::from(c.width.max(c.height)));
        self.residual(point, element).map_or(f64::INFINITY, |r| r.length() / side)
    }

    /// Takes out observations that lie far from where their points should be seen; how many points
    /// go with them.
    fn drop_contradictions(&mut self) -> usize {
        let mut points = std::mem::take(&mut self.points);
        for point in points.values_mut() {
            let (kept, wrong): (Vec<TrackElement>, Vec<TrackElement>) =
                point.track.iter().partition(|e| self.share_of_side(point, e) <= MEDIAN_ERROR);
            for element in wrong {
                let image = self.images.get_mut(&element.image);
                let seen = image.and_then(|i| i.observations.get_mut(element.observation as usize));
                if let Some(observation) = seen {
                    observation.point = None;
                }
            }
            point.track = kept;
        }
        self.points = points;
        self.without_unseen_points()
    }

    /// Takes out images, and points that are left with less than two observations.
    pub fn without_images(&mut self, names: &BTreeSet<&str>) {
        self.images.retain(|_, image| !names.contains(image.name.as_str()));
        for point in self.points.values_mut() {
            point.track.retain(|element| self.images.contains_key(&element.image));
        }
        self.without_unseen_points();
    }
}

/// Ascending; what is no number last.
fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

fn check_camera(camera: &Camera) -> Result<(), String> {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let side = width.max(height);
    for focal in camera.focal().to_array() {
        if !FOCAL.contains(&(focal / side)) {
            let size = format!("{}×{}", camera.width, camera.height);
            return Err(format!("camera {} has a focal length of {focal} px for {size} pixels", camera.id));
        }
    }
    let centre = camera.principal_point();
    if !(-side..=width + side).contains(&centre.x) || !(-side..=height + side).contains(&centre.y) {
        return Err(format!(
            "camera {} has its principal point at {:.0}, {:.0}, far outside its images",
            camera.id, centre.x, centre.y
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CameraModel, Observation, Pose, PosedImage, ScenePoint};
    use glam::{DQuat, DVec2, DVec3};

    /// Four cameras around 20 points, exact.
    fn model() -> Reconstruction {
        let mut model = Reconstruction::default();
        model.cameras.insert(1, Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 600.0));
        let points: Vec<DVec3> =
            (0..20).map(|i| DVec3::new(f64::from(i % 5), f64::from(i / 5), f64::from(i % 3)) * 0.2).collect();
        for id in 1..=4 {
            let angle = f64::from(id);
            let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0);
            let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Z);
            let see = |x: &DVec3| model.cameras[&1].project(pose.transform(*x)).unwrap();
            let seen = points.iter().enumerate();
            let observations =
                seen.map(|(i, x)| Observation { pixel: see(x), point: Some(i as u64) }).collect();
            model
                .images
                .insert(id, PosedImage { id, camera: 1, name: format!("{id}.png"), pose, observations });
        }
        for (i, position) in points.into_iter().enumerate() {
            let track = (1..=4).map(|image| TrackElement { image, observation: i as u32 }).collect();
            model.points.insert(i as u64, ScenePoint { position, rgb: [0; 3], error_px: 0.0, track });
        }
        model
    }

    #[test]
    fn an_exact_model_comes_in_as_it_is() {
        let mut admitted = model();
        assert_eq!(admitted.admit(), Ok(Vec::new()));
        assert_eq!(admitted, model());
    }

    #[test]
    fn nonsense_is_refused_by_what_is_wrong_with_it() {
        let cases: [(&str, &dyn Fn(&mut Reconstruction)); 10] = [
            ("both called 1.png", &|m| m.images.get_mut(&3).unwrap().name = "1.png".into()),
            ("the same pose", &|m| {
                let pose = m.images[&1].pose;
                m.images.values_mut().for_each(|i| i.pose = pose);
                m.points.clear();
                m.images.values_mut().flat_map(|i| &mut i.observations).for_each(|o| o.point = None);
            }),
            ("focal length", &|m| m.cameras.get_mut(&1).unwrap().params[0] = 1e-6),
            ("focal length", &|m| m.cameras.get_mut(&1).unwrap().params[0] = 1e9),
            ("principal point", &|m| m.cameras.get_mut(&1).unwrap().params[1] = -1e5),
            ("point 3 lies farther", &|m| m.points.get_mut(&3).unwrap().position.x = 1e30),
            ("camera of 2.png lies farther", &|m| m.images.get_mut(&2).unwrap().pose.translation.y = 1e12),
            ("do not fit", &|m| {
                m.images.values_mut().for_each(|i| i.pose.rotation *= DQuat::from_rotation_z(0.5))
            }),
            ("the pose of 2.png does not fit its 20", &|m| {
                m.images.get_mut(&2).unwrap().pose.rotation *= DQuat::from_rotation_z(0.5);
            }),
            ("not finite", &|m| m.images.get_mut(&1).unwrap().observations[0].pixel = DVec2::NAN),
        ];
        for (i, (words, damage)) in cases.into_iter().enumerate() {
            let mut model = model();
            damage(&mut model);
            let said = model.admit();
            assert!(said.as_ref().is_err_and(|e| e.contains(words)), "case {i}: {words}: {said:?}");
        }
    }

    #[test]
    fn repeated_track_elements_are_taken_out_and_said() {
        let mut model = model();
        let twice = model.points[&0].track[0];
        model.points.get_mut(&0).unwrap().track.push(twice);
        model.points.get_mut(&1).unwrap().track = vec![TrackElement { image: 1, observation: 1 }; 2];
        let said = model.admit().unwrap();
        assert!(said[0].contains("2 observations") && said[0].contains("1 points"), "{said:?}");
        assert_eq!((model.points[&0].track.len(), model.points.len()), (4, 19));
        assert_eq!(model.validate(), Ok(()));
    }

    #[test]
    fn single_observations_that_do_not_fit_are_taken_out_and_said() {
        let mut model = model();
        model.points.get_mut(&3).unwrap().position.z += 1.0;
        model.images.get_mut(&1).unwrap().observations[5].pixel.x += 100.0;
        let said = model.admit().unwrap();
        assert!(said[0].starts_with("5 of 80") && said[0].contains("1 points"), "{said:?}");
        assert!(!model.points.contains_key(&3) && model.points[&5].track.len() == 3);
        assert_eq!(model.images[&1].observations[5].point, None);
        assert_eq!(model.validate(), Ok(()));
    }

    #[test]
    fn images_are_taken_out_with_what_only_they_see() {
        let mut model = model();
        model.points.get_mut(&7).unwrap().track.truncate(2);
        model.images.values_mut().skip(2).for_each(|i| i.observations[7].point = None);
        model.without_images(&["1.png"].into());
        assert_eq!((model.images.len(), model.points.len()), (3, 19));
        assert_eq!(model.validate(), Ok(()));
    }
}
