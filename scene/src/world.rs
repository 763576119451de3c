//! The frame in which models leave the program.
//!
//! A solver's frame is arbitrary. What is written is right-handed with y down, as COLMAP and 3DGS
//! viewers expect: the object in the origin and one unit its radius, and the first image looks
//! along z. Formats with another convention are turned on the way ([`crate::io`]).

use crate::decision::{Decision, Measurement, Quantity, Rule, ScaleEvidence, Subject, UpEvidence};
use crate::overview::quantile;
use crate::sim3::{Sim3, nearest_rotation};
use crate::up::{StatedUp, UP, level_up, roll_deg};
use crate::{Pose, Reconstruction, Ring};
use glam::{DMat3, DQuat, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// An arc of cameras that is shorter does not say where its axis points, degrees. Source: chosen by
/// hand, never measured.
const SHORTEST_ARC_DEG: f64 = 180.0;
/// The axis of a circle farther from the cameras' own up is no vertical: a camera can be led over
/// the top of an object, too, degrees. Source: chosen by hand, never measured.
const MOST_TILT_DEG: f64 = 45.0;
/// Share of the points inside the object's radius: the others may be outliers. Source: chosen by
/// hand, never measured.
const INSIDE: f64 = 0.9;

/// What one unit is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WorldUnit {
    /// The radius of the object.
    ObjectRadius,
    /// Metres, by a length that was given.
    Metre,
    /// As the input, or the solver, has it.
    #[default]
    Unchanged,
}

/// How many metres a unit of a solver's model is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricScale {
    /// What says so.
    pub evidence: ScaleEvidence,
    /// Metres a unit of the solver.
    pub metres_per_unit: f64,
    /// Standard deviation as a share of it, where there is more than one measurement.
    pub relative_deviation: Option<f64>,
}

impl MetricScale {
    /// The scale, as a decision.
    pub fn decision(&self) -> Decision {
        let rule = match self.evidence {
            ScaleEvidence::Gps(_) => Rule::Evidence,
            _ => Rule::Given,
        };
        let decision = Decision::new(Subject::WorldScale, self.evidence, rule);
        match self.relative_deviation {
            Some(share) => decision.measured(Quantity::ScaleDeviation, share),
            None => decision,
        }
    }
}

/// Where the world lies, and what says so.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorldFrame {
    /// Direction that is up, in the world; (0, −1, 0) unless the frame was kept.
    pub up: [f64; 3],
    /// What says so.
    pub up_evidence: UpEvidence,
    /// Root mean square angle of the cameras' x axes with the horizontal plane, degrees.
    pub roll_deg: f64,
    /// Angle between the axis of the turn, or of the cameras' circle, and the up of level cameras,
    /// degrees, where there is one.
    pub axis_tilt_deg: Option<f64>,
    /// How many of how many nearly vertical lines agree, where they say what is up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lines: Option<[usize; 2]>,
    /// How many photos' metadata agree of how many that say what is up, where they say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stated: Option<[usize; 2]>,
    /// What one unit is.
    pub unit: WorldUnit,
    /// What says how long a metre is, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<MetricScale>,
    /// 4 × 4 matrix, row by row: from the frame of the input, or of the solver, into the world.
    pub world_from_source: [[f64; 4]; 4],
}

