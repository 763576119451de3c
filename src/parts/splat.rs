//! The splat of an object with moving parts: trained on the model that `parts` corrected.

use super::{meshes, record};
use crate::args::{EvalConfig, MeshConfig};
use crate::evaluate;
use crate::record::{Evaluation, KnownRun};
use anyhow::{Context, Result};
use glam::DVec3;
use scene::sim3::Sim3;
use scene::{FrameSet, Gaussians, Pose, Progress, Reconstruction};
use sfm::{Articulation, MovingPart};
use splat::{Dataset, Joint, MovingParts};
use std::ops::Range;
use std::path::Path;

/// What was found: the frames, the corrected model, and the parts.
pub(super) struct PartsTraining<'a> {
    pub(super) frames: &'a FrameSet,
    pub(super) model: &'a Reconstruction,
    pub(super) parts: &'a mut Articulation,
    /// How often the held-out views are rendered to measure frames per second.
    pub(super) fps_loops: u32,
}

impl PartsTraining<'_> {
    /// Trains a splat as the run's was into `folder` and judges it on the views that are held out.
    /// Angles are refined on the photos.
    pub(super) fn train(mut self, run: &Path, folder: &Path, progress: &Progress) -> Result<Evaluation> {
        let mut config = KnownRun::read(run)?.config;
        // Nothing beside the splat would say so when it is shown.
        config.train.antialias = false;
        let set = folder.join("undistorted");
        sfm::undistort(self.frames, self.model, &set, progress)?;
        let mut dataset = evaluate::load_to_train_splat(&set, &config.dataset, progress)?;
        let moving = self.moving(&dataset);
        dataset.articulate(moving, &self.parts.parts.iter().map(places_of).collect::<Vec<_>>());
        let checkpoints = folder.join(".train");
        let mut result = splat::train(&dataset, &config.train, Some(&checkpoints), progress)?;
        let moved = result.moving.context("training forgot the parts")?;
        self.refined(&dataset, moved);
        self.rest_in_the_first_frame(&mut result.gaussians);
        scene::io::ply::write_splat_ply(&folder.join("splat.ply"), &result.gaussians)?;
        record::write(folder, self.parts)?;
        std::fs::remove_dir_all(&checkpoints).ok();
        // Training had no use for the photos of views that are held out; surfaces have.
        drop(dataset);
        let dataset = evaluate::load_dataset(&set, &config.dataset, progress)?;
        let (fps_loops, mesh) = (self.fps_loops, MeshConfig::default());
        let shape = (&result.gaussians, &*self.parts);
        let (times, fine) = (seconds(self.frames), (splat::fusion::DEFAULT_RESOLUTION, progress));
        meshes::write(&folder.join("parts.glb"), shape, dataset, &times, fine)?;
        let judged = EvalConfig { lpips_weights: Vec::new(), fps_loops, mesh };
        evaluate::evaluate(folder, folder, &config.dataset, &judged, &config.train.device, progress)
    }

    /// Angles count from the first frame, where the parts are at rest: photos change that one, too.
    fn rest_in_the_first_frame(&mut self, gaussians: &mut Gaussians) {
        let mut end = self.parts.gaussians.first().copied().unwrap_or(0);
        for (part, count) in self.parts.parts.iter_mut().zip(self.parts.gaussians.iter().skip(1)) {
            let (first, own) = (part.angles_deg.first().copied().unwrap_or(0.0), end..end + count);
            end = own.end;
            move_some(gaussians, own, &part.pose(first));
            part.angles_deg.iter_mut().for_each(|angle| *angle -= first);
        }
    }

    /// The parts as the views of the data set have them.
    fn moving(&self, dataset: &Dataset) -> MovingParts {
        let numbers: Vec<Option<usize>> = dataset.views.iter().map(|v| self.parts.number(&v.name)).collect();
        let times = sfm::frame_times(self.frames);
        MovingParts {
            joints: self.parts.parts.iter().map(|part| joint(part, &numbers)).collect(),
            times: numbers.iter().map(|k| k.map_or(0.0, |k| times[k])).collect(),
            ..MovingParts::default()
        }
    }

    /// Takes over what training found out; parts for which it had no room are left out. Angles of
    /// frames without a view stay as they were.
    fn refined(&mut self, dataset: &Dataset, found: MovingParts) {
        self.parts.gaussians = found.gaussians;
        self.parts.parts.truncate(found.joints.len());
        for (part, joint) in self.parts.parts.iter_mut().zip(&found.joints) {
            (part.axis, part.place) = (joint.axis.to_array(), joint.place.to_array());
            for (view, angle) in joint.angles.iter().enumerate() {
                let Some(frame) = self.parts.frames.iter().position(|f| *f == dataset.views[view].name)
                else {
                    continue;
                };
                part.angles_deg[frame] = angle.to_degrees();
                part.angle_sigmas_deg[frame] = joint.sigmas[view].to_degrees();
            }
        }
    }
}

/// The Gaussians of a range moved by a pose.
fn move_some(all: &mut Gaussians, range: Range<usize>, pose: &Pose) {
    let mut some = all.clone();
    some.retain(|i| range.contains(&i));
    some.transform(&Sim3 { scale: 1.0, rotation: pose.rotation, translation: pose.translation });
    let each = all.sh.len().checked_div(all.len()).unwrap_or(0);
    all.sh[each * range.start..each * range.end].copy_from_slice(&some.sh);
    all.rotations[range.clone()].copy_from_slice(&some.rotations);
    all.means[range].copy_from_slice(&some.means);
}

/// The joint of a part, as views have it that are frames of these numbers.
fn joint(part: &MovingPart, frames: &[Option<usize>]) -> Joint {
    Joint {
        axis: DVec3::from(part.axis),
        place: DVec3::from(part.place),
        angles: by_view(&part.angles_deg, frames),
        sigmas: by_view(&part.angle_sigmas_deg, frames),
        unsure: [part.axis_sigma_deg.to_radians(), part.place_sigma],
    }
}

/// What frames have, degrees, by view, radians; 0 where a view is none of the frames.
fn by_view(of_frames: &[f64], frames: &[Option<usize>]) -> Vec<f64> {
    frames.iter().map(|k| k.and_then(|k| of_frames.get(k)).map_or(0.0, |v| v.to_radians())).collect()
}

/// The points of a part.
fn places_of(part: &MovingPart) -> Vec<DVec3> {
    part.points.iter().map(|p| DVec3::from(*p)).collect()
}

/// When the frames were taken; by their numbers, 30 a second, where that is not known.
fn seconds(frames: &FrameSet) -> Vec<f64> {
    frames.times().unwrap_or_else(|| (0..frames.len()).map(|k| k as f64 / FRAMES_A_SECOND).collect())
}

/// Frames a second where no time is known. Source: common.
const FRAMES_A_SECOND: f64 = 30.0;
