//! The splat of an object with moving parts: trained on the model that `parts` corrected.

use super::meshes;
use crate::args::{EvalConfig, MeshConfig};
use crate::evaluate;
use crate::record::{Evaluation, KnownRun};
use anyhow::{Context, Result};
use glam::DVec3;
use scene::{FrameSet, Progress, Reconstruction};
use sfm::Articulation;
use splat::parts::{Articulation as Moving, Joint, MOST_PARTS};
use splat::{Dataset, MovingResult};
use std::path::Path;

/// What was found: the frames, the corrected model, and the parts.
pub(super) struct Found<'a> {
    pub(super) frames: &'a FrameSet,
    pub(super) model: &'a Reconstruction,
    pub(super) parts: &'a mut Articulation,
    /// How often the held-out views are rendered to measure frames per second.
    pub(super) fps_loops: u32,
}

impl Found<'_> {
    /// Trains a splat as the run's was into `folder` and judges it on the views that are held out.
    /// Angles are refined on the photos.
    pub(super) fn train(mut self, run: &Path, folder: &Path, progress: &Progress) -> Result<Evaluation> {
        let config = KnownRun::read(run)?.config;
        self.parts.parts.truncate(MOST_PARTS);
        let set = folder.join("undistorted");
        sfm::undistort(self.frames, self.model, &set, progress)?;
        let mut dataset = evaluate::load_to_train(&set, &config.dataset, progress)?;
        let moving = self.moving(&mut dataset);
        dataset.articulate(moving);
        let checkpoints = folder.join(".train");
        let result = splat::train(&dataset, &config.train, Some(&checkpoints), progress)?;
        scene::io::ply::write_splat_ply(&folder.join("splat.ply"), &result.gaussians)?;
        let moved = result.moving.context("training forgot the parts")?;
        self.refined(&dataset, moved);
        super::write(folder, self.parts)?;
        std::fs::remove_dir_all(&checkpoints).ok();
        let (fps_loops, mesh) = (self.fps_loops, MeshConfig::default());
        let shape = (&result.gaussians, &*self.parts);
        let (times, fine) = (seconds(self.frames), (splat::fusion::DEFAULT_RESOLUTION, progress));
        meshes::write(&folder.join("parts.glb"), shape, &dataset, &times, fine)?;
        let judged = EvalConfig { lpips_weights: Vec::new(), fps_loops, mesh };
        evaluate::evaluate(folder, folder, &config.dataset, &judged, &config.train.device, progress)
    }

    /// The parts in the frame of the data set, which gets their points.
    fn moving(&self, dataset: &mut Dataset) -> Moving {
        let frame = dataset.normalisation;
        let numbers: Vec<Option<usize>> = dataset.views.iter().map(|v| self.parts.number(&v.name)).collect();
        let by_view = |of_frames: &[f64]| -> Vec<f64> {
            numbers.iter().map(|k| k.and_then(|k| of_frames.get(k)).map_or(0.0, |v| v.to_radians())).collect()
        };
        let times = sfm::frame_times(self.frames);
        let mut moving = Moving {
            of_points: vec![0; dataset.points.len()],
            times: numbers.iter().map(|k| k.map_or(0.0, |k| times[k])).collect(),
            ..Moving::default()
        };
        for (number, part) in (1..).zip(&self.parts.parts) {
            for point in &part.points {
                dataset.points.push((frame.point(DVec3::from(*point)), GREY));
                moving.of_points.push(number);
            }
            moving.joints.push(Joint {
                axis: DVec3::from(part.axis),
                place: frame.point(DVec3::from(part.place)).as_dvec3(),
                angles: by_view(&part.angles_deg),
                sigmas: by_view(&part.angle_sigmas_deg),
            });
        }
        moving
    }

    /// Takes over what training found out. Angles of frames without a view stay as they were.
    fn refined(&mut self, dataset: &Dataset, found: MovingResult) {
        self.parts.gaussians = found.gaussians;
        for (part, (angles, sigmas)) in
            self.parts.parts.iter_mut().zip(found.angles.iter().zip(&found.sigmas))
        {
            for (k, name) in self.parts.frames.iter().enumerate() {
                let Some(view) = dataset.views.iter().position(|v| v.name == *name) else { continue };
                part.angles_deg[k] = angles[view].to_degrees();
                part.angle_sigmas_deg[k] = sigmas[view].to_degrees();
            }
        }
    }
}

/// When the frames were taken; by their numbers, 30 a second, where that is not known.
fn seconds(frames: &FrameSet) -> Vec<f64> {
    let by_number = || (0..frames.frames.len()).map(|k| k as f64 / FRAMES_A_SECOND).collect();
    frames.times().unwrap_or_else(by_number)
}

/// Frames a second where no time is known. Source: common.
const FRAMES_A_SECOND: f64 = 30.0;

/// Colour of the first Gaussians of a part: its points have none yet. Source: any will do.
const GREY: [u8; 3] = [128; 3];