impl WorldFrame {
    /// Of a model. `ring`: the circle of its cameras, where they stand on one; `turn`: the axis
    /// about which the object turns, where it does (that of the ring, if there is one, goes through
    /// the object then); `scale`: how many metres a unit is, where that is known. `None` of a model
    /// without images.
    pub fn of(
        model: &Reconstruction,
        ring: Option<&Ring>,
        turn: Option<DVec3>,
        scale: Option<MetricScale>,
    ) -> Option<Self> {
        let poses: Vec<Pose> = model.images.values().map(|i| i.pose).collect();
        let level = level_up(&poses)?;
        let axis = turn.or(ring.map(|r| r.axis)).map(|a| if a.dot(level) < 0.0 { -a } else { a });
        let tilt_deg = axis.map(|a| a.angle_between(level).to_degrees());
        let spans = ring.is_some_and(|r| 360.0 - r.largest_gap().angle.to_degrees() >= SHORTEST_ARC_DEG);
        let is_upright = spans && tilt_deg.is_some_and(|t| t < MOST_TILT_DEG);
        let (up, up_evidence) = match axis {
            Some(axis) if turn.is_some() => (axis, UpEvidence::TurnAxis),
            Some(axis) if is_upright => (axis, UpEvidence::CircleAxis),
            _ => (level, UpEvidence::LevelCameras),
        };
        let world = Self::along(model, (up, up_evidence), ring.filter(|_| turn.is_some()), scale)?;
        Some(Self { axis_tilt_deg: tilt_deg, ..world })
    }

    /// With a direction that is up, and what says so. `ring`: its axis goes through the object.
    fn along(
        model: &Reconstruction,
        (up, up_evidence): (DVec3, UpEvidence),
        ring: Option<&Ring>,
        scale: Option<MetricScale>,
    ) -> Option<Self> {
        let poses: Vec<Pose> = model.images.values().map(|i| i.pose).collect();
        let rotation = upright(up, poses.first()?);
        let mut centre = middle(model, rotation);
        if let Some(ring) = ring {
            centre = ring.centre + up * (centre - ring.centre).dot(up);
        }
        let factor = scale.map_or_else(|| 1.0 / object_radius(model, centre), |s| s.metres_per_unit);
        let sim = Sim3 { scale: factor, rotation, translation: -factor * (rotation * centre) };
        Some(Self {
            up: UP.to_array(),
            up_evidence,
            roll_deg: roll_deg(&poses, up),
            axis_tilt_deg: None,
            lines: None,
            stated: None,
            unit: if scale.is_some() { WorldUnit::Metre } else { WorldUnit::ObjectRadius },
            scale,
            world_from_source: rows(&sim),
        })
    }

    /// The same by vertical lines: `up` is their direction, on which so many of so many agree.
    /// For a frame that only the cameras' own up holds.
    pub fn by_lines(self, model: &Reconstruction, up: DVec3, lines: [usize; 2]) -> Self {
        let found = Self::along(model, (up, UpEvidence::VerticalLines), None, self.scale);
        let axis_tilt_deg = self.axis_tilt_deg;
        found.map_or(self, |found| Self { lines: Some(lines), axis_tilt_deg, ..found })
    }

    /// The same by what the photos' metadata say. For a frame that only the cameras' own up holds.
    pub fn by_metadata(self, model: &Reconstruction, stated: &StatedUp) -> Self {
        let found = Self::along(model, (stated.up, UpEvidence::Metadata), None, self.scale);
        let axis_tilt_deg = self.axis_tilt_deg;
        found.map_or(self, |found| Self { stated: Some(stated.agreeing_and_all), axis_tilt_deg, ..found })
    }

    /// The frame as it is, with what is up in it; `turn`: from the input's file into the model.
    pub fn kept(self, turn: Sim3) -> Self {
        let up = self.sim3().rotation.conjugate() * UP;
        let (unit, world_from_source) = (WorldUnit::Unchanged, rows(&turn));
        Self { up: up.to_array(), unit, scale: None, world_from_source, ..self }
    }

    /// Which direction is up, as a decision. `rule`: what made it stand.
    pub fn decision(&self, rule: Rule) -> Decision {
        let decision = Decision::new(Subject::WorldUp, self.up_evidence, rule);
        let mut decision = decision.measured(Quantity::CameraRoll, self.roll_deg);
        if let Some([agreeing, lines]) = self.lines {
            let counted = [(Quantity::AgreeingLines, agreeing), (Quantity::Lines, lines)];
            decision = counted.into_iter().fold(decision, |d, (what, n)| d.with(Measurement::count(what, n)));
        }
        if let Some([agreeing, all]) = self.stated {
            let counted = [(Quantity::AgreeingPhotos, agreeing), (Quantity::StatingPhotos, all)];
            decision = counted.into_iter().fold(decision, |d, (what, n)| d.with(Measurement::count(what, n)));
        }
        match self.axis_tilt_deg {
            Some(tilt) => decision.measured(Quantity::AxisFromLevel, tilt),
            None => decision,
        }
    }

    /// `world_from_source` as a similarity.
    pub fn sim3(&self) -> Sim3 {
        let m = &self.world_from_source;
        let [x, y, z, translation] = [0, 1, 2, 3].map(|c| DVec3::new(m[0][c], m[1][c], m[2][c]));
        let linear = DMat3::from_cols(x, y, z);
        let scale = linear.determinant().cbrt();
        Sim3 { scale, rotation: nearest_rotation(linear), translation }
    }
}

fn rows(sim: &Sim3) -> [[f64; 4]; 4] {
    let linear = DMat3::from_quat(sim.rotation) * sim.scale;
    let [x, y, z] = [0, 1, 2].map(|r| linear.row(r).extend(sim.translation[r]).to_array());
    [x, y, z, [0.0, 0.0, 0.0, 1.0]]
}

/// The rotation into a frame with `up` at −y, in which the camera looks along z, seen from above.
fn upright(up: DVec3, camera: &Pose) -> DQuat {
    let down = -up;
    let ahead = camera.view_direction().reject_from_normalized(up);
    // A camera that looks straight down has its image's up ahead.
    let above = camera.rotation.conjugate() * DVec3::NEG_Y;
    let ahead = ahead.try_normalize().filter(|_| ahead.length() > 1e-3);
    let ahead = ahead.or_else(|| above.reject_from_normalized(up).try_normalize());
    let ahead = ahead.unwrap_or_else(|| up.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(down.cross(ahead), down, ahead).transpose())
}

/// The median along each axis of the turned frame, of the points or else of the camera centres;
/// source frame.
fn middle(model: &Reconstruction, rotation: DQuat) -> DVec3 {
    let points = model.points.values().map(|p| rotation * p.position);
    let mut turned: Vec<DVec3> = points.collect();
    if turned.is_empty() {
        turned = model.images.values().map(|i| rotation * i.pose.centre()).collect();
    }
    let median = [0, 1, 2].map(|axis| quantile(turned.iter().map(|p| p[axis]).collect(), 0.5));
    rotation.conjugate() * DVec3::from_array(median.map(|m| m.unwrap_or(0.0)))
}

/// Most points lie inside it, and half of the cameras outside; 1 where neither says.
fn object_radius(model: &Reconstruction, centre: DVec3) -> f64 {
    let points = model.points.values().map(|p| p.position.distance(centre)).collect();
    let cameras = model.images.values().map(|i| i.pose.centre().distance(centre)).collect();
    let found = [quantile(points, INSIDE), quantile(cameras, 0.5)];
    let radius = found.into_iter().flatten().filter(|r| r.is_finite() && *r > 0.0).reduce(f64::min);
    radius.unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PosedImage, ScenePoint};

    /// Cameras at these angles (degrees) round a unit ball at `CENTRE`, looking down on it by
    /// `pitch` degrees, each rolled by up to 4°; moved by `sim`.
    fn filmed(angles: &[f64], pitch: f64, sim: &Sim3) -> Reconstruction {
        let mut model = Reconstruction::default();
        for (id, a) in (1..).zip(angles) {
            let (sin, cos) = a.to_radians().sin_cos();
            let down = pitch.to_radians();
            let eye = DVec3::new(cos * down.cos(), sin * down.cos(), down.sin()) * 4.0;
            let roll = DQuat::from_rotation_z((4.0 * (1.7 * a).sin()).to_radians());
            let looking = Pose::look_at(eye + CENTRE, CENTRE, DVec3::Z);
            let pose = Pose::from_centre(roll * looking.rotation, looking.centre());
            let name = format!("{id:03}.png");
            model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: vec![] });
        }
        for id in 0..500_u64 {
            // A spiral over the ball (Saff and Kuijlaars, 1997).
            let z = 1.0 - (2 * id + 1) as f64 / 500.0;
            let (sin, cos) = (id as f64 * 2.399_963).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            let position = CENTRE + DVec3::new(radius * cos, radius * sin, z);
            model.points.insert(id, ScenePoint { position, rgb: [0; 3], error_px: 0.0, track: vec![] });
        }
        sim.transform_reconstruction(&model)
    }

    const CENTRE: DVec3 = DVec3::new(3.0, -1.0, 2.0);

    fn tumbled() -> Sim3 {
        let rotation = DQuat::from_xyzw(0.3, -0.5, 0.7, 0.2).normalize();
        Sim3 { scale: 37.0, rotation, translation: DVec3::new(-5.0, 8.0, 100.0) }
    }

    fn steps(from: f64, step: f64, count: u32) -> Vec<f64> {
        (0..count).map(|i| from + step * f64::from(i)).collect()
    }

    /// Checks that true up, centre and size come out, and returns what was found.
    fn found(angles: &[f64], pitch: f64, is_turn: bool, tolerance_deg: f64) -> WorldFrame {
        let sim = tumbled();
        let model = filmed(angles, pitch, &sim);
        let poses: Vec<Pose> = model.images.values().map(|i| i.pose).collect();
        let ring = Ring::fit(&poses);
        let turn = ring.as_ref().filter(|_| is_turn).map(|r| r.axis);
        let frame = WorldFrame::of(&model, ring.as_ref(), turn, None).unwrap();
        let world_from_true = frame.sim3().compose(&sim);
        let up = world_from_true.rotation * DVec3::Z;
        let off = up.angle_between(UP).to_degrees();
        assert!(off < tolerance_deg, "{off}°: {frame:?}");
        assert!(world_from_true.transform(CENTRE).length() < 0.15, "{frame:?}");
        assert!((world_from_true.scale - 1.0).abs() < 0.1, "{frame:?}");
        let moved = frame.sim3().transform_reconstruction(&model);
        let ahead = moved.images[&1].pose.view_direction();
        assert!(ahead.x.abs() < 1e-9 && ahead.z > 0.0, "the first image looks along z: {ahead}");
        frame
    }

    #[test]
    fn a_ring_of_cameras_has_its_axis_up_the_object_in_the_origin_and_its_radius_as_unit() {
        let frame = found(&steps(0.0, 10.0, 36), 25.0, false, 0.01);
        assert_eq!((frame.up_evidence, frame.up), (UpEvidence::CircleAxis, [0.0, -1.0, 0.0]));
        assert!((2.0..4.0).contains(&frame.roll_deg), "{frame:?}");
    }

    #[test]
    fn cameras_on_a_short_arc_are_upright_by_being_level() {
        let frame = found(&steps(20.0, 4.0, 20), 50.0, false, 6.0);
        assert_eq!(frame.up_evidence, UpEvidence::LevelCameras);
    }

    #[test]
    fn vertical_lines_say_better_than_the_cameras_what_is_up() {
        let (model, sim) = (filmed(&steps(20.0, 4.0, 20), 50.0, &tumbled()), tumbled());
        let frame = WorldFrame::of(&model, None, None, None).unwrap();
        let by_lines = frame.clone().by_lines(&model, sim.rotation * DVec3::Z, [20, 30]);
        let off = |f: &WorldFrame| (f.sim3().rotation * sim.rotation * DVec3::Z).angle_between(UP);
        assert!(off(&by_lines) < 1e-6 && off(&frame) > 1e-3, "{} {}", off(&by_lines), off(&frame));
        assert_eq!((by_lines.up_evidence, by_lines.lines), (UpEvidence::VerticalLines, Some([20, 30])));
        let words = by_lines.decision(Rule::Evidence).sentences().evidence.join("; ");
        assert!(words.contains("lines that agree") && words.contains("20"), "{words}");
    }

    #[test]
    fn metadata_say_better_than_the_cameras_what_is_up() {
        let (model, sim) = (filmed(&steps(20.0, 4.0, 20), 50.0, &tumbled()), tumbled());
        let frame = WorldFrame::of(&model, None, None, None).unwrap();
        let stated = StatedUp { up: sim.rotation * DVec3::Z, agreeing_and_all: [19, 20] };
        let by_metadata = frame.clone().by_metadata(&model, &stated);
        let off = |f: &WorldFrame| (f.sim3().rotation * sim.rotation * DVec3::Z).angle_between(UP);
        assert!(off(&by_metadata) < 1e-6 && off(&frame) > 1e-3, "{} {}", off(&by_metadata), off(&frame));
        assert_eq!(by_metadata.up_evidence, UpEvidence::Metadata);
        let words = by_metadata.decision(Rule::Evidence).sentences().evidence.join("; ");
        assert!(words.contains("photos that agree") && words.contains("19"), "{words}");
    }

    #[test]
    fn a_turn_has_its_axis_up_however_little_of_it_was_filmed() {
        let frame = found(&steps(0.0, 5.0, 20), 10.0, true, 0.01);
        assert_eq!(frame.up_evidence, UpEvidence::TurnAxis);
    }

    #[test]
    fn a_camera_led_over_the_top_of_an_object_does_not_lay_it_on_its_side() {
        let sim = tumbled();
        let mut model = filmed(&steps(0.0, 10.0, 36), 0.0, &Sim3::IDENTITY);
        for (image, angle) in model.images.values_mut().zip(steps(-80.0, 4.5, 36)) {
            let (sin, cos) = angle.to_radians().sin_cos();
            let eye = CENTRE + DVec3::new(0.0, 4.0 * sin, 4.0 * cos);
            image.pose = Pose::look_at(eye, CENTRE, DVec3::new(0.0, cos, -sin));
        }
        let model = sim.transform_reconstruction(&model);
        let poses: Vec<Pose> = model.images.values().map(|i| i.pose).collect();
        let ring = Ring::fit(&poses);
        let evidence = ScaleEvidence::MarkedLength;
        let scale = MetricScale { evidence, metres_per_unit: 0.5, relative_deviation: None };
        let frame = WorldFrame::of(&model, ring.as_ref(), None, Some(scale)).unwrap();
        assert_eq!((frame.up_evidence, frame.unit), (UpEvidence::LevelCameras, WorldUnit::Metre));
        assert!((frame.sim3().scale - 0.5).abs() < 1e-12, "metres, not radii");
        let x = frame.sim3().rotation * sim.rotation * DVec3::X;
        assert!(x.dot(UP).abs() < 0.05, "the path's axis stays level: {x}");
    }

    #[test]
    fn a_frame_that_is_kept_says_what_is_up_in_it() {
        let model = filmed(&steps(0.0, 10.0, 36), 25.0, &tumbled());
        let poses: Vec<Pose> = model.images.values().map(|i| i.pose).collect();
        let frame = WorldFrame::of(&model, Ring::fit(&poses).as_ref(), None, None).unwrap();
        let kept = frame.kept(Sim3::IDENTITY);
        let up = DVec3::from_array(kept.up);
        assert!(up.angle_between(tumbled().rotation * DVec3::Z) < 1e-3, "{kept:?}");
        assert_eq!((kept.sim3().scale, kept.unit), (1.0, WorldUnit::Unchanged));
    }
}
